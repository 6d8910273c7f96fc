"""Pace: a loop that slows down along its path to keep limits of velocity, acceleration and jerk.

All joints of a step q̇ = f are scaled by one share s in [0, 1], so that the robot follows the law's path, only later.
With the path time τ, which advances by s·Ts per sample,

    q̈ = s² f′ + ṡ f,    q⃛ = s³ f″ + 3 s ṡ f′ + s̈ f,    ′ = d/dτ

so that f′ and f″, which are estimated from the steps, determine the s that the path allows. A law that approaches its
target, f′ = −α f, must slow down before the target, as in a bend before its apex. Time-optimal path following uses the
same bounds (Bobrow, Dubowsky & Gibson 1985); here they look ahead by one order of the path.

Where no share keeps the limits of acceleration and jerk, as after a jump of the target during the motion, the joints
leave the path: each brakes, within its limits, towards the law's velocity. The loop measures where it
is and comes back. If the law keeps position limits, a joint that could no longer stop before its limit brakes instead.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.record import Array, ArrayLike, Bool, Float, Number, leaf, record, replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.rotations import safe_sqrt

TURNING = 0.6  # part of the acceleration for following the path at a constant share; the rest changes it
BENDING = 0.5  # the same part of the jerk
EASING = 0.5  # part of the jerk for easing the share to the path's limit
CHAIN = "chain"
FAR = 1e6  # [s] stands for never; finite, so that derivatives are finite


@record
class Pace:
    """Limits that a loop keeps by slowing down along its path, and by leaving the path where that is not enough.

    Attributes:
      velocity: [rad/s, m/s], a number or one per joint (n,); "chain": the chain's own; None: no limit.
      acceleration: of the sampled motion, (q̇[k] − q̇[k−1])/Ts [rad/s², m/s²], a number or (n,); None: no limit.
      jerk: change of the acceleration per second [rad/s³, m/s³], a number or (n,); None: no limit.
      wait: whether the path waits for the robot. Its time then advances by share·Ts per sample: the path is followed
        later, without cutting corners. None: it waits where the future of the reference is known; a stream of targets
        (`causal`, `resampled`) does not wait.

    Raises: ArgumentError for values that do not fit.
    """

    velocity: ArrayLike | None = CHAIN
    acceleration: ArrayLike | None = None
    jerk: ArrayLike | None = None
    wait: bool | None = None

    def __post_init__(self):
        if self.wait is not None:
            errors.truth("wait", self.wait)
        for name in ("velocity", "acceleration", "jerk"):
            value = getattr(self, name)
            if value is None or (name == "velocity" and isinstance(value, str) and value == CHAIN):
                continue
            known = errors.array(name, value, (), (None,), finite=False)
            if known.size == 0:
                raise errors.fail(name, "be a number or one per joint", "is empty")
            if errors.concrete(known) and not (np.asarray(known) > 0).all():
                raise errors.fail(name, "be positive", f"is {np.asarray(known).min():g}")
            object.__setattr__(self, name, leaf(value) if np.ndim(value) == 0 else known)

    @property
    def smooth(self) -> bool:
        """Whether acceleration or jerk is limited, so that joint velocities change gradually."""
        return not self.acceleration is self.jerk is None


@record
class Pacing:
    """State of a paced loop, which `paced` takes and returns.

    Attributes:
      velocity, acceleration: (n,) paced velocity and acceleration of the last sample [rad/s, rad/s²; m].
      requested: (n,) velocity requested by the loop. turn, bend: (n,) its derivatives f′, f″ along the path.
      share: s of the last step; a path that waits has advanced by share·Ts. Off the path: the share of the requested
        motion that the joints made.
      excess: largest share of an acceleration or jerk limit that the step needs with the best s. It is above 1 where no
        s keeps all limits, after a corner or a jump of the target; the joints then braked and left the path.
      begun: whether a step was paced.
    """

    velocity: Float[Array, " n"]
    acceleration: Float[Array, " n"]
    requested: Float[Array, " n"]
    turn: Float[Array, " n"]
    bend: Float[Array, " n"]
    share: Float[Array, ""]
    excess: Float[Array, ""]
    begun: Bool[Array, ""]

    @property
    def over(self) -> Bool[Array, ""]:
        """Whether the joints left the path in the step because no share keeps the limits of acceleration and jerk."""
        return self.excess > _whole(self.excess.dtype)


def _whole(dtype):
    """A whole limit, plus rounding."""
    return 1 + 1024 * jnp.finfo(dtype).eps


def pace_at_rest(q: Float[ArrayLike, " n"]) -> Pacing:
    """State of a paced loop that rests at joint values q (n,)."""
    zeros = jnp.zeros_like(_vector("q", q))
    one = jnp.ones((), zeros.dtype)
    state = dict.fromkeys(("velocity", "acceleration", "requested", "turn", "bend"), zeros)
    return Pacing(**state, share=one, excess=0 * one, begun=jnp.zeros((), bool))


def paced(
    pace: Pace,
    state: Pacing,
    dq: Float[ArrayLike, " n"],
    Ts: Number,
    *,
    stop: Number | None = None,
    sharpness: Number = 1.0,
) -> tuple[Float[Array, " n"], Pacing]:
    """One step of any loop, kept within its limits: for your own control loop. Pure.

    Args:
      pace: with velocity limits as numbers.
      state: from `pace_at_rest`, then the state that the previous call returned.
      dq: (n,) requested step, q̇·Ts [rad, m], with q̇ from any library.
      Ts: sampling time [s].
      stop: path time until the path stops or has a corner [s], where known: the motion slows down before it.
      sharpness: relative change of the path's velocity there.

    Returns: (dq, state): s·dq, where s is `state.share`; or, where no s keeps the limits of acceleration and jerk, a
      step that brakes the joints within them, and `state.over` is true.
    Raises: ArgumentError for shapes that do not fit.
    """
    dq = _vector("dq", dq)
    n = dq.shape[0]
    errors.kind("state", state, Pacing, "be what `pace_at_rest` or `paced` handed back")
    if state.velocity.shape != (n,):
        raise errors.fail("dq", f"have {state.velocity.shape[0]} joints, as `state`", f"has {n}")
    errors.number("Ts", Ts, positive=True)
    check_pace(pace, n)
    if isinstance(pace.velocity, str):
        raise errors.fail("velocity", "be numbers or None: the chain is not known here", f"is {pace.velocity!r}")
    if stop is not None:
        errors.number("stop", stop, at_least=0)
    errors.number("sharpness", sharpness, at_least=0)
    Ts = np.asarray(Ts, dq.dtype) if errors.concrete(Ts) else Ts
    return _scaled(pace, state, dq, Ts, stop, sharpness)


def _vector(name, value):
    return jnp.asarray(errors.array(name, value, (None,), finite=False))


def check_pace(pace, n: int, chain=None) -> Pace:
    """The pace with the chain's velocity limits filled in. Raises: ArgumentError unless it is a `Pace` for n joints."""
    errors.kind("pace", pace, Pace, "be Pace(...)")
    for name in ("velocity", "acceleration", "jerk"):
        if np.ndim(getattr(pace, name)) == 1:
            errors.array(name, getattr(pace, name), (n,), finite=False)
    if chain is None or not isinstance(pace.velocity, str):
        return pace
    if errors.kind("chain", chain, Chain).n != n:
        raise errors.fail("chain", f"have {n} joints", f"has {chain.n}")
    return replace(pace, velocity=modelled(chain).velocity_limit)


