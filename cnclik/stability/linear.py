"""Linear theory: what a method's own step does to ė = −alpha e.

z = alpha·Ts throughout, real or complex; R(z) is the factor by which one step multiplies e. The library's own
stepping runs over the linear field, so code and theory can't drift apart: `picard(5)` is the polynomial that five
passes are, `chord` and `newton` solve a linear stage exactly. Exponential methods hold their feedback over the step:
R(z) = e^{−z}, of all of them. A multistep method has a factor for each instant that it uses, the roots of
λᵖ = Σⱼ (aⱼ − z bⱼ) λᵖ⁻¹⁻ʲ; what counts is the largest. Everything here runs in float64 by itself.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import MOST
from cnclik.integrate.march import march
from cnclik.integrate.method import MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.feedback import per_step
from cnclik.precision import in_float64, of_numbers
from cnclik.record import Array, Float, record
from cnclik.robot.model import one_off

REACH = 1e6  # a method stable up to here on the real axis is called stable without limit
EPS = np.finfo(np.float64).eps  # of the precision everything here is computed in
_SLACK = 2**12 * EPS  # |R| above 1 by more than this is unstable: rounding of R(z) = ±1 is not
_ZERO = 1e-6  # a factor below this is none
_BLOCKS = (32, 1024)  # numbers of z in a call: any other would be compiled of its own
_PLATEAU = 1e-3  # a function within this share of its least value, at the end of an open range, falls on


class _Linear(NamedTuple):
    """The field q̇ = −w q."""

    qdot: Float[Array, " m"]
    newton: Callable


def stepped(method, stage, through, gain, Ts):
    """R (m, m): what one step of a one-step method does to the errors of ė = −P K e. Pure.

    Args: through: P (m, m), J J# of a loop at rest. gain: K (m, m), held over the step by an exponential method.
    """
    eye = jnp.eye(len(gain), dtype=gain.dtype)
    if method.exponential:
        return eye - Ts * through * per_step(jnp.diagonal(gain), Ts)
    w = through @ gain

    def field(_, q):
        f = -w @ q
        return _Linear(f, lambda h, k: k + jnp.linalg.solve(eye + h * w, f - k))

    return jax.vmap(lambda start: march(field, start, Ts, method, stage).q, out_axes=1)(eye)


@one_off(static_argnames=("method",))
def _amplification(method, stage, a, b):
    def one(a, b):
        w = jnp.array([[a, -b], [b, a]])
        return stepped(method, stage, jnp.eye(2), w, jnp.ones_like(a))[:, 0]

    return jax.vmap(one)(a, b)


@in_float64
def amplification(method, stage, z):
    """R(z): the factor by which one step of the method multiplies the error of ė = −alpha e.

    Of a multistep method it is the largest of the factors of a loop that has run for long.

    Args:
      method: EE, IE, CN, ... or a `Method` of your own; also by name.
      stage: how implicit stages are solved, such as picard(5); None for explicit methods.
      z: alpha·Ts, a number or an array of any shape, real or complex. Numerical analysis writes −z for it.
    Returns: a NumPy array of the shape of z; complex where z is, or where a multistep method's factor is. In float64.
    """
    method, stage = checked(method, stage)
    z = _numbers(z)
    if method.steps > 1 and not method.exponential:
        roots = factors(method, stage, z)
        largest = np.take_along_axis(roots, np.argmax(np.abs(roots), -1)[..., None], -1)[..., 0]
        return largest if np.iscomplexobj(z) or np.any(largest.imag) else largest.real
    x, y = _in_blocks(at_rest_as(method), stage, z.reshape(-1))
    value = x + 1j * y if np.iscomplexobj(z) else x
    return value.reshape(z.shape)


def _in_blocks(method, stage, z):
    """R of z (n,) as (2, n), in blocks of few sizes: a size of its own would be compiled of its own."""
    size = next((size for size in _BLOCKS if len(z) <= size), _BLOCKS[-1])
    pairs = np.zeros((2, -(-len(z) // size) * size))
    pairs[:, : len(z)] = z.real, z.imag
    blocks = [_amplification(method, stage, *block) for block in pairs.reshape(2, -1, size).swapaxes(0, 1)]
    return np.concatenate([*blocks, np.zeros((0, 2))])[: len(z)].T


def _numbers(z):
    """z as an array of real or complex numbers, all finite."""
    with contextlib.suppress(ValueError, TypeError):
        found = np.asarray(z)
        if found.dtype.kind in "iufc" and np.isfinite(found).all():
            return found
    raise errors.fail("z", "be a finite number, or an array of them", f"is {z!r}")


def at_rest_as(method):
    """A method that does the same to a small error at rest: of exponential formulas with a memory, exponential Euler.

    What they remember, J# and the target's velocity, has no say there.
    """
    return named("EXP-EE") if method.exponential and method.steps > 1 else method


@in_float64
def factors(method, stage, z, delay: int = 0):
    """All factors λ of a loop whose error has a delay of `delay` samples, complex (..., count); prompt by default.

    A step is e[k+1] = Σⱼ aⱼ e[k−j] + Σⱼ Bⱼ e[k−j−d]: a = 1 and B = R(z) − 1 of a one-step method, Bⱼ = −z bⱼ of a
    multistep formula. The factors are the roots of its polynomial.
    """
    method, stage = checked(method, stage)
    delay = errors.integer("delay", delay, at_least=0, at_most=MOST)
    a, b = coefficients(method, stage, _numbers(z))
    row = np.zeros((*b.shape[:-1], len(a) + delay), b.dtype)
    row[..., : len(a)] += a
    row[..., delay:] += b
    return np.linalg.eigvals(companion(row)).astype(complex)


def coefficients(method, stage, z):
    """a (p,) and B (..., p) of a step, see `factors`; both checked."""
    if method.steps == 1 or method.exponential:
        return np.ones(1), (amplification(method, stage, z) - 1.0)[..., None]
    a, b = (np.pad(np.asarray(v, float), (0, method.steps - len(v))) for v in (method.a, method.b))
    return a, -np.asarray(z)[..., None] * b


def companion(row):
    """The matrix (..., p, p) of e[k+1] = Σⱼ rowⱼ e[k−j], the newest first."""
    made = np.zeros((*row.shape, row.shape[-1]), row.dtype)
    made[..., 0, :] = row
    made[..., np.arange(1, row.shape[-1]), np.arange(row.shape[-1] - 1)] = 1
    return made


def checked(method, stage):
    """A method, also by name, and its stage, which an explicit one doesn't need."""
    method = named(method)
    if stage is None:
        if method.implicit:
            raise errors.fail("stage", f"be given for {method}, such as picard(5)", "is None")
        stage = picard(0)
    if not hasattr(stage, "tolerance"):
        raise errors.fail("stage", "be a stage such as picard(5)", f"is {stage!r}")
    return method, stage


