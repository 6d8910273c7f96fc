"""The null-space term: a posture that pulls at the joints of a redundant arm and does not move the task.

The law projects its pull q̇₀, (I − J# J) q̇₀ (Liégeois 1977; Siciliano et al. 2009, eq. 3.55).
"""

from __future__ import annotations

from cnclik import errors
from cnclik.record import ArrayLike, Float, Number, leaf, record


@record
class Posture:
    """See `posture`."""

    rest: Float[ArrayLike, " n"]
    rate: Number


def posture(rest: Float[ArrayLike, " n"], rate: Number = 1.0) -> Posture:
    """Move the joints towards a posture in the null space: q̇₀ = rate · (q_rest − q).

    Args:
      rest: (n,) joint values [rad, m], such as the middle of the limits.
      rate: [1/s].
    """
    rate = leaf(errors.number("rate", rate, positive=True))
    return Posture(rest=errors.array("rest", rest, (None,)), rate=rate)
