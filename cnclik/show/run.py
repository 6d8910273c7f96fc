"""One loop in pictures: joint values, error, joint velocities, status, tips. Each function draws one dataset.

Datasets are those of `cnclik.measure.dataset.to_dataset`; where they have a dimension `method`, joint paths and
velocities have a line for each method.
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
      kind: "overview" (joint values, error, velocities, status), "joints", "velocities" or "tip".

    Returns: a matplotlib Figure.
    Raises: ArgumentError for another kind, or a batch of runs.
    """
    draw = KINDS[errors.one_of("kind", kind, KINDS)]
    one_lane(run)
    with style.style():
        return draw(to_dataset(run, law), law.chain)


def joint_paths(data, chain=None):
    """Draw joint values over time, a panel for each joint, with the chain's limits where a joint comes near them."""

    def draw(panel, i):
        q = data.q.values[..., i]
        for look, one in _methods(data):
            panel.plot(data.time, one.q.values[:, i], **look)
        room = max(np.ptp(q), 0.1)
        if np.ptp(q) <= 1e-9:  # rounding would fill the panel
            panel.set_ylim(np.median(q) - room, np.median(q) + room)
        if chain is not None:
            _limits(panel, q, (chain.lower[i], chain.upper[i]), room)

    return _per_joint(data, draw, "$q$")


def joint_velocities(data, chain=None):
    """Draw joint velocities, constant during each step, with the chain's limits where a joint comes near them."""
    fastest = np.nanmax(np.abs(data.qdot.values), initial=0.0) or 1.0

    def draw(panel, i):
        every = np.nan_to_num(data.qdot.values[..., i], nan=0.0)
        if rounding := np.max(np.abs(every), initial=0.0) <= 1e-9 * fastest:  # it would fill the panel
            panel.set_ylim(-0.1 * fastest, 0.1 * fastest)
        for look, one in _methods(data, linewidth=1.0):
            v = np.nan_to_num(one.qdot.values[:, i]) if rounding else one.qdot.values[:, i]
            panel.stairs(v, data.time.values, baseline=None, **_unmarked(look))
        if chain is not None:
            limit = chain.velocity_limit[i]
            _limits(panel, every, (-limit, limit), 0.5 * limit)

    return _per_joint(data, draw, r"$\dot q$", per="/s")


def _limits(panel, values, bounds, room):
    """Draw the bounds that values come nearer to than `room`."""
    for bound in bounds:
        if np.min(values, initial=np.inf) - room < bound < np.max(values, initial=-np.inf) + room:
            panel.axhline(bound, label="limit", **style.LIMIT)


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
        speed.stairs(v, data.time.values, baseline=None, **_unmarked(look))
    joints.set_ylabel(f"joint value [{data.q.units}]")
    speed.set_ylabel("joint velocity over its limit" if limited else f"joint velocity [{data.qdot.units}]")
    if limited:
        _limits(speed, np.nan_to_num(data.qdot.values / limits, nan=0.0), (-1, 1), 0.5)
    _name_limits([speed])
    _draw_error(size, data)
    size.legend(loc="best")
    _draw_status(flags, data)
    for panel in (speed, flags):
        panel.set_xlabel(_TIME)
    style.legend(figure, joints)
    return figure


KINDS = {"overview": overview, "joints": joint_paths, "velocities": joint_velocities, "tip": tip}


def _methods(data, **changes):
    """(keywords of a line, the run that it shows) for each method, or for the one run there is."""
    if "method" not in data.dims:
        return [({"color": style.BLACK, "linewidth": 1.2} | changes, data)]
    names = [str(name) for name in data.method.values]
    # Markers staggered, so that coinciding lines stay distinguishable.
    every = [(2 * i, 6) if len(names) <= 3 else (i, 7) for i in range(len(names))]
    return [
        (style.line(name, **{"markevery": some} | changes), data.sel({"method": name}))
        for name, some in zip(names, every, strict=True)
    ]


def _unmarked(look):
    """The keywords of a line that `stairs` takes too."""
    return {name: look[name] for name in look if not name.startswith("mark")}


def _name_limits(panels):
    """A legend for the dashed lines, in the first of the panels that has one."""
    for panel in panels:
        lines = [line for line in panel.get_lines() if line.get_label() == "limit"]
        if lines:
            panel.legend(handles=lines[:1], loc="best", fontsize=6.5)
            return


def _per_joint(data, draw, symbol, per=""):
    """A panel for each joint, drawn by draw(panel, i); its unit is that of the joint, `per` a time."""
    n = data.sizes["joint"]
    columns = 1 if n <= 3 else 2
    rows = -(-n // columns)
    size = (style.COLUMN if columns == 1 else style.PAGE, 0.5 + 0.95 * rows)
    fixed = {} if "method" in data.dims else style.fixed_grid(*size, rows, columns)
    figure, grid = plt.subplots(rows, columns, sharex=True, squeeze=False, figsize=size, **fixed)
    panels = grid.T.ravel()
    for i, panel in enumerate(panels):
        if i >= n:  # an odd joint's neighbour; the panel above it has the time axis
            panel.set_axis_off()
            panels[i - 1].tick_params(labelbottom=True)
            panels[i - 1].set_xlabel(_TIME)
            continue
        draw(panel, i)
        panel.set_title(str(data.joint.values[i]), loc="left", pad=2)
        panel.set_ylabel(f"{symbol} [{data.joint_unit.values[i]}{per}]")
        if fixed:
            panel.yaxis.set_label_coords(style.LABEL_AT, 0.5)
        panel.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
        panel.margins(x=0.01, y=0.12)
        if i % rows == rows - 1:
            panel.set_xlabel(_TIME)
    _name_limits(panels)
    if "method" in data.dims:
        figure.align_ylabels(grid)
        style.legend(figure, panels[0])
    return figure


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
