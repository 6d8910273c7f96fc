"""What is asked of all targets of a call, and how an answer becomes a status."""

import math

import numpy as np

from cnclik import errors
from cnclik.hints import Recent
from cnclik.law.task import Task
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.reaching.step import STATIONARY
from cnclik.reaching.targets import task_of
from cnclik.record import kept, leaf, record, replace
from cnclik.robot.chain import REVOLUTE, Chain
from cnclik.robot.posture import arm_length

TOUCHING = 1e-9  # [rad, m] from a limit: at it
CLEAR = 100.0  # tolerances that an error exceeds of which it can be said that nothing makes it smaller


@record
class Asked:
    """The arguments of `cnclik.reach` that all targets share."""

    chain: Chain
    task: Task
    tolerance: object  # (2,) [m], [rad]
    accept: object  # (2,) or None
    jump: object  # a number or None
    seeds: object  # postures to start from, at most
    budget: object  # looks, at most
    seed: object  # of the first set of seeds
    limits: bool
    explain: bool  # why there is no answer

    def unweighted(self, xp=np):
        """The task without weights, by which answers are searched for, and the weights' roots (m,), or None."""
        weights = self.task.weights
        return replace(self.task, weights=None), None if weights is None else xp.sqrt(xp.asarray(weights, float))

    def limited(self):
        """Lower and upper limits (n,), infinite where they are not to be kept."""
        lower, upper = np.array(self.chain.lower, float), np.array(self.chain.upper, float)
        return (lower, upper) if self.limits else (np.full_like(lower, -np.inf), np.full_like(upper, np.inf))

    def bounds(self, near, xp=np):
        """Where joints are searched for: within the limits, and within `jump` of `near` (B, n)."""
        lower, upper = self.limited()
        if self.jump is None:
            return lower, upper
        low, high = xp.maximum(lower, near - self.jump), xp.minimum(upper, near + self.jump)
        return xp.minimum(low, upper), xp.maximum(high, lower)  # outside the limits: what is nearest to `near`

    @property
    def downhill(self) -> bool:
        """Whether the nearest pose is wanted where there is no answer."""
        return self.explain or self.accept is not None

    def turning(self):
        """Which joints (n,) go round without a limit."""
        lower, upper = self.limited()
        return np.array(self.chain.periodic) & np.isinf(lower) & np.isinf(upper)

    def finite(self, pose, near, xp=np):
        """Which targets (..., 12), and what is near them, hold numbers alone."""
        return xp.isfinite(pose).all(axis=-1) & (True if near is None else xp.isfinite(near).all(axis=-1))

    def beyond(self):
        """Where the search goes that tells why there is no answer: without `jump`, or without limits; None: nowhere."""
        if not self.explain:
            return None
        if self.jump is not None:
            return self.limited()
        lower, upper = self.limited()
        if not (np.isfinite(lower) | np.isfinite(upper)).any():
            return None
        return np.full_like(lower, -np.inf), np.full_like(upper, np.inf)

    def too_far(self, pose, xp=np):
        """Which targets (..., 12) are farther from the first joint than the stretched arm is long."""
        first = self.chain.joints[0]
        turning = all(joint.kind == REVOLUTE for joint in self.chain.joints)
        if not turning or not self.task.linear:
            return xp.zeros(pose.shape[:-1], bool)
        away = (pose[..., :3] - xp.stack(first.origin.position))[..., np.array(self.task.linear)]
        return xp.sqrt(xp.sum(away * away, axis=-1)) > arm_length(self.chain) + self.tolerance[0]

    def reached(self, pose, near, q, squares, steep, looks, found, beyond, xp=np) -> Reached:
        """The record of answers: of one target, or of (B,) with that axis first."""
        position, turn = xp.sqrt(squares[..., 0]), xp.sqrt(squares[..., 1])
        turn = 2.0 * xp.arcsin(xp.minimum(turn / 2.0, 1.0))
        # Next to a singularity an error this small is stationary, too.
        clear = (position > CLEAR * self.tolerance[0]) | (turn > CLEAR * self.tolerance[1])
        rests = (steep <= STATIONARY**2) & clear | self.too_far(pose, xp)
        status = xp.where(rests, int(ReachStatus.OUT_OF_REACH), int(ReachStatus.OUT_OF_BUDGET))
        why = ReachStatus.AT_LIMIT if self.jump is None else ReachStatus.JUMP
        status = xp.where(beyond, int(why), status)
        if self.accept is not None:
            near_enough = (position <= self.accept[0]) & (turn <= self.accept[1])
            status = xp.where(near_enough, int(ReachStatus.ACCEPTED), status)
        status = xp.where(found, int(ReachStatus.SOLVED), status)
        if self.jump is not None:  # where `near` is outside the limits
            away = xp.max(xp.abs(q - near), axis=-1) > self.jump * (1 + 1e-9)
            status = xp.where((status <= ReachStatus.ACCEPTED) & away, int(ReachStatus.JUMP), status)
        status = xp.where(self.finite(pose, near, xp), status, int(ReachStatus.NON_FINITE))
        none = (status == ReachStatus.JUMP) | (status == ReachStatus.NON_FINITE) | ~xp.isfinite(squares).all(axis=-1)
        if not self.explain:
            none = none | (status > ReachStatus.ACCEPTED)
        lower, upper = self.limited()
        around = xp.zeros_like(q) if near is None else near
        q = xp.where(self.turning(), q - 2 * math.pi * xp.round((q - around) / (2 * math.pi)), q)
        q, position, turn = (
            xp.where(gone, xp.nan, v) for gone, v in ((none[..., None], q), (none, position), (none, turn))
        )
        return Reached(
            q=q,
            status=status,
            position_error=position,
            orientation_error=turn,
            evaluations=looks.astype(int),
            at_limit=(q <= lower + TOUCHING) | (q >= upper - TOUCHING),
            distance=xp.full_like(position, xp.nan) if near is None else xp.max(xp.abs(q - near), axis=-1),
            chain=self.chain,
            task=self.task,
        )


def asked_of(chain, *rest) -> Asked:
    """The arguments as a record, made once for a chain: a control loop asks for the same a thousand times a second.

    Args: as `Asked` has them. Raises: ArgumentError for those that can't be asked.
    """
    errors.kind("chain", chain, Chain)
    key = rest, tuple(map(type, rest))  # 1.0 is no number of seeds, and equals 1
    try:
        hash(key)
        lasting = all(map(errors.concrete, rest))
    except TypeError:  # lists, arrays
        lasting = False
    if not lasting:
        return _asked(chain, *rest)
    return kept(chain, "_asked", lambda _: Recent()).made(key, lambda _: _asked(chain, *rest))


def _asked(chain, task, tolerance, accept, jump, seeds, budget, seed, limits, explain) -> Asked:
    if not all(errors.concrete(v) for v in (*chain.lower, *chain.upper)):
        raise errors.fail("chain", "have limits that are numbers", "has traced ones")
    if jump is not None:
        errors.number("jump", jump, positive=True)
    for name, value in {"seeds": seeds, "budget": budget}.items():
        errors.integer(name, value, at_least=1, at_most=(1 << 30) - 1)
    tolerance = _pair("tolerance", tolerance)
    return Asked(
        chain=chain,
        task=task_of(task),
        tolerance=np.array([tolerance[0], 2 * np.sin(min(tolerance[1], np.pi) / 2)]),  # what is looked at is a chord
        accept=None if accept is None else _pair("accept", accept),
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
    if not errors.concrete(value) or not (np.asarray(value) > 0).all():
        raise errors.fail(name, "hold positive numbers", f"is {value!r}")
    return np.asarray(value, float)
