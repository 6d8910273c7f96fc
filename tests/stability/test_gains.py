"""Gains: against closed forms, SciPy, loops in time, true maps written apart (`plant`), and the site's calculator."""

import dataclasses
import json
import pathlib
import shutil
import subprocess

import numpy as np
import pytest
import scipy.linalg

import cnclik as ck
from cnclik.integrate.drive import Drive
from cnclik.stability.gain import gain_table, limits, mixed_share, stable_share
from cnclik.stability.linear import gain_removing, removed
from cnclik.stability.poles import scalar_loop, within
from tests.refusals import refusals
from tests.stability import plant

Ts = 0.002
CASES = [(name, M) for name, m in ck.METHODS.items() for M in ((2, 5, None) if m.implicit else (None,))]
DRIVES = {
    "ideal": Drive(),
    "dead time": Drive(delay=3),
    "fractions": Drive(delay=2.5, measurement_delay=1),
    "lag": Drive(lag=0.02, delay=1.3),
    "servo": Drive(natural_frequency=60.0, damping_ratio=0.3, delay=2),
    "positions": Drive(natural_frequency=40.0, damping_ratio=0.7, command="position", delay=0.5),
    "rebased": Drive(lag=0.01, command="position", feedback="rebased", delay=1),
    "commanded": Drive(natural_frequency=40.0, damping_ratio=0.7, command="position", feedback="commanded"),
    "error filter": Drive(delay=2, lag=0.03, smoothing=0.6),
    "command filter": Drive(delay=1, natural_frequency=50.0, command="position", smoothing=0.6, smoothed="command"),
    "own commands, filter": Drive(delay=2, lag=0.03, feedback="commanded", smoothing=0.6),
    "target filter": Drive(delay=2, cutoff=10.0, smoothed="target"),
}


@pytest.mark.parametrize("d", [0, 1, 2, 5, 17])
def test_pure_dead_time_is_known_on_paper(d):
    """2 sin(π/(2(2d + 1))) and d^d/(d + 1)^(d + 1) (Levin & May 1976; Ladas, Philos & Sficas 1989)."""
    found = ck.gains(Ts=Ts, drive=Drive(delay=d), method="EE")
    assert found.largest_stable * Ts == pytest.approx(2 * np.sin(np.pi / (2 * (2 * d + 1))), rel=1e-12)
    assert found.without_overshoot * Ts == pytest.approx(float(d) ** d / (d + 1) ** (d + 1), rel=1e-12)
    assert found.recommended * Ts == pytest.approx((d + 1.0) ** (d + 1) / (d + 2.0) ** (d + 2), rel=1e-12)
    exponential = ck.gains(Ts=Ts, drive=Drive(delay=d), method="EXP-EE")
    share = found.largest_stable * Ts
    assert exponential.largest_stable * Ts == pytest.approx(-np.log1p(-share) if share < 1 else np.inf, rel=1e-9)


def test_a_fast_loop_through_a_servo_is_stable_to_twice_its_damping():
    """alpha < 2ζω₀ = k_v/m, by Routh's criterion of s(s² + 2ζω₀ s + ω₀²) + alpha ω₀²."""
    w, zeta = 23.25, 0.6
    for drive, off in ((Drive(natural_frequency=w, damping_ratio=zeta, command="position"), 2e-3),
                       (Drive(natural_frequency=w, damping_ratio=zeta), 4e-3)):  # fmt: skip
        assert ck.gains(Ts=1e-4, drive=drive).largest_stable == pytest.approx(2 * zeta * w, rel=off)


