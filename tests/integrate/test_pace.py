"""Pace: limits of velocity, acceleration and jerk kept by going slower along the way; the path waits."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate.drive import Drive
from cnclik.integrate.status import Status
from cnclik.integrate.trajectory import join, truncate
from tests.oracles import close

ARM = ck.planar_arm([1.0, 0.8, 0.6])
LAW = ck.Law(ARM, ck.position("xy"), alpha=10.0)
Q0 = np.array([0.3, 1.2, 0.9])
X0 = np.asarray(ck.forward(ARM, Q0).position[:2])
TS = 0.002
LIMITS = dict(velocity=2.0, acceleration=10.0, jerk=300.0)
PACE = ck.Pace(**LIMITS)
REBASED = Drive(lag=0.1, command="position", feedback="rebased")
WAY = np.array([-0.5, -0.4])
CENTER, RADIUS = X0 - [0.2, 0.0], 0.2
CIRCLE = ck.circle(CENTER, RADIUS, period=0.8)
LINE = ck.line(X0, X0 + WAY, duration=0.5)
FAR = ck.hold(X0 + WAY)


def marked(run, bit):
    return int(np.sum((np.asarray(run.status) & int(bit)) != 0))


# --- any loop's steps ---------------------------------------------------------------------------------


def wave(seed, n=4, speed=1.0):
    """Amplitudes, rates and phases of a random smooth path of n joints."""
    draw = np.random.default_rng(seed)
    return draw.normal(size=(4, n)) * 0.5, speed * draw.uniform(1, 4, (4, 1)), draw.uniform(0, 6, (4, n))


def along(waves, t):
    size, rate, phase = waves
    return jnp.sum(size * jnp.sin(rate * t + phase), axis=0)


@functools.partial(jax.jit, static_argnames=("N",))
def following(pace, waves, *, N):
    """q, asked velocity, share, excess and path time of a loop that follows a wave."""
    size, rate, phase = waves

    def one(carry, _):
        q, t, state = carry
        asked = 10.0 * (along(waves, t) - q) + jnp.sum(size * rate * jnp.cos(rate * t + phase), axis=0)
        dq, state = ck.paced(pace, state, TS * asked, TS)
        return (q + dq, t + TS * state.share, state), (q, asked, dq, state.share, state.excess, t)

    q = along(waves, 0.0) + 0.05
    return jax.lax.scan(one, (q, 0.0, ck.pace_at_rest(q)), None, length=N)[1]


def followed(pace, seed, speed=1.0, N=1000):
    return [np.asarray(v) for v in following(pace, wave(seed, 4, speed), N=N)]


def worst(dq, Ts=TS):
    """Largest velocity, acceleration and jerk of each joint, by differences."""
    v = np.concatenate([np.zeros((2, dq.shape[1])), dq / Ts])
    return [np.abs(w).max() for w in (v, np.diff(v, axis=0) / Ts, np.diff(v, 2, axis=0) / Ts**2)]


@pytest.mark.parametrize("speed", [1.0, 4.0])  # easily followed, and 5 times too fast
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_limits_are_kept_in_every_step_of_random_paths(seed, speed):
    q, asked, dq, share, excess, t = followed(PACE, seed, speed)
    for found, most in zip(worst(dq), LIMITS.values(), strict=True):
        assert found <= most * (1 + 1e-7)
    assert excess.max() <= 1 + 1e-9
    close(dq, share[:, None] * asked * TS, atol=1e-14)  # the direction is kept
    assert (share >= 0).all() and (share <= 1).all()
    assert share.mean() > 0.5 / speed and worst(asked * TS)[1] > LIMITS["acceleration"]
    at = np.stack([along(wave(seed, 4, speed), now) for now in np.asarray(t[::50])])
    assert np.abs(q[::50] - at)[10:].max() < 0.02  # late, not cut


@pytest.mark.parametrize(
    "limits",
    [
        dict(velocity=1.0),
        dict(velocity=None, acceleration=10.0),
        dict(velocity=None, jerk=300.0),
        dict(velocity=np.array([2.0, np.inf, 1.0, 3.0]), acceleration=np.array([10.0, 5.0, np.inf, 8.0])),
        dict(velocity=None),
    ],
)
def test_each_limit_by_itself_and_per_joint(limits):
    _, _, dq, share, excess, _ = followed(ck.Pace(**limits), 1, N=600)
    v = np.concatenate([np.zeros((2, 4)), dq / TS])
    several = dict(velocity=v, acceleration=np.diff(v, axis=0) / TS, jerk=np.diff(v, 2, axis=0) / TS**2)
    for name, most in limits.items():
        assert most is None or (np.abs(several[name]) <= most * (1 + 1e-7)).all()
    assert excess.max() <= 1 + 1e-9 and np.isfinite(dq).all()
    assert limits != dict(velocity=None) or (share == 1).all()


def test_where_no_share_keeps_the_limits_the_joints_brake_within_them():
    """A corner of 90°: what the best share would take, against a search over all; and what is done, which is within."""
    pace, state = ck.Pace(velocity=5.0, acceleration=10.0, jerk=3000.0), ck.pace_at_rest(np.zeros(2))
    for _ in range(200):
        _, state = ck.paced(pace, state, TS * np.array([1.0, 0.2]), TS)
    assert not state.over and state.share == 1
    asked = np.array([-0.2, 1.0])

    def parts(s):
        a = (s * asked - state.velocity) / TS
        return max(np.abs(a).max() / 10, np.abs((a - state.acceleration) / TS).max() / 3000)

    dq, after = ck.paced(pace, state, TS * asked, TS)
    shares = np.linspace(0, 1, 20001)
    assert after.over
    close(after.excess, min(map(parts, shares)), rtol=1e-3)
    close(dq, TS * after.velocity, atol=0)
    close(np.abs(after.acceleration - state.acceleration) / TS, 3000.0, rtol=1e-9)  # each joint as fast as it may
    assert after.acceleration[0] < 0 < after.acceleration[1]
    for _ in range(300):
        dq, after = ck.paced(pace, after, TS * asked, TS)
    close(dq, TS * asked, atol=1e-12)
    assert not after.over


@functools.partial(jax.jit, static_argnames=("every",))
def retargeted(pace, targets, alpha, *, every):
    """Joints q and steps dq of a loop whose target jumps every so many steps."""

    def one(carry, k):
        q, state = carry
        dq, state = ck.paced(pace, state, TS * alpha * (targets[k // every] - q), TS)
        return (q + dq, state), (q + dq, dq)

    start = jnp.zeros(targets.shape[1]), ck.pace_at_rest(targets[0])
    return jax.lax.scan(one, start, jnp.arange(len(targets) * every))[1]


@pytest.mark.parametrize("alpha", [3.0, 10.0, pytest.param(40.0, marks=pytest.mark.slow), 150.0])
@pytest.mark.parametrize(
    "limits",
    [
        LIMITS,
        dict(velocity=2.0, acceleration=10.0, jerk=3000.0),
        dict(velocity=2.0, acceleration=10.0),
        pytest.param(dict(velocity=2.0, jerk=300.0), marks=pytest.mark.slow),
    ],
)
def test_targets_that_jump_under_way_break_no_limit_and_are_reached(limits, alpha):
    """The last one soon: the time at full speed, that of two stops, and the loop's own; and not overshot."""
    draw = np.random.default_rng(5)
    for every in (30, 90):
        for size in (0.05, 0.3, 1.0):
            jumps = 3 + 2000 // every
            targets = size * draw.normal(size=(jumps, 4))
            targets[3:] = targets[3]
            q, dq = map(np.asarray, retargeted(ck.Pace(**limits), targets, alpha, every=every))
            for found, (name, most) in zip(worst(dq), dict.fromkeys(LIMITS, np.inf).items(), strict=True):
                assert found <= limits.get(name, most) * (1 + 1e-7), name
            rest = q[3 * every - 1 :] - targets[-1]
            assert (rest @ -rest[0]).max() <= 0.05 * rest[0] @ rest[0]
            arrived = TS * (1 + np.flatnonzero(np.abs(rest).max(1) > 1e-3)[-1])
            assert arrived < 1.7 * (np.abs(rest[0]).max() / 2.0 + 0.35 + 3 / alpha)