def path_waits(pace, reference) -> bool:
    """Whether a path waits for the robot at a pace, which may be None."""
    return pace is not None and bool(reference.known if pace.wait is None else pace.wait)


# --- the share ----------------------------------------------------------------------------------------


@bounded_jit
def _scaled(pace, state, dq, Ts, stop, sharpness):
    s, state = share(pace, state, dq / Ts, Ts, stop, sharpness)
    return jnp.where(state.over, state.velocity * Ts, s * dq), state


def _max(v):
    """The largest entry, by its index: the derivative of `jnp.max` is NaN if XLA rounds v in two ways."""
    v = v.ravel()
    return v[jnp.argmax(v)]


def _largest(v):
    return _max(jnp.abs(v))


def share(pace, state, f, Ts, stop, sharpness, room=None):
    """(s, the next state) for a requested velocity f (n,); the resulting velocity is in the state.

    Args: room: (2, n) distance of each joint to its lower and upper limit [rad, m]; None: no limits are kept.
    """
    dtype, limits = f.dtype, (pace.velocity, pace.acceleration, pace.jerk)
    v, a, j = (None if w is None else jnp.broadcast_to(jnp.asarray(w, dtype), f.shape) for w in limits)
    v = None if v is None else jnp.maximum(v, 1e-12)  # a velocity limit may be 0
    # Smoothed over a sample of path time, to avoid divisions by a share of nearly 0.
    passed = jnp.where(state.begun, Ts * state.share, 0.0)
    requested = jnp.where(state.begun, state.requested, f)
    turn = (state.turn * Ts + (f - requested)) / (passed + Ts)
    bend = (state.bend * Ts + (turn - state.turn)) / (passed + Ts)

    most = jnp.ones((), dtype) if v is None else 1 / jnp.maximum(1.0, _largest(f / v))
    if room is not None:
        most = jnp.minimum(most, _inside(a, j, state, f, Ts, jnp.where(f < 0, *room)))
    low, high, excess = _kept(a, j, state, f, Ts, most)
    leaves = excess > _whole(dtype)
    steep = _steepness(state, f, Ts)
    turn, bend = jnp.where(leaves, -steep * f, turn), jnp.where(leaves, steep**2 * f, bend)
    wanted = jnp.minimum(_borne(v, a, j, state, f, turn, bend, Ts, stop, sharpness), most)
    s = jnp.clip(jnp.maximum(low, jnp.minimum(wanted, high)), 0.0, most)
    velocity = s * f
    if not (a is None and j is None):
        velocity = jnp.where(leaves, _braked(a, j, state, wanted * f, Ts), velocity)
        if room is not None:  # a joint that could not brake later brakes now
            late = _too_late(a, j, state, velocity, Ts, room)
            velocity = jnp.where(late, _braked(a, j, state, jnp.zeros_like(f), Ts), velocity)
            leaves, excess = leaves | late.any(), jnp.where(late.any(), jnp.maximum(excess, 2.0), excess)
        s = jnp.where(leaves, _along(velocity, f), s)
    return s, Pacing(
        velocity=velocity,
        acceleration=(velocity - state.velocity) / Ts,
        requested=f,
        turn=turn,
        bend=bend,
        share=s,
        excess=excess,
        begun=jnp.ones_like(state.begun),
    )