@pytest.mark.parametrize("name", DRIVES)
def test_every_method_and_drive_has_the_limits_of_its_true_map(name):
    """One joint: the map written apart is stable just below the limit, and not just above; a run passes by 1 %."""
    drive = DRIVES[name]
    inside = within(drive) if drive.filters != "target" else dataclasses.replace(drive, cutoff=None)
    shares = limits(drive, Ts)

    def radius(method, M, z):
        S = np.array([[np.exp(-z) if method.startswith("EXP") else plant.march(method, M, 1.0, np.array([[z]]))[0, 0]]])
        return plant.radius(S, [inside], Ts)

    for k, (method, M) in enumerate(CASES):
        stable, smooth = (min(share and gain_removing(share, method, M), 1e3) for share in shares[:2])
        if k % len(DRIVES) == list(DRIVES).index(name):
            own = ck.gains(Ts=Ts, drive=drive, method=method, M=M)
            assert min(own.largest_stable * Ts, 1e3) == pytest.approx(stable, rel=1e-12)
            assert min(own.without_overshoot * Ts, 1e3) == pytest.approx(smooth, rel=1e-12)
        for z in (0.999 * stable, 0.5 * stable, 0.01 * stable):
            assert radius(method, M, z) < 1 + 1e-9, (method, M)
        if stable < 1e3:
            assert radius(method, M, 1.001 * stable) > 1, (method, M)
    loop = scalar_loop(drive, Ts)
    matrix, x, worst = loop.matrix(float(removed("EE", 0.999 * shares[1]))), loop.displaced, 0.0
    for _ in range(4000):  # the motion, sample by sample
        x = matrix @ x
        worst = max(worst, -float(loop.q @ x))
    assert worst <= 0.0101


@pytest.mark.parametrize("name", [n for n in DRIVES if DRIVES[n].order < 2 and not DRIVES[n].filters])
def test_margins_are_those_of_scipy(name):
    """The loop gain at SciPy's frequencies; noise by SciPy's Lyapunov solution."""
    drive = DRIVES[name]
    loop, s = scalar_loop(drive, Ts), 0.02
    import scipy.signal  # takes as long as half of the package, and is of no other test

    system = scipy.signal.StateSpace(loop.A, loop.b[:, None], loop.C[None], np.zeros((1, 1)), dt=Ts)
    w = np.geomspace(1e-3, np.pi, 50)
    _, response = scipy.signal.dfreqresp(system, w)
    np.testing.assert_allclose(response, loop.unit_gain(np.exp(1j * w)), rtol=1e-8, atol=1e-12 / s)
    noisy = loop.disturbed - s * loop.b
    P = scipy.linalg.solve_discrete_lyapunov(loop.matrix(s), np.outer(noisy, noisy))
    found = ck.gains(Ts=Ts, drive=drive, method="EE").at(s / Ts)
    assert found.noise_gain == pytest.approx(np.sqrt(loop.q @ P @ loop.q), rel=1e-5)
    assert found.velocity_noise_gain == pytest.approx(s / Ts * np.sqrt(1 + loop.C @ P @ loop.C), rel=1e-5)
    if drive.feedback == "measured":  # an integrator: a ramp's error is its speed over the gain, 0 with feed-forward
        assert found.lag == pytest.approx(Ts / s, rel=1e-5) and found.lag_fed_forward == 0
        later = dataclasses.replace(drive, delay=drive.delay + found.delay_margin / Ts)
        assert stable_share(later, Ts) == pytest.approx(s, rel=1e-4)


@pytest.mark.parametrize("smoothed", ["", "error", "command"])
def test_a_response_is_that_of_a_run(smoothed):
    """The step of a planar arm through a servo with dead time, in time: overshoot and settling time."""
    arm, filters = ck.planar_arm([1.0, 1.0]), {"smoothing": 0.6, "smoothed": smoothed} if smoothed else {}
    drive = Drive(delay=3, natural_frequency=40.0, damping_ratio=0.8, command="position", **filters)
    found = ck.gains(Ts=0.01, drive=drive)
    alpha = 2.0 * found.without_overshoot
    q0, step = np.array([0.3, 1.2]), 1e-5
    law = ck.Law(arm, ck.joints(), alpha=alpha)
    run = ck.solve(law, ck.hold(values=q0 + np.array([step, 0.0])), q0, 0.01, 400, drive=drive)
    away = np.asarray(run.e, float)[:, 0] / step
    predicted = found.at(alpha)
    assert -away.min() == pytest.approx(predicted.overshoot, abs=2e-3)
    settled = np.flatnonzero(np.abs(away) > 0.02)[-1] + 1
    assert settled * 0.01 == pytest.approx(predicted.settling_time, abs=0.011)


