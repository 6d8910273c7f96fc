"""Figures of reaching: where a robot can put its tip, with the robot in it."""

import matplotlib.pyplot as plt
import numpy as np

from cnclik.show import style

_LONG = {"x": "x [m]", "y": "y [m]", "z": "z [m]"}


def reachability(found, *, title=""):
    """Share of orientations, and how far from singular answers are, over a plane; of a box, the best along each axis.

    Args:
      found: from `cnclik.reaching.reachability`.
    """
    if len(found.axes) == 3:
        return _box(found, title)
    figure, panels = plt.subplots(1, 2, figsize=(style.PAGE, 3.3))
    many = found.reached.task.orientation
    what = "share of orientations reached" if many else "reached"
    _panel(figure, panels[0], found, found.share, found.axes, what, vmax=1.0)
    what = "least singular value, median (lengths in m)"
    _panel(figure, panels[1], found, found.least_singular_value, found.axes, what)
    figure.suptitle(title)
    return figure


def _box(found, title):
    figure, panels = plt.subplots(1, 3, figsize=(style.PAGE, 2.7))
    for panel, gone in zip(panels, (2, 1, 0), strict=True):
        axes = tuple(a for i, a in enumerate(found.axes) if i != gone)
        share = np.max(found.share, axis=gone)
        _panel(figure, panel, found, share, axes, f"share reached, best along {found.axes[gone]}", vmax=1.0)
    figure.suptitle(title)
    return figure


def _panel(figure, panel, found, values, axes, what, vmax=None):
    across, up = (found.places[found.axes.index(a)] for a in axes)
    shown = np.where(values > 0, values, np.nan).T
    mesh = panel.pcolormesh(across, up, shown, cmap="viridis", vmin=0.0, vmax=vmax, shading="nearest", rasterized=True)
    i, j = ("xyz".index(a) for a in axes)
    for width, color in ((3.2, "white"), (1.4, style.BLACK)):
        panel.plot(
            found.arm[:, i], found.arm[:, j], "o-", color=color, linewidth=width, markersize=width + 1.2, zorder=4
        )
    figure.colorbar(mesh, ax=panel, label=what, location="top", shrink=0.9, pad=0.02)
    panel.set(xlabel=_LONG[axes[0]], ylabel=_LONG[axes[1]], aspect="equal")
    panel.grid(False)
    panel.set_facecolor("0.95")