def _borne(v, a, j, state, f, turn, bend, Ts, stop, sharpness):
    """The share that the path allows, now and as far as its bend is predicted, approached with bounded jerk."""
    caps, heavy, stiff = [1.0], None, None
    if v is not None:
        room = v
        if j is not None:  # leave room to stop the growth of f: v + q̈²/(2 j) ≤ V
            gains = jnp.maximum(0.0, jnp.sign(f) * state.share**2 * turn)
            room = v - jnp.minimum(gains * gains / (2 * EASING * j), v / 2)
        caps.append(1 / jnp.maximum(1.0, _largest(f / room)))
    if a is not None:
        heavy = _largest(f / a)  # the inverse of the largest ṡ
        lag = Ts if j is None else 2 * _max(jnp.where(jnp.isfinite(a), a, 0.0) / j)  # time until it brakes fully
        grows = jnp.maximum(0.0, jnp.sign(turn) * bend) / (TURNING * a)
        now = jnp.abs(turn) / (TURNING * a) + grows * state.share * lag
        # s² ≤ min over x ≥ 0 of 1/(now + grows·x) + 2 ṡ x: the path's limit at x, plus the braking until then.
        there = jnp.maximum(jnp.maximum(1.0, now), safe_sqrt(grows * heavy / (2 * (1 - TURNING))))
        caps.append(jnp.sqrt(jnp.minimum(1.0, -_max((now - 2 * there) / there**2))))
    if j is not None:
        stiff = _largest(f / j)
        caps.append(jnp.maximum(1.0, _largest(bend / j) / BENDING) ** (-1 / 3))
    if stop is not None:
        caps.append(_before(jnp.asarray(stop, f.dtype), sharpness, heavy, stiff, Ts))
    cap = caps[0]
    for other in caps[1:]:
        cap = jnp.minimum(cap, other)
    if j is None:
        return cap
    # The square root law, ṡ = √(2 s̈ (cap − s)), which arrives exactly in its last sample.
    gap = cap - state.share
    return state.share + 2 * EASING * gap * Ts / (
        jnp.sqrt((EASING * Ts) ** 2 + 2 * EASING * stiff * jnp.abs(gap)) + EASING * Ts
    )