def test_a_pole_that_rounds_to_1_is_damped():
    """A gain so small that a step hardly moves: ζ was nan or −1."""
    found = ck.gains(Ts=0.01, drive=Drive(delay=3))
    for alpha in (1e-300, 1e-20, 1e-15):
        assert found.at(alpha).damping_ratio == 1


def test_a_response_waits_for_a_filter_outside_of_the_loop():
    """On its own commands: the robot lags by d + ρ/(1 − ρ) samples, and was said never to settle."""
    drive = Drive(delay=2, smoothing=0.97, smoothed="command", feedback="commanded")
    found = ck.gains(Ts=0.01, drive=drive).response
    assert found.lag_fed_forward == pytest.approx(0.01 * (2 + 0.97 / 0.03), rel=1e-5)
    assert found.settling_time == pytest.approx(1.34, abs=0.011)


def test_a_response_goes_on_until_a_slow_loop_has_settled():
    """At 10 kHz a lag of 200 ms: a ramp's error is its speed over the gain, and the step settles like (1 + x) e^−x."""
    found = ck.gains(Ts=1e-4, drive=Drive(lag=0.2), method="EE")
    assert found.response.lag == pytest.approx(1 / found.recommended, rel=1e-4)
    assert found.response.settling_time == pytest.approx(5.834 * 0.4, rel=1e-3)


def test_a_step_and_a_ramp_come_late_through_a_filter_of_the_target():
    """A run of solve: settling in 0.45 s without overshoot, and 50.354 ms behind a ramp with feed-forward at most."""
    servo = dict(delay=2, natural_frequency=40.0, damping_ratio=0.7, command="position")
    found = ck.gains(Ts=0.01, drive=Drive(**servo, smoothing=0.6, smoothed="target")).response
    assert (found.settling_time, found.start_error) == pytest.approx((0.45, 0.050354), rel=1e-4)
    slow = ck.gains(Ts=0.01, drive=Drive(delay=2, smoothing=0.97, smoothed="target")).response
    assert slow.settling_time == pytest.approx(1.38, abs=0.011) and slow.start_error >= 0.999 * slow.lag_fed_forward
    late = ck.gains(Ts=0.01, drive=Drive(delay=2, measurement_delay=4)).response  # which feed-forward does not wait for
    assert late.start_error == pytest.approx(0.02)


def test_no_more_than_one_per_cent_is_passed_without_overshoot():
    """A servo outside of the loop may overshoot by itself: the motion counts, not the commands."""
    servo = Drive(delay=10, natural_frequency=16.4, damping_ratio=0.4, command="position", feedback="commanded")
    for method in ("EE", "EXP-MIDPOINT"):
        found = ck.gains(Ts=Ts, drive=servo, method=method)
        assert found.response.overshoot <= 0.0101 and 5 < found.recommended < 15


def test_on_its_own_commands_a_loop_waits_for_no_measurement():
    late = Drive(delay=2, measurement_delay=3, lag=0.03, feedback="commanded")
    found, prompt = (ck.gains(Ts=0.01, drive=drive) for drive in (late, ck.replace(late, measurement_delay=0)))
    assert found.response == prompt.response and found.reason == prompt.reason
    late, prompt = (ck.gains(Ts=0.01, drive=ck.replace(one.drive, command="position")) for one in (found, prompt))
    assert late.elsewhere["UR servoj"].value < prompt.elsewhere["UR servoj"].value  # which measures


# --- the theorem: random loops of random robots --------------------------------------------------------


