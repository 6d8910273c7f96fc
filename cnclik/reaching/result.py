"""Result of a search for poses: one status per target, never a silent wrong answer."""

import enum
from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.record import AnyArray, Bool, Float, Int, record
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.task.parts import At
from cnclik.task.task import Task, aims

TOUCHING = 1e-9  # [rad, m] distance from a limit that counts as being at it


class ReachStatus(enum.IntEnum):
    """Outcome for a target."""

    SOLVED = 0  # q is an answer: both errors are within `tolerance`
    AT_LIMIT = 1  # there are answers beyond the joint limits alone; q is the nearest pose found within them
    OUT_OF_REACH = 2  # farther than the stretched arm, or no answer found, without limits either; q is the nearest pose
    JUMP = 3  # there are answers, but none within `jump` of `near`; q is NaN
    OUT_OF_BUDGET = 4  # no answer found, and it is not known whether there is one; q is the best pose found
    NON_FINITE = 5  # the target, or `near`, is not finite, or beyond 1e77 m (1e9 in float32); q is NaN
    NO_OTHER = 6  # fewer different solutions were found than asked for; q is NaN


@record
class Reached:
    """Answers for B targets; one target has no axis B, and k `solutions` have an axis k after it.

    Errors are of the tip that misses most. The orientation error is 2 asin ‖v‖, v the task's coordinates of the vector
    part of the quaternion of the rotation that is left: of three axes its angle, of "xy" the tilt of the z axis.
    NumPy arrays in float64; under jit, vmap and grad JAX's, in its dtype.
    """

    q: Float[AnyArray, "*B n"]  # joint values [rad, m]
    status: Int[AnyArray, " *B"]  # values of `ReachStatus`
    position_error: Float[AnyArray, " *B"]  # [m], of the task's coordinates, evaluated again in float64
    orientation_error: Float[AnyArray, " *B"]  # [rad], about the task's axes
    distance: Float[AnyArray, " *B"]  # largest joint's distance from `near` [rad, m]; NaN without it or q
    chain: Chain  # the robot
    task: Task  # the task

    @property
    def solved(self) -> Bool[AnyArray, " *B"]:
        """Whether q is an answer."""
        return self.status == ReachStatus.SOLVED

    @property
    def at_limit(self) -> Bool[AnyArray, "*B n"]:
        """Whether each joint is at one of the chain's limits."""
        return touching(self.chain, self.q)

    @property
    def strays(self) -> Float[np.ndarray, " B-1"]:
        """(B − 1,) how far a tip, the one that strays most, leaves the straight line half-way between rows [m].

        While all joints move evenly from one answer to the next; NaN where one of both is missing.
        Raises: ArgumentError for what is no path: one target, or several solutions of each.
        """
        if self.q.ndim != 2:
            raise errors.fail("targets", "be rows of a path, each with one answer", f"gave q of shape {self.q.shape}")
        q, chain = np.where(self.solved[:, None], self.q, np.nan), modelled(self.chain)
        tips = dict.fromkeys((aim.tip, aim.to) for aim in aims(self.task))
        there, between = At(chain, q), At(chain, (q[1:] + q[:-1]) / 2)
        ends = [there.position(*tip) for tip in tips]
        away = [between.position(*tip) - (p[1:] + p[:-1]) / 2 for tip, p in zip(tips, ends, strict=True)]
        return np.max([np.linalg.norm(v, axis=1) for v in away], axis=0)

    def __str__(self):
        return ", ".join(f"{number:,} {name}" for name, number in count(self.status).items())


def count(status) -> dict:
    """Return the number of targets with each status."""
    status = np.asarray(status)
    return {s.name: int(np.sum(status == s)) for s in ReachStatus if np.any(status == s)}


def touching(chain: Chain, q):
    """Return which joints (..., n) are at a limit."""
    return (q <= np.array(chain.lower) + TOUCHING) | (q >= np.array(chain.upper) - TOUCHING)


class Row(NamedTuple):
    """What a descent, or a search, comes to: views of the rows (..., n + 6) of targets."""

    q: Float[AnyArray, "*B n"]
    status: Float[AnyArray, " *B"]
    position_error: Float[AnyArray, " *B"]  # [m]
    orientation_error: Float[AnyArray, " *B"]  # [rad]
    distance: Float[AnyArray, " *B"]  # from `near`; NaN without it
    cost: Float[AnyArray, " *B"]  # squared error [units, rad], weighted where it is that of the nearest pose
    steep: Float[AnyArray, " *B"]  # its gradient there, see `descent.State`


def width(n: int) -> int:
    """Return the numbers of a row."""
    return n + len(Row._fields) - 1


def row_of(rows, n: int) -> Row:
    """Return views of rows (..., width)."""
    return Row(rows[..., :n], *[rows[..., i] for i in range(n, width(n))])


def blank(n: int) -> np.ndarray:
    """Return the row of a try that was not made."""
    return np.append(np.zeros(n), [int(ReachStatus.OUT_OF_BUDGET), np.inf, np.inf, np.nan, np.inf, np.inf])


def from_rows(chain, task, rows) -> Reached:
    """Return the record of targets, or of solutions of each, from their rows (..., width)."""
    if isinstance(rows, np.ndarray):
        rows.flags.writeable = False
    row = row_of(rows, chain.n)._asdict()
    del row["cost"], row["steep"]
    return Reached(chain=chain, task=task, **row | {"status": row["status"].astype(int)})
