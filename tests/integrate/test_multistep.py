"""Multistep methods: against loops written by hand, orders, starts and restarts, limits, and the history handed on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.integrate import history
from cnclik.integrate.method import adams
from cnclik.law.law import observe
from cnclik.robot.model import modelled
from tests.integrate.test_exponential import ARM, CIRCLE, LAW, LENGTHS, START, by_steps
from tests.oracles import clik, close, planar_jacobian, planar_law, planar_position

RESTARTED = int(ck.Status.RESTARTED)
# The formulas as their papers print them: past joint values and slopes, the newest first.
FORMULAS = {
    "AB2": ([1], [3 / 2, -1 / 2]),
    "AB3": ([1], [23 / 12, -16 / 12, 5 / 12]),
    "AB4": ([1], [55 / 24, -59 / 24, 37 / 24, -9 / 24]),
    "ZNN4": ([3 / 2, -1, 1 / 2], [1]),
    "ZEAD4": ([3 / 5, 1 / 5, 1 / 5], [8 / 5]),
    "ZNN6": ([6 / 13, 2 / 13, 4 / 13, 3 / 13, -2 / 13], [24 / 13]),
    "IFD5": ([-1 / 8, 3 / 4, 5 / 8, -1 / 4], [9 / 4]),
}
QUICK = ("AB3", "ZEAD4")
OMEGA = 2 * np.pi / 4
CENTER = planar_position(np.array(LENGTHS), START) - [0.2, 0.0]


def target(t):
    return CENTER + 0.2 * np.array([np.cos(OMEGA * t), np.sin(OMEGA * t)])


def velocity(t):
    return 0.2 * OMEGA * np.array([-np.sin(OMEGA * t), np.cos(OMEGA * t)])


def by_hand(method, f, Ts, N):
    a, b = FORMULAS[method]
    p = max(len(a), len(b))
    q = list(clik("RK4", f, START, Ts, p - 1))
    for k in range(p - 1, N):
        moved = sum(w * q[k - j] for j, w in enumerate(a))
        q.append(moved + Ts * sum(w * f(q[k - j], (k - j) * Ts) for j, w in enumerate(b)))
    return np.array(q)


@pytest.mark.parametrize("method", [pytest.param(m, marks=[] if m in QUICK else pytest.mark.slow) for m in FORMULAS])
def test_is_the_formula_as_printed(method):
    f = planar_law(LENGTHS, target, velocity, 4.0)
    run = ck.solve(LAW, CIRCLE, START, 0.05, 12, method)
    close(run.q, by_hand(method, f, 0.05, 12), atol=1e-11)
    early = len(max(FORMULAS[method], key=len)) - 1
    assert run.evaluations == 12 + 3 * early and not np.any(run.status)
    close(run.qdot, np.diff(run.q, axis=0) / 0.05, atol=1e-11)


def test_exponential_memory_is_the_formula_as_written_down():
    """EXP-AB2 in NumPy, with its first step, by EXP-RK4, taken from the library."""
    Ts, N, lengths = 0.1, 8, np.array(LENGTHS)
    run = ck.solve(LAW, CIRCLE, START, Ts, N, "EXP-AB2")
    q, past = [START, np.asarray(run.q[1])], (np.linalg.pinv(planar_jacobian(lengths, START)), velocity(0.0))
    for k in range(1, N):
        now = np.linalg.pinv(planar_jacobian(lengths, q[k])), velocity(k * Ts)
        e = target(k * Ts) - planar_position(lengths, q[k])
        wanted = target((k + 1) * Ts) - target(k * Ts) - np.expm1(-4.0 * Ts) * e
        (j, v), (jj, vv) = now, past
        mean_v, mean_j = 1.5 * v - 0.5 * vv, 1.5 * j - 0.5 * jj
        q.append(q[k] + Ts * (1.5 * j @ v - 0.5 * jj @ vv) + mean_j @ (wanted - Ts * mean_v))
        past = now
    close(run.q, q, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("method", FORMULAS)
def test_order(method):
    f = planar_law(LENGTHS, target, velocity, 4.0)
    exact = clik("RK4", f, START, 1 / 1000, 1000)[-1]
    N = 320 if method == "AB4" else 80  # of steps from which on the order shows
    coarse, fine = (by_steps(LAW, CIRCLE, START, 1 / n, n, method)[0][-1] - exact for n in (N, 2 * N))
    assert np.log2(np.linalg.norm(coarse) / np.linalg.norm(fine)) == pytest.approx(ck.METHODS[method].order, abs=0.15)


def test_formulas_are_consistent():
    """Exact for polynomials of their order, and no further: Σ aⱼ = 1, and so on."""
    for name, (a, b) in FORMULAS.items():
        method = ck.METHODS[name]
        assert (list(method.a), list(method.b)) == (pytest.approx(a), pytest.approx(b))
        for power in range(method.order + 2):
            past = [(-j) ** power for j in range(5)]
            slopes = [power * (-j) ** max(power - 1, 0) if power else 0 for j in range(5)]
            made = sum(w * v for w, v in zip(a, past, strict=False)) + sum(
                w * v for w, v in zip(b, slopes, strict=False)
            )
            assert (abs(made - 1) < 1e-14) == (power <= method.order)
        assert method.table[0][1][:1] == (1.0,) and method.table[-1][0][: len(a)] == pytest.approx(tuple(a))


# As printed in Hairer, Nørsett & Wanner (1993), III.1, and usual tables.
PRINTED = {
    1: [1],
    2: [3 / 2, -1 / 2],
    3: [23 / 12, -16 / 12, 5 / 12],
    4: [55 / 24, -59 / 24, 37 / 24, -9 / 24],
    5: [1901 / 720, -2774 / 720, 2616 / 720, -1274 / 720, 251 / 720],
    6: [4277 / 1440, -7923 / 1440, 9982 / 1440, -7298 / 1440, 2877 / 1440, -475 / 1440],
}


def test_adams_weights_of_any_order():
    for p, weights in PRINTED.items():
        assert adams(p) == pytest.approx(weights, rel=1e-15)


@pytest.mark.parametrize("p", [pytest.param(5, marks=pytest.mark.slow), 6])
def test_formulas_of_ones_own_of_many_instants(p):
    """A start by RK4 and, after a jump of the target, Adams-Bashforth of rising order: up to 5 of 6 instants."""
    method = ck.Multistep(name=f"AB{p}", b=PRINTED[p], order=p, source="")
    f = planar_law(LENGTHS, target, velocity, 4.0)
    qs = list(clik("RK4", f, START, 0.02, p - 1))
    for k in range(p - 1, 12):
        qs.append(qs[k] + 0.02 * sum(w * f(qs[k - j], (k - j) * 0.02) for j, w in enumerate(PRINTED[p])))
    close(by_steps(LAW, CIRCLE, START, 0.02, 12, method)[0], qs, atol=1e-11)
    assert [row[1][: i + 1] for i, row in enumerate(method.table)] == [adams(i + 1) for i in range(p)]


@pytest.mark.parametrize(
    ("named", "message"),
    [
        (dict(b=[1.5, -0.4], order=1), "`b` must hold weights whose sum is 1, but has a sum of 1.1"),
        (dict(b=[1.5, -0.5], order=3), "`order` must be 2, that of the weights, but is 3"),
        (dict(a=[0.5, 0.4], b=[1.0], order=1), "`a` must hold weights whose sum is 1"),
        (dict(a=[-4.0, 5.0], b=[4.0, 2.0], order=3), "`a` must have no root of .* beyond 1, but has one of size 5"),
        (dict(a=[2.0, -1.0], b=[1.0, -1.0], order=1), "`a` must have no double root of .* at 1"),
        (dict(a=[0.5, 0.5], b=[1.5], order=1, exponential=True), "`exponential` must be False"),
        (dict(b=[], order=1), "`b` must hold weights whose sum is 1"),
        (dict(b="AB2", order=1), "`b` must be an array of real numbers"),
    ],
)
def test_formulas_that_are_none(named, message):
    with pytest.raises(ck.ArgumentError, match=message):
        ck.Multistep(name="own", source="", **named)


# --- history ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["EXP-AB3", pytest.param("ZNN4", marks=pytest.mark.slow)])
def test_steps_are_the_loop(method):
    run = ck.solve(LAW, CIRCLE, START, 0.05, 9, method)
    close(by_steps(LAW, CIRCLE, START, 0.05, 9, method)[0], run.q, atol=1e-12)


def test_history_goes_from_one_engine_to_the_other():
    first = ck.step(LAW, CIRCLE, START, 0.0, 0.05, "EXP-AB2")
    second = ck.step(LAW, CIRCLE, first.q, 0.05, 0.05, "EXP-AB2", history=first.history)
    other = jax.jit(lambda q, h: ck.step(LAW, CIRCLE, q, 0.05, 0.05, "EXP-AB2", history=h))(first.q, first.history)
    close(other.q, second.q, atol=1e-14)
    assert jax.tree.structure(other.history) == jax.tree.structure(second.history)
    assert int(second.history.count) == 1


def test_from_far_off_at_a_large_gain_the_past_is_left_alone():
    """J# is another one after each step; extrapolated from there, 70 of 200 loops of a Panda arrived, not 190."""
    law = ck.replace(LAW, alpha=np.array(500.0))
    goal = ck.hold(np.asarray(ck.forward(ARM, [-0.2, 2.2, -0.7]).position[:2]))
    run = ck.solve(law, goal, START, 0.05, 30, "EXP-AB2")
    euler = ck.solve(law, goal, START, 0.05, 30, "EXP-EE")
    restarted = np.flatnonzero(np.asarray(run.status) & RESTARTED)
    assert np.linalg.norm(run.e[-1]) < 1e-9 and np.linalg.norm(euler.e[-1]) < 1e-9
    assert len(restarted) and restarted[-1] < 15  # near the target the past counts


