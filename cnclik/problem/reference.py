"""References by name; the pose of the tip at the start fills in what is not given."""

import pathlib
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law import paths as ref
from cnclik.law.reference import Reference
from cnclik.problem import words
from cnclik.problem.columns import POSITION, QUATERNION, TIME
from cnclik.problem.magnitudes import remark_on_places
from cnclik.problem.names import fitting
from cnclik.problem.tables import read_poses
from cnclik.reaching.public import reach
from cnclik.reaching.result import ReachStatus
from cnclik.reaching.targets import wanted_at
from cnclik.record import Array, Float, replace
from cnclik.robot import poses
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length
from cnclik.task.parts import At
from cnclik.task.task import Task

_WRITTEN = {"start": "from", "end": "to"}  # `from` is no name in Python


def as_written(options) -> dict:
    """Options by the names that a user writes: `start` and `end` become from and to."""
    for python, name in _WRITTEN.items():
        if python in options and name in options:
            raise errors.fail(python, f"be left out where `{name}` is given", f"is {options[python]!r}")
    return {_WRITTEN.get(name, name): value for name, value in options.items()}


class ArmAtStart(NamedTuple):
    """The arm at the start, from which a path is completed."""

    chain: Chain
    task: Task  # of one tip, whose target has its coordinates
    q0: Float[Array, " n"]
    here: tuple  # position and rotation of the tip at q0
    tips: tuple = (None, None)  # names of the tip, and of the tip that it is relative to


def reference_from(name, chain: Chain, task, q0, *, horizon=10.0, **given) -> Reference:
    """A desired path by name.

    A point has a position (in the task's coordinates or as x y z), if the task has one. If the task has an
    orientation, a unit quaternion w x y z follows; without it the orientation at q0 is kept.

    hold: `target`. The default is the tip's pose after every joint moves by 0.3 rad (a tenth of the arm's
      length for prismatic joints) towards the middle of its limits.
    line: `start` (the tip at q0), `end` (as hold's target), in `period` seconds, then held.
    circle: `radius` (a tenth of the arm's length), `center` (so that the circle starts at the tip), `normal`,
      `phase` at t = 0 [rad], `period` of a turn (negative: the other sense).
    lissajous: `amplitude` (one number or one per axis; a twentieth of the arm's length), `frequency` (1, 2, 3),
      `center` (the tip at q0), `phase` per axis, `period` of frequency 1.
    FILE.csv: waypoints for `cnclik.waypoints`; rows of time and point, a header and # comments are skipped.

    Args:
      horizon: length of the run [s], the default of `period`.
      given: the options named above; `from` and `to` are `start` and `end`.
    """
    tips = task.parts[0].tip, task.parts[0].to
    coordinates = replace(task, parts=tuple(replace(part, tip=None, to=None) for part in task.parts))
    arm = ArmAtStart(chain, coordinates, q0, _tip(chain, q0, *tips), tips)
    given = as_written(given)
    if str(name).lower().endswith(".csv"):
        fitting("reference", name, words.Takes(), given)
        return _waypoints(arm, name)
    errors.one_of("reference", name, (*words.REFERENCES, "FILE.csv"))
    choice = words.REFERENCES[name]
    length = {"period": horizon} if "period" in choice.options else {}
    return choice.make(arm, **(length | fitting("reference", name, choice, given)))


def hold(arm, target=None):
    """A fixed target; the options of this and the next three are those of `reference_from`."""
    there = arm.here if target is not None else _away(arm)
    return ref.hold(*_point("target", target, arm.task, there))


def line(arm, period, **ends):
    errors.number("period", period, positive=True)
    first, turned = _point("from", ends.get("from"), arm.task, arm.here)
    last, turned_last = _point("to", ends.get("to"), arm.task, arm.here if "to" in ends else _away(arm))
    if first is not None and len(first) != len(last):  # one end is x y z, the other in the task's coordinates
        first, last = (p if len(p) < 3 else p[np.array(arm.task.linear)] for p in (first, last))
    turned_last = None if turned_last is turned else turned_last  # the same orientation: nothing to turn
    return ref.line(first, last, duration=period, rotation=turned, rotation_end=turned_last)


def circle(arm, period, center=None, radius=None, normal=None, phase=0.0):
    _needs_position("circle", arm.task)
    radius = arm_length(arm.chain) / 10 if radius is None else radius
    errors.number("radius", radius, positive=True)
    phase = errors.array("phase", phase, (), (1,)).reshape(())  # a list of one is a number
    at, rotation = _point("center", center, arm.task, arm.here)
    if center is None:
        around = ref.circle(np.zeros(len(at)), radius, period=1.0, normal=normal, phase=phase).curve
        at = at - _known(around.first)
    return ref.circle(at, radius, period=period, normal=normal, phase=phase, rotation=rotation)


