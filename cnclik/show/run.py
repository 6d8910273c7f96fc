"""One loop in pictures: joint paths, error, joint velocities, status."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.ticker import MaxNLocator

from cnclik.integrate.status import Status
from cnclik.show import style

_LIMIT = {"color": style.VERMILION, "linewidth": 0.8, "linestyle": (0, (4, 2)), "zorder": 2}
_PART = {
    "m": ("position error ‖e‖ [m]", style.BLUE, "-"),
    "rad": ("orientation error ‖e‖ [rad]", style.ORANGE, (0, (5, 2))),
}


def joint_paths(data, chain):
    """Joint values against time, one panel per joint, with their limits where the path comes near them."""

    def draw(panel, i):
        q = data.q.values[:, i]
        panel.plot(data.time, q, color=style.BLACK)
        room = max(np.ptp(q), 0.1)
        for bound in (chain.lower[i], chain.upper[i]):
            if q.min() - room < bound < q.max() + room:
                panel.axhline(bound, **_LIMIT)

    return _per_joint(data, draw, lambda unit: unit)


def joint_velocities(data, chain):
    """Joint velocities, held during each step, with their limits where the velocity comes near them."""

    fastest = np.nanmax(np.abs(data.qdot.values), initial=0.0) or 1.0

    def draw(panel, i):
        v = data.qdot.values[:, i]
        if np.nanmax(np.abs(v), initial=0.0) <= 1e-9 * fastest:  # rounding, which would fill the panel
            v = np.where(np.isfinite(v), 0.0, v)
            panel.set_ylim(-0.1 * fastest, 0.1 * fastest)
        panel.stairs(v, data.time.values, color=style.BLACK, baseline=None, linewidth=1.0)
        limit = chain.velocity_limit[i]
        for bound in (-limit, limit):
            if np.isfinite(limit) and np.nanmax(np.abs(v)) > 0.5 * limit and bound * v[np.nanargmax(np.abs(v))] > 0:
                panel.axhline(bound, **_LIMIT)

    return _per_joint(data, draw, lambda unit: f"{unit}/s")


def error(data):
    """Norms of the position and of the orientation error against time, on a logarithmic scale."""
    figure, panel = plt.subplots(figsize=(style.COLUMN, 2.2))
    usual = []
    for unit, (label, color, dashes) in _PART.items():
        part = data.e.values[:, data.axis_unit.values == unit]
        if part.size:
            norm = np.linalg.norm(part, axis=1)
            panel.plot(data.time, np.where(norm > 0, norm, np.nan), color=color, linestyle=dashes, label=label)
            positive = norm[norm > 0]
            usual += [np.quantile(positive, 0.01)] if positive.size else []
    panel.set_yscale("log")
    if usual:  # a start exactly on the path would stretch the axis down to rounding
        panel.set_ylim(bottom=0.3 * min(usual))
    panel.set_xlabel("time $t$ [s]")
    panel.set_ylabel("error norm")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def status(data):
    """What was wrong in each step, one line per status bit; an empty line is good."""
    bits = [s for s in Status if s]
    figure, panel = plt.subplots(figsize=(style.COLUMN, 1.4))
    edges = data.time.values
    if not data.status.values.any():
        panel.text(0.5, 0.5, "every step OK", transform=panel.transAxes, ha="center", va="center", color="0.4")
    for row, bit in enumerate(reversed(bits)):
        bad = np.flatnonzero(data.status.values & bit.value)
        spans = [(edges[k], edges[k + 1] - edges[k]) for k in bad]
        panel.broken_barh(_merged(spans), (row - 0.35, 0.7), color=style.VERMILION, linewidth=0)
    panel.set_yticks(range(len(bits)), [b.name.replace("_", " ").lower() for b in reversed(bits)])
    panel.set_ylim(-0.6, len(bits) - 0.4)
    panel.set_xlim(edges[0], edges[-1])
    panel.set_xlabel("time $t$ [s]")
    panel.grid(axis="y", visible=False)
    return figure


def _merged(spans):
    """Neighbouring steps as one bar."""
    merged = []
    for start, width in spans:
        if merged and np.isclose(sum(merged[-1]), start, rtol=1e-9, atol=1e-12):
            merged[-1] = (merged[-1][0], start + width - merged[-1][0])
        else:
            merged.append((start, width))
    return merged


def _per_joint(data, draw, unit):
    n = data.sizes["joint"]
    columns = 1 if n <= 3 else 2
    rows = -(-n // columns)
    width = style.COLUMN if columns == 1 else style.PAGE
    figure, grid = plt.subplots(rows, columns, sharex=True, squeeze=False, figsize=(width, 0.5 + 0.95 * rows))
    panels = grid.T.ravel()
    for i, panel in enumerate(panels):
        if i >= n:  # an odd joint's neighbour: only its time axis, so that the rows stay even
            panel.spines["left"].set_visible(False)
            panel.set_yticks([])
            panel.set_xlabel("time $t$ [s]")
            continue
        draw(panel, i)
        panel.set_title(str(data.joint.values[i]), loc="left", pad=2)
        panel.set_ylabel(f"[{unit(str(data.joint_unit.values[i]))}]")
        panel.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
        panel.margins(x=0.01, y=0.12)
        if i % rows == rows - 1:
            panel.set_xlabel("time $t$ [s]")
    figure.align_ylabels(grid[:, 0])
    return figure