def test_a_target_that_turns_back_restarts_nothing():
    """Along a straight line and back: its velocity passes through 0, and J# is what it was."""
    x = np.asarray(ck.forward(ARM, START).position)[:2]
    there_and_back = ck.path(lambda t: jnp.stack([x[0] - 0.2 * (1 - jnp.cos(OMEGA * t)), 0 * t + x[1]]))
    errors = [ck.solve(LAW, there_and_back, START, 4 / N, N, "EXP-AB2") for N in (40, 80)]
    assert not any(np.any(np.asarray(run.status) & RESTARTED) for run in errors)
    coarse, fine = (np.sqrt(np.mean(np.asarray(run.e) ** 2)) for run in errors)
    assert np.log2(coarse / fine) > 1.8


def test_bad_histories_are_named():
    first = ck.step(LAW, CIRCLE, START, 0.0, 0.05, "EXP-AB2")
    again = dict(q=START, t=0.0, Ts=0.05)
    with pytest.raises(ck.ArgumentError, match="Argument `history` must be None for EE, which has no memory"):
        ck.step(LAW, CIRCLE, **again, method="EE", history=first.history)
    with pytest.raises(ck.ArgumentError, match="Argument `history` must be one of EXP-AB3 and this law"):
        ck.step(LAW, CIRCLE, **again, method="EXP-AB3", history=first.history)
    with pytest.raises(ck.ArgumentError, match="Argument `history` must be one of AB2 and this law"):
        ck.step(LAW, CIRCLE, **again, method="AB2", history=first.history)
    with pytest.raises(ck.ArgumentError, match="Argument `history` must be what `step` handed back"):
        ck.step(LAW, CIRCLE, **again, method="AB2", history=3)


