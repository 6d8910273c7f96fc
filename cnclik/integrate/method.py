"""Method: one step in time as a Butcher tableau.

A step takes slopes kᵢ = f(q + Ts Σⱼ Aᵢⱼ kⱼ, t + cᵢ Ts) and moves by Ts Σᵢ bᵢ kᵢ; one with Aᵢᵢ ≠ 0 is implicit. R(z),
z = alpha·Ts, is the factor by which a step multiplies the error of ė = −alpha e.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from cnclik import errors
from cnclik.record import with_jax

ROUNDING = 1e-9  # rounding of weights written as decimals


@dataclasses.dataclass(frozen=True, kw_only=True)
class Method:
    """A (diagonally implicit) Runge-Kutta method; it is compiled in.

    Attributes:
      name: name in the API, on the command line and in datasets.
      A: rows of the lower triangular coefficient matrix, row i with i + 1 entries; a last entry of 0 may be left out.
      b: weights of the slopes.
      c: times of the slopes, in units of Ts.
      order: order of accuracy on a moving target, with exactly solved stages; taken as given.
      source: its publication.
      exponential: whether the error decays by its exact factor over the step, see `exponential`.
    """

    name: str
    A: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    c: tuple[float, ...]
    order: int
    source: str
    exponential: bool = False

    def __post_init__(self):
        b, c = _weights("b", self.b), _weights("c", self.c)
        A = tuple(_weights(f"A[{i}]", row) for i, row in enumerate(self.A))
        A = tuple((*row, 0.0) if len(row) == i else row for i, row in enumerate(A))
        if [len(row) for row in A] != list(range(1, len(b) + 1)):
            raise errors.fail("A", "be lower triangular, row i with i + 1 entries for each of `b`", f"is {self.A!r}")
        if len(c) != len(b):
            raise errors.fail("c", f"have shape ({len(b)},) like `b`", f"has shape ({len(c)},)")
        if abs(sum(b) - 1) > ROUNDING:
            raise errors.fail("b", "hold weights whose sum is 1", f"has a sum of {sum(b):g}")
        vars(self).update(A=A, b=b, c=c, order=errors.integer("order", self.order, at_least=1))
        if self.exponential and self.implicit:
            raise errors.fail("exponential", "be False for an implicit tableau", "is True")

    def __repr__(self):
        return self.name

    @property
    def implicit(self) -> bool:
        """Whether some slope depends on itself."""
        return any(row[i] != 0 for i, row in enumerate(self.A))


with_jax(lambda jax: jax.tree_util.register_static(Method))


def _weights(name, values) -> tuple:
    """Return weights or times of a method as a tuple of floats."""
    return tuple(float(x) for x in errors.array(name, values, (None,), (0,)))  # explicit: the first row is empty


def _tableau(name, order, A, b, source) -> Method:
    """Return a `Method` with cᵢ = Σⱼ Aᵢⱼ."""
    return Method(name=name, A=A, b=b, c=tuple(map(sum, A)), order=order, source=source)


EE = _tableau("EE", 1, ((0.0,),), (1.0,), "explicit Euler, Drexler (2016), eq. 2; R(z) = 1 − z")
IE = _tableau("IE", 1, ((1.0,),), (1.0,), "implicit Euler, Drexler (2016), eqs. 4 and 6-10; R(z) = 1/(1 + z)")

# The paper averages the increments of EE and of IE. Its second slope is therefore taken at the end point of
# *implicit Euler*, not at its own end point: this is not the textbook Crank-Nicolson (see TRAPEZOID) and it
# is not A-stable.
_PAPERS = "the paper's Crank-Nicolson, Drexler (2016), eqs. 11-12; R(z) = (1 − z²/2)/(1 + z)"
CN = _tableau("CN", 2, ((0.0,), (0.0, 1.0)), (0.5, 0.5), _PAPERS)

# The textbook Crank-Nicolson: the second slope is taken at the step's own end point. A-stable.
_TEXTBOOK = "trapezoidal rule, Crank & Nicolson (1947); R(z) = (1 − z/2)/(1 + z/2)"
TRAPEZOID = _tableau("TRAPEZOID", 2, ((0.0,), (0.5, 0.5)), (0.5, 0.5), _TEXTBOOK)

HEUN = _tableau("HEUN", 2, ((0.0,), (1.0, 0.0)), (0.5, 0.5), "Heun (1900); R(z) = 1 − z + z²/2")
_RUNGE = "explicit midpoint rule, Runge (1895); R(z) = 1 − z + z²/2"
MIDPOINT = _tableau("MIDPOINT", 2, ((0.0,), (0.5, 0.0)), (0.0, 1.0), _RUNGE)
_STAGES = (0.0,), (0.5, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0, 0.0)
RK4 = _tableau("RK4", 4, _STAGES, (1 / 6, 1 / 3, 1 / 3, 1 / 6), "Kutta (1901); R(z) = 1 − z + z²/2 − z³/6 + z⁴/24")


MethodLike = Method | str  # a method or its name


def named(method, argument="method") -> Method:
    """Return the method, or the one of this name. Raises: ArgumentError, naming `argument`, for an unknown name."""
    return method if isinstance(method, Method) else METHODS[errors.one_of(argument, method, METHODS)]


def exponential(method: MethodLike) -> Method:
    """Return the exponential form of an explicit method, "EXP-" and its name: stable at every gain, at the same cost.

    The law's exact solution over a step is x*(t + s) = x_d(t + s) − exp(−K·s) e(t). So e is measured once, at the
    start of the step; the tableau integrates what has no closed form, the path of the joints (after Lawson 1967):

      kᵢ = J#(qᵢ) (ẋ_d(t + cᵢ·Ts) + w) + (I − J#J) q̇₀(qᵢ),   qᵢ = q + Ts Σⱼ Aᵢⱼ kⱼ,   q⁺ = q + Ts Σᵢ bᵢ kᵢ
      w  = (I − exp(−K·Ts)) e(t)/Ts + (x_d(t + Ts) − x_d(t))/Ts − Σᵢ bᵢ ẋ_d(t + cᵢ·Ts)

    R(z) = exp(−z) for every z and every tableau. For orders above two, w follows the decay within the step; that, and
    rotations, are explained in `cnclik.law.feedback`. With exact J# the order is that of the method, with a damped J#,
    where the error decays more slowly than assumed, it is one.

    Args:
      method: an explicit `Method`, or its name.
    Raises: ArgumentError for others.
    """
    method = named(method)
    if method.implicit or method.exponential:
        raise errors.fail("method", "be an explicit tableau such as RK4", f"is {method}")
    return dataclasses.replace(
        method, name=f"EXP-{method}", exponential=True, source=f"exponential form of {method}; R(z) = exp(−z)"
    )


_PLAIN = (EE, IE, CN, TRAPEZOID, HEUN, MIDPOINT, RK4)
EXP_EE, EXP_HEUN, EXP_MIDPOINT, EXP_RK4 = map(exponential, (EE, HEUN, MIDPOINT, RK4))
METHODS = {m.name: m for m in (*_PLAIN, EXP_EE, EXP_HEUN, EXP_MIDPOINT, EXP_RK4)}

DEFAULT = EXP_MIDPOINT  # second order, without a limit of z: see results/methods


def evaluations_per_step(method: Method, stage, n: int) -> Any:
    """Return the evaluations of f(q, t) in one step of n joints; an array if the stage's M is one."""
    explicit = sum(1 for i, row in enumerate(method.A) if row[i] == 0)
    implicit = len(method.A) - explicit
    start = 0 if method.A[0][0] == 0 else 1  # implicit stages start from the explicit Euler slope
    return explicit + start + (implicit * stage.evaluations(n) if implicit else 0)