# --- crossings ----------------------------------------------------------------------------------------


FEW = 16  # values of a batch up to which one is dear: they are looked at one after another


def first_above(fn, level, reach=REACH, points=1024):
    """Smallest z from which fn(z) > level, to 11 digits; inf where that is nowhere up to `reach`, 0 where it always is.

    fn maps an array (points,) to one. It is looked at every 10/points up to 10 and in geometric steps beyond; an
    excursion narrower than that is not seen. With FEW points the result has five digits.
    """
    near = np.linspace(0, 10, points + 1)[1:]
    grids = (near, np.geomspace(10, reach, points)) if reach > 10 else (np.linspace(0, reach, points + 1)[1:],)
    low, least, (parts, rounds) = 0.0, 1 if points <= FEW else points, (2, 16) if points <= FEW else (points, 4)
    for grid in grids:
        if (i := _first(fn, level, grid, least)) < len(grid):
            low, high = (grid[i - 1] if i else low), grid[i]
            break
        low = grid[-1]
    else:
        return np.inf
    for _ in range(rounds):  # to a thousandth of the bracket, or half of it
        grid = np.linspace(low, high, parts + 1)[1:]
        i = _first(fn, level, grid[:-1], parts)
        low, high = (grid[i - 1] if i else low), grid[i]
    return float(0.5 * (low + high)) if low else 0.0