# --- restarts -----------------------------------------------------------------------------------------


def jumping(t):
    """A circle in 4 s that jumps 2 cm at 0.525 s: a little more than it moves in a step."""
    angle = OMEGA * t
    there = jnp.stack([CENTER[0] + 0.2 * jnp.cos(angle), CENTER[1] + 0.2 * jnp.sin(angle)])
    return there + jnp.where(t > 0.525, -0.02, 0.0)


@pytest.mark.parametrize(
    ("method", "dtype"),
    [
        ("EXP-AB3", np.float64),
        pytest.param("EXP-AB3", np.float32, marks=pytest.mark.slow),
        pytest.param("AB2", np.float64, marks=pytest.mark.slow),
    ],
)
def test_a_jump_restarts(method, dtype):
    """Once, at the first instant after it; the step is then one of (exponential) Euler, without a Jacobian more."""
    run = ck.solve(LAW, ck.path(jumping), START.astype(dtype), 0.05, 16, method)
    np.testing.assert_array_equal(np.flatnonzero(np.asarray(run.status) & RESTARTED), [11])
    assert run.evaluations == 16 + 3 * (2 if method == "EXP-AB3" else 1)
    euler = "EXP-EE" if method == "EXP-AB3" else "EE"
    alone = ck.step(LAW, ck.path(jumping), run.q[11], np.asarray(run.t)[11], 0.05, euler)
    close(run.q[12], alone.q, atol=1e-12 if dtype is np.float64 else 1e-5)
    assert ck.require_ok(ck.solve(LAW, CIRCLE, START, 0.05, 16, method)) is not None


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_ordinary_motion_is_no_jump(dtype):
    """From rest, to rest, turning round, at constant speed and stopping dead; at long times in single precision."""
    x = CENTER
    paths = [
        ck.waypoints([0.0, 0.4, 0.6, 2.0], x + np.array([[0.2, 0], [0.21, 0.1], [0.1, 0.12], [0.2, 0.0]])),
        ck.line(x, 1.1 * x, duration=0.73),
        ck.lissajous(x, [0.2, 0.05], period=1.1, phase=[np.pi / 2, 0.0]),
        ck.hold(x),
        ck.with_feedforward(CIRCLE, [0.0, 0.0]),
    ]
    task = ck.pose("xy", "z")
    law = modelled(ck.Law(ARM, task, alpha=1.0, inverse=ck.damped(0.1)))
    q = jnp.asarray(START, dtype)
    for reference, t0 in zip(paths, (0.0, 0.0, 50.0, 50.0, 50.0), strict=True):
        turning = ck.path(lambda t, f=reference.curve: _turned(f(t)[0], t))  # and a rotation with it
        turning = ck.replace(turning, feedforward=None if reference.feedforward is None else np.zeros(3))
        assert np.all(_counts(law, turning, t0, q, dtype(0.02)) == 1)


