"""The compiled programs of a search in batches: so many steps for the first lanes of arrays of a fixed size.

How many lanes, and how many steps, is decided as it runs: one program serves any number of targets.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax

from cnclik.engine.native import scalars
from cnclik.engine.plan import in_scalars, unless_chosen
from cnclik.hints import LIGHT_COMPILE, few_lanes, on_cpu, quick_jit
from cnclik.integrate.lanes import tiled
from cnclik.reaching.step import begin, in_parts, iterate
from cnclik.record import cast
from cnclik.robot.model import modelled

CAPACITY, TILE = 2048, 32  # lanes


class Found(NamedTuple):
    """What a search of (B, n) lanes comes to."""

    q: object  # the best posture of each (B, n)
    squares: object  # squared position and orientation error there (B, 2)
    cost: object
    steep: object
    looks: object

    def within(self, tolerance):
        """Which are within a tolerance [m], [rad]."""
        return (self.squares <= tolerance**2).all(axis=1)


def _lane(task, chain, bounds, tolerance, q, target, steps, careful, roots):
    chain, target = cast(chain, q.dtype), in_parts(target)

    def once(carry):
        i, at = carry
        return i + 1, iterate(chain, task, at, target, bounds, tolerance, careful, roots)

    start = jnp.zeros_like(steps), begin(q, q[0] * 0.0)
    _, at = lax.while_loop(lambda c: (c[0] < steps) & ~c[1].arrived, once, start)
    return Found(at.best, at.squares, at.cost, at.steep, at.looks)


def _many(chain, task, bounds, tolerance, q, target, steps, careful, roots, count):
    read = scalars(functools.partial(_lane, task))

    def lane(q, target, *own):
        with few_lanes(0):  # as one native function it would have more arguments than XLA (jaxlib 0.10) can pass
            return read(chain, own or bounds, tolerance, q, target, steps, careful, roots)

    own = bounds if bounds[0].ndim > 1 else ()
    return tiled(lane, min(TILE, q.shape[0]), q, target, *own, count=count)


_search = quick_jit(_many, compiler=LIGHT_COMPILE)  # runs in less than half of the time of QUICK_COMPILE's


def engine():
    """Context manager: what runs the programs, if the user has not chosen: on a CPU the source as it is.

    It is compiled in 1 s of CPU time and takes 45 to 80 µs a target; scalars take 9 s, and then half of that.
    """
    return unless_chosen("plain" if on_cpu() else None)


def workers() -> int | None:
    """How many blocks may run side by side: one of the source as it is, which calls LAPACK, else None, all.

    See `cnclik.hints.shares_threads`.
    """
    return None if in_scalars() else 1


def search(chain, task, bounds, tolerance, q, target, steps, careful=False, roots=None) -> Found:
    """At most `steps` steps from each of (B, n) postures to its target (B, 12), in the dtype of q; NumPy arrays.

    Args:
      bounds: lower and upper, (n,) for all or (B, n), in that dtype. careful, roots: see `step.iterate`.
    """
    chain, parts = modelled(chain), []
    for i in range(0, len(q), CAPACITY):
        cut = slice(i, i + CAPACITY)
        size = len(q[cut])
        own = tuple(filled(b[cut]) if b.ndim > 1 else b for b in bounds)
        part = filled(q[cut]), filled(target[cut])
        found = _search(chain, task, own, tolerance, *part, np.int32(steps), np.bool_(careful), roots, np.int32(size))
        parts.append([np.asarray(v)[:size] for v in found])
    return Found(*map(np.concatenate, zip(*parts, strict=True)))


def filled(rows, size=CAPACITY):
    """The array with so many rows, of which the last are 0."""
    if len(rows) == size:
        return rows
    out = np.zeros((size, *rows.shape[1:]), rows.dtype)
    out[: len(rows)] = rows
    return out