def test_a_joint_that_may_not_move_stops_all_and_nothing_asked_is_nothing_done():
    dq, state = ck.paced(ck.Pace(velocity=np.array([0.5, 1e-9])), ck.pace_at_rest(np.zeros(2)), np.ones(2), TS)
    assert np.abs(dq).max() <= 1e-9 * TS
    dq, state = ck.paced(PACE, ck.pace_at_rest(np.zeros(2)), np.zeros(2), TS)
    assert not dq.any() and state.share == 1 and not state.over


# --- solve --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["EE", "AB2"])
def test_a_line_is_left_from_rest_and_stopped_at_its_end(method):
    run = ck.solve(LAW, LINE, Q0, TS, 900, method, pace=PACE)
    kept = ck.check_limits(run, PACE, chain=ARM)
    assert kept.ok and kept.acceleration.max() > 0.9
    assert marked(run, Status.OVER_ACCELERATION) == 0 and not ck.check_limits(ck.solve(LAW, LINE, Q0, TS, 400), PACE).ok
    along = (np.asarray(run.x) - X0) @ WAY / (WAY @ WAY)
    assert along.max() < 1.01 and abs(along[-1] - 1) < 1e-3  # by less than 1 % of the way beyond the end
    assert run.path_time[-1] > 0.5 and (np.diff(run.path_time) >= 0).all()
    free = ck.solve(LAW, LINE, Q0, TS, 300, method)
    assert np.abs(run.e).max() <= np.abs(free.e).max()


