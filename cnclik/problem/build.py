"""A problem in plain names: what the command line and sweep files say, turned into records.

Every builder takes text and numbers as a user writes them and returns what the library works with;
`problem_from` builds a whole problem from one flat table.
"""

import csv
import dataclasses
import inspect
import pathlib
import re

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.hints import hints
from cnclik.integrate import stage as stages
from cnclik.integrate.method import METHODS, Method
from cnclik.law import inverse as inverses
from cnclik.law import limits as limiters
from cnclik.law import null
from cnclik.law import reference as references
from cnclik.law import task as tasks
from cnclik.law.law import Law
from cnclik.robot import builtin
from cnclik.robot.chain import REVOLUTE, Chain, planar_arm
from cnclik.robot.kinematics import frames
from cnclik.robot.posture import arm_length, is_planar, start_posture
from cnclik.robot.urdf import load_urdf

ROBOTS = {"panda": builtin.panda, "ur5": builtin.ur5}
REFERENCES = ("hold", "line", "circle", "lissajous")
STAGES = tuple(name for name in ("picard", "chord", "newton") if hasattr(stages, name))
INVERSES = ("pseudoinverse", "damped", "transpose", "manipulability-damped", "singular-damped")
LIMITS = ("none", "velocity-scaling", "weighted-least-norm", "saturation")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Problem:
    """What `solve` needs, `solve(p.law, p.reference, p.q0, p.Ts, p.N, p.method, p.stage)`, and its name."""

    name: str
    law: Law
    reference: references.Reference
    q0: np.ndarray
    Ts: float
    N: int
    method: Method
    stage: object


def problem_from(
    robot,
    *,
    tip=None,
    base=None,
    task=None,
    reference="hold",
    alpha=5.0,
    inverse=None,
    damping=None,
    threshold=None,
    limits="none",
    error_clamp=None,
    posture=None,
    manipulability=None,
    q0=None,
    Ts=0.01,
    N=1000,
    method="CN",
    stage="picard",
    M=5,
    **path,
) -> Problem:
    """A whole problem from a flat table of names and numbers, such as a section of a sweep file.

    Args:
      robot, tip, base: see `robot_from`.
      task: see `task_from`.
      reference, path: see `reference_from`; `from` and `to` are its `start` and `end`.
      alpha: gain [1/s], a number or one per task coordinate.
      inverse, damping, threshold: see `inverse_from`.
      limits: see `limits_from`.
      error_clamp: largest position [m] and orientation [rad] error that the gain sees.
      posture, manipulability: see `null_from`.
      q0: joint values at the start [rad, m]; see `start_from` for the default.
      Ts: sampling time [s]. N: number of steps.
      method: EE, IE, CN, TRAPEZOID, HEUN, MIDPOINT, RK4.
      stage, M: see `stage_from`.

    Raises: ArgumentError naming the entry that does not fit.
    """
    path = {{"from": "start", "to": "end"}.get(key, key): value for key, value in path.items()}
    known = [p for p in inspect.signature(reference_from).parameters if p not in ("name", "chain", "task", "q0")]
    for key in path:
        errors.one_of("option", key, known)
    errors.number("Ts", Ts, positive=True)
    errors.integer("N", N, at_least=1)
    chain = robot_from(robot, tip, base)
    task = task_from(task, chain)
    q0 = start_from(chain, task, q0)
    path = {"horizon": N * Ts} | path
    law = Law(
        chain,
        task,
        alpha=gain_from(alpha),
        inverse=inverse_from(inverse, damping, threshold),
        limits=limits_from(limits, Ts),
        error_clamp=error_clamp,
        null_velocity=null_from(chain, task, posture, manipulability),
    )
    return Problem(
        name=robot_name(robot, tip),
        law=law,
        reference=reference_from(reference, chain, task, q0, **path),
        q0=q0,
        Ts=Ts,
        N=N,
        method=method_from(method),
        stage=stage_from(stage, M),
    )


# --- robot and start ----------------------------------------------------------------------------------


