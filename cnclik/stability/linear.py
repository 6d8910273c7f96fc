"""Linear theory: the factor R(z) by which one step of a method multiplies the error of ė = −alpha e. NumPy only.

z = alpha·Ts throughout, real or complex. A step uses the field q̇ = −alpha q only, so R(z) follows from the tableau: a
polynomial where stages are explicit or iterated a number M of times, a rational function where they are solved exactly,
and e^{−z} of exponential methods. 1 − R(z) is the share of an error that a step removes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

from cnclik import errors
from cnclik.integrate.method import Method, MethodLike, named

REACH = 1e6  # z up to which is looked: a method stable so far has no limit
SLACK = 2.0**-40  # |R| beyond 1 by more than rounding
PAST = 1e-15  # what R may exceed 1 by, as rounding
WHOLE = 1e-12  # of a share that is missing: all of an error is removed, but for rounding
NEAR, POINTS, HALVINGS = 10.0, 1024, 52  # of a search


def passes_of(stage) -> int | None:
    """Return M of `picard(M)` or M itself; None where stages are solved exactly, as by `chord` and `newton` here.

    A field that is linear is solved exactly by the first guess of chord and newton, whatever their M.
    """
    if stage is None or type(stage).__name__ in ("chord", "newton"):
        return None
    M = getattr(stage, "M", stage)
    if not errors.concrete(M):
        raise errors.fail("M", "be a known number of passes", "is traced")
    return errors.integer("M", M, at_least=0, at_most=errors.MOST)


def removed(method: MethodLike, z, M: Any = None):
    """Return the share 1 − R(z) of an error that one step removes.

    Args:
      method: by name, or a `Method`.
      z: α·Ts, of any shape, real or complex.
      M: fixed-point passes of an implicit stage, or a stage such as picard(5); None: solved exactly.
    """
    method, M, z = named(method), passes_of(M), _numbers(z)
    if method.exponential:
        return -np.expm1(-z)
    slopes: list = []  # times Ts
    with np.errstate(all="ignore"):
        for row in method.A:
            base, own = 1.0 + sum((a * k for a, k in zip(row, slopes)), 0.0 * z), row[-1]  # noqa: B905
            slope = -z * (base if M is None or not own else 1.0)  # passes start from the step's first slope
            if own and M is None:
                slope = slope / (1.0 + own * z)
            for _ in range(M or 0) if own else ():
                slope = -z * (base + own * slope)
            slopes.append(slope)
        return -sum(b * k for b, k in zip(method.b, slopes, strict=True))


def amplification(method: MethodLike, z, M: Any = None):
    """Return R(z), the factor by which one step multiplies the error of ė = −alpha e. Args: as for `removed`."""
    return 1.0 - removed(method, z, M)


def _numbers(z):
    """z as an array of real or complex numbers, all finite."""
    with contextlib.suppress(ValueError, TypeError):
        values = np.asarray(z)
        if values.dtype.kind in "iufc" and np.isfinite(values).all():
            return values
    raise errors.fail("z", "be a finite number, or an array of them", f"is {z!r}")


def stability_limit(method: MethodLike, M: Any = None) -> float:
    """Return the largest z = alpha·Ts on the real axis up to which |R(z)| ≤ 1; inf where there is none.

    EE 2, IE with five passes 1, IE solved exactly inf, the paper's CN solved exactly 1 + √5, RK4 2.785, exponential
    methods inf.

    Args: as for `removed`.
    """
    return first_beyond(lambda z: ~(np.abs(amplification(method, z, M)) - 1.0 <= SLACK), REACH)


def gain_removing(share: float, method: MethodLike, M: Any = None) -> float:
    """Return the largest z up to which a step removes no more than a share of an error, and adds nothing to it."""
    method = named(method)
    if method.exponential:
        return float(-np.log1p(-share)) if share < 1 - WHOLE else np.inf

    def beyond(z):
        taken = removed(method, z, M)
        return ~((taken <= share) & (taken >= -PAST))

    return first_beyond(beyond, REACH)


def first_beyond(holds: Callable, reach: float, points: int = POINTS, halvings: int = HALVINGS) -> float:
    """Return the smallest x in (0, reach] from which holds(x), bisected; inf if there is none.

    What is narrower than the grid, even up to NEAR and geometric beyond, is not seen.

    Args: holds: maps an array of x to one of bools.
    """
    near = np.linspace(0, min(reach, NEAR), points + 1)[1:]
    grid = near if reach <= NEAR else np.concatenate([near, np.geomspace(NEAR, reach, points)[1:]])
    low = 0.0
    for part in np.array_split(grid, max(points // 16, 1)):
        if (there := np.asarray(holds(part))).any():
            break
        low = part[-1]
    else:
        return np.inf
    i = int(there.argmax())
    low, high = (part[i - 1] if i else low), part[i]
    for _ in range(halvings):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if bool(holds(np.array([middle]))[0]) else (middle, high)
    return float(low)


def describe(method: Method, M) -> str:
    """Return a method with its passes in words: "CN, M = 5"."""
    return f"{method.name}, {'solved exactly' if M is None else f'M = {M}'}" if method.implicit else method.name
