"""One loop in pictures: joint values, error, joint velocities, status, and the paths of its tips.

Each function draws a dataset of `cnclik.measure.dataset.to_dataset`.
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from cnclik import errors
from cnclik.integrate.status import Status, level
from cnclik.integrate.trajectory import Trajectory, check_run
from cnclik.law.law import Law
from cnclik.measure.dataset import to_dataset
from cnclik.precision import of_numbers
from cnclik.robot.posture import is_planar
from cnclik.show import style
from cnclik.show.motion import error_parts, motion_of

_TIME = "time $t$ [s]"
_PARTS = {
    "m": ("position [m]", {"color": style.BLUE}),
    "rad": ("orientation [rad]", {"color": style.PURPLE, "linestyle": style.DASH}),
}


@of_numbers
def plot(run: Trajectory, law: Law, kind: str = "overview") -> Figure:
    """Draw one run: `ck.plot(run, law)`.

    Args:
      run: `Trajectory` of solve(law, ...), one lane.
      kind: "overview" (joint values, error, joint velocities, status) or "tip" (its path).

    Returns: a matplotlib Figure.
    Raises: ArgumentError for another kind, or a batch of runs.
    """
    draw = KINDS[errors.one_of("kind", kind, KINDS)]
    check_run(run, lanes=False)
    with style.style():
        return draw(to_dataset(run, law), law.chain)


def tip(data, chain):
    """Draw the paths of the tips and of their targets in space, or in the plane of a planar robot, at one scale."""
    motion, axes = motion_of(data, chain), "xy" if is_planar(chain) else "xyz"
    figure = plt.figure(figsize=(style.COLUMN, 3.4))
    panel: Any = figure.add_subplot(projection="3d" if len(axes) == 3 else None)
    for i, (about, way, target) in enumerate(zip(chain.tips, motion.paths, motion.targets, strict=True)):
        look, more = {"color": style.COLORS[i % len(style.COLORS)]}, "_" * bool(i)  # no second entry in the legend
        end = {"marker": "o", "markevery": [-1]}  # a constant target shows nothing else
        name, way = about.name if len(chain.tips) > 1 else "tip", way[:, : len(axes)].T
        panel.plot(*way, **end, **look, linewidth=1.2, label=name, zorder=3)
        if target is not None:
            about = {"color": "0.6", "linewidth": 2.4, "markersize": 6, "label": f"{more}target"}
            panel.plot(*target[:, : len(axes)].T, **end, **about)
        panel.plot(*way[:, :1], "s", **look, markerfacecolor="white", label=f"{more}start", zorder=4)
    points = np.concatenate([way for way in (*motion.paths, *motion.targets) if way is not None])[:, : len(axes)]
    room = max(0.55 * np.ptp(points, axis=0).max(), 1e-3)  # for resting tips 1 mm
    for name, middle in zip(axes, (points.min(axis=0) + points.max(axis=0)) / 2, strict=True):
        panel.set(**{f"{name}lim": (middle - room, middle + room), f"{name}label": f"${name}$ [m]"})
    panel.set_box_aspect((1, 1, 1), zoom=0.8) if len(axes) == 3 else panel.set_aspect("equal")
    panel.locator_params(nbins=4)
    style.legend(figure, panel)
    return figure


def overview(data, chain):
    """Joint values, error, joint velocities (over their limits where all joints have one) and status at a glance."""
    figure, ((joints, size), (speed, flags)) = plt.subplots(2, 2, sharex=True, figsize=(style.PAGE, 4.4))
    limits = np.asarray(chain.velocity_limit)
    limited = bool(np.all(np.isfinite(limits)))
    speeds = data.qdot.values / limits if limited else data.qdot.values
    for i, name in enumerate(data.joint.values):
        color, dashes = style.COLORS[i % len(style.COLORS)], style.DASHES[i % len(style.DASHES)]
        look = {"color": color, "linestyle": dashes, "linewidth": 1.0}
        joints.plot(data.time, data.q[:, i], label=name, **look)
        speed.stairs(speeds[:, i], data.time.values, baseline=None, **look)
    joints.set_ylabel(f"joint value [{data.q.units}]")
    speed.set_ylabel("joint velocity over its limit" if limited else f"joint velocity [{data.qdot.units}]")
    near = [side for side in (-1, 1) if limited and np.nanmax(side * speeds, initial=0.0) > 0.5]
    for side in near:
        speed.axhline(side, **style.LIMIT)
    _draw_error(size, data)
    _draw_status(flags, data)
    for panel in (speed, flags):
        panel.set_xlabel(_TIME)
    style.legend(figure, joints)
    return figure


KINDS = {"overview": overview, "tip": tip}


def _draw_error(panel, data):
    """Draw a line for positions and one for orientations, of each task in a colour of its own."""
    tasks, norms = data.task.values.tolist() if "task" in data.coords else [], []
    for task, unit, some in error_parts(data):
        label, look = _PARTS.get(unit, (f"[{unit}]", {"color": style.BLACK}))
        if task:
            look = style.series(tasks.index(task), marker="", linestyle=style.DASH if unit == "rad" else "-")
            label = f"{task} [{unit}]"
        norms.append(np.linalg.norm(data.e.values[:, some], axis=1))
        panel.plot(data.time, np.where(norms[-1] > 0, norms[-1], np.nan), label=label, **look)
    style.log_errors(panel, norms)
    panel.set_ylabel(f"error ‖e‖ [{', '.join(dict.fromkeys(data.axis_unit.values))}]")
    panel.legend(loc="best")


def _draw_status(panel, data):
    edges, bits = data.time.values, [bit for bit in Status if bit]
    if not data.status.values.any():
        panel.text(0.5, 0.5, "every step OK", transform=panel.transAxes, ha="center", va="center", color="0.4")
    for row, bit in enumerate(bits):
        has = (data.status.values & bit.value) != 0
        changes = np.flatnonzero(np.diff(has, prepend=False, append=False)).reshape(-1, 2)  # first and end of each bar
        spans = [(edges[first], edges[end] - edges[first]) for first, end in changes]
        panel.broken_barh(spans, (row - 0.35, 0.7), color=style.LEVELS[level(bit)], linewidth=0)
    panel.set_yticks(range(len(bits)), [str(bit.name).replace("_", " ").lower() for bit in bits])
    panel.set_ylim(len(bits) - 0.4, -0.6)
    panel.set_xlim(edges[0], edges[-1])
    panel.grid(axis="y", visible=False)
