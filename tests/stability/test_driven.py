"""Linear loops through drives: against closed forms, SciPy, and loops in time."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

import cnclik as ck
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive, sampled
from cnclik.stability import advise, analyse, delay_limit, driven_limits, recommend
from cnclik.stability.driven import (
    damping_ratio,
    delay_margin,
    driven_factors,
    increments,
    least_limits,
    noise_gain,
    noise_limit,
    open_loop,
    overshoot,
    radius,
    respond,
    settling,
)
from cnclik.stability.drives import each_drive, own_drives, side_by_side
from tests.oracles import discrete

Ts = 0.002
SERVO = Drive(natural_frequency=23.25, damping_ratio=2.325, command="position")
DRIVES = {
    "lag": Drive(lag=0.02, delay=1.3),
    "servo": Drive(natural_frequency=60.0, damping_ratio=0.3, delay=2),
    "positions": Drive(natural_frequency=40.0, damping_ratio=0.7, command="position", delay=0.5),
    "rebased": Drive(lag=0.01, command="position", feedback="rebased", delay=1),
}


def steps(z, method="EE"):
    return increments(method, None, np.array([z]))


@pytest.mark.parametrize("d", [0, 1, 2, 5, 17])
def test_pure_dead_time_is_known_on_paper(d):
    """2 sin(π/(2(2d + 1))) and d^d/(d + 1)^(d + 1) (Levin & May 1976); recommended: that of d + 1."""
    found = driven_limits("EE", Ts=Ts, drive=Drive(delay=d))
    assert found.stable == pytest.approx(2 * np.sin(np.pi / (2 * (2 * d + 1))), rel=1e-7)
    assert found.monotone == pytest.approx(float(d) ** d / (d + 1) ** (d + 1), rel=1e-5)
    assert found.recommended == pytest.approx((d + 1.0) ** (d + 1) / (d + 2.0) ** (d + 2), rel=1e-5)
    for method in ("AB2", "EXP-EE", "CN"):
        assert driven_limits(method, ck.chord(1), Ts=Ts, drive=Drive(delay=d)).stable == pytest.approx(
            delay_limit(d, method, ck.chord(1)), rel=1e-6
        )


def test_a_fast_loop_through_a_servo_is_stable_to_twice_its_damping():
    """alpha < 2ζω₀ = k_v/m, by Routh's criterion of s(s² + 2ζω₀ s + ω₀²) + alpha ω₀²."""
    w, zeta = 23.25, 2.325
    # A velocity that is held for a sample comes half a sample late, a position that steps does not.
    for drive, off in ((SERVO, 0.01), (Drive(natural_frequency=w, damping_ratio=zeta), 0.06)):
        for T in (1e-3, 1e-4):
            assert driven_limits("EE", Ts=T, drive=drive).stable / T == pytest.approx(2 * zeta * w, rel=off * T / 1e-3)


def test_half_a_sample_late_is_between():
    """z² − (1 − z/2)… has the product z/2 of its roots: stable to 2; and monotone where its discriminant is 0."""
    found = driven_limits("EE", Ts=Ts, drive=Drive(delay=0.5))
    assert found.stable == pytest.approx(2, rel=1e-7)
    assert found.monotone == pytest.approx(6 - 4 * np.sqrt(2), rel=1e-4)  # (1 − z/2)² = 2z


@pytest.mark.parametrize("name", ["lag", "servo", "positions"])
def test_factors_are_those_of_scipy(name):
    """The loop closed around scipy's zero-order hold, of whole samples of dead time."""
    drive = ck.replace(DRIVES[name], delay=2.0)
    if drive.order == 1:
        a, b = np.array([[0, 1], [0, -1 / 0.02]]), np.array([[0], [1 / 0.02]])
    else:
        w, zeta = float(drive.natural_frequency), float(drive.damping_ratio)
        a, b = np.array([[0, 1], [-w * w, -2 * zeta * w]]), np.array([[0], [w * w]])
        if drive.command == "velocity":
            a = np.block([[np.zeros((1, 1)), np.eye(1, 2)], [np.zeros((2, 1)), a]])
            b = np.vstack([[[0]], b])
    phi, gamma = discrete(a, b, Ts)
    n, z, position = len(phi), 0.3, drive.command == "position"
    loop = np.zeros((n + 2 + position,) * 2)  # x, commands one and two samples old, the sum of the steps
    step = np.zeros(len(loop))
    step[0] = -z
    command = step / Ts
    if position:
        loop[-1, -1] = 1.0
        loop[-1] += step
        command = loop[-1]
    loop[:n, :n], loop[:n, n + 1], loop[n], loop[n + 1, n] = phi, gamma[:, 0], command, 1.0
    found = driven_factors(steps(z), drive, Ts)[0]
    np.testing.assert_allclose(np.sort(np.abs(found)), np.sort(np.abs(np.linalg.eigvals(loop))), atol=1e-6)


