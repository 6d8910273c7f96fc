"""Figures of a report: as SVG that stands in a page beside others, small whatever is drawn."""

import base64
import pathlib
import re
import tempfile

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import Collection
from matplotlib.lines import Line2D

from cnclik.show import style

MOST_POINTS = 2500  # of a line or a collection that is drawn as paths; what has more becomes pixels
MOST_BYTES = 250_000  # of an SVG; a larger one becomes a picture

_ID = re.compile(r'\bid="([^"]+)"')
_REFERENCE = re.compile(r'(xlink:href="#|href="#|url\(#)')
_HEAD = re.compile(r"^.*?(?=<svg)", re.S)
_ABOUT = re.compile(r"<metadata>.*?</metadata>\s*", re.S)
_SHEET = re.compile(r"\*\s*\{([^}]*)\}")


def picture(make, name: str, about: dict, number: int) -> str:
    """A figure as an element of a page: SVG, or PNG where that is large.

    Args:
      make: makes the figure; it may be called twice. about: what the file says of itself. number: of it on the page.
    """
    with tempfile.TemporaryDirectory() as place, style.style():
        vector, pixels = pathlib.Path(place, "figure.svg"), pathlib.Path(place, "figure.png")
        figure = make()
        _rasterise(figure)
        style.save(figure, vector, about)
        text = vector.read_text(encoding="utf-8")
        if len(text) <= MOST_BYTES:
            return inline(text, f"f{number}-", name)
        style.save(make(), pixels, about)
        data = base64.b64encode(pixels.read_bytes()).decode()
    return f'<img alt="{name}" src="data:image/png;base64,{data}">'


def inline(svg: str, prefix: str, name: str) -> str:
    """An SVG file's text for a page that holds others: no head, every id its own, its sheet for itself alone."""
    svg = _ABOUT.sub("", _HEAD.sub("", svg, count=1))
    svg = _ID.sub(lambda m: f'id="{prefix}{m[1]}"', svg)
    svg = _REFERENCE.sub(lambda m: m[1] + prefix, svg)
    svg = _SHEET.sub(lambda m: f"#{prefix}figure *{{{m[1]}}}", svg, count=1)
    return svg.replace("<svg ", f'<svg id="{prefix}figure" role="img" aria-label="{name}" ', 1).strip()


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
