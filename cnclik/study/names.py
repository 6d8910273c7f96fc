"""Robots, tasks, references and stages by plain names, as a spec writes them."""

import cnclik.law.reference as ref
from cnclik import errors
from cnclik.integrate import stage as stages
from cnclik.law import inverse as inverses
from cnclik.law.task import orientation, pose, position
from cnclik.robot.chain import planar_arm

REFERENCES = ("hold", "line", "circle", "lissajous")
STAGES = tuple(name for name in ("picard", "chord", "newton") if hasattr(stages, name))


def robot_from(text, tip=None, base=None):
    """A chain: "planar:1,1" or "planar-clockwise:1,1"."""
    kind, _, rest = str(text).partition(":")
    if kind not in ("planar", "planar-clockwise"):
        raise errors.fail("robot", "be planar:LENGTHS", f"is {text!r}")
    try:
        lengths = [float(v) for v in rest.split(",")]
    except ValueError:
        raise errors.fail("robot", "be planar:LENGTHS, such as planar:1,1", f"is {text!r}") from None
    return planar_arm(lengths, clockwise=kind != "planar")


def task_from(text, chain=None):
    """A task: "pose", "position", "orientation", or axes such as "xy"."""
    whole = {"pose": pose, "position": position, "orientation": orientation}
    return whole[text]() if text in whole else position(text)


def inverse_from(name=None, damping=None):
    """J# by name; by default damped where `damping` is given."""
    name = name or ("pseudoinverse" if damping is None else "damped")
    errors.one_of("inverse", name, ("pseudoinverse", "damped", "transpose"))
    if (name == "damped") != (damping is not None):
        raise errors.fail("damping", "be given for the damped inverse, and only for it", f"is {damping!r}")
    return inverses.damped(damping) if name == "damped" else getattr(inverses, name)()


def stage_from(name, M, **options):
    """A stage by name."""
    return getattr(stages, errors.one_of("stage", name, STAGES))(M, **options)


def reference_from(name, chain, task, q0, *, horizon, period=None, **path):
    """A reference by the name of its builder; `period` is `horizon` by default."""
    period = horizon if period is None else period
    if name == "hold":
        return ref.hold(path["target"])
    if name == "line":
        return ref.line(path["start"], path["end"], duration=period)
    if name == "circle":
        return ref.circle(path["center"], path["radius"], period=period, normal=path.get("normal"))
    return ref.lissajous(path["center"], path["amplitude"], period=period, frequency=path.get("frequency"))