SEVERAL = {
    "lag": Drive(lag=np.array([0.02, 0.05, 0.02, 0.01]), delay=1.3),
    "servo": Drive(natural_frequency=np.array([60.0, 30.0]), damping_ratio=np.array([0.3, 0.9]), delay=2),
    "positions": Drive(natural_frequency=np.array([40.0, 25.0]), damping_ratio=0.7, command="position", delay=0.5),
    "rebased": Drive(lag=np.array([0.01, 0.03]), command="position", feedback="rebased", delay=1),
    "commanded": Drive(lag=np.array([0.01, 0.03]), command="position", feedback="commanded", delay=2),
}


@pytest.mark.parametrize(("name", "method"), [*((name, "EE") for name in SEVERAL), ("lag", "AB2")])
def test_several_drives_side_by_side_are_each_by_itself(name, method):
    """Limits and responses, the worst of the joints' drives; a humanoid with one for each took a minute of CPU time."""
    drive, z = SEVERAL[name], np.array([0.002, 0.01, 0.03])
    each, modes, several = each_drive(drive), increments(method, None, z), side_by_side(drive)
    assert len(each) == len(np.unique(drive.lag if drive.order == 1 else drive.natural_frequency))
    found, alone = (responses_of(modes, one) for one in (several, *each[:1]))
    every = [alone, *(responses_of(modes, one) for one in each[1:])]
    for k, pick in enumerate((min, max, max, max, max)):
        assert found[k] == pytest.approx(pick(one[k] for one in every), rel=1e-6, abs=1e-9), k
    limits, those = least_limits(method, None, Ts, drive), [driven_limits(method, Ts=Ts, drive=one) for one in each]
    for what in ("stable", "monotone", "recommended"):
        assert getattr(limits, what) == pytest.approx(min(getattr(one, what) for one in those), rel=2e-4, abs=1e-12), (
            what
        )


def responses_of(modes, drive):
    return (damping_ratio(modes, drive, Ts), overshoot(modes, drive, Ts), settling(modes, drive, Ts),
            *noise_gain(modes, drive, Ts))  # fmt: skip


def in_time(steps, drive, Ts, target, forward=0.0, noise=0.0):
    """A mode (p,) sample by sample, from rest at 0 and at its target for long: motion (N + 1,) and steps (N,)."""
    drive, N = drive.lumped, len(target)
    model, noise = sampled(drive, Ts), np.broadcast_to(noise, N)
    x, sent, line = np.zeros(model.size), np.float64(0.0), (np.float64(0.0),) * model.remembered
    past, q, asked = [-target[0]] * len(steps), np.zeros(N + 1), np.zeros(N)
    for k in range(N):
        seen = sent if drive.feedback == "commanded" else x[0] + noise[k]
        past = [seen - target[k], *past[:-1]]
        asked[k] = np.dot(steps, past) + forward * Ts
        sent = (seen if drive.feedback == "rebased" else sent) + asked[k]
        u = sent if drive.steps_positions else asked[k] / Ts
        x, line = model.moved(x, line, u), (u, *line)[: model.remembered]
        q[k + 1] = x[0]
    return q, asked


@pytest.mark.parametrize(
    ("drive", "method"),
    [
        *((one, "EE") for one in (*DRIVES.values(), *SEVERAL.values())),
        (DRIVES["servo"], "AB2"),
        (SEVERAL["lag"], "AB2"),
    ],
)
def test_responses_are_those_of_a_loop_that_goes_sample_by_sample(drive, method):
    N = 300
    D, t = increments(method, None, np.array([0.01, 0.03])), Ts * np.arange(N)
    cases = (
        ({"target": 1.0}, (np.ones(N),)),
        ({"speed": 1.0, "forward": np.array([1.0, 0.0])}, (t, None)),
        ({"noise": 1.0}, (np.zeros(N), 0.0, np.eye(1, N)[0])),
    )
    for inputs, (target, *others) in cases:
        q, asked = respond(D, side_by_side(drive), Ts, N, **inputs)
        for i, one in enumerate(each_drive(drive)):
            for j in range(2):
                at = (..., i, j) if own_drives(drive) else (..., j)
                wanted = in_time(D[j], one, Ts, target, *([1.0 - j] if others == [None] else others))
                np.testing.assert_allclose(q[at], wanted[0], atol=1e-9)
                np.testing.assert_allclose(asked[at], wanted[1], atol=1e-9)