def robot_from(text, tip=None, base=None) -> Chain:
    """A URDF file, `panda`, `ur5`, `planar:1,1,1` (link lengths [m]) or `planar-clockwise:1,1`.

    The last two are the paper's arms in both senses of rotation. `tip` and `base` name links of a file.
    """
    if isinstance(text, Chain):
        return text
    if not isinstance(text, (str, pathlib.Path)):
        raise errors.fail("robot", "be a URDF file or the name of a robot", f"is {text!r}")
    text = str(text)
    planar = re.fullmatch(r"planar(-clockwise)?:(.*)", text)
    named = planar or text in ROBOTS
    for name, link in (("tip", tip), ("base", base)):
        if named and link is not None:
            raise errors.fail(name, f"be left out for {text.partition(':')[0]}, which is no file", f"is {link!r}")
    if text in ROBOTS:
        return ROBOTS[text]()
    if planar:
        try:
            lengths = [float(part) for part in planar[2].split(",")]
        except ValueError:
            raise errors.fail("robot", "give link lengths such as planar:1,1,1", f"is {text!r}") from None
        return planar_arm(lengths, clockwise=bool(planar[1]))
    if not pathlib.Path(text).exists() and not text.lower().endswith((".urdf", ".xml", ".xacro")):
        names = f"be a URDF file, {', '.join(ROBOTS)} or planar:1,1,1"
        raise errors.fail("robot", names, f"is {text!r}")
    return load_urdf(text, tip, base)


def robot_name(text, tip=None) -> str:
    """What to call a robot in titles: its file's name without folder, and the tip."""
    if isinstance(text, Chain):
        return f"{text.n}-joint chain"
    text = str(text)
    name = text if text in ROBOTS or text.startswith("planar") else pathlib.Path(text).stem
    return f"{name} {tip}" if tip else name


def start_from(chain: Chain, task, q0=None):
    """q0 (n,), checked; by default `start_posture`."""
    if q0 is None:
        return start_posture(chain, task)
    return np.asarray(errors.array("q0", q0, (chain.n,)), float)


# --- task and law -------------------------------------------------------------------------------------


def task_from(text, chain: Chain | None = None) -> tasks.Task:
    """`pose`, `position`, `orientation`, or task coordinates by name such as `xy`, `rz`, `xyzrxry`.

    On a planar arm the three words mean its plane: xy with rz, xy, rz. By default `pose` where the chain has
    the joints for it, else `position`.
    """
    if isinstance(text, tasks.Task):
        return text
    flat = chain is not None and is_planar(chain)
    where, turn = ("xy", "z") if flat else ("xyz", "xyz")
    if text is None:
        text = "pose" if not flat and (chain is None or chain.n >= 6) else "position"
    words = {
        "pose": lambda: tasks.pose(where, turn),
        "position": lambda: tasks.position(where),
        "orientation": lambda: tasks.orientation(turn),
    }
    if text in words:
        return words[text]()
    found = re.fullmatch(r"(x?y?z?)((?:rx)?(?:ry)?(?:rz)?)", str(text))
    if not found or not text:
        raise errors.fail("task", "be pose, position, orientation, or coordinates such as xy or xyrz", f"is {text!r}")
    axes, turns = found[1], found[2].replace("r", "")
    if not turns:
        return tasks.position(axes)
    return tasks.pose(axes, turns) if axes else tasks.orientation(turns)


def gain_from(alpha):
    """A gain [1/s]: a number, or one per task coordinate; a list of one is a number. A negative one is refused."""
    alpha = np.asarray(errors.array("alpha", alpha), float)
    if alpha.ndim < 2 and np.any(alpha < 0):
        raise errors.fail("alpha", "be at least 0", f"is {alpha.tolist()}")
    return alpha[0] if alpha.shape == (1,) else alpha


def inverse_from(name=None, damping=None, threshold=None):
    """J# by name: pseudoinverse, damped, transpose, manipulability-damped, singular-damped.

    Args:
      name: by default damped where `damping` is given, else pseudoinverse.
      damping: λ of the damped ones (never λ²).
      threshold: manipulability or least singular value below which the last two are damped.
    """
    if name is None:
        name = "pseudoinverse" if damping is None else "damped"
    errors.one_of("inverse", name, INVERSES)
    uses = {"damping": "damped" in name, "threshold": name.endswith("-damped")}
    given = {"damping": damping, "threshold": threshold}
    for key, used in uses.items():
        if used and given[key] is None:
            raise errors.fail(key, f"be given for the inverse {name!r}", "is not")
        if not used and given[key] is not None:
            raise errors.fail(key, f"be left out for the inverse {name!r}", f"is {given[key]!r}")
    return getattr(inverses, name.replace("-", "_"))(*(given[key] for key in uses if uses[key]))


