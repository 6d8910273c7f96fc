"""The arguments of a call of `reach`, shared by all its targets, and the status of a target without an answer."""

import jax
import numpy as np

from cnclik import errors
from cnclik.cache import LRU
from cnclik.precision import as_numbers
from cnclik.reaching.descent import Terms, unit_of
from cnclik.reaching.result import ReachStatus, Row, row_of, touching
from cnclik.record import AnyArray, Float, Number, leaf, memoized, record
from cnclik.robot.chain import Chain
from cnclik.robot.posture import beyond_arm
from cnclik.task.build import orientation, pose, position
from cnclik.task.task import WIDTH, Task, aims

TASKS = {"pose": pose(), "position": position(), "orientation": orientation()}

STATIONARY = 1e-3  # of ‖e‖ ‖J‖: a gradient smaller than that is none
FEW, DOUBT = 3, 1e-2  # with more joints, a target missed by less than DOUBT [rad, units] may still have an answer
MISSED = 3.0  # a larger error, in tolerances, can be attributed to limits or to `jump`
CLEAR = 100.0  # a larger error, in tolerances, is known to be the smallest possible
FOLD = 1e-7  # [units, rad] next to a singularity a descent may end with such an error although an answer is near


@record
class Asked:
    """The arguments of `cnclik.reach` that all targets share."""

    chain: Chain
    task: Task
    tolerance: Float[AnyArray, " 2"]  # [m], chord of an angle [rad]
    jump: Number | None  # [rad, m]
    limits: bool

    @property
    def scale(self) -> np.ndarray:
        """The units of both errors (2,)."""
        return np.array([unit_of(self.chain), 1.0])

    def limited(self) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper limits (n,); infinite without limits."""
        lower, upper = np.array(self.chain.lower, float), np.array(self.chain.upper, float)
        return (lower, upper) if self.limits else (np.full_like(lower, -np.inf), np.full_like(upper, np.inf))

    def terms(self, *, jump=True, limits=True, weights=False, xp=np) -> Terms:
        """Return the terms of descents. Args: jump, limits: whether they hold. weights: whether errors have them."""
        lower, upper = self.limited() if limits else np.full((2, self.chain.n), [[-np.inf], [np.inf]])
        most = self.jump if jump and limits and self.jump is not None else np.inf
        roots = self.task.weights if weights and self.task.weights is not None else np.ones(self.task.m)
        units = np.where(np.isin(np.arange(self.task.m), self.task.lengths), self.scale[0], 1.0)
        numbers = lower, upper, most, self.tolerance, xp.sqrt(xp.asarray(roots, float)) / units
        return Terms(*(xp.asarray(v, float) for v in numbers))

    def finite(self, pose, near, xp=np):
        """Return which targets (..., t) have squares of squares that are numbers, and finite joint values in `near`."""
        most = float(np.finfo(pose.dtype).max) ** 0.25
        return (xp.abs(pose) < most).all(axis=-1) & (True if near is None else xp.isfinite(near).all(axis=-1))

    def too_far(self, pose, xp=np):
        """Return which targets (..., t) are farther from the first joint than the stretched arm is long."""
        far = xp.zeros(pose.shape[:-1], bool)
        for k, aim in enumerate(aims(self.task)):
            if aim.linear and aim.to is None:
                where, number = pose[..., WIDTH * k + np.array(aim.linear)], self.chain.tip_number(aim.tip)
                far = far | (beyond_arm(self.chain, where, aim.linear, xp, number) > self.tolerance[0])
        return far

    def squares(self, row: Row, xp=np):
        """Return the squared errors (...,) of positions [units] and orientations (chords) together."""
        return (row.position_error / self.scale[0]) ** 2 + (2 * xp.sin(row.orientation_error / 2)) ** 2

    def within(self, row: Row, times, xp=np):
        """Return whether errors are within `times` tolerances, or below FOLD."""
        most = np.maximum(times * self.tolerance, FOLD * self.scale)
        return (row.position_error <= most[0]) & (2 * xp.sin(row.orientation_error / 2) <= most[1])

    def meaning(self, status, rows, costs, xp=np):
        """Return the meaning (...,) of a search beyond limits or jump: `status` where it found an answer, else 0.

        OUT_OF_BUDGET where it came too near to exclude one. Args: costs: least ones (...,) of its tries.
        """
        doubt = np.sum(np.maximum(CLEAR * self.tolerance / self.scale, FOLD) ** 2)
        unsure = xp.where(costs <= doubt, int(ReachStatus.OUT_OF_BUDGET), 0)
        return xp.where(row_of(rows, self.chain.n).status == ReachStatus.SOLVED, status, unsure)

    def concluded(self, rows, finite, why, far, xp=np):
        """Return rows (..., width) with the status of their targets, and NaN where there are no joint values."""
        row, status, solved = row_of(rows, self.chain.n), ReachStatus, int(ReachStatus.SOLVED)
        rests = (row.steep <= STATIONARY**2) & ~self.within(row, CLEAR, xp) & (why == 0)
        made = xp.where(rests | far, int(status.OUT_OF_REACH), int(status.OUT_OF_BUDGET))
        certain = (self.chain.n <= FEW) | (self.squares(row, xp) >= DOUBT**2)
        at_bound = touching(self.chain, row.q).any(axis=-1) | (self.jump is not None)
        held = (why == status.AT_LIMIT) & at_bound & certain
        made = xp.where(((why == status.JUMP) | held) & ~self.within(row, MISSED, xp), why, made)
        made = xp.where(row.status == solved, solved, made)
        made = xp.where(finite, made, int(status.NON_FINITE))
        none = (made == status.JUMP) | (made == status.NON_FINITE) | ~xp.isfinite(row.position_error)
        gone = xp.where(none[..., None], xp.nan, 0.0)
        away = xp.stack([row.position_error, row.orientation_error, row.distance], -1) + gone
        return xp.concatenate([row.q + gone, made[..., None], away, rows[..., self.chain.n + 4 :]], -1)


def asked_of(chain, *rest) -> Asked:
    """Return the arguments as a record, kept with the chain: a control loop repeats the same call at 1 kHz."""
    errors.kind("chain", chain, Chain)
    kept = memoized(chain, "_asked", lambda _: LRU())
    try:  # types too: True equals 1 but is no valid jump
        return kept.made((rest, tuple(map(type, rest))), lambda _: _asked(chain, *rest))
    except TypeError:  # no key are lists, arrays, what is traced
        return _asked(chain, *rest)


def _asked(chain, task, tolerance, jump, limits) -> Asked:
    if chain.balls:
        what = f"turns about any axis by {chain.joint_names[chain.balls[0][1]]}"
        raise errors.fail("chain", "have no free base and no ball joint, to be asked for joint values", what)
    if not all(map(errors.concrete, jax.tree.leaves((chain.lower, chain.upper)))):
        raise errors.fail("chain", "have limits that are numbers", "has traced ones")
    if jump is not None:
        errors.number("jump", jump, positive=True)
    as_numbers("reach", "tolerance", tolerance)
    pair = np.asarray(errors.array("tolerance", tolerance, (2,), finite=False))
    if not (pair > 0).all():
        raise errors.fail("tolerance", "hold positive numbers", f"is {tolerance!r}")
    if not isinstance(task, Task):
        if task not in [*TASKS]:
            must = f"be a Task, such as ck.position('xy'), or one of {', '.join(TASKS)}"
            raise errors.fail("task", must, f"is {task!r}")
        task = TASKS[task]
    task = task.on(chain)
    aims(task)
    return Asked(
        chain=chain,
        task=task,
        tolerance=np.array([pair[0], 2 * np.sin(min(pair[1], np.pi) / 2)], float),  # a chord
        jump=leaf(jump),
        limits=errors.truth("limits", limits),
    )