@pytest.mark.parametrize("name", DRIVES)
def test_limits_are_where_loops_in_time_begin_to_grow(name):
    """Within 1 %, of a robot's whole loop; no overshoot up to the monotone limit, and more beyond."""
    drive = DRIVES[name]
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
    q = np.array([0.3, 1.1])
    x = np.asarray(ck.forward(law.chain, q).position)[:2]
    found = recommend(law, None, q, Ts=Ts, method="EE", drive=drive)
    assert found.z_largest == pytest.approx(driven_limits("EE", Ts=Ts, drive=drive).stable, rel=1e-6)

    def error(z, far=1e-7):
        run = ck.solve(ck.replace(law, alpha=z / Ts), ck.hold(x + np.array([far, 0])), q, Ts, 4000, "EE", drive=drive)
        return np.asarray(run.e)[:, 0] / far

    late = [np.abs(error(s * found.z_largest)[-200:]).max() for s in (0.99, 1.01)]
    middle = [np.abs(error(s * found.z_largest)[1900:2100]).max() for s in (0.99, 1.01)]
    assert late[0] < middle[0] and late[1] > middle[1]
    at_limit, beyond = error(found.z_monotone), error(1.5 * found.z_monotone)
    assert at_limit.min() > -0.0101 and beyond.min() < at_limit.min() - 1e-4


def test_each_joint_may_have_a_drive_of_its_own():
    """Of a square arm with exact J# the worst joint's; with one joint to spare, in time."""
    lags = np.array([0.01, 0.05])
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
    found = recommend(law, None, np.array([0.3, 1.1]), Ts=Ts, method="EE", drive=Drive(lag=lags, delay=3))
    alone = [driven_limits("EE", Ts=Ts, drive=Drive(lag=lag, delay=3)) for lag in lags]
    assert found.z_largest == pytest.approx(min(one.stable for one in alone), rel=1e-5)
    assert found.z_monotone == pytest.approx(min(one.monotone for one in alone), rel=1e-4)
    assert found.z_recommended == pytest.approx(min(one.recommended for one in alone), rel=1e-4)
    arm, q = ck.planar_arm([1.0, 0.8, 0.6]), np.array([0.3, 1.1, -0.4])
    law, drive = ck.Law(arm, ck.position("xy"), alpha=5.0), Drive(lag=np.array([0.01, 0.05, 0.03]), delay=3)
    z = recommend(law, None, q, Ts=Ts, method="EE", drive=drive).z_largest
    x = np.asarray(ck.forward(arm, q).position)[:2]
    for share, grows in ((0.98, False), (1.02, True)):
        law = ck.replace(law, alpha=share * z / Ts)
        e = np.asarray(ck.solve(law, ck.hold(x + np.array([1e-7, 0])), q, Ts, 4000, "EE", drive=drive).e)
        late, middle = (np.abs(e[i : i + 300]).max() for i in (3700, 1850))
        assert (late > middle) == grows


def test_margins_and_noise_are_what_happens():
    """At the delay margin the loop stops being stable; noise moves it as long runs with noise do."""
    for name, z in (("lag", 0.08), ("servo", 0.03), ("positions", 0.04)):
        drive = DRIVES[name]
        D = steps(z)
        more = delay_margin(D, drive, Ts)
        near = [radius(D[None], ck.replace(drive, delay=drive.delay + s * more), Ts)[0] for s in (0.98, 1.02)]
        assert near[0] < 1 < near[1], name
        motion, speed = noise_gain(D, drive, Ts)
        noise = np.random.default_rng(0).normal(size=20_000)
        q, asked = in_time(D[0], drive, Ts, np.zeros(20_000), noise=noise)
        assert np.std(q) == pytest.approx(motion, rel=0.15) and np.std(asked) / Ts == pytest.approx(speed, rel=0.1)
    assert noise_gain(steps(0.5), Drive(), Ts)[0] == pytest.approx(np.sqrt(0.5 / 1.5), rel=1e-3)
    assert noise_limit(0.5, Drive(), Ts) == pytest.approx(2 * 0.25 / 1.25, rel=1e-3)
    assert delay_margin(steps(0.25), Drive(), Ts) == pytest.approx((np.pi / np.arcsin(0.125) / 2 - 1) / 2, rel=0.01)
    assert np.abs(open_loop(steps(0.5)[0], Drive(), Ts, np.array([np.pi]))) == pytest.approx(0.25)


