"""Method: one step in time as a Butcher tableau.

A step takes slopes kᵢ = f(q + Ts Σⱼ Aᵢⱼ kⱼ, t + cᵢ Ts) and moves by Ts Σᵢ bᵢ kᵢ. A stage with Aᵢᵢ ≠ 0 is
implicit; `cnclik.integrate.stage` says how it is solved. From the tableau come the stepper, the stability
function and the names on the command line. z = alpha·Ts, and R(z) is the factor by which one step
multiplies the error of ė = −alpha e.
"""

import dataclasses

import jax

from cnclik import errors


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True, kw_only=True)
class Method:
    """A (diagonally implicit) Runge-Kutta method, compiled in.

    Attributes:
      name: as written in the API, on the command line and in datasets.
      A: rows of the lower triangular coefficient matrix, row i with i + 1 entries.
      b: weights of the slopes.
      c: times of the slopes, in units of Ts.
      order: the order of accuracy on a moving target, stages solved exactly.
      source: where it comes from.
    """

    name: str
    A: tuple
    b: tuple
    c: tuple
    order: int
    source: str

    def __repr__(self):
        return self.name

    @property
    def implicit(self) -> bool:
        """Whether some slope depends on itself."""
        return any(row[i] != 0 for i, row in enumerate(self.A))


EE = Method(
    name="EE",
    A=((0.0,),),
    b=(1.0,),
    c=(0.0,),
    order=1,
    source="explicit Euler, Drexler (2016), eq. 2; R(z) = 1 − z",
)

IE = Method(
    name="IE",
    A=((1.0,),),
    b=(1.0,),
    c=(1.0,),
    order=1,
    source="implicit Euler, Drexler (2016), eqs. 4 and 6-10; R(z) = 1/(1 + z)",
)

# The paper averages the increments of EE and of IE. Its second slope is therefore taken at the end point of
# *implicit Euler*, not at its own end point: this is not the textbook Crank-Nicolson (see TRAPEZOID) and it
# is not A-stable.
CN = Method(
    name="CN",
    A=((0.0,), (0.0, 1.0)),
    b=(0.5, 0.5),
    c=(0.0, 1.0),
    order=2,
    source="the paper's Crank-Nicolson, Drexler (2016), eqs. 11-12; R(z) = (1 − z²/2)/(1 + z)",
)

# The textbook Crank-Nicolson: the second slope is taken at the step's own end point. A-stable.
TRAPEZOID = Method(
    name="TRAPEZOID",
    A=((0.0,), (0.5, 0.5)),
    b=(0.5, 0.5),
    c=(0.0, 1.0),
    order=2,
    source="trapezoidal rule, Crank & Nicolson (1947); R(z) = (1 − z/2)/(1 + z/2)",
)

HEUN = Method(
    name="HEUN",
    A=((0.0,), (1.0, 0.0)),
    b=(0.5, 0.5),
    c=(0.0, 1.0),
    order=2,
    source="Heun (1900); R(z) = 1 − z + z²/2",
)

MIDPOINT = Method(
    name="MIDPOINT",
    A=((0.0,), (0.5, 0.0)),
    b=(0.0, 1.0),
    c=(0.0, 0.5),
    order=2,
    source="explicit midpoint rule, Runge (1895); R(z) = 1 − z + z²/2",
)

RK4 = Method(
    name="RK4",
    A=((0.0,), (0.5, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0, 0.0)),
    b=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    c=(0.0, 0.5, 0.5, 1.0),
    order=4,
    source="Kutta (1901); R(z) = 1 − z + z²/2 − z³/6 + z⁴/24",
)

METHODS = {m.name: m for m in (EE, IE, CN, TRAPEZOID, HEUN, MIDPOINT, RK4)}


def named(method, argument="method") -> Method:
    """The method, or the one of that name. Raises: ArgumentError, naming `argument`, where there is none."""
    return method if isinstance(method, Method) else METHODS[errors.one_of(argument, method, METHODS)]