def drawn_drive(rng):
    numbers = dict(delay=float(rng.choice([0, 0, 1, 2, 0.4, 2.5, 3])), measurement_delay=int(rng.choice([0, 0, 1])))
    kind = rng.integers(6)
    if kind in (1, 3):
        numbers |= dict(lag=float(10 ** rng.uniform(-2.3, -0.7)))
    if kind in (2, 4, 5):
        numbers |= dict(natural_frequency=float(10 ** rng.uniform(0.9, 2.1)))
        numbers |= dict(damping_ratio=float(rng.uniform(0.25, 1.4)))
    if kind in (3, 4):
        numbers |= dict(command="position")
    if kind == 5:
        numbers |= dict(command="position", feedback=str(rng.choice(["rebased", "commanded"])))
    if rng.random() < 0.25:
        numbers |= dict(smoothing=float(rng.uniform(0.1, 0.9)), smoothed=str(rng.choice(["error", "command"])))
    if numbers.get("feedback") == "commanded":
        numbers.pop("smoothed", None)
    if numbers.get("feedback") == "rebased":
        numbers["delay"] += numbers.pop("measurement_delay")
    return Drive(**numbers)


def drawn_rates(rng, jacobian, task):
    """(M = J#KJ + (I − J#J) k of a random inverse, its largest rate): weights, levels, limits and a posture term."""
    weights = 10 ** rng.uniform(-1, 1, 2)[task] if rng.random() < 0.5 else np.ones(len(jacobian))
    J, n = weights[:, None] * jacobian, jacobian.shape[1]
    kind = rng.choice(["exact", "damped", "levels"])
    gain = np.ones(len(J)) if rng.random() < 0.3 else np.maximum(10 ** rng.uniform(-1.5, 0, 2), 0.01)[task]
    if rng.random() < 0.2 and kind != "exact":  # joints held by their limits: rows of the first level with their rate
        some = rng.choice(n, rng.integers(1, 3), replace=False)
        J = np.vstack([1e3 * np.eye(n)[some], J])
        gain, task = np.r_[np.full(len(some), rng.uniform(0.05, 1)), gain], np.r_[np.full(len(some), 0), task]
    if kind == "exact":
        inverse = np.linalg.pinv(J)
    else:
        levels = np.sort(10 ** rng.uniform(-3, -0.3, 2))[task]
        damping = np.full(len(J), rng.uniform(0.01, 0.5)) if kind == "damped" else levels
        inverse = J.T @ np.linalg.inv(J @ J.T + np.diag(damping**2))
    posture = rng.uniform(0.02, 1) if rng.random() < 0.35 else 0.0
    M = inverse @ (gain[:, None] * J) + posture * (np.eye(n) - inverse @ J)
    return M, max(gain.max(), posture)


def step_map(method, passes, M, z, Ts):
    """What a step of a method does to the joints with rates z M/Ts."""
    return scipy.linalg.expm(-z * M) if method.startswith("EXP") else plant.march(method, passes, Ts, z / Ts * M)


@pytest.mark.parametrize("seed", range(3))
def test_no_random_loop_is_unstable_below_the_scalar_limit(seed):
    """Robots, postures, weights, levels, dampings, gains, postures, held joints, methods and drives at random."""
    rng, Ts = np.random.default_rng(100 + seed), 0.01
    for i in range(25):
        jacobian, task = plant.jacobian(plant.ROBOTS[i % len(plant.ROBOTS)], rng)
        M, largest = drawn_rates(rng, jacobian, task)
        drive = drawn_drive(rng)
        method, passes = CASES[rng.integers(len(CASES))]
        share = stable_share(drive, Ts)
        if share == 0:  # rebased servos that swing at any small gain
            continue
        z = min(gain_removing(share, method, passes), 50.0)
        S = step_map(method, passes, M / largest, 0.99 * z, Ts)
        assert plant.radius(S, [drive] * len(M), Ts) < 1 + 1e-6, (i, method, passes, drive)


def test_a_recommended_gain_is_no_larger_than_what_removes_the_most():
    """Of IE with M passes 1 − R = z (1 − (−z)^(M + 1))/(1 + z): with odd M 0 at z = 1, which was recommended."""
    slow = Drive(lag=0.1, command="position", feedback="rebased")
    for drive, M, most in ((Drive(), 1, 0.5), (slow, 5, 0.66980)):
        found = ck.gains(Ts=0.01, drive=drive, method="IE", M=M)
        assert found.recommended * 0.01 == pytest.approx(most, abs=1e-3) and "the most" in found.reason
        assert found.response.settling_time < 2.0