def _turned(position, t):
    """The pose at a place, turned about z at once quickly and once slowly."""
    a = 0.7 * jnp.sin(3 * t)
    c, s, o, i = jnp.cos(a), jnp.sin(a), jnp.zeros_like(a), jnp.ones_like(a)
    place = jnp.stack([*(jnp.asarray(x, a.dtype) for x in position), o])
    return ck.Pose(position=place, rotation=jnp.stack([jnp.stack(r) for r in ((c, -s, o), (s, c, o), (o, o, i))]))


def _counts(law, reference, t0, q, Ts):
    """How many entries count at instants a step apart, one of them having counted."""

    def one(k):
        marks = [
            history.mark(law, reference, observe(law, reference, t, q), t)
            for t in (t0 + Ts * k, t0 + Ts * (k + 1).astype(q.dtype))
        ]
        blank = history.blank(law, q, ck.METHODS["AB2"])
        before = history.remember(blank, blank.entries[0], marks[0], Ts, jnp.ones((), int))
        return history.valid(before, law, marks[1], Ts)

    return np.asarray(jax.jit(jax.vmap(one))(jnp.arange(60).astype(q.dtype)))


def test_a_new_target_or_sampling_time_restarts_a_step():
    q = np.asarray(START)
    first = ck.step(LAW, ck.hold(CENTER), q, 0.0, 0.05, "EXP-AB2")
    go = dict(method="EXP-AB2", history=first.history)
    assert not int(ck.step(LAW, ck.hold(CENTER), first.q, 0.05, 0.05, **go).status) & RESTARTED
    assert int(ck.step(LAW, ck.hold(CENTER + 1e-6), first.q, 0.05, 0.05, **go).status) & RESTARTED
    assert int(ck.step(LAW, ck.hold(CENTER), first.q, 0.05, 0.08, **go).status) & RESTARTED


# --- limits -------------------------------------------------------------------------------------------

SPEED, HIGH = 0.9, 0.75
LIMITED = ck.replace(ARM, velocity_limit=(SPEED,) * 3, upper=(10.0, 10.0, HIGH), lower=(-10.0,) * 3)


@pytest.mark.parametrize(
    ("method", "limits"),
    [
        ("EXP-AB3", "bounded"),
        ("AB2", "velocity_scaling"),
        pytest.param("ZNN4", "bounded", marks=pytest.mark.slow),
    ],
)
def test_limits_are_respected_and_drop_the_history(method, limits):
    """Where joints saturate, steps are those of the limited law itself, and the memory grows anew after them."""
    law = ck.Law(LIMITED, ck.position("xy"), alpha=8.0, inverse=ck.damped(1e-3), limits=getattr(ck, limits)())
    run = ck.solve(law, ck.circle(CENTER, 0.2, period=2.0), START, 0.05, 40, method)
    assert np.abs(run.qdot).max() <= SPEED * (1 + 1e-9) and not np.any(np.asarray(run.status) & 16)
    assert np.any(np.asarray(run.status) & RESTARTED) and np.any(np.asarray(run.status) & 4)
    close(run.qdot, np.diff(run.q, axis=0) / 0.05, atol=1e-11)
    if limits != "velocity_scaling":
        assert np.max(run.q[:, 2]) <= HIGH + 1e-12


@pytest.mark.parametrize("limits", [None, pytest.param(ck.velocity_scaling(), marks=pytest.mark.slow)])
def test_null_space_terms(limits):
    """Order 2 of the joint path with a posture, with limits that are never met or none."""
    law = ck.replace(LAW, null_velocity=ck.posture([0.0, -0.5, 0.5], rate=1.0), limits=limits)
    exact = by_steps(law, CIRCLE, START, 1 / 640, 640, "MIDPOINT")[0][-1]
    coarse, fine = (by_steps(law, CIRCLE, START, 1 / N, N, "EXP-AB2")[0][-1] - exact for N in (40, 80))
    assert np.log2(np.linalg.norm(coarse) / np.linalg.norm(fine)) == pytest.approx(2, abs=0.2)
