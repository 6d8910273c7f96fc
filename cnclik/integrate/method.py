"""Method: one step in time as a Butcher tableau.

A step takes slopes kᵢ = f(q + Ts Σⱼ Aᵢⱼ kⱼ, t + cᵢ Ts) and moves by Ts Σᵢ bᵢ kᵢ. A stage with Aᵢᵢ ≠ 0 is
implicit; `cnclik.integrate.stage` explains how it is solved. From the tableau come the stepper, the stability
function and the names on the command line. z = alpha·Ts, and R(z) is the factor by which one step
multiplies the error of ė = −alpha e.
"""

import dataclasses
import functools
import itertools
from fractions import Fraction

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.stage import Count

ROUNDING = 1e-9  # rounding of weights written as decimals


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
class Method:
    """A (diagonally implicit) Runge-Kutta method; it is compiled in.

    Attributes:
      name: name in the API, on the command line and in datasets.
      A: rows of the lower triangular coefficient matrix, row i with i + 1 entries; a last entry of 0 may be left out.
      b: weights of the slopes.
      c: times of the slopes, in units of Ts.
      order: order of accuracy on a moving target, with exactly solved stages.
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
        b, c = weights_of("b", self.b), weights_of("c", self.c)
        A = tuple(weights_of(f"A[{i}]", row) for i, row in enumerate(self.A))
        A = tuple((*row, 0.0) if len(row) == i else row for i, row in enumerate(A))
        if [len(row) for row in A] != list(range(1, len(b) + 1)):
            raise errors.fail("A", "be lower triangular, row i with i + 1 entries for each of `b`", f"is {self.A!r}")
        if len(c) != len(b):
            raise errors.fail("c", f"have shape ({len(b)},) like `b`", f"has shape ({len(c)},)")
        most = len(b) + any(row[-1] != 0 for row in A)  # s stages have order s at most, implicit ones s + 1
        left = _conditions(A, np.array(b), np.array(c), most + 1)
        for name, value in (("A", A), ("b", b), ("c", c), ("order", check_order(self.order, b, left))):
            object.__setattr__(self, name, value)
        if self.exponential and self.implicit:
            raise errors.fail("exponential", "be False for an implicit tableau", "is True")

    def __repr__(self):
        return self.name

    @property
    def implicit(self) -> bool:
        """Whether some slope depends on itself."""
        return any(row[i] != 0 for i, row in enumerate(self.A))

    @property
    def steps(self) -> int:
        """Number of instants that it uses: one."""
        return 1


def _conditions(A, b, c, most):
    """The residuals of the conditions of orders 1 to `most`: Σ bᵢ Φᵢ(t) − 1/γ(t) for every rooted tree t with as many
    vertices (Hairer, Nørsett & Wanner 1993, II.2).
    """
    A = np.array([(*row, *(0.0,) * (len(b) - len(row))) for row in A])
    for order in range(1, most + 1):
        weighed = [_weight(A, tree) for tree in trees(order)]
        yield [b @ phi - 1 / gamma for phi, gamma, _ in weighed] + [*(A.sum(1) - c)] * (order == 2)


@functools.cache
def trees(order):
    """Rooted trees with `order` vertices; each is the sorted tuple of the subtrees at its root."""
    return ((),) if order == 1 else tuple(sorted({new for tree in trees(order - 1) for new in _grown(tree)}))


def _grown(tree):
    """Trees with one more leaf."""
    yield tuple(sorted((*tree, ())))
    for i, branch in enumerate(tree):
        for new in _grown(branch):
            yield tuple(sorted((*tree[:i], new, *tree[i + 1 :])))


def _weight(A, tree):
    """(Φ (s,), γ, number of vertices) of a tree."""
    phi, gamma, count = np.ones(len(A)), 1, 1
    for branch in tree:
        above, density, size = _weight(A, branch)
        phi, gamma, count = phi * (A @ above), gamma * density, count + size
    return phi, gamma * count, count


def _tableau(name, order, A, b, source) -> Method:
    """A `Method` with cᵢ = Σⱼ Aᵢⱼ."""
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


# --- multistep methods --------------------------------------------------------------------------------
#   q[k+1] = Σⱼ aⱼ q[k−j] + Ts Σⱼ bⱼ f[k−j]
#
# Adams-Bashforth formulas remember slopes; the Taylor-type formulas of the zeroing-neural-network literature remember
# joint values. The limit of z = alpha·Ts follows from the roots of λᵖ = Σⱼ (aⱼ − z bⱼ) λᵖ⁻¹⁻ʲ, see
# `cnclik.stability.linear`.


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
        `cnclik.integrate.history`.
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

MethodLike = Method | Multistep | str  # a method or its name


def named(method, argument="method") -> Method | Multistep:
    """The method, or the one with this name. Raises: ArgumentError, naming `argument`, for an unknown name."""
    return method if isinstance(method, (Method, Multistep)) else METHODS[errors.one_of(argument, method, METHODS)]


def exponential(method: MethodLike) -> Method | Multistep:
    """The exponential form of an explicit method, "EXP-" and its name: stable at every gain, at the same cost.

    The law's exact solution over a step is x*(t + s) = x_d(t + s) − exp(−K·s) e(t). So e is measured once, at the
    start of the step, and decays by its exact factor. The tableau integrates what has no closed form, the path of the
    joints (an exponential integrating-factor step, after Lawson 1967):

      kᵢ = J#(qᵢ) (ẋ_d(t + cᵢ·Ts) + w) + (I − J#J) q̇₀(qᵢ),   qᵢ = q + Ts Σⱼ Aᵢⱼ kⱼ,   q⁺ = q + Ts Σᵢ bᵢ kᵢ
      w  = (I − exp(−K·Ts)) e(t)/Ts + (x_d(t + Ts) − x_d(t))/Ts − Σᵢ bᵢ ẋ_d(t + cᵢ·Ts)

    R(z) = exp(−z) for every z and every tableau. For orders above two, w follows the decay within the step, see
    `cnclik.law.feedback.feedback_within`. With exact J# the order is that of the method; that of EXP-AB methods is two
    while an error decays. With a damped J# the error decays more slowly than assumed, and the order is one. Rotations
    are explained in `cnclik.law.feedback`. An Adams-Bashforth formula becomes an EXP-AB method, with
    one Jacobian per step and a memory, see `cnclik.integrate.history`.

    Args:
      method: an explicit `Method` or an Adams-Bashforth `Multistep`, or its name.
    Raises: ArgumentError for others.
    """
    method = named(method)
    if method.implicit or method.exponential or getattr(method, "a", (1.0,)) != (1.0,):
        raise errors.fail("method", "be an explicit tableau such as RK4, or AB2, AB3 or AB4", f"is {method}")
    return dataclasses.replace(
        method, name=f"EXP-{method}", exponential=True, source=f"exponential form of {method}; R(z) = exp(−z)"
    )


_PLAIN = (EE, IE, CN, TRAPEZOID, HEUN, MIDPOINT, RK4)
_OF_STEPS = (AB2, AB3, AB4, ZNN4, ZEAD4, ZNN6, IFD5)
EXP_EE, EXP_HEUN, EXP_MIDPOINT, EXP_RK4 = map(exponential, (EE, HEUN, MIDPOINT, RK4))
EXP_AB2, EXP_AB3, EXP_AB4 = map(exponential, (AB2, AB3, AB4))
_EXPONENTIAL = EXP_EE, EXP_HEUN, EXP_MIDPOINT, EXP_RK4, EXP_AB2, EXP_AB3, EXP_AB4
METHODS = {m.name: m for m in (*_PLAIN, *_OF_STEPS, *_EXPONENTIAL)}

DEFAULT = EXP_MIDPOINT  # second order, without a memory or a limit of z: see results/methods


def starter(method):
    """The one-step method of the first steps of a multistep method: RK4, or EXP-RK4."""
    return EXP_RK4 if method.exponential else RK4


# --- what a step costs -------------------------------------------------------------------------------------


def evaluations_per_step(method, stage, n: int) -> Count:
    """Evaluations of f(q, t) in one step with n joints; an array if the stage's M is one."""
    if method.steps > 1:
        return 1
    explicit = sum(1 for i, row in enumerate(method.A) if row[i] == 0)
    implicit = len(method.A) - explicit
    start = 0 if method.A[0][0] == 0 else 1  # implicit stages start from the explicit Euler slope
    return explicit + start + (implicit * stage.evaluations(n) if implicit else 0)


def evaluations_of(method, stage, n: int, N: int) -> Count:
    """Evaluations of f(q, t) in N steps with n joints, including those of the starting method."""
    several = N * evaluations_per_step(method, stage, n)
    if method.steps == 1:
        return several
    return several + early_steps(method, N) * (evaluations_per_step(starter(method), stage, n) - 1)


def early_steps(method, N: int) -> int:
    """Number of steps, at most N, by the starting method."""
    return min(method.steps - 1, N)