def test_joints_with_different_drives():
    """One gain: the hull holds for every robot, and "the slowest is safe" does not."""
    rng, Ts = np.random.default_rng(3), 0.01
    for i in range(12):
        late = float(rng.choice([0, 1, 2, 3.5]))
        drives = [Drive(delay=late, lag=float(10 ** rng.uniform(-2.3, -0.7))) for _ in range(3)]
        jacobian, _ = plant.jacobian(plant.ROBOTS[i % len(plant.ROBOTS)], rng)
        n = jacobian.shape[1]
        kinds = rng.integers(3, size=n)
        each, share = [drives[k] for k in kinds], mixed_share([drives[k] for k in np.unique(kinds)], Ts)
        P = np.linalg.pinv(jacobian) @ jacobian
        assert plant.radius(np.eye(n) - 0.99 * share * P, each, Ts) < 1 + 1e-7
    several = ck.gains(Ts=Ts, drive=Drive(delay=2, lag=[0.2, 0.02, 0.02]))
    slowest = ck.gains(Ts=Ts, drive=Drive(delay=2, lag=0.2))
    assert several.recommended == slowest.recommended
    assert several.largest_stable == pytest.approx(slowest.largest_stable)
    assert len(several.drive.joints) == 2
    assert "a lag of 20 to 200 ms" in str(several)
    pair = Drive(delay=2, lag=0.05), Drive(delay=2, lag=0.2, feedback="commanded")  # together worse than alone
    one, other = (scalar_loop(drive, Ts).unit_gain(np.exp(1j * np.linspace(0.1, 1, 2000))) for drive in pair)
    part, share = np.linspace(0, 1, 401)[:, None], mixed_share(pair, Ts)
    away = [np.abs(1 + s * share * (part * one + (1 - part) * other)).min() for s in (0.9, 1.0)]
    assert share < 0.96 * min(stable_share(drive, Ts) for drive in pair) and away[1] < 2e-3 < 0.03 < away[0]
    outside = Drive(delay=2, lag=[0.2, 0.02], feedback="commanded")  # of a loop on its own commands drives are no part
    assert ck.gains(Ts=Ts, drive=outside, method="EE").largest_stable == pytest.approx(2 / Ts)


# --- what is said ------------------------------------------------------------------------------------------


def test_a_filter_lowers_gains_but_not_of_the_target():
    """10 ms of dead time at 4 ms, EXP: 24 1/s without a filter; 18.2, 9.97 and 5.58 with ρ = 0.5, 0.8, 0.9."""

    def recommended(**filters):
        return ck.gains(Ts=0.004, drive=Drive(delay=2.5, **filters)).recommended

    for kept, expected in ((0.0, 24), (0.5, 18.2), (0.8, 9.97), (0.9, 5.58)):
        assert recommended(smoothing=kept) == pytest.approx(expected, rel=0.01)
        assert recommended(smoothing=kept, smoothed="command") == pytest.approx(expected, rel=0.01)
    assert recommended(smoothing=0.9, smoothed="target") == recommended()
    kept = np.exp(-2 * np.pi * 20.0 * 0.004)
    assert recommended(cutoff=20.0) == pytest.approx(recommended(smoothing=kept), rel=1e-12)
    target = ck.gains(Ts=0.004, drive=Drive(delay=2.5, smoothing=0.9, smoothed="target")).response
    assert target.lag_fed_forward == pytest.approx(0.01 * 0 + 0.004 * 0.9 / 0.1, rel=1e-9)


def test_a_table_holds_the_gains_of_its_cells():
    drive = Drive(lag=0.05, measurement_delay=3)  # whose dead time gives way to that of the table
    data = gain_table(Ts=[0.002, 0.01], dead_time=[0.0, 0.01, 0.02], drive=drive)
    assert data.recommended.dims == ("Ts", "dead_time") and data.recommended.attrs["units"] == "1/s"
    cell = ck.gains(Ts=0.01, drive=Drive(delay=2, lag=0.05))
    assert float(data.recommended.sel(Ts=0.01, dead_time=0.02)) == cell.recommended
    assert float(data.largest_stable.sel(Ts=0.01, dead_time=0.02)) == cell.largest_stable