def test_a_far_target_is_reached_soon_and_not_overshot():
    run = ck.solve(LAW, FAR, Q0, TS, 900, "EE", pace=PACE)
    assert ck.check_limits(run, PACE).ok and marked(run, Status.OVER_ACCELERATION) == 0
    e = np.asarray(run.e)
    assert -(e @ e[0]).min() <= 0.01 * e[0] @ e[0] and np.abs(e[-1]).max() < 1e-4
    # Straight in joint space, the move would take at least 2·√(way/acceleration).
    way = np.abs(np.asarray(run.q[-1]) - Q0).max()
    arrival = run.t[np.argmax(np.linalg.norm(e, axis=1) < 0.02 * np.linalg.norm(e[0]))]
    assert arrival < 2.2 * 2 * np.sqrt(way / LIMITS["acceleration"])


def test_a_circle_is_followed_late_but_not_cut():
    run = ck.solve(LAW, CIRCLE, Q0, TS, 900, "EE", pace=PACE)
    free = ck.solve(LAW, CIRCLE, Q0, TS, 900, "EE")
    off = [np.abs(np.linalg.norm(np.asarray(r.x) - CENTER, axis=1) - RADIUS).max() for r in (run, free)]
    assert off[0] <= off[1] and ck.check_limits(run, PACE).ok
    assert run.path_time[-1] < 0.95 * run.t[-1]
    # Errors are those to where the target was when it waited.
    at = CENTER + RADIUS * np.stack([np.cos(w := 2 * np.pi / 0.8 * np.asarray(run.path_time)), np.sin(w)], axis=1)
    close(run.e, at - np.asarray(run.x), atol=1e-12)
    across = ck.measure_run(run, LAW, CIRCLE, ["max_across"]).max_across  # of the path where it waited
    assert 0.5 * off[0] < across < 1.5 * off[0]


def test_limits_that_do_not_bind_change_nothing():
    loose = ck.Pace(velocity=1e6, acceleration=1e9, jerk=1e15)
    run, free = (ck.solve(LAW, CIRCLE, Q0, TS, 40, "AB2", **p) for p in (dict(pace=loose), {}))
    close(run.q, free.q, atol=1e-6)
    close(run.path_time, free.t, atol=1e-12)


