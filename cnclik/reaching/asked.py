"""The arguments of a call of `reach`, shared by all its targets, and the status of an answer."""

import numpy as np

from cnclik import errors
from cnclik.cache import LRU
from cnclik.precision import as_numbers
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.reaching.seeds import periods, turned
from cnclik.reaching.step import STATIONARY
from cnclik.reaching.strategy import LONGER, SURE
from cnclik.reaching.targets import WIDTH, aims, task_of
from cnclik.reaching.units import in_units, of_joints
from cnclik.record import AnyArray, Float, Number, leaf, memoized, record
from cnclik.robot.chain import Chain
from cnclik.robot.posture import beyond_arm
from cnclik.task.task import Task

TOUCHING = 1e-9  # [rad, m] distance from a limit that counts as being at it
MOST_SEEDS = ((1 << 31) - 1) // max(LONGER)  # the numbers of all tries must fit int32
FEW, DOUBT = 3, 1e-2  # with more joints, a target missed by less than DOUBT [rad, units] may still have an answer
MISSED = 3.0  # a larger error, in tolerances, can be attributed to limits or to `jump`
CLEAR = 100.0  # a larger error, in tolerances, is known to be the smallest possible
FOLD = 1e-7  # [units, rad] next to a singularity a search may stop with such an error although an answer is near