def _before(stop, sharpness, heavy, stiff, Ts):
    """The share from which all motion can stop within a path time `stop`, or slow down for a corner's sharpness."""
    stop, slowness, floor = jnp.clip(stop, 1e-3 * Ts, 1e6 * Ts), 1.0, 1.0
    if heavy is not None:
        slowness = jnp.maximum(1.0, heavy / stop) ** 0.5
        floor = 1 / jnp.maximum(1.0, 4 * heavy / Ts)
    if stiff is not None:
        slowness = jnp.maximum(slowness, jnp.maximum(1.0, 4 * stiff / (BENDING * stop * stop)) ** (1 / 3))
        floor = jnp.minimum(floor, 1 / jnp.maximum(1.0, 4 * stiff / Ts**2))
    return jnp.maximum(1 / slowness, jnp.minimum(1.0, floor / jnp.maximum(sharpness, 1e-3)))


def _inside(a, j, state, f, Ts, room):
    """The largest share with which each joint can brake before its position limit and no step ends beyond it."""
    size, towards = jnp.abs(f), jnp.sign(f)
    near = (size > 0) & (room > 0)
    size, room = jnp.where(near, size, 1.0), jnp.where(near, jnp.minimum(room, FAR), FAR)
    heavy, stiff = (None if w is None else size / w for w in (a, j))
    left = room
    if j is not None:  # distance until its acceleration is 0
        speeds, gains = (jnp.maximum(0.0, towards * w) for w in (state.velocity, state.acceleration))
        lasts = gains / j
        left = room - lasts * (speeds + gains * lasts / 3)
    return -_max(-jnp.minimum(_before(left / size, 1.0, heavy, stiff, Ts), room / (size * Ts)))


def _kept(a, j, state, f, Ts, most):
    """(low, high, excess): the shares in [0, most] that violate a and j least, and the largest share of a limit used.

    Each limit of each joint is |s g − b| ≤ 1. Intervals on a line have a common point if any two of them do (Helly),
    so the least μ with all |s g − b| ≤ μ follows from pairs.
    """
    g, b = [], []
    if a is not None:
        g.append(f / (a * Ts))
        b.append(state.velocity / (a * Ts))
    if j is not None:
        g.append(f / (j * Ts**2))
        b.append((state.velocity + Ts * state.acceleration) / (j * Ts**2))
    if not g:
        return jnp.zeros_like(most), most, jnp.zeros_like(most)
    g, b = jnp.concatenate(g), jnp.concatenate(b)
    size = jnp.abs(g)
    both = size[:, None] + size
    apart = jnp.abs(b[:, None] * g - g[:, None] * b)
    pairs = jnp.where(both > 0, apart / jnp.where(both > 0, both, 1.0), 0.0)
    still = size == 0
    safe = jnp.where(still, 1.0, size)
    middle = b * jnp.sign(g) / safe
    alone = jnp.abs(jnp.clip(middle, 0.0, most) * g - b)
    excess = jnp.maximum(_max(pairs), _max(alone))
    reach = jnp.maximum(excess, 1.0) / safe
    low = _max(jnp.where(still, -jnp.inf, middle - reach))
    high = -_max(jnp.where(still, -jnp.inf, -middle - reach))
    return low, high, excess