def test_a_corner_that_is_known_is_slowed_down_before():
    def fn(t):
        return X0 + np.array([-0.4, 0.0]) * jnp.minimum(t, 0.5) + np.array([0.0, -0.4]) * jnp.maximum(t - 0.5, 0)

    run = ck.solve(LAW, ck.path(fn), Q0, TS, 900, "EE", pace=PACE)
    assert ck.check_limits(run, PACE).ok and run.path_time[-1] > 0.6
    unseen = ck.solve(LAW, ck.causal(ck.path(fn)), Q0, TS, 900, "EE", pace=PACE)
    assert unseen.path_time is None and marked(unseen, Status.OVER_ACCELERATION) > 0
    assert ck.check_limits(unseen, PACE).ok  # off the path for some steps, but within the limits
    with pytest.raises(ck.StepError, match="OVER_ACCELERATION: round the path's corners"):
        ck.require_ok(unseen)


def test_the_chains_own_velocities_are_the_default():
    arm = ck.replace(ARM, velocity_limit=(0.5, 0.4, 0.3))
    law = ck.Law(arm, ck.position("xy"), alpha=10.0)
    run = ck.solve(law, FAR, Q0, TS, 300, "EE", pace=ck.Pace())
    close(np.max(np.abs(run.qdot) / [0.5, 0.4, 0.3]), 1.0, rtol=1e-12)
    assert marked(run, Status.OVER_VELOCITY) == 0
    assert marked(ck.solve(law, FAR, Q0, TS, 300, "EE"), Status.OVER_VELOCITY) > 0
    assert ck.check_limits(run, ck.Pace(), chain=arm).ok


def test_float32_does_not_stop_short():
    law = ck.Law(ck.planar_arm([1.0, 1.0]), ck.position("xy"), alpha=1.0)
    run = ck.solve(law, ck.hold([1.2, 0.9]), np.array([0.3, 1.2], np.float32), 0.001, 20_000, "EE", pace=PACE)
    assert run.e.dtype == np.float32 and np.linalg.norm(run.e[-1]) < 1e-6  # where 41 µm would round to nothing


def test_float32_and_lanes():
    run = ck.solve(LAW, CIRCLE, Q0.astype(np.float32), TS, 300, "EE", pace=PACE)
    assert run.q.dtype == run.path_time.dtype == np.float32 and marked(run, Status.OVER_ACCELERATION) == 0
    assert ck.check_limits(run, ck.Pace(velocity=2.0, acceleration=10.001, jerk=301.0)).ok
    starts = np.stack([Q0, Q0 + 0.1])
    many = jax.vmap(lambda q: ck.solve(LAW, CIRCLE, q, TS, 60, "EE", pace=PACE))(starts)
    one = ck.solve(LAW, CIRCLE, starts[1], TS, 60, "EE", pace=PACE)
    close(many.q[1], one.q, atol=1e-12)


def test_gradients_are_finite_and_right():
    def late(acceleration, alpha, N=60):
        law = ck.replace(LAW, alpha=alpha)
        pace = ck.Pace(velocity=2.0, acceleration=acceleration, jerk=300.0)
        return jnp.sum(ck.solve(law, FAR, Q0, TS, N, "EE", pace=pace).e[-1] ** 2)

    found = jax.grad(late, argnums=(0, 1))(3.1, 10.0)
    assert np.isfinite(found).all() and found[0] < 0  # more acceleration, less error
    h = 1e-5
    close(found[0], (late(3.1 + h, 10.0) - late(3.1 - h, 10.0)) / (2 * h), rtol=1e-4)
    rest = jax.grad(lambda dq: ck.paced(PACE, ck.pace_at_rest(dq), dq, TS)[0].sum())(jnp.zeros(3))
    assert np.isfinite(rest).all()


def test_a_paced_run_is_data_like_any_other():
    run = ck.solve(LAW, LINE, Q0, TS, 30, "EE", pace=PACE)
    data = ck.to_dataset(run, LAW)
    assert data.path_time.dims == ("time",) and data.path_time.attrs["units"] == "s"
    assert "path    0 to" in repr(run)
    first = truncate(run, 10)
    assert first.path_time.shape == (11,)
    close(join([first, first]).path_time[10:], run.path_time[:11], atol=0)


# --- a stream of targets ------------------------------------------------------------------------------


TIMES = np.arange(0, 1.0, 1 / 30)
TARGETS = np.stack([np.cos(2 * TIMES), TIMES**2], axis=1)


