"""Result of a search for poses: one status per target, never a silent wrong answer."""

from __future__ import annotations

import enum
from typing import NamedTuple

import numpy as np

from cnclik import errors
from cnclik.record import AnyArray, Bool, Float, Int, record, replace
from cnclik.robot import poses
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.posture import task_jacobians
from cnclik.task.parts import At
from cnclik.task.task import WIDTH, Task, aims


class ReachStatus(enum.IntEnum):
    """Outcome for a target; up to ACCEPTED the joint values are an answer."""

    SOLVED = 0  # both errors within `tolerance`
    ACCEPTED = 1  # within `accept`, but not `tolerance`
    AT_LIMIT = 2  # there are answers beyond the joint limits alone; q is the nearest pose found within them
    OUT_OF_REACH = 3  # farther than the stretched arm, or no answer found, without limits either; q is the nearest pose
    JUMP = 4  # there are answers, but none within `jump` of `near`; q is NaN
    OUT_OF_BUDGET = 5  # no answer found, and it is not known whether there is one; q is the best pose found
    NON_FINITE = 6  # the target, or `near`, is not finite; q is NaN
    NO_OTHER = 7  # fewer different solutions were found than asked for; q is NaN


_PER_TARGET = "q", "status", "position_error", "orientation_error", "evaluations", "at_limit", "distance"


class Missed(NamedTuple):
    """Errors of one task, or of one tip, see `Reached`."""

    position_error: Float[np.ndarray, " *B"]  # [m]
    orientation_error: Float[np.ndarray, " *B"]  # [rad]


@record
class Reached:
    """Answers for B targets; one target has no axis B, and k `solutions` have an axis k after it.

    Errors are of the tip that misses most; of several tips `reached["left"]` are those of one task of a stack, or tip.

    The orientation error is 2 asin ‖v‖, v the coordinates that the task has of the vector part of the quaternion of the
    rotation that is left. Of all three axes that is the angle of this rotation. Of "xy" it is the tilt alone, by which
    the rotation turns the z axis: the base's, or the tip's own where the axes are. The turn about z is left out.

    NumPy arrays in float64; under jit, vmap and grad JAX's, in its dtype.
    """

    q: Float[AnyArray, "*B n"]  # joint values [rad, m]
    status: Int[AnyArray, " *B"]  # values of `ReachStatus`
    position_error: Float[AnyArray, " *B"]  # [m], of the task's coordinates, evaluated again in float64
    orientation_error: Float[AnyArray, " *B"]  # [rad], about the task's axes
    evaluations: Int[AnyArray, " *B"]  # number of evaluations (kinematics, Jacobian, step)
    at_limit: Bool[AnyArray, "*B n"]  # whether each joint is at a limit
    distance: Float[AnyArray, " *B"]  # largest joint's distance from `near` [rad, m]; NaN without it
    chain: Chain  # the robot
    task: Task  # the task
    solutions: int = 1  # number of requested solutions for each target
    targets: Float[AnyArray, "*B t"] | None = None  # of several tips, in the base frame, see `aims`

    @property
    def solved(self) -> Bool[AnyArray, " *B"]:
        """Whether q is an answer: SOLVED or ACCEPTED."""
        return self.status <= ReachStatus.ACCEPTED

    @property
    def least_singular_value(self) -> Float[np.ndarray, " *B"]:
        """(B,) least singular value of the task's Jacobian at q, in the Jacobian's own units; NaN where q is NaN.

        It is computed on demand, as it takes longer than the search.
        """
        q = np.asarray(self.q, float)
        rows = task_jacobians(self.chain, self.task, q.reshape(-1, q.shape[-1]))
        known = np.isfinite(rows).all(axis=(1, 2))
        found = np.full(len(rows), np.nan)
        found[known] = np.linalg.svd(rows[known], compute_uv=False)[:, -1]
        return found.reshape(q.shape[:-1])

    def __getitem__(self, name: str) -> Missed:
        """Errors of one task of a stack, or of one of several tips, by name; computed on demand."""
        names = [aim.path[0] for aim in aims(self.task)]
        errors.one_of("name", name, dict.fromkeys(names))
        some = [own for own, of in zip(self.each, names, strict=True) if of == name]
        return Missed(*(np.max(v, axis=0) for v in zip(*some, strict=True)))

    @property
    def each(self) -> list[Missed]:
        """The errors of each position and orientation of a tip, in the order of the task's, see `__getitem__`."""
        if self.targets is None:
            return [Missed(np.asarray(self.position_error), np.asarray(self.orientation_error))]
        at, every = At(modelled(self.chain), np.asarray(self.q, float)), np.asarray(self.targets, float)
        every = every[..., None, :] if self.solutions > 1 else every
        found = []
        for k, aim in enumerate(aims(self.task)):
            own = every[..., WIDTH * k : WIDTH * (k + 1)]
            found.append(_missed(aim, own, at.position(aim.tip, aim.to), at.rotation(aim.tip, aim.to)))
        return found

    @property
    def strays(self) -> Float[np.ndarray, " B-1"]:
        """(B − 1,) by how much a tip leaves the straight line half-way between each row and the next [m].

        While all joints move evenly from one answer to the next; NaN where one of both is missing. Of several tips the
        one that strays most.
        """
        q, chain = np.where(self.solved[:, None], self.q, np.nan), modelled(self.chain)
        tips = dict.fromkeys((aim.tip, aim.to) for aim in aims(self.task))
        there, between = At(chain, q), At(chain, (q[1:] + q[:-1]) / 2)
        ends = [there.position(*tip) for tip in tips]
        away = [between.position(*tip) - (p[1:] + p[:-1]) / 2 for tip, p in zip(tips, ends, strict=True)]
        return np.max([np.linalg.norm(v, axis=1) for v in away], axis=0)

    def __str__(self):
        status = np.atleast_1d(np.asarray(self.status))
        parts = ", ".join(f"{number:,} {name}" for name, number in count(status).items())
        targets, each = status.size // self.solutions, f", {self.solutions:,} solutions of each" * (self.solutions > 1)
        return f"{targets:,} target{'s' * (targets != 1)}{each}: {parts}"