@record
class Asked:
    """The arguments of `cnclik.reach` that all targets share."""

    chain: Chain  # its lengths, and all others here, in `unit`
    unit: float  # [m], see `units`
    task: Task
    tolerance: Float[AnyArray, " 2"]  # [units], [rad]
    accept: Float[AnyArray, " 2"] | None
    jump: Number | Float[AnyArray, " n"] | None  # [rad, units]
    seeds: Number  # largest number of start postures
    budget: Number  # largest number of evaluations
    seed: Number  # seed of the start postures
    limits: bool
    explain: bool  # whether to find the reason where there is no answer

    def limited(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits (n,); infinite without limits."""
        lower, upper = np.array(self.chain.lower, float), np.array(self.chain.upper, float)
        return (lower, upper) if self.limits else (np.full_like(lower, -np.inf), np.full_like(upper, np.inf))

    @property
    def downhill(self) -> bool:
        """Whether to find the nearest pose where there is no answer."""
        return self.explain or self.accept is not None

    @property
    def periods(self):
        """See `seeds.periods`."""
        return periods(self.chain)

    def turns(self):
        """The periods (n,) of joints that can take a posture in several turns, 0 of others."""
        lower, upper = self.limited()
        return np.where(upper - lower >= self.periods, self.periods, 0.0)

    def finite(self, pose, near, xp=np):
        """Which targets (..., t) are finite, with the joint values in `near`."""
        return xp.isfinite(pose).all(axis=-1) & (True if near is None else xp.isfinite(near).all(axis=-1))

    def sure(self, looks):
        """Whether a search of `looks` evaluations (...,) was long enough to conclude that there is no answer."""
        return (self.seeds >= SURE) & (looks < self.budget)

    def within(self, squares, times, xp=np):
        """Whether errors, given as squares (..., 2), are within `times` tolerances, or below FOLD."""
        return (squares <= xp.maximum(times * self.tolerance, FOLD) ** 2).all(axis=-1)

    def meaning(self, status, found, squares, xp=np):
        """The meaning of a search without limits or jump: `status` where it found an answer, else 0.

        OUT_OF_BUDGET where it came too near to exclude one.
        """
        unsure = xp.where(self.within(squares, CLEAR, xp), int(ReachStatus.OUT_OF_BUDGET), 0)
        return xp.where(found, status, unsure)

    def too_far(self, pose, xp=np):
        """Which targets (..., t) are farther from the first joint than the stretched arm is long."""
        far = xp.zeros(pose.shape[:-1], bool)
        for k, aim in enumerate(aims(self.task)):
            if aim.linear and aim.to is None:
                at, number = pose[..., WIDTH * k + np.array(aim.linear)], self.chain.tip_number(aim.tip)
                far = far | (beyond_arm(self.chain, at, aim.linear, xp, number) > self.tolerance[0])
        return far

    def reached(self, pose, near, q, squares, steep, looks, found, sure, why, xp=np) -> Reached:
        """The record of answers: for one target, or for (B,) along the first axis.

        Args: why: the result of `meaning`.
        """
        position, turn = xp.sqrt(squares[..., 0]), xp.sqrt(squares[..., 1])
        turn = 2.0 * xp.arcsin(xp.minimum(turn / 2.0, 1.0))
        # Next to a singularity an error this small is stationary, too.
        clear, missed = (~self.within(squares, times, xp) for times in (CLEAR, MISSED))
        lower, upper = self.limited()
        around = xp.zeros_like(q) if near is None else near
        q = xp.clip(turned(q, around, self.turns(), lower, upper, xp), lower, upper)
        at_limit = (q <= lower + TOUCHING) | (q >= upper - TOUCHING)
        rests = (steep <= STATIONARY**2) & clear & sure & (why == 0) & self.explain | self.too_far(pose, xp)
        status = xp.where(rests, int(ReachStatus.OUT_OF_REACH), int(ReachStatus.OUT_OF_BUDGET))
        certain = (self.chain.n <= FEW) | (self.seeds < SURE) | (squares.sum(axis=-1) >= DOUBT**2)
        explained = (why == ReachStatus.JUMP) | (why == ReachStatus.AT_LIMIT) & at_limit.any(axis=-1) & certain
        status = xp.where(explained & sure & missed, why, status)
        if self.accept is not None:
            near_enough = (position <= self.accept[0]) & (turn <= self.accept[1])
            status = xp.where(near_enough, int(ReachStatus.ACCEPTED), status)
        status = xp.where(found, int(ReachStatus.SOLVED), status)
        if self.jump is not None:  # where `near` is outside the limits
            away = (xp.abs(q - near) > self.jump * (1 + 1e-9)).any(axis=-1)
            status = xp.where((status <= ReachStatus.ACCEPTED) & away, int(ReachStatus.JUMP), status)
        status = xp.where(self.finite(pose, near, xp), status, int(ReachStatus.NON_FINITE))
        none = (status == ReachStatus.JUMP) | (status == ReachStatus.NON_FINITE) | ~xp.isfinite(squares).all(axis=-1)
        if not self.explain:
            none = none | (status > ReachStatus.ACCEPTED)
        q, position, turn = (
            xp.where(gone, xp.nan, v) for gone, v in ((none[..., None], q), (none, position), (none, turn))
        )
        return Reached(
            q=q,
            status=status,
            position_error=position,
            orientation_error=turn,
            evaluations=looks.astype(int),
            at_limit=at_limit & ~none[..., None],
            distance=xp.full_like(position, xp.nan) if near is None else xp.max(xp.abs(q - near), axis=-1),
            chain=self.chain,
            task=self.task,
        )


def asked_of(chain, *rest) -> Asked:
    """The arguments as a record. It is cached with the chain, because a control loop repeats the same call at 1 kHz.

    Args: the fields of `Asked`. Raises: ArgumentError for unusable values.
    """
    errors.kind("chain", chain, Chain)
    key = rest, tuple(map(type, rest))  # types too: 1.0 equals 1 but is no valid number of seeds
    try:
        hash(key)
        lasting = all(map(errors.concrete, rest))
    except TypeError:  # lists, arrays
        lasting = False
    if not lasting:
        return _asked(chain, *rest)
    return memoized(chain, "_asked", lambda _: LRU()).made(key, lambda _: _asked(chain, *rest))


def _asked(chain, task, tolerance, accept, jump, seeds, budget, seed, limits, explain) -> Asked:
    if chain.balls:
        what = f"turns about any axis by {chain.joint_names[chain.balls[0][1]]}"
        raise errors.fail("chain", "have no free base and no ball joint, to be asked for joint values", what)
    if not all(errors.concrete(v) for v in (*chain.lower, *chain.upper)):
        raise errors.fail("chain", "have limits that are numbers", "has traced ones")
    numbers = {"seeds": (seeds, MOST_SEEDS), "budget": (budget, (1 << 30) - 1)}
    others = {"tolerance": tolerance, "accept": accept, "seed": seed, "limits": limits, "explain": explain}
    as_numbers("reach", *numbers.items(), *others.items())
    if jump is not None:
        errors.number("jump", jump, positive=True)
    for name, (value, most) in numbers.items():
        errors.integer(name, value, at_least=1, at_most=most)
    tolerance, (own, unit), task = _pair("tolerance", tolerance), in_units(chain), task_of(task).on(chain)
    aims(task)
    if jump is not None and unit != 1.0 and "m" in chain.units:
        jump = jump / np.array(of_joints(chain, unit))
    return Asked(
        chain=own,
        unit=unit,
        task=task,
        tolerance=np.array([tolerance[0] / unit, 2 * np.sin(min(tolerance[1], np.pi) / 2)]),  # a chord
        accept=None if accept is None else _pair("accept", accept) / np.array([unit, 1.0]),
        jump=leaf(jump),
        seeds=np.int32(seeds),
        budget=np.int32(budget),
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
