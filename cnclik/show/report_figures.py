"""Figures of a report as images inside the page, kept small."""

import base64
import pathlib
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import Collection
from matplotlib.lines import Line2D

from cnclik.show import style

MOST_POINTS = 2500  # a line or collection with more points is drawn as pixels
MOST_BYTES = 250_000  # a larger SVG is replaced by a PNG


def picture(make, name: str, about: dict) -> str:
    """A figure as an element of a page: an image in SVG, or in PNG where that is large.

    Args:
      make: makes the figure; it may be called twice. about: the description in the file.
    """
    with tempfile.TemporaryDirectory() as place, style.style():
        file, kind, look = pathlib.Path(place, "figure.svg"), "svg+xml", ""
        figure = make()
        _rasterise(figure)
        style.save(figure, file, about)
        if file.stat().st_size > MOST_BYTES:
            file, kind, look = file.with_suffix(".png"), "png", ' class="pixels"'
            style.save(make(), file, about)
        return f'<img alt="{name}"{look} src="data:image/{kind};base64,{base64.b64encode(file.read_bytes()).decode()}">'


def _rasterise(figure) -> None:
    for one in figure.findobj(Line2D):
        if len(one.get_xdata(orig=False)) > MOST_POINTS:
            one.set_rasterized(True)
    for one in figure.findobj(Collection):
        if sum(len(path.vertices) for path in one.get_paths()) > MOST_POINTS:
            one.set_rasterized(True)


def errors_beside(motions):
    """The errors of motions over time, on a logarithmic scale."""
    kinds = [what for what in motions[0].error if any(what in m.error for m in motions[1:] or motions)]
    size = (style.COLUMN, 0.5 + 1.6 * len(kinds))
    figure, panels = plt.subplots(len(kinds), 1, sharex=True, squeeze=False, figsize=size)
    for panel, what in zip(panels[:, 0], kinds, strict=True):
        for k, motion in enumerate(motions):
            values = motion.error[what]
            look = {"color": style.COLORS[k], "linestyle": style.DASHES[k], "label": motion.name}
            panel.plot(motion.t, np.where(values > 0, values, np.nan), **look)
        style.log_errors(panel, [motion.error[what] for motion in motions])
        panel.set_ylabel(what)
    panels[-1, 0].set_xlabel("time $t$ [s]")
    style.legend(figure, panels[0, 0], columns=1)
    return figure
