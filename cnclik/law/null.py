"""Null-space terms: what a redundant arm does with the freedom that the task leaves.

A term is a record that maps q (a tuple of n scalars) to a joint velocity q̇₀; the law projects it,
(I − J# J) q̇₀ (Liégeois 1977; Siciliano et al. 2009, eq. 3.55).
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from cnclik import errors
from cnclik.law import dense
from cnclik.law.task import Task
from cnclik.record import leaf, record
from cnclik.robot import spatial as sp
from cnclik.robot.chain import Chain
from cnclik.robot.kinematics import frames, jacobian_rows


@record
class Posture:
    """See `posture`."""

    rest: object
    rate: object

    def __call__(self, q):
        if len(self.rest) != len(q):
            raise errors.fail("rest", f"have shape ({len(q)},)", f"has shape ({len(self.rest)},)")
        return tuple(self.rate * (self.rest[i] - x) for i, x in enumerate(q))


@record
class MaximizeManipulability:
    """See `maximize_manipulability`."""

    chain: Chain
    task: Task
    gain: object

    def __call__(self, q):
        return sp.scale(self.gain, jax.grad(self._measure)(q))

    def _measure(self, q):
        rows = jacobian_rows(self.chain, frames(self.chain, q), self.task.linear, self.task.angular)
        thin = rows if len(rows) <= len(rows[0]) else sp.transpose(rows)
        trace = jax.lax.stop_gradient(sp.total(sp.dot(row, row) for row in thin))
        # A shift at rounding level: w has a kink at 0, where this stays finite.
        tiny = 64 * jnp.finfo(jnp.result_type(trace)).eps * (trace + 1e-6)
        _, _, pivots = dense.ldl(dense.gram(thin, tiny))
        product = pivots[0]
        for pivot in pivots[1:]:
            product = product * pivot
        return jnp.sqrt(product)


def posture(rest: ArrayLike, rate: ArrayLike = 1.0) -> Posture:
    """Draw the joints towards a posture in the null space: q̇₀ = rate · (q_rest − q).

    Args:
      rest: (n,) joint values [rad, m], such as the middle of the limits.
      rate: [1/s].
    """
    rate = leaf(errors.number("rate", rate, positive=True))
    return Posture(rest=errors.array("rest", rest, (None,)), rate=rate)


def maximize_manipulability(chain: Chain, task: Task, gain: ArrayLike = 1.0) -> MaximizeManipulability:
    """Move away from singularities in the null space: q̇₀ = gain · ∂w/∂q, w = √det(J Jᵀ) (Yoshikawa 1985).

    Args:
      chain, task: those of the law.
      gain: [1/s per unit of w].
    """
    return MaximizeManipulability(chain=chain, task=task, gain=leaf(errors.number("gain", gain, positive=True)))
