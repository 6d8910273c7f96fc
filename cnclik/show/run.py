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
_BITS = [bit for bit in Status if bit]


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
    looks = [{"color": "0.7", "linewidth": 2.6, "label": "before"}]  # visible behind a coinciding one
    looks += [{"color": style.BLUE, "linewidth": 1.2, "label": "after"}]
    for panel, (task, unit, some) in zip(panels[:, 0], parts, strict=True):
        norms = [np.linalg.norm(data.e.values[:, some], axis=1) for data in (before, after)]
        for norm, look in zip(norms, looks, strict=True):
            panel.plot(after.time, np.where(norm > 0, norm, np.nan), **look)
        style.log_errors(panel, norms)
        what = task or {"m": "position", "rad": "orientation"}.get(unit, "")
        panel.set_ylabel(f"{what} error [{unit}]".strip())
    panels[0, 0].legend(ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.2)
    panels[-1, 0].set_xlabel(_TIME)
    return figure


def tip(data, chain):
    """Draw the paths of each tip and of its target in space, or in the plane of a planar robot, at one scale."""
    motion, axes = motion_of(data, chain), "xy" if is_planar(chain) else "xyz"
    every = list(zip([tip.name for tip in chain.tips], motion.paths, motion.targets, strict=True))
    space = {} if len(axes) == 2 else {"subplot_kw": {"projection": "3d"}}
    columns = 2 if len(every) == 4 else min(len(every), 3)
    rows = -(-len(every) // columns)
    size = (style.COLUMN, 3.2) if columns == 1 else (style.PAGE / 3 * columns, 0.4 + 2.5 * rows)
    figure, grid = plt.subplots(rows, columns, squeeze=False, figsize=size, **space)
    for panel in grid.flat[len(every) :]:
        panel.set_axis_off()
    points = [np.concatenate([way for way in paths if way is not None])[:, : len(axes)] for _, *paths in every]
    room = max(0.55 * max(np.ptp(some, axis=0).max() for some in points), 1e-3)  # for resting tips 1 mm
    for panel, (name, *paths) in zip(grid.flat, every, strict=False):
        _draw_tip(panel, axes, *paths, room, alone=len(every) == 1)
        if len(every) > 1:
            panel.set_title(name, pad=2)
    style.legend(figure, max(grid.flat, key=lambda panel: len(panel.get_lines())))
    return figure


def _draw_tip(panel, axes, way, target, room, alone):
    paths = [(way[:, : len(axes)], {"color": style.BLUE, "linewidth": 1.2, "label": "tip", "zorder": 3})]
    if target is not None:
        look = {"color": "0.6", "linewidth": 2.4, "markersize": 6, "label": "target"}
        paths.append((target[:, : len(axes)], look))
    for points, look in paths:
        marker = {"marker": "o", "markevery": [-1]}  # the end; a constant target shows nothing else
        panel.plot(*points.T, **marker, **look)
    panel.plot(*paths[0][0][:1].T, "s", color=style.BLUE, markerfacecolor="white", label="start", zorder=4)
    every = np.concatenate([points for points, _ in paths])
    low, high = every.min(axis=0), every.max(axis=0)
    for name, middle in zip(axes, (low + high) / 2, strict=True):
        panel.set(**{f"{name}lim": (middle - room, middle + room), f"{name}label": f"${name}$ [m]"})
        getattr(panel, f"{name}axis").set_major_locator(MaxNLocator(4 if alone else 3))
    if len(axes) > 2:
        panel.set_box_aspect((1, 1, 1), zoom=0.9 if alone else 0.75)  # room for the labels
        for axis, tick, label in ((panel.xaxis, -2, -3), (panel.yaxis, -2, 0), (panel.zaxis, 3, 2)):
            axis.set_tick_params(pad=tick)
            axis.labelpad = label
    else:
        panel.set_aspect("equal")


def overview(data, chain):
    """Joint values, error, joint velocities (over their limits where all joints have one) and status at a glance."""
    figure, ((joints, size), (speed, flags)) = plt.subplots(2, 2, sharex=True, figsize=(style.PAGE, 4.4))
    limits = np.asarray(chain.velocity_limit)
    limited = bool(np.all(np.isfinite(limits)))
    for i, name in enumerate(data.joint.values):
        look = style.series(i, linewidth=1.0)
        every = style.sparse(i, data.sizes["time"])
        joints.plot(data.time, data.q.values[:, i], label=str(name), markevery=every, **look)
        v = data.qdot.values[:, i] / (limits[i] if limited else 1.0)
        unmarked = {key: value for key, value in look.items() if not key.startswith("mark")}
        speed.stairs(v, data.time.values, baseline=None, **unmarked)
    joints.set_ylabel(f"joint value [{data.q.units}]")
    speed.set_ylabel("joint velocity over its limit" if limited else f"joint velocity [{data.qdot.units}]")
    for side in (-1, 1) if limited else ():
        if np.nanmax(side * data.qdot.values / limits, initial=0.0) > 0.5:
            label = None if speed.get_legend_handles_labels()[0] else "limit"
            speed.axhline(side, label=label, **style.LIMIT)
            speed.legend(loc="best", fontsize=6.5)
    _draw_error(size, data)
    size.legend(loc="best")
    _draw_status(flags, data)
    for panel in (speed, flags):
        panel.set_xlabel(_TIME)
    style.legend(figure, joints)
    return figure


KINDS = {"overview": overview, "tip": tip}


def _draw_error(panel, data):
    norms = []
    for label, look, some in _error_parts(data):
        norm = np.linalg.norm(data.e.values[:, some], axis=1)
        panel.plot(data.time, np.where(norm > 0, norm, np.nan), label=label, **look)
        norms.append(norm)
    style.log_errors(panel, norms)
    panel.set_ylabel(f"error ‖e‖ [{', '.join(dict.fromkeys(data.axis_unit.values))}]")


def _error_parts(data):
    """(label, look, which coordinates) of each line: positions and orientations, of each task a colour."""
    tasks, found = data.task.values.tolist() if "task" in data.coords else [], []
    for task, unit, some in error_parts(data):
        if not task:
            found.append((*_PARTS.get(unit, (f"[{unit}]", {"color": style.BLACK})), some))
            continue
        color = style.COLORS[tasks.index(task) % len(style.COLORS)]
        look = {"color": color, "linestyle": style.DASH if unit == "rad" else "-"}
        found.append((f"{task} [{unit}]", look, some))
    return found


def _status_rows(data):
    """(label, colour, whether each step has it) of each row; in a stack a row for each task that has it alone."""
    found = []
    for bit in _BITS:
        words = bit.name.replace("_", " ").lower()
        color = style.LEVELS[level(bit)]
        own = data.task_status.values.T & bit.value if "task_status" in data and bit & OWN else np.zeros((0, 1))
        if own.any():
            found += [
                (f"{words}: {task}", color, has != 0)
                for task, has in zip(data.task.values, own, strict=True)
                if has.any()
            ]
        else:
            found.append((words, color, (data.status.values & bit.value) != 0))
    return found


def _draw_status(panel, data):
    edges = data.time.values
    if not data.status.values.any():
        panel.text(0.5, 0.5, "every step OK", transform=panel.transAxes, ha="center", va="center", color="0.4")
    rows = _status_rows(data)
    for row, (_, color, has) in enumerate(rows):
        bad = np.flatnonzero(has)
        together = np.split(bad, np.flatnonzero(np.diff(bad) > 1) + 1)  # neighbouring steps as one bar
        spans = [(edges[steps[0]], edges[steps[-1] + 1] - edges[steps[0]]) for steps in together if steps.size]
        panel.broken_barh(spans, (row - 0.35, 0.7), color=color, linewidth=0)
    panel.set_yticks(range(len(rows)), [label for label, *_ in rows])
    panel.set_ylim(len(rows) - 0.4, -0.6)
    panel.set_xlim(edges[0], edges[-1])
    panel.grid(axis="y", visible=False)