@settings(max_examples=40, deadline=None)
@given(
    z=st.floats(0.005, 1.5),
    delay=st.floats(0, 6),
    lag=st.floats(0.2, 20),
    kind=st.sampled_from(["none", "lag", "servo", "positions", "rebased"]),
)
def test_what_factors_say_happens(z, delay, lag, kind):
    """Of any drive: a response grows where the largest factor is above 1, and else falls as that factor does."""
    made = {
        "none": {},
        "lag": {"lag": lag * Ts},
        "servo": {"natural_frequency": 1 / (lag * Ts), "damping_ratio": 0.6},
        "positions": {"natural_frequency": 1 / (lag * Ts), "damping_ratio": 0.9, "command": "position"},
        "rebased": {"lag": lag * Ts, "command": "position", "feedback": "rebased"},
    }[kind]
    drive = Drive(delay=round(delay, 1), **made)
    size = float(np.abs(driven_factors(steps(z), drive, Ts)).max())
    e = np.abs(respond(steps(z), drive, Ts, 3000, target=1.0)[0][:, 0] - 1)
    if size > 1.01:
        assert not e[-1] < e[:100].max()
    elif size < 0.99:
        first, last = (np.log(np.maximum(e[k : k + 200].max(), 1e-300)) for k in (300, 600))
        assert e[-200:].max() < 1e-9 or last < first
        if last > np.log(1e-12):
            assert (last - first) / 300 == pytest.approx(np.log(size), abs=0.02)
    ratio = damping_ratio(steps(z), drive, Ts)
    assert ratio <= 1 and (ratio > 0) == (size < 1)


def test_a_loop_that_looks_at_its_own_commands_knows_no_drive():
    own = ck.replace(SERVO, feedback="commanded")
    found = driven_limits("EE", Ts=Ts, drive=own)
    assert (found.stable, found.monotone, found.recommended) == pytest.approx((2, 1, 0.25), rel=1e-6)
    assert delay_margin(steps(0.25), own, Ts) == np.inf and noise_gain(steps(0.25), own, Ts)[0] == 0


def test_what_advice_says_of_a_gain_is_what_it_does():
    """Lag behind a ramp, overshoot, settling time: of a whole loop in time."""
    arm, q = ck.planar_arm([1.0, 0.8]), np.array([0.3, 1.1])
    law, drive = ck.Law(arm, ck.position("xy"), alpha=12.0), Drive(lag=0.02, delay=3)
    said = advise(law, None, q, Ts=0.01, method="EE", drive=drive, speed=0.2)
    x, now = np.asarray(ck.forward(arm, q).position)[:2], said.now
    path = ck.line(x, x + np.array([0.2, 0.0]), duration=2.0)
    for factor, name in ((0.0, "lag"), (1.0, "lag_fed_forward")):
        run = ck.solve(ck.replace(law, feedforward=factor), path, q, 0.01, 200, "EE", drive=drive)
        assert run.e[-1, 0] / 0.1 == pytest.approx(getattr(now, name), abs=2e-3), name
    assert np.abs(run.e[:, 0]).max() / 0.1 == pytest.approx(now.start_error, rel=0.02)
    e = np.asarray(ck.solve(law, ck.hold(x + np.array([1e-6, 0])), q, 0.01, 200, "EE", drive=drive).e)[:, 0] / 1e-6
    assert -e.min() == pytest.approx(now.overshoot, abs=1e-3) and now.overshoot > 0.05
    assert np.flatnonzero(np.abs(e) > 0.02)[-1] * 0.01 == pytest.approx(now.settling_time, abs=0.011)
    assert f"\nalpha recommended {said.recommended_alpha:.4g} 1/s (without overshoot to " in f"\n{said}"
    assert "(without overshoot at any gain, stable at any gain, if drives had" in str(advise(law, None, q, Ts=0.01))
    assert said.recommended.overshoot < 0.01 and said.recommended_alpha < said.fastest_monotone_alpha
    J = np.asarray(ck.jacobian(arm, q))[:2]
    assert np.isnan(said.joint_speed) and said.analysis.times is None and np.linalg.cond(J) < 10


def test_one_line_for_what_can_not_be_asked():
    law = ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=5.0)
    q = np.array([0.3, 1.1])
    with pytest.raises(ArgumentError, match="`Ts` must be given where there is a drive"):
        recommend(law, None, q, drive=Drive(delay=1))
    with pytest.raises(ArgumentError, match="`drive` must be one for all joints"):
        driven_limits("EE", Ts=Ts, drive=Drive(lag=np.ones(2)))
    with pytest.raises(ArgumentError, match="`speed` must be at least 0"):
        advise(law, None, q, Ts=Ts, speed=-1)
    with pytest.raises(ArgumentError, match=r"`lag` must have shape \(2,\)"):
        analyse(law, None, q, Ts=Ts, drive=Drive(lag=np.ones(3)))
    assert settling(steps(2.5), Drive(), Ts) == np.inf and overshoot(steps(1.5), Drive(), Ts) == pytest.approx(0.5)


def test_a_rounding_beside_real_modes_changes_no_overshoot():
    """The slowest mode was then taken for the one that swings most: 0 where another lands twice as far."""
    modes, drive = np.array([[-0.232], [-0.232], [-4e-4]]), Drive(delay=4.0, lag=0.06)
    plain = overshoot(modes, drive, 0.004)
    assert plain > 0.99 and overshoot(modes + 1e-16j, drive, 0.004) == pytest.approx(plain, rel=1e-9)
