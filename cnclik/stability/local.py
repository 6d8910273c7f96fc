"""The one-step map at any instant of a run, by central differences of the step itself.

A verdict wants a loop's eigenvalues where a run ended, with the error there being what it is, and at several gains.
Differences need the step compiled only as it is, a fraction of what its derivative costs; they are good to 1e-8, which
tells what shakes from what settles, but not a null-space eigenvalue from 1 (that is what `spectrum` is for).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.hints import quick_jit
from cnclik.integrate.solve import advance, cast
from cnclik.law import reference as ref
from cnclik.record import replace
from cnclik.stability.spectrum import task_radius, task_rows

GAINS = 32  # looked at together: one shape, one program
LEAST = 1e-15  # share of the gain down to which a stable one is looked for
_STEP = 1e-6  # of the differences [rad, m]
_NOISE = 1e-6  # of the eigenvalues that come of it


class Instant(NamedTuple):
    """Where a loop is at an instant, and what it is to do: a held reference that has the path's velocity."""

    q: np.ndarray  # (n,)
    reference: ref.Reference


@quick_jit
def targets(reference, task, t):
    """Position, rotation and task velocity of a reference at times t (k,), each None or an array (k, ...)."""

    def one(t):
        position, rotation, velocity = ref.sample(reference, task, t)
        return jnp.stack(position) if position else None, jnp.asarray(rotation) if rotation else None, velocity

    position, rotation, velocity = jax.vmap(one)(t)
    return position, rotation, jnp.stack([jnp.broadcast_to(v, t.shape) for v in velocity], -1)


@quick_jit(static_argnames=("method",))
def _moved(law, reference, q, scale, Ts, stage, *, method):
    """q one step on (L, n) and the rows of J (L, m, n), for gains scale·alpha (L,)."""
    law, reference, Ts = cast((law, reference, Ts), q.dtype)
    zero = jnp.zeros_like(Ts)

    def one(q, scale):
        gained = replace(law, alpha=law.alpha * scale)
        return jnp.stack(advance(gained, reference, tuple(q), zero, Ts, method, stage).q), task_rows(law, reference, q)

    return jax.vmap(one)(q, scale)


def maps(law, at: Instant, scale, Ts, method, stage):
    """∂q[k+1]/∂q[k] at an instant for gains scale·alpha (GAINS, n, n), and J (m, n)."""
    n = len(at.q)
    near = at.q + _STEP * np.concatenate([np.eye(n), -np.eye(n), np.zeros((1, n))])
    q, scales = np.tile(near, (len(scale), 1)), np.repeat(np.asarray(scale, float), 2 * n + 1)
    moved, rows = _moved(law, at.reference, q, scales, np.asarray(Ts, float), stage, method=method)
    moved = np.asarray(moved).reshape(len(scale), 2 * n + 1, n)
    return (moved[:, :n] - moved[:, n:-1]).transpose(0, 2, 1) / (2 * _STEP), np.asarray(rows[-1])


def stable_share(law, at: Instant, Ts, method, stage) -> float:
    """Share of the gain up to which the loop is stable at an instant, to 1 %: 1 if all of it is, 0 below LEAST."""

    def bad(scale):
        return ~(task_radius(*maps(law, at, scale, Ts, method, stage)) <= 1 + _NOISE)

    for top in np.geomspace(1, LEAST, 6)[:-1]:  # three decades at a time
        grid = np.geomspace(top * 1e-3, top, GAINS)
        unstable = bad(grid)
        first = int(np.argmax(unstable))
        if not unstable.any():
            return float(top)
        if first > 0:
            grid = np.linspace(grid[first - 1], grid[first], GAINS)
            return float(grid[max(int(np.argmax(bad(grid))) - 1, 0)])
    return 0.0


def fastest_share(law, at: Instant, Ts, method, stage) -> float:
    """Share of the gain, at most 1, with which the loop settles soonest at an instant."""
    grid = np.linspace(0, 1, GAINS + 1)[1:]
    for _ in range(2):
        best = grid[np.argmin(task_radius(*maps(law, at, grid, Ts, method, stage)))]
        grid = np.minimum(best + (np.arange(GAINS) - GAINS // 2) / (GAINS // 2) / GAINS, 1.0)
    return float(best)
