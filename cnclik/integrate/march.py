"""march: one step of a tableau over any field, a law's or a linear one."""

from typing import NamedTuple

import jax.numpy as jnp

from cnclik.integrate.method import Method
from cnclik.robot import spatial as sp


class Moved(NamedTuple):
    """One step over any field: where it went, how, and what the field was at its start."""

    q: tuple
    qdot: tuple
    first: object
    residual: object
    contraction: object


def march(field, q, Ts, method: Method, stage, first=None) -> Moved:
    """One step of the method over `field`, in component form.

    field(c, q) is the right-hand side at time t + c·Ts: anything with `qdot` (n scalars) and, for stages that
    use it, `correct`. A law's field is an `Evaluation`; the stability function steps over a linear one. `first` is
    field(0, q), where it is known.
    """
    first = field(0.0, q) if first is None else first  # explicit Euler: a stage of most methods, where others start
    slopes = []
    residual = contraction = jnp.zeros_like(q[0])
    for i, (row, c) in enumerate(zip(method.A, method.c, strict=True)):
        base = shift(q, Ts, row[:i], slopes)
        if row[i] == 0:
            slopes.append(first.qdot if c == 0 and not any(row) else field(c, base).qdot)
            continue
        h = sp.mul(row[i], Ts)
        ahead = sp.combine([w / row[i] for w in row[:i]], slopes) if any(row[:i]) else sp.each(lambda _: 0.0, q)

        def g(k, c=c, base=base, h=h):
            return field(c, shift(base, h, (1.0,), (k,)))

        solved = stage(g, first, h, ahead)
        slopes.append(solved.slope)
        residual = jnp.maximum(residual, solved.residual)
        contraction = jnp.maximum(contraction, solved.contraction)
    qdot = sp.combine(method.b, slopes)
    moved = shift(q, Ts, (1.0,), (qdot,))
    return Moved(q=moved, qdot=qdot, first=first, residual=residual, contraction=contraction)


def shift(q, h, weights, slopes):
    """q + h Σ wᵢ kᵢ."""
    return sp.vadd(q, sp.scale(h, sp.combine(weights, slopes))) if any(weights) else q