def _first(fn, level, grid, least):
    """Index of the first value of a grid above a level, or its length; batches grow from `least`."""
    i = 0
    while i < len(grid):
        above = ~(np.asarray(fn(grid[i : i + max(i, least)])) <= level)  # NaN counts as above
        if above.any():
            return i + int(np.argmax(above))
        i += len(above)
    return i


def least_on(fn, high, points=1024):
    """Where fn is least on (0, high], and its value there.

    Beyond 10 a function that falls to the end, or stays there at its least value, is least at `high`: rounding of
    what has levelled off doesn't choose a place.
    """
    low = 0.0
    if high > 10:  # unbounded in effect: first find the scale
        grid = np.geomspace(1e-2, high, points)
        values = np.asarray(fn(grid))
        i = int(np.argmin(values))
        if values[-1] <= values[i] * (1 + _PLATEAU) + _SLACK:
            return float(high), float(values[-1])
        low, high = (grid[i - 1] if i else 0.0), grid[i + 1]
    for _ in range(1 if points <= FEW else 5):
        grid = np.linspace(low, high, points + 1)[1:]
        values = np.asarray(fn(grid))
        i = int(np.argmin(values))
        low, high = (grid[i - 1] if i else low), grid[min(i + 1, points - 1)]
    at, least = grid[i], values[i]
    for _ in range(12 if points <= FEW else 0):  # halved about the least, which is known
        grid = np.array([low, 0.5 * (low + at), at, 0.5 * (at + high), high])
        values = np.array([np.inf, *fn(grid[1:4:2]), np.inf])[[0, 1, 0, 2, 3]]
        values[2] = least
        i = int(np.argmin(values))
        (low, at, high), least = grid[i - 1 : i + 2], values[i]
    return float(at), float(least)


# --- limits -------------------------------------------------------------------------------------------


@record
class RealAxisLimits:
    """Limits of z = alpha·Ts on the real axis, by R(z); inf without a limit.

    Attributes:
      stable: largest z up to which |R| ≤ 1.
      monotone: largest z up to which 0 ≤ R ≤ 1: the error shrinks without changing sign.
      dead_beat: smallest z with R = 0, where one step removes the error; NaN where there is none.
      fastest: z of the smallest |R| in the stable range.
      rate: |R| there.
    """

    stable: float
    monotone: float
    dead_beat: float
    fastest: float
    rate: float


@of_numbers
def real_axis_limits(method, stage=None) -> RealAxisLimits:
    """Stable, monotone, dead-beat and fastest z of a method with its stage, from `amplification`. In float64.

    Args: as for `amplification`.
    """
    method, stage = checked(method, stage)
    stable = stability_limit(method, stage)
    crossing = first_above(lambda z: _changes_sign(amplification(method, stage, z)), 2**9 * EPS)
    zero_there = np.abs(amplification(method, stage, min(crossing, REACH))) < _ZERO  # or two real factors meet
    fastest, rate = least_on(lambda z: np.abs(amplification(method, stage, z)), min(stable, REACH))
    return RealAxisLimits(
        stable=stable,
        monotone=min(stable, crossing),
        dead_beat=crossing if crossing < stable and zero_there else np.nan,
        fastest=np.inf if fastest >= REACH else fastest,  # approached, never reached
        rate=rate,
    )


def _changes_sign(factor):
    """How far a factor is from one of an error that keeps its sign: −R, and |Im R| of a complex one."""
    return np.maximum(-factor.real, np.abs(factor.imag)) if np.iscomplexobj(factor) else -factor


