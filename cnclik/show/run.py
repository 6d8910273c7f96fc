"""One loop in pictures: joint values, error, joint velocities, status, and the paths of its tips.

Each function draws a dataset of `cnclik.measure.dataset.to_dataset`.
"""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from cnclik import errors
from cnclik.integrate.status import OWN, Status, level
from cnclik.integrate.trajectory import Trajectory, one_lane
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
    one_lane(run)
    with style.style():
        return draw(to_dataset(run, law), law.chain)


def tuned(found):
    """Draw the norms of the errors of a `Tuned`, before in grey and after; of a stack a panel for each task."""
    before, after = (to_dataset(run, found.law) for run in (found.before, found.after))
    parts = error_parts(after)
    size = (style.COLUMN, 0.6 + 1.5 * len(parts))
    figure, panels = plt.subplots(len(parts), 1, figsize=size, sharex=True, squeeze=False)
    for panel, (task, unit, some) in zip(panels[:, 0], parts, strict=True):
        norms = [np.linalg.norm(data.e.values[:, some], axis=1) for data in (before, after)]
        panel.plot(after.time, _positive(norms[0]), color="0.7", linewidth=2.6, label="before")  # seen behind the other
        panel.plot(after.time, _positive(norms[1]), color=style.BLUE, linewidth=1.2, label="after")
        style.log_errors(panel, norms)
        what = task or {"m": "position", "rad": "orientation"}.get(unit, "")
        panel.set_ylabel(f"{what} error [{unit}]".strip())
    panels[0, 0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    panels[-1, 0].set_xlabel(_TIME)
    return figure


def tip(data, chain):
    """Draw the paths of each tip and of its target in space, or in the plane of a planar robot, at one scale."""
    motion, axes = motion_of(data, chain), "xy" if is_planar(chain) else "xyz"
    tips = list(zip(chain.tips, motion.paths, motion.targets, strict=True))
    space = {} if len(axes) == 2 else {"subplot_kw": {"projection": "3d"}}
    columns = 2 if len(tips) == 4 else min(len(tips), 3)
    rows = -(-len(tips) // columns)
    size = (style.COLUMN, 3.2) if columns == 1 else (style.PAGE / 3 * columns, 0.4 + 2.5 * rows)
    figure, grid = plt.subplots(rows, columns, squeeze=False, figsize=size, **space)
    for panel in grid.flat[len(tips) :]:
        panel.set_axis_off()
    points = [np.concatenate([way for way in paths if way is not None])[:, : len(axes)] for _, *paths in tips]
    room = max(0.55 * max(np.ptp(some, axis=0).max() for some in points), 1e-3)  # for resting tips 1 mm
    for panel, (about, way, target), some in zip(grid.flat, tips, points, strict=False):
        _draw_tip(panel, axes, way, target, alone=len(tips) == 1)
        for name, middle in zip(axes, (some.min(axis=0) + some.max(axis=0)) / 2, strict=True):
            panel.set(**{f"{name}lim": (middle - room, middle + room), f"{name}label": f"${name}$ [m]"})
        panel.set_title(about.name if len(tips) > 1 else "", pad=2)
    style.legend(figure, max(grid.flat, key=lambda panel: len(panel.get_lines())))
    return figure


def _draw_tip(panel, axes, way, target, alone):
    way, end = way[:, : len(axes)].T, {"marker": "o", "markevery": [-1]}  # a constant target shows nothing else
    panel.plot(*way, **end, color=style.BLUE, linewidth=1.2, label="tip", zorder=3)
    if target is not None:
        panel.plot(*target[:, : len(axes)].T, **end, color="0.6", linewidth=2.4, markersize=6, label="target")
    panel.plot(*way[:, :1], "s", color=style.BLUE, markerfacecolor="white", label="start", zorder=4)
    for name in axes:
        getattr(panel, f"{name}axis").set_major_locator(MaxNLocator(4 if alone else 3))
    if len(axes) == 2:
        panel.set_aspect("equal")
        return
    panel.set_box_aspect((1, 1, 1), zoom=0.9 if alone else 0.75)  # room for the labels
    for axis, tick, label in ((panel.xaxis, -2, -3), (panel.yaxis, -2, 0), (panel.zaxis, 3, 2)):
        axis.set_tick_params(pad=tick)
        axis.labelpad = label


def overview(data, chain):
    """Joint values, error, joint velocities (over their limits where all joints have one) and status at a glance."""
    figure, ((joints, size), (speed, flags)) = plt.subplots(2, 2, sharex=True, figsize=(style.PAGE, 4.4))
    limits = np.asarray(chain.velocity_limit)
    limited = bool(np.all(np.isfinite(limits)))
    speeds = data.qdot.values / limits if limited else data.qdot.values
    for i, name in enumerate(data.joint.values):
        look = style.series(i, linewidth=1.0)
        joints.plot(data.time, data.q[:, i], label=name, markevery=style.sparse(i, data.sizes["time"]), **look)
        unmarked = {key: value for key, value in look.items() if not key.startswith("mark")}
        speed.stairs(speeds[:, i], data.time.values, baseline=None, **unmarked)
    joints.set_ylabel(f"joint value [{data.q.units}]")
    speed.set_ylabel("joint velocity over its limit" if limited else f"joint velocity [{data.qdot.units}]")
    near = [side for side in (-1, 1) if limited and np.nanmax(side * speeds, initial=0.0) > 0.5]
    lines = [speed.axhline(side, **style.LIMIT) for side in near]
    if lines:
        speed.legend(lines[:1], ["limit"], loc="best", fontsize=6.5)
    _draw_error(size, data)
    _draw_status(flags, data)
    for panel in (speed, flags):
        panel.set_xlabel(_TIME)
    style.legend(figure, joints)
    return figure


KINDS = {"overview": overview, "tip": tip}


def _positive(norm):
    return np.where(norm > 0, norm, np.nan)


def _draw_error(panel, data):
    """Draw a line for positions and one for orientations, of each task in a colour of its own."""
    tasks, norms = data.task.values.tolist() if "task" in data.coords else [], []
    for task, unit, some in error_parts(data):
        label, look = _PARTS.get(unit, (f"[{unit}]", {"color": style.BLACK}))
        if task:
            look = style.series(tasks.index(task), marker="", linestyle=style.DASH if unit == "rad" else "-")
            label = f"{task} [{unit}]"
        norms.append(np.linalg.norm(data.e.values[:, some], axis=1))
        panel.plot(data.time, _positive(norms[-1]), label=label, **look)
    style.log_errors(panel, norms)
    panel.set_ylabel(f"error ‖e‖ [{', '.join(dict.fromkeys(data.axis_unit.values))}]")
    panel.legend(loc="best")


def _status_rows(data):
    """Yield (label, bit, whether each step has it) of each row; in a stack a row for each task that has it alone."""
    for bit in (bit for bit in Status if bit):
        words = bit.name.replace("_", " ").lower()
        own = data.task_status.values.T & bit.value if "task_status" in data and bit & OWN else np.zeros((0, 1))
        if own.any():
            tasks = zip(data.task.values, own, strict=True)
            yield from ((f"{words}: {task}", bit, has != 0) for task, has in tasks if has.any())
        else:
            yield words, bit, (data.status.values & bit.value) != 0


def _draw_status(panel, data):
    edges = data.time.values
    if not data.status.values.any():
        panel.text(0.5, 0.5, "every step OK", transform=panel.transAxes, ha="center", va="center", color="0.4")
    rows = list(_status_rows(data))
    for row, (_, bit, has) in enumerate(rows):
        changes = np.flatnonzero(np.diff(has, prepend=False, append=False)).reshape(-1, 2)  # first and end of each bar
        spans = [(edges[first], edges[end] - edges[first]) for first, end in changes]
        panel.broken_barh(spans, (row - 0.35, 0.7), color=style.LEVELS[level(bit)], linewidth=0)
    panel.set_yticks(range(len(rows)), [label for label, *_ in rows])
    panel.set_ylim(len(rows) - 0.4, -0.6)
    panel.set_xlim(edges[0], edges[-1])
    panel.grid(axis="y", visible=False)