def limits_from(name="none", Ts=None):
    """How limits are respected: none, velocity-scaling, weighted-least-norm or saturation.

    Where the sampling time is known, a joint nears its limit at most as fast as one step can stop: 1/Ts, and
    10 per second at most.
    """
    errors.one_of("limits", name, LIMITS)
    if name == "none":
        return None
    if name == "velocity-scaling":
        return limiters.velocity_scaling()
    return getattr(limiters, name.replace("-", "_"))(10.0 if Ts is None else min(10.0, 1.0 / Ts))


def null_from(chain: Chain, task, posture=None, manipulability=None):
    """The null-space term: towards a `posture` (n,) at 1/s, or up the `manipulability` with this gain, or None."""
    if posture is not None and manipulability is not None:
        raise errors.fail("manipulability", "be left out where `posture` is given", f"is {manipulability!r}")
    if posture is not None:
        return null.posture(errors.array("posture", posture, (chain.n,)))
    if manipulability is None:
        return None
    errors.number("manipulability", manipulability, positive=True)
    return null.maximize_manipulability(chain, task, manipulability)


# --- loop ---------------------------------------------------------------------------------------------


def method_from(name) -> Method:
    """A method by name."""
    return name if isinstance(name, Method) else METHODS[errors.one_of("method", name, METHODS)]


def stage_from(name="picard", M=5, **options):
    """How implicit stages are solved: the iteration's name, its number of passes M, further options of it."""
    return getattr(stages, errors.one_of("stage", name, STAGES))(M, **options)


# --- reference ----------------------------------------------------------------------------------------


def reference_from(
    name,
    chain: Chain,
    task,
    q0,
    *,
    target=None,
    start=None,
    end=None,
    center=None,
    radius=None,
    amplitude=None,
    frequency=None,
    normal=None,
    period=None,
    horizon=10.0,
) -> references.Reference:
    """A desired path by name, with what is left out filled in from the tip's pose at q0.

    A point is a position (in the task's coordinates or as x y z), then for tasks with an orientation
    optionally a unit quaternion w x y z; without one the orientation at q0 is kept. For a task without
    position it is the quaternion alone.

    hold: `target`; by default where the tip gets when every joint moves by 0.3 rad (a tenth of the arm's
      length for prismatic joints) towards the middle of its limits.
    line: `start` (the tip at q0), `end` (as hold's target), in `period` seconds, then held.
    circle: `radius` (a tenth of the arm's length), `center` (so that the circle starts at the tip), `normal`.
    lissajous: `amplitude` (one number or one per axis; a twentieth of the arm's length), `frequency` (1, 2, 3),
      `center` (the tip at q0).
    FILE.csv: waypoints for `cnclik.waypoints`; rows of time and point, a header and # comments are skipped.

    Args:
      period: time of one turn, or of the line [s]; `horizon` by default, the length of the run.
    """
    period = horizon if period is None else period
    errors.number("period", period)
    given = {
        "target": target,
        "start": start,
        "end": end,
        "center": center,
        "radius": radius,
        "amplitude": amplitude,
        "frequency": frequency,
        "normal": normal,
    }
    _refuse_unused(name, given)
    here = _tip(chain, q0)
    if name == "hold":
        there = _away(chain, q0) if target is None else None
        return references.hold(*_point("target", target, task, there or here))
    if name == "line":
        first, turned = _point("from", start, task, here)
        last, turned_last = _point("to", end, task, _away(chain, q0) if end is None else here)
        errors.number("period", period, positive=True)
        turns = {} if turned is None else {"rotation": turned, "rotation_end": turned_last}
        return references.line(first, last, duration=period, **turns)
    if name == "circle":
        _needs_position(name, task)
        radius = arm_length(chain) / 10 if radius is None else radius
        errors.number("radius", radius, positive=True)
        at, rotation = _point("center", center, task, here)
        if center is None:
            first = references.circle(np.zeros(len(at)), radius, period=1.0, normal=normal).curve(0.0)[0]
            at = at - _stacked(first)
        return references.circle(at, radius, period=period, normal=normal, rotation=rotation)
    if name == "lissajous":
        _needs_position(name, task)
        amplitude = arm_length(chain) / 20 if amplitude is None else amplitude
        at, rotation = _point("center", center, task, here)
        amplitude = _known(errors.array("amplitude", amplitude, (), (1,), (len(at),)))
        size = amplitude * np.ones(len(at))
        return references.lissajous(at, size, period=period, frequency=frequency, rotation=rotation)
    if str(name).lower().endswith(".csv"):
        return _waypoints(name, task, here)
    errors.one_of("reference", name, (*REFERENCES, "FILE.csv"))