def test_the_same_loop_elsewhere():
    found = ck.gains(Ts=0.002, drive=Drive(delay=17)).elsewhere
    assert found["pink"].value == found["mink"].value == found["Placo"].value == pytest.approx(0.01989, rel=1e-3)
    assert found["MoveIt Servo"].value == pytest.approx(found["pink"].value / 0.002)
    assert found["Isaac Lab"].value is None and "identify" in found["Isaac Lab"].meaning
    servo = ck.gains(Ts=0.02, drive=Drive(natural_frequency=20.0, damping_ratio=1.0, command="position")).elsewhere
    assert 0 < servo["Isaac Lab"].value <= 1 and servo["UR servoj"].value > 0
    unknown, late = (ck.gains(Ts=0.02, drive=drive).elsewhere["UR servoj"] for drive in (None, Drive(delay=1.5)))
    assert unknown == late  # the look-ahead stands for the lag that is assumed
    rate = ck.gains(Ts=0.02, drive=Drive(lag=0.1)).elsewhere
    assert rate["UR servoj"].value is None and rate["Isaac Lab"].value is None


def test_rebased_servos_that_run_away_are_refused():
    """Unstable at any small gain from τ = (2π − arccos(4ζ² − 1))/(ω₀√(2 − 4ζ²)) of dead time on."""
    w, zeta = 10.0, 0.2
    late = (2 * np.pi - np.arccos(4 * zeta**2 - 1)) / (w * np.sqrt(2 - 4 * zeta**2))

    def of(samples):
        drive = Drive(delay=samples, natural_frequency=w, damping_ratio=zeta, command="position", feedback="rebased")
        return ck.gains(Ts=0.01, drive=drive)

    assert stable_share(of(late / 0.01 + 1).drive, 0.01) == 0 < stable_share(of(late / 0.01 - 2).drive, 0.01)
    refused = of(late / 0.01 + 1)
    assert refused.recommended == 0 and refused.response is None and "measured joints" in refused.reason
    assert "no gain" not in ck.gains(Ts=0.01, drive=DRIVES["rebased"]).reason


test_bad_input_is_named = refusals(
    (lambda: ck.gains(Ts=0.0), "`Ts` must be positive"),
    (lambda: ck.gains(Ts=1e308), "`Ts` must be within ±1e\\+12, but reaches 1e\\+308"),
    (lambda: ck.gains(Ts="4ms"), r"`Ts` must be a number, but is '4ms'"),
    (lambda: ck.gains(Ts=0.01, drive=0.03), r"`drive` must be Drive\(\.\.\.\)"),
    (lambda: ck.gains(Ts=0.01, method="EEE"), "`method` must be one of"),
    (lambda: ck.gains(Ts=0.01, method="IE", M=-1), "`M` must be at least 0"),
    (lambda: ck.gains(Ts=0.01).at(0.0), "`alpha` must be positive"),
    (lambda: gain_table(Ts=[0.01], dead_time=[0.0], drive=None), "`drive` must be Drive"),
    (lambda: gain_table(Ts=[], dead_time=[0.0]), "`Ts` must hold numbers, but is empty"),
    (lambda: ck.gains(Ts=1e-4), "`drive` must be given, such as a delay: .* but is unknown, with a Ts of 0.1 ms"),
    (lambda: Drive(smoothing=-0.1), "`smoothing` must be at least 0"),
    (lambda: Drive(cutoff=0.0), "`cutoff` must be positive"),
)


def test_a_search_may_meet_a_pole_of_the_drive():
    servo = dict(delay=3, command="position", feedback="rebased")
    near, exact = (ck.gains(Ts=0.01, drive=Drive(natural_frequency=w, **servo)) for w in (20.0001, 20.0))
    assert exact.without_overshoot == pytest.approx(near.without_overshoot, rel=1e-3)
    assert exact.recommended == pytest.approx(near.recommended, rel=1e-3)


