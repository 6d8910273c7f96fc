"""Words: every name that an option may have, and the options that it takes. Read without loading JAX.

`cnclik.problem.names` and `.reference` say what each name builds; to add one, add its line here and there.
"""

from typing import NamedTuple


class Takes(NamedTuple):
    """The options of a name: so nothing is left out that it needs, and nothing given that it would silently drop."""

    needs: tuple = ()  # options that must be given
    takes: tuple = ()  # options that may be
    tip: str = ""  # of a robot: what its tip is called

    @property
    def options(self) -> tuple:
        return (*self.needs, *self.takes)


ROBOTS = {
    "panda": Takes(tip="flange"),
    "ur5": Takes(tip="tool flange"),
    "planar": Takes(needs=("lengths",), tip="end of the last link"),
    "planar-clockwise": Takes(needs=("lengths",), tip="end of the last link"),
}
URDF = Takes(takes=("tip", "base"))
TASKS = ("pose", "position", "orientation")
INVERSES = {
    "pseudoinverse": Takes(),
    "damped": Takes(needs=("damping",)),
    "transpose": Takes(),
    "manipulability-damped": Takes(needs=("damping", "threshold")),
    "singular-damped": Takes(needs=("damping", "threshold")),
}
LIMITS = ("none", "velocity-scaling", "weighted-least-norm", "saturation")
REFERENCES = {
    "hold": Takes(takes=("target",)),
    "line": Takes(takes=("from", "to", "period")),
    "circle": Takes(takes=("center", "radius", "normal", "phase", "period")),
    "lissajous": Takes(takes=("center", "amplitude", "frequency", "phase", "period")),
}
METHODS = (
    *("EE", "IE", "CN", "TRAPEZOID", "HEUN", "MIDPOINT", "RK4", "AB2", "AB3", "AB4", "ZNN4", "ZEAD4", "ZNN6", "IFD5"),
    *("EXP-EE", "EXP-HEUN", "EXP-MIDPOINT", "EXP-RK4", "EXP-AB2", "EXP-AB3", "EXP-AB4"),
)
STAGES = ("picard", "chord", "newton")
BEGINS = ("q0", "on-path")
FUTURES = ("known", "unknown")
COMMANDS = ("velocity", "position")
FEEDBACKS = ("measured", "commanded", "rebased")