_USES = {
    "hold": ("target",),
    "line": ("start", "end"),
    "circle": ("center", "radius", "normal"),
    "lissajous": ("center", "amplitude", "frequency"),
}


def _refuse_unused(name, given):
    """Refuse what the chosen path has no use for: it would be dropped silently."""
    for key, value in given.items():
        if value is not None and key not in _USES.get(name, ()):
            shown = {"start": "from", "end": "to"}.get(key, key)
            raise errors.fail(shown, f"be left out for the reference {name!r}", f"is {value!r}")


def _needs_position(name, task):
    if not task.position:
        raise errors.fail("reference", "be hold, line or a file for a task without position", f"is {name!r}")


def _tip(chain, q):
    with hints(False):
        at = frames(chain, tuple(_known(q)))
    return _stacked(at.position), _stacked([_stacked(row) for row in at.rotation])


def _known(values):
    """Numbers as a NumPy array; what is traced stays as it is, so that a sweep can vary it."""
    return np.asarray(values, float) if errors.concrete(values) else values


def _stacked(values):
    return np.array(values, float) if all(map(errors.concrete, values)) else jnp.stack([jnp.asarray(v) for v in values])


def _away(chain, q0):
    """The tip's pose after every joint moved a little towards the middle of its limits."""
    lower, upper = np.array(chain.lower), np.array(chain.upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle = np.where(bounded, np.where(bounded, lower, 0) / 2 + np.where(bounded, upper, 0) / 2, np.inf)
    size = np.full(chain.n, 0.3)
    for joint in chain.joints:
        if joint.kind != REVOLUTE:
            size[joint.coordinate] = arm_length(chain) / 10
    size = np.minimum(size, (upper - lower) / 4)
    return _tip(chain, q0 + (np if errors.concrete(q0) else jnp).where(middle >= q0, size, -size))


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
        values, quaternion = values[:-4], values[-4:]
        norm = (np if errors.concrete(quaternion) else jnp).linalg.norm(quaternion)
        if errors.concrete(norm) and abs(norm - 1) > 1e-2:
            raise errors.fail(name, "end with a unit quaternion w x y z", f"has one of norm {norm:.6g}")
        rotation = _known(references._rotation(name, quaternion / norm))
    return (values if task.position else None), rotation


def _waypoints(file, task, here):
    """Waypoints of a CSV file: time, position, optional quaternion w x y z."""
    path = pathlib.Path(file)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is no text"
        raise errors.fail("reference", "name a CSV file that can be read", f"{path.name}: {reason}") from None
    rows = list(csv.reader(line for line in text.splitlines() if line.strip() and not line.startswith("#")))
    if rows and not any(map(_is_number, rows[0])):  # a header; a first row with a slip in it is none
        rows = rows[1:]
    for k, row in enumerate(rows):
        if len(row) != len(rows[0]) or not all(_is_number(x) for x in row):
            raise errors.fail("reference", "hold numbers, as many in every row", f"row {k + 1} of {path.name} does not")
    if len(rows) < 2:
        raise errors.fail("reference", "hold at least two waypoints", f"{path.name} holds {len(rows)}")
    table = np.array(rows, float)
    points = [_point(f"{path.name} row {k + 1}", row, task, here) for k, row in enumerate(table[:, 1:])]
    if np.any(np.diff(table[:, 0]) <= 0):
        k = int(np.argmax(np.diff(table[:, 0]) <= 0))
        first, second = table[k : k + 2, 0]
        raise errors.fail("reference", "hold times that increase", f"{path.name} has {first:g} and then {second:g}")
    positions = np.stack([p for p, _ in points]) if task.position else None
    rotations = np.stack([r for _, r in points]) if task.orientation else None
    return references.waypoints(table[:, 0], positions, rotations)


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True