def lissajous(arm, period, center=None, amplitude=None, frequency=None, phase=None):
    _needs_position("lissajous", arm.task)
    amplitude = arm_length(arm.chain) / 20 if amplitude is None else amplitude
    at, rotation = _point("center", center, arm.task, arm.here)
    size = _known(errors.array("amplitude", amplitude, (), (1,), (len(at),))) * np.ones(len(at))
    return ref.lissajous(at, size, period=period, frequency=frequency, phase=phase, rotation=rotation)


def on_path(chain: Chain, task, reference, q0):
    """Joint values (n,), nearest to q0, that put each tip where its path begins.

    Raises: ArgumentError where none are found.
    """
    task, target = wanted_at(reference, task, 0.0)
    found = reach(chain, target, task=task, near=q0)
    if errors.concrete(found.status) and not found.solved:
        at = f"is on-path, and where the path begins is {ReachStatus(int(found.status)).name}"
        raise errors.fail("begin", "be q0 for a path that begins where the arm doesn't reach", at)
    return found.q


def _needs_position(name, task):
    if not task.position:
        raise errors.fail("reference", "be hold, line or a file for a task without position", f"is {name!r}")


# --- points -------------------------------------------------------------------------------------------


def _tip(chain, q, tip, to):
    """Position and rotation of a tip, in the base frame or in that of another tip."""
    at = At(modelled(chain), np.asarray(q, float) if errors.concrete(q) else q)
    return _known(at.position(tip, to)), _known(at.rotation(tip, to))


def _known(values):
    """Numbers as a NumPy array; a traced value stays as it is, so that a sweep can vary it."""
    return np.asarray(values, float) if errors.concrete(values) else values


def _away(arm):
    """The tip's pose after every joint moved a little towards the middle of its limits."""
    chain, q0 = arm.chain, arm.q0
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle = np.where(bounded, np.where(bounded, lower, 0) / 2 + np.where(bounded, upper, 0) / 2, np.inf)
    size = [0.3] * chain.n
    for i, unit in enumerate(chain.units):
        if unit == "m":
            size[i] = arm_length(chain) / 10
    xp = np if errors.concrete(q0) and all(map(errors.concrete, size)) else jnp
    size = xp.minimum(xp.stack([xp.asarray(s, float) for s in size]), (upper - lower) / 4)
    return _tip(chain, q0 + xp.where(middle >= q0, size, -size), *arm.tips)


def _point(name, given, task, default):
    """Position (or None) and rotation (or None) of a point as a user writes it; see `reference_from`."""
    position, rotation = default
    position = position[np.array(task.linear)] if task.position else None
    rotation = rotation if task.orientation else None
    if given is None:
        return position, rotation
    values = _known(errors.array(name, given, (None,)))
    sizes = {len(task.position), 3} if task.position else {0}
    fits = sorted(sizes | ({s + 4 for s in sizes} if task.orientation else set())) if sizes != {0} else [4]
    if len(values) not in fits:
        raise errors.fail(name, f"hold {' or '.join(map(str, fits))} numbers for this task", f"holds {len(values)}")
    if task.orientation and len(values) >= 4:
        values, rotation = values[:-4], poses.rotations(name, values[-4:])
    return (values if task.position else None), rotation


# --- waypoint files -----------------------------------------------------------------------------------


def _waypoints(arm, file):
    """Waypoints of a CSV file, with columns by name, or without a header time, position and perhaps a quaternion."""
    name, task = pathlib.Path(file).name, arm.task

    def by_place(width):
        turns = (0, 4) if task.orientation else (0,)
        fits = {1 + len(some) + turn: some for some in {task.position, task.position and "xyz"} for turn in turns}
        some = fits.get(width)
        return None if some is None else (TIME, *some, *QUATERNION[: width - 1 - len(some)])

    columns, table = read_poses("reference", file, by_place, () if arm.tips[0] is None else arm.tips[:1])
    if len(table) < 2:
        raise errors.fail("reference", "hold at least two waypoints", f"{name} holds {len(table)}")
    if columns:
        axes = POSITION if set(POSITION) <= set(columns) else task.position
        order = [TIME, *(axes if task.position else ()), *(QUATERNION if task.orientation and "qw" in columns else ())]
        lacking = [column for column in order if column not in columns]
        if lacking:
            raise errors.fail("reference", "have a column for each coordinate", f"{name} lacks {' '.join(lacking)}")
        table = np.stack([columns[column] for column in order], 1)
    points = [_point(f"{name} row {k + 1}", row, arm.task, arm.here) for k, row in enumerate(table[:, 1:])]
    late = ~(table[1:, 0] > table[:-1, 0])  # also if one is not finite
    if late.any():
        k = int(np.argmax(late))
        first, second = table[k : k + 2, 0]
        raise errors.fail("reference", "hold times that increase", f"{name} has {first:g} and then {second:g}")
    positions = np.stack([p for p, _ in points]) if arm.task.position else None
    rotations = np.stack([r for _, r in points]) if arm.task.orientation else None
    if positions is not None and arm.tips[1] is None:
        remark_on_places(name, positions, arm.chain, arm.task, arm.tips[0])
    return ref.waypoints(table[:, 0], positions, rotations)
