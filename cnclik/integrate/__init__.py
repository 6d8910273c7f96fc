"""Integration: how the loop moves in time.

`cnclik` itself offers the functions `solve` and `lanes`; here these names are the modules that contain them.
"""

from cnclik.integrate.advance import Step
from cnclik.integrate.history import History
from cnclik.integrate.method import CN, EE, HEUN, IE, METHODS, MIDPOINT, RK4, TRAPEZOID, Method, exponential
from cnclik.integrate.multistep import Multistep
from cnclik.integrate.solve import step
from cnclik.integrate.stage import chord, newton, picard
from cnclik.integrate.status import Status, StepError, require_ok
from cnclik.integrate.trajectory import Trajectory

__all__ = [
    "CN",
    "EE",
    "HEUN",
    "IE",
    "METHODS",
    "MIDPOINT",
    "RK4",
    "TRAPEZOID",
    "History",
    "Method",
    "Multistep",
    "Status",
    "Step",
    "StepError",
    "Trajectory",
    "chord",
    "exponential",
    "newton",
    "picard",
    "require_ok",
    "step",
]
