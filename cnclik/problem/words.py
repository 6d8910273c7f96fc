"""Words: every name that may be the value of an option, its maker and its own options. Read without loading JAX."""

import importlib
from typing import Any, NamedTuple


class Takes(NamedTuple):
    """A name: its maker and its options, so that a missing option is reported, and one without use is not dropped."""

    maker: str = ""  # "module:function"; "" for no object
    needs: tuple[str, ...] = ()  # options that must be given
    takes: tuple[str, ...] = ()  # options that may be given
    always: tuple = ()  # (name, value) of the maker's fixed arguments
    tip: str = ""  # name of a robot's tip

    @property
    def options(self) -> tuple:
        return (*self.needs, *self.takes)

    def function(self):
        """The maker; its module is loaded now."""
        module, _, function = self.maker.partition(":")
        return getattr(importlib.import_module(f"cnclik.{module}"), function)

    def make(self, *args, **given):
        """The object that the name stands for."""
        return self.function()(*args, **dict(self.always), **given)


_PLANAR: dict[str, Any] = dict(needs=("lengths",), tip="end of the last link")
ROBOTS = {
    "panda": Takes("robot.builtin:panda", tip="flange"),
    "ur5": Takes("robot.builtin:ur5", tip="tool flange"),
    "planar": Takes("robot.chain:planar_arm", **_PLANAR),
    "planar-clockwise": Takes("robot.chain:planar_arm", always=(("clockwise", True),), **_PLANAR),
}
URDF = Takes(takes=("tip", "base"))
TASKS = ("pose", "position", "orientation")
STACKED = (*TASKS, "joints", "center_of_mass")  # kinds of task in a stack
INVERSES = {
    "pseudoinverse": Takes("law.inverse:pseudoinverse"),
    "damped": Takes("law.inverse:damped", needs=("damping",)),
    "singular-damped": Takes("law.inverse:singular_damped", needs=("damping", "threshold")),
}
LIMITS = {  # `rate` [1/s]: how quickly a joint may near its limit
    "none": Takes(),
    "velocity-scaling": Takes("law.limits:velocity_scaling"),
    "bounded": Takes("law.bounded:bounded", takes=("rate",)),
}
REFERENCES = {
    "hold": Takes("problem.reference:hold", takes=("target",)),
    "line": Takes("problem.reference:line", takes=("from", "to", "period")),
    "circle": Takes("problem.reference:circle", takes=("center", "radius", "normal", "phase", "period")),
    "lissajous": Takes("problem.reference:lissajous", takes=("center", "amplitude", "frequency", "phase", "period")),
}
METHODS = (
    *("EE", "IE", "CN", "TRAPEZOID", "HEUN", "MIDPOINT", "RK4"),
    *("EXP-EE", "EXP-HEUN", "EXP-MIDPOINT", "EXP-RK4"),
)
SHAPES = {  # between which a wall keeps a distance
    "half-space": Takes("task.shapes:half_space", needs=("normal",), takes=("offset",)),
    "capsule": Takes("task.shapes:capsule", needs=("from", "to"), takes=("tip", "radius")),
    "sphere": Takes("task.shapes:sphere", takes=("tip", "radius", "center")),
}
STAGES = {name: Takes(f"integrate.stage:{name}") for name in ("picard", "chord", "newton")}
BEGINS = ("q0", "on-path")
FUTURES = ("known", "unknown")
COMMANDS = ("velocity", "position")
FEEDBACKS = ("measured", "commanded", "rebased")
SMOOTHED = ("error", "command", "target")