@of_numbers
def stability_limit(method: MethodLike, stage: Stage | None = None) -> float:
    """Largest z = alpha·Ts on the real axis up to which |R(z)| ≤ 1; inf where there is none. In float64.

    EE 2, IE with picard(5) 1, IE with chord(M) inf, the paper's CN solved exactly 1 + √5, RK4 2.785, AB2 1, exponential
    methods inf.
    """
    method, stage = checked(method, stage)
    return first_above(lambda z: np.abs(amplification(method, stage, z)), 1 + _SLACK)


def stability_region(method, stage=None, *, real=(-2.0, 4.0), imaginary=(-4.0, 4.0), points=401):
    """|R(z)| over the complex plane, stable where it is at most 1.

    A pair of complex z belongs to a gain matrix with complex eigenvalues, or to a law that turns (error in a
    rotating frame, a Jacobian that is wrong by an angle φ: z exp(iφ)).

    Returns: an xarray.DataArray with dimensions (im, re).
    """
    import xarray as xr

    method, stage = checked(method, stage)
    points = errors.integer("points", points, at_least=2, at_most=10_000)
    ends = (np.asarray(errors.array(name, v, (2,)), float) for name, v in (("real", real), ("imaginary", imaginary)))
    x, y = (np.linspace(*pair, points) for pair in ends)
    values = np.abs(amplification(method, stage, x + 1j * y[:, None]))
    return xr.DataArray(
        values,
        dims=("im", "re"),
        coords={
            "re": ("re", x, {"units": "1", "long_name": "Re z"}),
            "im": ("im", y, {"units": "1", "long_name": "Im z"}),
        },
        name="amplification",
        attrs={"units": "1", "long_name": "|R(z)|", "method": method.name, "stage": str(stage)},
    )


# --- delay --------------------------------------------------------------------------------------------


@of_numbers
def delayed_radius(method, stage, z, delay: int):
    """Spectral radius of the loop whose error has a delay of `delay` samples.

    A step then adds its increment from the state `delay` samples ago, e[k+1] = e[k] + (R(z) − 1) e[k−d]: the
    largest root of λ^(d+1) − λ^d + 1 − R(z) = 0. See `factors` for multistep methods.

    Args:
      z: alpha·Ts, an array of any shape.
      delay: d ≥ 0, whole samples.
    """
    return np.abs(factors(method, stage, z, delay)).max(-1)


def late_stable(delay: float) -> float:
    """Largest stable z of explicit Euler with d samples of dead time: 2 sin(π/(2(2d + 1))) (Levin & May 1976)."""
    return 2 * math.sin(math.pi / (4 * delay + 2))


def late_monotone(delay: float) -> float:
    """Largest z of explicit Euler without overshoot, with d samples of dead time: d^d/(d + 1)^(d + 1).

    Up to it an error may keep its sign, beyond it none does (Ladas, Philos & Sficas 1989).
    """
    return (delay / (delay + 1)) ** delay / (delay + 1)


@of_numbers
def delay_limit(delay: int, method="EE", stage=None) -> float:
    """Largest stable z = alpha·Ts with an error delayed by `delay` samples, on the real axis.

    Explicit Euler: 2 sin(π/(2(2d + 1))), that is 2, 1, 0.618, 0.445, 0.347 for d = 0 … 4 (Levin & May 1976).
    Exponential methods: where 1 − e^{−z} is that, so none for d = 0 and 1, then 0.962, 0.589, 0.427.
    """
    method, stage = checked(method, stage)
    return first_above(lambda z: delayed_radius(method, stage, z, delay), 1 + _SLACK)


# --- units of gain ------------------------------------------------------------------------------------


def gain_per_step(alpha, Ts):
    """z = alpha·Ts: the dimensionless gain per step that pink and mink take (1 is dead-beat for EE)."""
    return alpha * Ts


def share_per_step(method, z: float) -> float:
    """Share of an error that an explicit Euler step removes so that it decays as with this method: z, or 1 − e^{−z}."""
    return -math.expm1(-z) if method.exponential else z


def gain_per_second(z, Ts):
    """alpha = z/Ts [1/s]: the rate that this library, robotics-toolbox and frax take, from a gain per step."""
    return z / Ts
