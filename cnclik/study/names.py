"""Robots, tasks, references and stages by plain names, as a spec writes them."""

import cnclik.law.reference as ref
from cnclik import errors
from cnclik.integrate.stage import picard
from cnclik.law.task import orientation, pose, position
from cnclik.robot.chain import planar_arm


def robot_from(text, tip=None):
    """A chain: "planar:1,1"."""
    kind, _, rest = str(text).partition(":")
    if kind != "planar":
        raise errors.fail("robot", "be planar:LENGTHS", f"is {text!r}")
    try:
        return planar_arm([float(v) for v in rest.split(",")])
    except ValueError as error:
        if isinstance(error, errors.ArgumentError):
            raise
        raise errors.fail("robot", "be planar:LENGTHS, such as planar:1,1", f"is {text!r}") from None


def task_from(text):
    """A task: "pose", "position", "orientation", or axes such as "xy"."""
    whole = {"pose": pose, "position": position, "orientation": orientation}
    return whole[text]() if text in whole else position(text)


def reference_from(kind, **parameters):
    """A reference by the name of its builder."""
    return getattr(ref, kind)(**parameters)


def stage_from(kind, M, **options):
    """A stage by name."""
    return {"picard": picard}[errors.one_of("stage", kind, ("picard",))](M, **options)
