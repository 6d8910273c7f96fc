"""References by name; the pose of the tip at the start fills in what is not given."""

import inspect
import pathlib
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.law import paths
from cnclik.law.paths import Reference
from cnclik.problem.tables import read_points
from cnclik.reaching.public import reach
from cnclik.reaching.result import ReachStatus
from cnclik.reaching.targets import wanted_at
from cnclik.record import xp_for
from cnclik.robot import poses
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length
from cnclik.task.parts import At, places
from cnclik.task.task import Task


class Arm(NamedTuple):
    """The arm at the start, from which a path is completed."""

    chain: Chain
    task: Task
    q0: Any  # (n,)
    here: tuple  # position and rotation of the tip at q0


def reference_from(name, chain: Chain, task: Task, q0, *, horizon=10.0, **options) -> Reference:
    """A desired path by name, with options as `problem_from` has them; None is the default.

    A point has a position (in the task's coordinates or as x y z), if the task has one. If the task has an
    orientation, a unit quaternion w x y z follows; without it the orientation at q0 is kept.

    Args: horizon: length of the run [s], the default of `period`.
    """
    given = {k: v for k, v in options.items() if v is not None}
    if str(name).lower().endswith(".csv"):
        maker, given = waypoints, {"file": name} | given
    else:
        maker = _KINDS[errors.one_of("reference", name, (*_KINDS, "FILE.csv"))]
    takes = inspect.signature(maker).parameters
    for key, value in given.items():
        if key not in takes:
            raise errors.fail(key, f"be left out for the reference {name!r}", f"is {value!r}")
    given = ({"period": horizon} if "period" in takes else {}) | given
    return maker(Arm(chain, task, q0, _tip(chain, task, q0)), **given)


def hold(arm, target=None):
    return paths.hold(*_point("target", target, arm, _away))


def line(arm, period, target=None, start=None):
    errors.number("period", period, positive=True)
    first, turned = _point("start", start, arm)
    last, turned_last = _point("target", target, arm, _away)
    turned_last = None if turned_last is turned else turned_last  # the same orientation: nothing to turn
    return paths.line(first, last, duration=period, rotation=turned, rotation_end=turned_last)


def circle(arm, period, radius=None, phase=0.0):
    radius = arm_length(arm.chain) / 10 if radius is None else errors.number("radius", radius, positive=True)
    here, rotation = _curved("circle", arm, least=2)
    phase = errors.array("phase", phase, (), (1,)).reshape(())  # a list of one is a number
    about = paths.circle(np.zeros(len(here)), radius, period=1.0, phase=phase).curve
    return paths.circle(here - _known(about.first), radius, period=period, phase=phase, rotation=rotation)


def lissajous(arm, period, amplitude=None, frequency=None, phase=None):
    here, rotation = _curved("lissajous", arm)
    amplitude = arm_length(arm.chain) / 20 if amplitude is None else amplitude
    size = _known(errors.array("amplitude", amplitude, (), (1,), (len(here),))) * np.ones(len(here))
    return paths.lissajous(here, size, period=period, frequency=frequency, phase=phase, rotation=rotation)


_KINDS: dict[str, Callable] = {"hold": hold, "line": line, "circle": circle, "lissajous": lissajous}


def waypoints(arm, file, speed=None):
    """Waypoints of a CSV file. Args: speed: of the tip along them [m/s], in place of their times."""
    name = pathlib.Path(file).name
    times, points = read_points("reference", file, arm.task, timed=speed is None)
    if len(points) < 2:
        raise errors.fail("reference", "hold at least two waypoints", f"{name} holds {len(points)}")
    each = [_point(f"{name} row {k + 1}", row, arm) for k, row in enumerate(points)]
    positions, rotations = (None if column[0] is None else np.stack(column) for column in zip(*each, strict=True))
    if speed is not None:
        errors.number("speed", speed, positive=True)
        if positions is None:
            raise errors.fail("speed", "be left out for a task without position", f"is {speed:g}")
        times = np.cumsum([0.0, *np.linalg.norm(np.diff(positions, axis=0), axis=1) / speed])
    if not np.all(times[1:] > times[:-1]):  # also if one is not finite
        must = f"hold {'times that increase' if speed is None else 'points that differ, with a speed'}"
        raise errors.fail("reference", must, f"{name} has times {', '.join(f'{t:g}' for t in times[:9])}")
    return paths.waypoints(times, positions, rotations)


OPTIONS = {key for kind in [*_KINDS.values(), waypoints] for key in inspect.signature(kind).parameters} - {
    "arm",
    "file",
}


def on_path(chain: Chain, task, reference, q0):
    """Joint values (n,), nearest to q0, that put the tip where its path begins.

    Raises: ArgumentError where none are found.
    """
    task, target = wanted_at(reference, task, 0.0)
    found = reach(chain, target, task=task, near=q0)
    if errors.concrete(found.status) and not found.solved:
        far = float(found.position_error)
        unit = f", {far:.3g} m away: millimetres are written with their unit" * (far > 10 * float(arm_length(chain)))
        at = f"is on-path, and where the path begins is {ReachStatus(int(found.status)).name}{unit}"
        raise errors.fail("begin", "be q0 for a path that begins where the arm doesn't reach", at)
    return found.q


# --- points -------------------------------------------------------------------------------------------


def _tip(chain, task, q):
    """Position and rotation of the task's tip."""
    at, tip = At(modelled(chain), np.asarray(q, float) if errors.concrete(q) else q), task.parts[0].tip
    return _known(at.position(tip)), _known(at.rotation(tip))


def _known(values):
    """Numbers as a NumPy array; a traced value stays as it is, so that a sweep can vary it."""
    return np.asarray(values, float) if errors.concrete(values) else values


def _away(arm):
    """The tip's pose after every joint moved by 0.3 rad or 0.1 m, at most a quarter of its range, towards the middle of
    its limits."""
    chain, xp = arm.chain, xp_for(arm.q0)
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    with np.errstate(invalid="ignore"):
        middle = (lower + upper) / 2  # NaN without limits: upwards
    size = np.minimum([0.1 if unit == "m" else 0.3 for unit in chain.units], (upper - lower) / 4)
    return _tip(chain, arm.task, arm.q0 + xp.where(arm.q0 > middle, -size, size))


def _curved(name, arm, least=1):
    if len(arm.task.position) < least:
        which = "without position" if not arm.task.position else "of one coordinate of a position"
        raise errors.fail("reference", f"be hold, line or a file for a task {which}", f"is {name!r}")
    return _point("reference", None, arm)


def _point(name, given, arm, default=lambda arm: arm.here):
    """Position in the task's coordinates and rotation of a point as a user writes it, each None if the task has none;
    see `reference_from`."""
    task = arm.task
    position, rotation = default(arm) if given is None else (None, arm.here[1])
    if given is not None:
        values = _known(errors.array(name, given, (None,)))
        sizes = sorted({len(task.position), 3}) if task.position else [0]
        fits = [s for s in sizes + [s + 4 for s in sizes] * bool(task.orientation) if s]
        if len(values) not in fits:
            what = [f"{' '.join(task.position)} [m]"] * bool(task.position)
            what += ["a quaternion w x y z"] * bool(task.orientation)
            must = f"have {' or '.join(map(str, fits))} numbers ({' and '.join(what)})"
            raise errors.fail(name, must, f"has {len(values)}")
        if len(values) not in sizes:
            values, rotation = values[:-4], poses.rotations(name, values[-4:])
        position = values
    if task.position and len(position) != len(task.position):
        position = position[places(task.position)]
    return (position if task.position else None), (rotation if task.orientation else None)