# --- off the path -------------------------------------------------------------------------------------


def _braked(a, j, state, wanted, Ts):
    """The velocity (n,) nearest to the wanted one that each joint reaches within its limits."""
    gap = wanted - state.velocity
    if j is None:
        return state.velocity + jnp.clip(gap, -a * Ts, a * Ts)
    # As for the share: the acceleration is 0 when the wanted velocity is reached.
    size = jnp.abs(gap)
    change = 2 * EASING * gap / (safe_sqrt((EASING * Ts) ** 2 + 2 * EASING * size / j) + EASING * Ts)
    change = jnp.clip(change, state.acceleration - j * Ts, state.acceleration + j * Ts)
    if a is not None:
        change = jnp.clip(change, -a, a)
    return state.velocity + Ts * change


def _too_late(a, j, state, velocity, Ts, room):
    """The joints that `_braked` could not stop before a position limit after a step at a velocity (n,)."""
    v, grows = (jnp.stack([-w, w]) for w in (velocity, (velocity - state.velocity) / Ts))
    far = _stopping(a, j, v, grows, Ts)
    return ((far > 0) & (far + v * Ts > room)).any(axis=0)


def _stopping(a, j, v, grows, Ts):
    """How far joints move towards a limit until `_braked` stops them, from v and an acceleration `grows` towards it.

    With a jerk limit, braking has three phases: full jerk, constant acceleration a if it is reached, and easing to
    rest. A joint that still moves away continues from its turning point.
    """
    fast = jnp.maximum(v, 0.0)
    if j is None:
        return jnp.where(fast > a * Ts, fast * (fast / (2 * a) - Ts / 2) + a * Ts**2 / 8, 0.0)
    j = jnp.minimum(j, FAR / Ts**2)
    top = v + jnp.maximum(grows, 0.0) ** 2 / (2 * j)
    turned = safe_sqrt(2 * j * jnp.maximum(top, 0.0))
    begins = jnp.where(v > 0, jnp.maximum(grows, -safe_sqrt(2 * EASING * j * fast)), turned)
    eases = jnp.maximum(fast + begins**2 / (2 * j), 0.0) / (1 + EASING)
    brakes = safe_sqrt(2 * EASING * j * eases)
    held = 0.0
    if a is not None:
        a = jnp.minimum(a, FAR / Ts)
        full, reached = a * a / (2 * EASING * j), fast + (begins**2 - a * a) / (2 * j)
        held = jnp.where(eases > full, (reached**2 - full**2) / (2 * a), 0.0)
        brakes, eases = jnp.minimum(brakes, a), jnp.minimum(eases, full)
    lasts = (begins + brakes) / j
    far = lasts * (fast + lasts * (begins / 2 - lasts * j / 6)) + held
    return jnp.where(top > 0, far + eases / 3 * safe_sqrt(2 * eases / (EASING * j)), 0.0)


def _steepness(state, f, Ts):
    """The decrease of f per unit of motion [1/s] if the last step was off the path: α, for f′ = −α f."""
    moved = Ts * safe_sqrt(jnp.sum(state.velocity**2))
    found = safe_sqrt(jnp.sum((f - state.requested) ** 2)) / jnp.where(moved > 0, moved, 1.0)
    return jnp.where(state.over & (moved > 0), found, 0.0)


def _along(velocity, f):
    """The share of f in a velocity."""
    size = jnp.sum(f * f)
    return jnp.where(size > 0, jnp.clip(jnp.sum(velocity * f) / jnp.where(size > 0, size, 1.0), 0.0, 1.0), 1.0)
