"""Multistep methods: one evaluation of f per step, and a memory of the steps before.

  q[k+1] = Σⱼ aⱼ q[k−j] + Ts Σⱼ bⱼ f[k−j]

Adams-Bashforth formulas remember slopes; the Taylor-type formulas of the zeroing-neural-network literature remember
joint values. The limit of z = alpha·Ts follows from the roots of λᵖ = Σⱼ (aⱼ − z bⱼ) λᵖ⁻¹⁻ʲ, see
`cnclik.stability.linear`.
"""

import dataclasses
import functools
import itertools
from fractions import Fraction

import jax
import numpy as np

from cnclik import errors

ROUNDING = 1e-9  # rounding of weights written as decimals


@functools.cache
def adams(p: int) -> tuple:
    """The p weights of Adams-Bashforth, bⱼ = ∫₀¹ Πᵢ (s + i)/(i − j) ds over i ≠ j (Bashforth & Adams 1883).

    See Hairer, Nørsett & Wanner (1993), III.1.
    """
    weights = []
    for j in range(p):
        polynomial = [Fraction(1)]  # coefficients in s, constant first
        for i in (*range(j), *range(j + 1, p)):
            polynomial = [(i * a + b) / (i - j) for a, b in zip([*polynomial, 0], [0, *polynomial], strict=True)]
        weights.append(float(sum(x / (k + 1) for k, x in enumerate(polynomial))))
    return tuple(weights)


def weights_of(name, values) -> tuple:
    """Weights or times of a method as a tuple of floats."""
    return tuple(float(x) for x in errors.array(name, values, (None,)))


def check_order(order, b, left) -> int:
    """A method's order, a whole number. Raises: ArgumentError if its weights have a lower order.

    Args: left: residuals of the conditions of orders 1, 2, …, one tuple per order; 0 if they hold.
    """
    order = errors.integer("order", order, at_least=1)
    left = iter(left)
    (excess,) = next(left)
    if abs(excess) > ROUNDING:
        raise errors.fail("b", f"hold weights whose sum is {sum(b) - excess:g}", f"has a sum of {sum(b):g}")
    for found, missed in enumerate(itertools.islice(left, order - 1), 1):
        if max(map(abs, missed)) > ROUNDING:
            raise errors.fail("order", f"be {found}, that of the weights", f"is {order}")
    return order


@jax.tree_util.register_static
@dataclasses.dataclass(frozen=True, kw_only=True)
class Multistep:
    """An explicit linear multistep method; it is compiled in.

    Attributes:
      name: name in the API, on the command line and in datasets.
      a: weights of q[k], q[k−1], …; their sum is 1.
      b: weights of the slopes f[k], f[k−1], ….
      order: order of accuracy on a moving target.
      source: its publication.
      exponential: whether the error decays by its exact factor and J# and ẋ_d are remembered, see
        `cnclik.integrate.remember`.
    """

    name: str
    a: tuple[float, ...] = (1.0,)
    b: tuple[float, ...]
    order: int
    source: str
    exponential: bool = False

    def __post_init__(self):
        a, b = (weights_of(name, getattr(self, name)) for name in "ab")
        if abs(sum(a) - 1) > ROUNDING:
            raise errors.fail("a", "hold weights whose sum is 1", f"holds {list(a)}")
        roots = np.roots([1.0, *(-w for w in a)])  # growth of errors of the past for any Ts (Dahlquist 1956)
        growth = max(map(abs, roots))
        if growth > 1 + ROUNDING**0.5:
            raise errors.fail("a", "have no root of λᵖ = Σⱼ aⱼ λᵖ⁻¹⁻ʲ beyond 1", f"has one of size {growth:.4g}")
        edge = roots[np.abs(roots) > 1 - ROUNDING**0.5]
        if any(abs(one - other) < ROUNDING**0.25 for one, other in itertools.combinations(edge, 2)):
            raise errors.fail("a", "have no double root of λᵖ = Σⱼ aⱼ λᵖ⁻¹⁻ʲ at 1: errors would add up", "has one")
        if self.exponential and a != (1.0,):
            raise errors.fail("exponential", "be False for a formula that remembers joint values", "is True")
        order = check_order(self.order, b, [[_missed(a, b, k)] for k in range(1, len(a + b) + 2)])
        for name, value in (("a", a), ("b", b), ("order", order)):
            object.__setattr__(self, name, value)

    def __repr__(self):
        return self.name

    @property
    def implicit(self) -> bool:
        """False, as for an explicit `Method`."""
        return False

    @property
    def steps(self) -> int:
        """Number of instants that the formula uses, including the present one."""
        return max(len(self.a), len(self.b))

    @property
    def table(self) -> tuple:
        """(a, b), each with `steps` weights, by the number of remembered instants before the present one.

        With all of them it is the formula itself; with fewer, Adams-Bashforth of rising order up to its own.
        """
        rising = [((1.0,), adams(min(past + 1, self.order))) for past in range(self.steps - 1)]
        return tuple(tuple((*w, *(0.0,) * (self.steps - len(w))) for w in row) for row in (*rising, (self.a, self.b)))


def _missed(a, b, k) -> float:
    """The error of the formula at the end of a step from 0 to 1 along tᵏ."""
    past = sum(w * (-j) ** k for j, w in enumerate(a))
    return past - 1.0 + sum(w * k * (-j) ** (k - 1) for j, w in enumerate(b))


_ADAMS = "Bashforth & Adams (1883)"
AB2, AB3, AB4 = (Multistep(name=f"AB{p}", b=adams(p), order=p, source=_ADAMS) for p in (2, 3, 4))
_TAYLOR = "Taylor-type difference of the zeroing-neural-network literature, "
_FOUR, _FIVE = _TAYLOR + "four instants; z up to 1", _TAYLOR + "five instants; z up to 0.281"
ZNN4 = Multistep(name="ZNN4", a=(3 / 2, -1.0, 1 / 2), b=(1.0,), order=2, source=_FOUR)
ZEAD4 = Multistep(name="ZEAD4", a=(3 / 5, 1 / 5, 1 / 5), b=(8 / 5,), order=2, source=_FOUR)
_ZNN6 = 6 / 13, 2 / 13, 4 / 13, 3 / 13, -2 / 13
ZNN6 = Multistep(name="ZNN6", a=_ZNN6, b=(24 / 13,), order=3, source=_TAYLOR + "six instants; z up to 2/3")
IFD5 = Multistep(name="IFD5", a=(-1 / 8, 3 / 4, 5 / 8, -1 / 4), b=(9 / 4,), order=3, source=_FIVE)