SCRIPT = pathlib.Path(__file__).parents[2] / "docs" / "_static" / "calculator.js"
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PAGE = """<!doctype html><meta charset="utf-8"><pre id="out"></pre><script src="{script}"></script><script>
const rows = {loops}.map(([drive, Ts, method, M], i) => {{
  const found = cnclik.gains(drive, Ts, method, M), z = found.recommended;
  const did = z ? cnclik.response(drive, Ts, z, method, M) : {{ settling: 0, overshoot: 0 }};
  const tools = i < 10 ? Object.values(cnclik.elsewhere(drive, Ts)) : [];  // it searches four loops more
  return [found.stable, found.smooth, z, did.settling, did.overshoot, ...tools];
}});
document.getElementById("out").textContent = JSON.stringify(rows, (_, x) => (x === Infinity ? "inf" : x));
</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_the_page_answers_as_gains_does(tmp_path):
    rng, loops, wanted = np.random.default_rng(20261129), [], []
    names = dict(natural_frequency="frequency", damping_ratio="damping")
    rest = dict(lag=0, frequency=0, damping=1, command="velocity", feedback="measured", smoothing=0, smoothed="error")
    cases = [case for case in CASES if case[0] in ("EE", "IE", "CN", "TRAPEZOID", "RK4", "EXP-MIDPOINT")]
    for _ in range(32):
        drive, Ts, (method, M) = drawn_drive(rng).lumped, 10 ** rng.uniform(-3, -1.2), cases[rng.integers(len(cases))]
        late = dict(delay=min(rng.uniform(0, 0.05) / Ts, 60.0)) if rng.random() < 0.3 else {}
        filters = dict(smoothing=0.7, smoothed="target") if rng.random() < 0.1 else {}
        drive = dataclasses.replace(drive, **late, **filters)
        found = ck.gains(Ts=Ts, drive=drive, method=method, M=M)
        elsewhere = {name: one.value or 0.0 for name, one in (found.elsewhere if len(loops) < 10 else {}).items()}
        did = (found.response.settling_time, found.response.overshoot) if found.response else (0, 0)
        tools = [elsewhere[name] for name in ("pink", "Placo", "MoveIt Servo", "Isaac Lab", "UR servoj") if elsewhere]
        wanted.append([found.largest_stable, found.without_overshoot, found.recommended, *did, *tools])
        given = {names.get(k, k): v for k, v in vars(drive).items() if v is not None}
        loops.append([rest | {k: v if isinstance(v, str) else float(v) for k, v in given.items()}, Ts, method, M])
    page = tmp_path / "page.html"
    page.write_text(PAGE.format(script=SCRIPT.as_uri(), loops=json.dumps(loops)), encoding="utf-8")
    flags = ("--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=600000", "--dump-dom")
    text = subprocess.run(
        [CHROMIUM, *flags, page.as_uri()], capture_output=True, text=True, timeout=300, check=True
    ).stdout
    rows = json.loads(text.split('<pre id="out">')[1].split("</pre>")[0])
    for row, numbers in zip(rows, wanted, strict=True):
        np.testing.assert_allclose([0.0 if x is None else float(x) for x in row], numbers, rtol=1e-6, atol=1e-9)


@pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")
def test_the_page_refuses_what_it_cannot_answer():
    """At 5 kHz a servo of 5 rad/s had "none"; of 150 samples of dead time it answered for 100."""
    loops = [dict(delay=d, frequency=w, damping=0.7, smoothed="none") for d, w in ((0.5, 5), (150, 10), (0.5, 10))]
    page = f"globalThis.document = {{ querySelectorAll: () => [] }};\n{SCRIPT.read_text(encoding='utf-8')}"
    ask = f"{json.dumps(loops)}.map((d) => cnclik.refusal(d, 2e-4) || cnclik.gains(d, 2e-4).recommended)"
    run = ["node", "-e", f"{page}\nconsole.log(JSON.stringify({ask}))"]
    slow, late, gain = json.loads(subprocess.run(run, capture_output=True, text=True, check=True).stdout)
    drive = Drive(delay=0.5, natural_frequency=10.0, damping_ratio=0.7)
    assert "slow" in slow and "100 samples" in late
    assert gain == pytest.approx(ck.gains(Ts=2e-4, drive=drive).recommended, rel=1e-4)