@np.errstate(invalid="ignore")  # where there is no answer
def _missed(aim, target, position, rotation) -> Missed:
    """Errors of positions (..., 3) and rotations (..., 3, 3) of a tip."""
    away, turn = target[..., :3] - position, target[..., 3:].reshape(*target.shape[:-1], 3, 3)
    chord = 2 * np.linalg.norm(poses.quaternions(turn @ rotation.mT)[..., 1:][..., list(aim.angular)], axis=-1)
    return Missed(
        np.hypot.reduce(away[..., list(aim.linear)], axis=-1, initial=0.0), 2 * np.arcsin(np.minimum(chord / 2, 1))
    )


# --- rows -------------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """What a descent, or a search, comes to: views of the rows (..., 2 n + 7) of targets."""

    q: Float[AnyArray, "*B n"]
    at_limit: Float[AnyArray, "*B n"]  # 1 or 0
    status: Float[AnyArray, " *B"]
    position_error: Float[AnyArray, " *B"]  # [m]
    orientation_error: Float[AnyArray, " *B"]  # [rad]
    evaluations: Float[AnyArray, " *B"]
    distance: Float[AnyArray, " *B"]  # from `near`; NaN without it
    cost: Float[AnyArray, " *B"]  # squared error in the chain's unit, weighted where it is that of the nearest pose
    steep: Float[AnyArray, " *B"]  # its gradient there, see `descent.State`


def width(n: int) -> int:
    """Return the numbers of a row."""
    return 2 * n + len(Row._fields) - 2


def row_of(rows, n: int) -> Row:
    """Return views of rows (..., width)."""
    return Row(rows[..., :n], rows[..., n : 2 * n], *[rows[..., i] for i in range(2 * n, 2 * n + 7)])


def from_rows(chain, task, rows, **others) -> Reached:
    """Return the record of targets, or of solutions of each, from their rows (..., width)."""
    if isinstance(rows, np.ndarray):
        rows.flags.writeable = False
    row = row_of(rows, chain.n)
    return Reached(
        q=row.q,
        status=row.status.astype(int),
        position_error=row.position_error,
        orientation_error=row.orientation_error,
        evaluations=row.evaluations.astype(int),
        at_limit=row.at_limit > 0,
        distance=row.distance,
        chain=chain,
        task=task,
        **others,
    )


def with_axis(made: Reached) -> Reached:
    """Return the record of one target as that of a batch of one."""
    if np.ndim(made.status) > (made.solutions > 1):
        return made
    values = {name: np.asarray(value)[None] for name, value in vars(made).items() if name in _PER_TARGET}
    return replace(made, **values)


def count(status) -> dict:
    """Number of targets with each status."""
    status = np.asarray(status)
    return {s.name: int(np.sum(status == s)) for s in ReachStatus if np.any(status == s)}