def sampled(stream, t):
    return np.asarray(jax.vmap(lambda t: stream.curve(t)[0])(t))


def test_a_stream_is_held_ramped_or_smoothed_and_never_known_before_it_comes():
    gap, t = 1 / 30, np.arange(0, 1.3, 0.001) + 1e-6
    last = np.clip(np.searchsorted(TIMES, t, side="right") - 1, 0, len(TIMES) - 1)
    found = {kind: sampled(ck.resampled(TIMES, TARGETS, kind=kind), t) for kind in ("hold", "ramp", "spline")}
    close(found["hold"], TARGETS[last], atol=1e-12)
    ramp = np.stack([np.interp(t - gap, TIMES, x) for x in TARGETS.T], axis=1)
    close(found["ramp"], ramp, atol=1e-9)
    # The smooth one is the ramp's mean over a period, which the future has no part in.
    fine = np.linspace(-gap / 2, gap / 2, 401)
    smooth = [np.interp(t[:, None] - 1.5 * gap + fine, TIMES, x).mean(axis=1) for x in TARGETS.T]
    close(found["spline"], np.stack(smooth, axis=1), atol=1e-4)
    for kind, path in found.items():
        changed = TARGETS.copy()
        changed[20:] += 1.0
        other = sampled(ck.resampled(TIMES, changed, kind=kind), t)
        known = t < TIMES[20]
        close(other[known], path[known], atol=0)
        assert np.abs(other - path).max() > 0.5
    assert not ck.resampled(TIMES, TARGETS).known


def test_a_stream_of_rotations_and_uneven_times():
    turns = np.linspace(0, 1.0, 8)
    rotations = np.stack([np.cos(turns / 2), 0 * turns, 0 * turns, np.sin(turns / 2)], axis=1)
    times = np.cumsum([0, 0.03, 0.05, 0.03, 0.04, 0.03, 0.05, 0.03])
    stream = ck.resampled(times, None, rotations, kind="spline")
    at = jax.vmap(lambda t: stream.curve(t)[1])(np.linspace(0, 0.5, 101))
    angle = np.arctan2(at[:, 1, 0], at[:, 0, 0])
    close(angle[[0, -1]], [0.0, 1.0], atol=1e-9)
    assert (np.diff(angle) >= -1e-12).all() and np.abs(np.diff(angle, 2)).max() < 0.02


def test_a_smooth_stream_shakes_a_fast_loop_least():
    points = X0 + np.stack([-0.3 * (1 - np.cos(2 * TIMES)), -0.2 * np.sin(3 * TIMES)], axis=1)
    shaken = {}
    for kind in ("hold", "ramp", "spline"):
        run = ck.solve(LAW, ck.resampled(TIMES, points, kind=kind), Q0, TS, 450, "EE")
        shaken[kind] = np.abs(np.diff(np.asarray(run.qdot), axis=0)[100:]).max() / TS
    assert shaken["spline"] < 0.5 * shaken["hold"] and shaken["spline"] < 0.5 * shaken["ramp"]


# --- through drives -----------------------------------------------------------------------------------


def test_a_paced_loop_through_drives_moves_as_it_was_commanded_later():
    """A controller that looks at its own commands sends what it would send to an ideal robot."""
    ideal = ck.solve(LAW, CIRCLE, Q0, TS, 80, "EE", pace=PACE)
    late = ck.solve(LAW, CIRCLE, Q0, TS, 80, "EE", pace=PACE, drive=Drive(delay=3, feedback="commanded"))
    close(late.q[3:], ideal.q[:-3], atol=1e-12)
    close(late.path_time, ideal.path_time, atol=1e-12)
    close(late.q[:4], np.tile(Q0, (4, 1)), atol=1e-15)


