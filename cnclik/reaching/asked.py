"""The arguments of a call of `reach`, shared by all its targets, and the status of a target without an answer."""

import numpy as np

from cnclik import errors
from cnclik.cache import LRU
from cnclik.precision import as_numbers
from cnclik.reaching.descent import Terms
from cnclik.reaching.result import ReachStatus, Row, row_of
from cnclik.reaching.targets import task_of
from cnclik.reaching.units import unit_of
from cnclik.record import AnyArray, Float, Number, leaf, memoized, record
from cnclik.robot.chain import Chain
from cnclik.robot.posture import beyond_arm
from cnclik.task.task import WIDTH, Task, aims

MOST_SEEDS = ((1 << 31) - 1) // 16  # the numbers of all tries must fit int32
SURE = 256  # tries, at least, before it is said that there is no answer
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
    accept: Float[AnyArray, " 2"] | None  # [m], [rad]
    jump: Number | None  # [rad, m]
    seeds: Number  # largest number of tries
    seed: Number
    limits: bool
    explain: bool  # whether to find the reason where there is no answer

    @property
    def downhill(self) -> bool:
        """Whether to find the nearest pose where there is no answer."""
        return self.explain or self.accept is not None

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
        numbers = lower, upper, most, self.tolerance / self.scale, xp.sqrt(xp.asarray(roots, float))
        return Terms(*(xp.asarray(v, float) for v in numbers))

    def finite(self, pose, near, xp=np):
        """Return which targets (..., t) are finite, with the joint values in `near`."""
        return xp.isfinite(pose).all(axis=-1) & (True if near is None else xp.isfinite(near).all(axis=-1))

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
        most = xp.maximum(times * self.tolerance, FOLD * self.scale)
        return (row.position_error <= most[0]) & (2 * xp.sin(row.orientation_error / 2) <= most[1])

    def meaning(self, status, row: Row, xp=np):
        """Return the meaning of a search beyond limits or jump: `status` where it found an answer, else 0.

        OUT_OF_BUDGET where it came too near to exclude one.
        """
        unsure = xp.where(self.within(row, CLEAR, xp), int(ReachStatus.OUT_OF_BUDGET), 0)
        return xp.where(row.status == ReachStatus.SOLVED, status, unsure)

    def concluded(self, rows, finite, sure, why, far, xp=np):
        """Return rows (..., width) with the status of their targets, and NaN where there are no joint values.

        Args: finite, far: results of the methods. sure: whether enough was tried. why: the result of `meaning`.
        """
        row, status = row_of(rows, self.chain.n), ReachStatus
        missed, clear = (~self.within(row, times, xp) for times in (MISSED, CLEAR))
        rests = (row.steep <= STATIONARY**2) & clear & sure & (why == 0) & self.explain | far
        made = xp.where(rests, int(status.OUT_OF_REACH), int(status.OUT_OF_BUDGET))
        certain = (self.chain.n <= FEW) | (self.seeds < SURE) | (self.squares(row, xp) >= DOUBT**2)
        held = (why == status.AT_LIMIT) & (row.at_limit > 0).any(axis=-1) & certain
        made = xp.where(((why == status.JUMP) | held) & sure & missed, why, made)
        if self.accept is not None:
            enough = (row.position_error <= self.accept[0]) & (row.orientation_error <= self.accept[1])
            made = xp.where(enough, int(status.ACCEPTED), made)
        made = xp.where(row.status == status.SOLVED, int(status.SOLVED), made)
        made = xp.where((made <= status.ACCEPTED) & self.away(row), int(status.JUMP), made)
        made = xp.where(finite, made, int(status.NON_FINITE))
        none = (made == status.JUMP) | (made == status.NON_FINITE) | ~xp.isfinite(row.position_error)
        none = (none | (made > status.ACCEPTED) & (not self.explain))[..., None]
        gone, n = xp.where(none, xp.nan, 0.0), self.chain.n
        numbers = xp.stack([row.position_error, row.orientation_error], -1) + gone
        parts = row.q + gone, xp.where(none, 0.0, row.at_limit), made[..., None], numbers, rows[..., 2 * n + 3 :]
        return xp.concatenate(parts, -1)

    def farther(self, rows, moved, xp=np):
        """Return rows (B, ..., width) of targets that were searched for nearer by so much (B,) [m], see `units`."""
        n, moved = self.chain.n, moved.reshape(-1, *(1,) * (rows.ndim - 2))
        row = row_of(rows, n)
        status = xp.where(
            (moved > 0) & (row.status < ReachStatus.NON_FINITE), int(ReachStatus.OUT_OF_REACH), row.status
        )
        numbers = xp.stack([status, row.position_error + moved], -1)
        return xp.concatenate([rows[..., : 2 * n], numbers, rows[..., 2 * n + 2 :]], -1)

    def away(self, row: Row):
        """Return whether answers jump all the same, as where `near` is outside the limits."""
        return False if self.jump is None else row.distance > self.jump * (1 + 1e-9)


def asked_of(chain, *rest) -> Asked:
    """Return the arguments as a record. It is kept with the chain: a control loop repeats the same call at 1 kHz.

    Args: the fields of `Asked`. Raises: ArgumentError for unusable values.
    """
    errors.kind("chain", chain, Chain)
    key = rest, tuple(map(type, rest))  # types too: 1.0 equals 1 but is no valid number of seeds
    try:
        hash(key)
    except TypeError:  # lists, arrays
        return _asked(chain, *rest)
    if not all(map(errors.concrete, rest)):
        return _asked(chain, *rest)
    return memoized(chain, "_asked", lambda _: LRU()).made(key, lambda _: _asked(chain, *rest))


def _asked(chain, task, tolerance, accept, jump, seeds, seed, limits, explain) -> Asked:
    if chain.balls:
        what = f"turns about any axis by {chain.joint_names[chain.balls[0][1]]}"
        raise errors.fail("chain", "have no free base and no ball joint, to be asked for joint values", what)
    if not all(errors.concrete(v) for v in (*chain.lower, *chain.upper)):
        raise errors.fail("chain", "have limits that are numbers", "has traced ones")
    others = {"tolerance": tolerance, "accept": accept, "seeds": seeds, "seed": seed}
    as_numbers("reach", *others.items(), ("limits", limits), ("explain", explain))
    if jump is not None:
        errors.number("jump", jump, positive=True)
    tolerance, task = _pair("tolerance", tolerance), task_of(task).on(chain)
    aims(task)
    return Asked(
        chain=chain,
        task=task,
        tolerance=np.array([tolerance[0], 2 * np.sin(min(tolerance[1], np.pi) / 2)]),  # a chord
        accept=None if accept is None else _pair("accept", accept),
        jump=leaf(jump),
        seeds=np.int32(errors.integer("seeds", seeds, at_least=1, at_most=MOST_SEEDS)),
        seed=np.int32(errors.seed(seed)),
        limits=errors.truth("limits", limits),
        explain=errors.truth("explain", explain),
    )


def _pair(name, value):
    if not isinstance(value, (tuple, list)) and np.ndim(value) == 0:
        raise errors.fail(name, "be a pair, of position [m] and orientation [rad]", f"is {value!r}")
    value = errors.array(name, value, (2,), finite=False)
    if not (np.asarray(value) > 0).all():
        raise errors.fail(name, "hold positive numbers", f"is {value!r}")
    return np.asarray(value, float)