@pytest.mark.parametrize("wait", [True, False])
def test_a_paced_loop_that_sees_its_late_motion_commands_within_the_limits(wait):
    pace, drive = ck.replace(PACE, velocity=1.0, wait=wait), Drive(delay=2, lag=0.02)
    run = ck.solve(ck.replace(LAW, alpha=2.0), CIRCLE, Q0, TS, 400, "EE", pace=pace, drive=drive)
    free = ck.solve(ck.replace(LAW, alpha=2.0), CIRCLE, Q0, TS, 400, "EE", drive=drive)
    assert np.abs(free.qdot).max() > 1.05 * np.max(pace.velocity)  # which the pace is there for
    assert np.abs(run.qdot).max() <= np.max(pace.velocity) * (1 + 1e-9)
    assert (np.abs(np.diff(run.qdot, axis=0)) / TS).max() <= np.max(pace.acceleration) * (1 + 1e-6)
    assert np.linalg.norm(run.e[-1]) < (0.05 if wait else 0.1)  # which cuts what it has no time for


def test_an_ideal_drive_changes_nothing():
    found, wanted = (ck.solve(LAW, CIRCLE, Q0, TS, 40, "AB2", pace=PACE, **d) for d in ({"drive": Drive()}, {}))
    np.testing.assert_array_equal(found.q, wanted.q)


# --- errors -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: ck.Pace(jerk=-1), "`jerk` must be positive, but is -1"),
        (lambda: ck.Pace(velocity="fast"), "`velocity` must be an array of real numbers, but is 'fast'"),
        (lambda: ck.Pace(wait="no"), "`wait` must be True or False, but is 'no'"),
        (lambda: ck.Pace(wait=np.zeros(2)), "`wait` must be True or False"),
        (lambda: ck.Pace(acceleration=[]), "`acceleration` must be a number or one per joint, but is empty"),
        (
            lambda: ck.solve(
                LAW, FAR, Q0, TS, 3, pace=PACE, drive=Drive(lag=0.1, command="position", feedback="rebased")
            ),
            "`pace` must be left out where commands begin at the measured joints",
        ),
        (lambda: ck.solve(LAW, FAR, Q0, TS, 3, pace=2.0), r"`pace` must be Pace\(...\), but is float"),
        (lambda: ck.solve(LAW, FAR, Q0, TS, 3, pace=ck.Pace(jerk=[1.0, 2.0])), r"`jerk` must have shape \(3,\)"),
        (lambda: ck.paced(PACE, None, Q0, TS), "`state` must be what `pace_at_rest`"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0[:2], TS), "`dq` must have 3 joints, as `state`, but has 2"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0, 0.0), "`Ts` must be positive"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0, TS, stop=np.nan), "`stop` must be finite, but is nan"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0, TS, stop=-1.0), "`stop` must be at least 0, but is -1"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0, TS, stop=Q0), "`stop` must be a number"),
        (lambda: ck.paced(PACE, ck.pace_at_rest(Q0), Q0, TS, sharpness="x"), "`sharpness` must be a number"),
        (
            lambda: ck.check_limits(np.zeros((3, 2)), PACE, Ts=TS, chain=LAW.chain),
            "`chain` must have the run's 2",
        ),
        (lambda: ck.check_limits(np.zeros((3, 2)), PACE, Ts=TS, chain=5), "`chain` must be a Chain, but is int"),
        (lambda: ck.check_limits(ck.solve(LAW, FAR, Q0, TS, 3), PACE, Ts=TS), "`Ts` must be left out for a Trajectory"),
        (lambda: ck.paced(ck.Pace(), ck.pace_at_rest(Q0), Q0, TS), "`velocity` must be numbers or None"),
        (lambda: ck.check_limits(np.zeros((3, 2)), PACE), "`Ts` must be a number, but is None"),
        (lambda: ck.check_limits(np.zeros((3, 2)), ck.Pace(), Ts=TS), "`chain` must be given, for its velocity"),
        (lambda: ck.resampled([0.0, 1.0], kind="ramp"), "`positions` must be given, or `rotations`"),
        (lambda: ck.resampled([0.0, 0.0], np.zeros((2, 2))), "`times` must increase"),
        (lambda: ck.resampled([0.0, 1.0], np.zeros((2, 2)), kind="ramps"), "`kind` must be one of hold, ramp, spline"),
        (lambda: ck.resampled([0.0, 1.0], np.zeros((2, 2)), delay=1.0), "`delay` must be at least 1.5 s, for spline"),
    ],
)
def test_errors(call, message):
    with pytest.raises(ck.ArgumentError, match=message):
        call()
