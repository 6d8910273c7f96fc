"""What is read from a recording is what was put into it: gain, dead time, and whether it rings at all."""

import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest
from cnclik.stability.driven import driven_limits
from tests.stability.test_driven import in_time

import cnclik as ck
from cnclik.diagnosis import Kind, diagnose, diagnose_tasks, fit_drive
from cnclik.diagnosis.advice import limits_of
from cnclik.diagnosis.blocks import orthogonal, triangle
from cnclik.diagnosis.calm import is_as_large
from cnclik.diagnosis.late import LateLoop
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from tests.diagnosis.logs import late_loop
from tests.diagnosis.recordings import loop, monotone, servo, stable

TS = 0.002
ROOT = pathlib.Path(__file__).parents[2]


def slow(*values):
    return [pytest.param(v, marks=pytest.mark.slow) for v in values]


def about(found, z, d):
    return found.rings and found.delay == d and abs(found.z / z - 1) < 0.05


@pytest.mark.parametrize("d", [0, 2, 7, *slow(1, 3, 4, 5, 6, 8)])
def test_gain_and_dead_time_of_loops_that_ring(d):
    """23 loops of each dead time, 207 in all, half of them with noise of 1 % of the first error."""
    rng = np.random.default_rng(d)
    low, high = max(1.6 * monotone(d), 1.15 * (d == 0)), 1.03 * stable(d)
    wrong = []
    for i, z in enumerate(rng.uniform(low, high, 23)):
        e = loop(z, d, 160)
        y = rng.choice([-1, 1]) * rng.uniform(0.1, 2) * e + rng.uniform(-2, 2)
        y = y + (i % 2) * 0.01 * np.ptp(y[: d + 4]) / np.ptp(e[: d + 4]) * rng.standard_normal(len(y))
        found = diagnose(y, TS)
        if not about(found, z, d):
            wrong.append((z, i % 2, found.kind, found.delay, found.z))
    assert not wrong


@pytest.mark.parametrize("d", [1, *slow(0, 3, 7)])
def test_what_surrounds_the_ringing_does_not_matter(d):
    """A drift, a slow path, rest before the step of a target, several joints, a column that stands still."""
    rng = np.random.default_rng(100 + d)
    z = 0.9 * stable(d)
    e, t = loop(z, d, 300), np.arange(300.0)
    assert about(diagnose(0.1 * e + 1.5 - 0.002 * t, TS), z, d)
    late = np.concatenate([np.zeros(40), 1 - e])
    assert about(diagnose(late + 0.005 * rng.standard_normal(len(late)), TS), z, d)
    e = loop(0.97 * stable(d), d, 1200)
    path = np.sin(2 * np.pi * np.arange(1200) / 700) + 0.3 * np.cos(2 * np.pi * np.arange(1200) / 431)
    assert about(diagnose(path + 0.2 * e + 0.001 * rng.standard_normal(1200), TS), 0.97 * stable(d), d)
    joints = np.stack([0.3 * e + 1, -0.1 * e - 2, np.full(1200, 0.7), 0.02 * e], 1)
    joints[:, [0, 1, 3]] += 0.002 * rng.standard_normal((1200, 3))
    found = diagnose(joints, TS)
    assert about(found, 0.97 * stable(d), d)
    assert found.amplitude[0] > found.amplitude[1] > found.amplitude[3] > found.amplitude[2] == 0


def test_the_unit_of_a_recording_does_not_matter():
    """Below 1e-154, whose square is none, columns were divided by 0, and a stack's task had no part in its swing."""
    e = 1e-250 * loop(0.35, 3, 60)
    one = diagnose_tasks({"one": np.stack([e, 0.1 * e], 1)}, TS).tasks["one"]
    assert one.share == 1 and one.factor and about(one.found, 0.35, 3) and one.found.confidence > 0.5


def test_commands_and_joints_of_a_loop_with_noise_in_it():
    """Recorded by the library's own loops: a mode of the linear theory, and a whole arm."""
    rng = np.random.default_rng(5)
    for d, z in ((2, 0.5), (5, 0.22)):
        q, asked = in_time([-z], Drive(delay=d), TS, np.ones(200), noise=0.001 * rng.standard_normal(200))
        assert about(diagnose(q, TS), z, d) and about(diagnose(asked, TS), z, d)
    arm = ck.planar_arm([1.0, 0.8])
    law = ck.Law(arm, ck.position("xy"), alpha=40.0)
    q0 = np.array([0.4, 1.1])
    target = ck.hold(ck.forward(arm, q0).position[:2] + np.array([0.005, -0.01]))
    run = ck.solve(law, target, q0, 0.01, 120, "EE", ck.picard(5), drive=Drive(delay=2))
    found = diagnose(np.asarray(run.q), 0.01, alpha=40.0)
    assert about(found, 0.4, 2) and found.recommended_alpha == pytest.approx(40 * found.recommended / found.z)


def test_a_gain_that_would_end_it_does():
    z, d, alpha = 0.4, 3, 200.0
    found = diagnose(loop(z, d, 200), TS, alpha=alpha)
    assert found.kind is Kind.RINGING and found.confidence > 0.9 and found.pure
    assert found.stable == pytest.approx(stable(3)) and found.monotone == pytest.approx(monotone(3), rel=0.02)
    assert found.recommended < found.monotone and found.factor == pytest.approx(found.recommended / found.z)
    quiet = diagnose(loop(z * found.recommended_alpha / alpha, d, 200), TS)
    assert quiet.kind is Kind.MONOTONE
    said = str(found)
    assert said.startswith("ringing: period ") and "3 samples (6 ms) of dead time" in said and "1/s" in said
    assert "start at the measured joints a smaller gain may not" in found.note  # tests/stability/test_rebased.py


def test_values_that_return_every_second_time():
    found = diagnose(loop(1.8, 0, 60), TS)
    assert found.delay == 0 and found.z == pytest.approx(1.8, rel=1e-6) and found.period == pytest.approx(2)
    assert "every second sample" in str(found) and found.kind is Kind.RINGING
    assert diagnose(loop(2.05, 0, 60), TS).kind is Kind.GROWING


def test_a_clipped_oscillation_is_sustained():
    rng = np.random.default_rng(2)
    for d in (0, 2, 5):
        e = loop(1.4 * stable(d), d, 400, clip=0.3) + 0.002 * rng.standard_normal(400)
        found = diagnose(e, TS)
        assert found.kind is Kind.SUSTAINED and found.delay == d, (d, found)
        assert found.growth == pytest.approx(1, abs=2e-3) and found.z == found.stable and "at least" in str(found)


def test_no_oscillation_where_there_is_none():
    rng = np.random.default_rng(3)
    for N in (40, 200, 1000):
        for k in (1, 4):
            for _ in range(3):
                assert diagnose(1.0 + 1e-4 * rng.standard_normal((N, k)), TS).kind is Kind.NOISE
    t = np.arange(600)
    path = np.sin(2 * np.pi * t / 400)
    assert diagnose(path + 1e-4 * rng.standard_normal(600), TS).kind is Kind.NOISE
    for quiet in (np.full(100, 0.3), 0.3 + 1e-4 * np.arange(100.0)):
        found = diagnose(quiet, TS)
        assert found.kind is Kind.QUIET and not found.rings and found.z is None and "no oscillation" in str(found)


def test_a_motion_from_one_place_to_another_is_no_oscillation():
    """Bends of a path are sums of waves to whoever fits them: they must be seen in each period."""
    rng = np.random.default_rng(6)
    s = np.clip(np.arange(600) / 400, 0, 1)
    for path in (10 * s**3 - 15 * s**4 + 6 * s**5, s, np.minimum(2 * s, 1) - s**2):
        for noise in (0.0, 1e-4):
            assert not diagnose(path + noise * rng.standard_normal(600), TS).rings


@pytest.mark.parametrize("digits", [None, 6])
@pytest.mark.parametrize("slope", [0.02, 1.0])
@pytest.mark.parametrize(("frequency", "size", "N"), [(3, 0.01, 600), (5, 0.05, 300), (2, 0.02, 1000), (8, 0.01, 600)])
def test_clean_waves_on_a_ramp_are_seen(frequency, size, N, slope, digits):
    """Small beside the way, and without noise or with that of a display's digits alone."""
    t = 0.01 * np.arange(N)
    y = slope * t + size * np.sin(2 * np.pi * frequency * t + 0.3)
    found = diagnose(y if digits is None else y.round(digits), 0.01)
    assert found.kind is Kind.SUSTAINED and found.period == pytest.approx(100 / frequency, rel=1e-2)


def test_what_is_excited_again_rings_and_is_not_sustained():
    e = np.tile(loop(0.3, 4, 200), 20) + 0.003 * np.random.default_rng(7).standard_normal(4000)
    found = diagnose(e, TS)
    assert found.kind is Kind.RINGING and about(found, 0.3, 4)


def test_a_drive_that_lags_is_found_by_the_gain():
    """With alpha known the oscillation says how much of what is late is a lag; without, the gain suits most of it."""
    drive = Drive(delay=2, lag=0.01)
    limits = driven_limits("EE", Ts=TS, drive=drive)
    z = 0.8 * limits.stable
    q, _ = in_time([-z], drive, TS, np.ones(300))
    found = diagnose(q, TS, alpha=z / TS)
    assert not found.pure and found.delay == pytest.approx(2, abs=0.05) and found.lag == pytest.approx(0.01, rel=0.02)
    assert found.recommended_alpha == pytest.approx(limits.recommended / TS, rel=0.02)
    assert "a lag of 0.01 s" in str(found)
    blind = diagnose(q, TS)
    assert blind.factor * z < 1.05 * limits.recommended and "--alpha or a recorded step (--step) decides" in str(blind)


@pytest.mark.parametrize("alpha", [None, 35.0])
def test_alpha_does_not_decide_where_an_oscillation_is_clipped(alpha):
    """Its z is hidden: "--alpha decides" was said also to those who had given it."""
    found = diagnose(loop(1.0077 * stable(4), 4, 400), 0.01, alpha=alpha)
    assert found.kind is Kind.SUSTAINED
    assert "suits most of them; a recorded step (--step) decides" in str(found) and "--alpha" not in str(found)


def test_limits_of_dead_time_alone_are_those_of_the_theory():
    for d in (0, 1, 5):
        ours, theirs = limits_of(LateLoop(d, 0.0, 0.1), TS), driven_limits("EE", Ts=TS, drive=Drive(delay=d))
        assert (ours.stable, ours.recommended) == pytest.approx((theirs.stable, theirs.recommended), rel=1e-3)


def test_a_recording_of_one_period():
    for N in (45, 60):
        found = diagnose(loop(0.15, 8, N), TS)
        assert found.delay == 8 and found.z == pytest.approx(0.15, rel=0.1) and found.period > 30


def test_a_monotone_decay():
    rng = np.random.default_rng(4)
    for noise in (0.0, 0.005):
        e = loop(0.08, 0, 150) + noise * rng.standard_normal(150)
        found = diagnose(e, TS, alpha=40.0)
        assert found.kind is Kind.MONOTONE and found.delay is None and found.z == pytest.approx(0.08, rel=0.05)
        assert "dead time open" in str(found)
    assert diagnose(loop(0.9 * monotone(4), 4, 200), TS).kind is Kind.MONOTONE


@pytest.mark.parametrize(("z", "most", "start"), [(2.5, 0.1, 2.9), (2.8, 0.3, 2.0), (6.0, 0.1, 2.9), (4.0, 3.0, 2.0)])
def test_a_gain_far_too_large_whose_error_stays_bounded_is_no_decay_and_no_noise(z, most, start):
    """The error comes at the joint's velocity limit, and then moves on without end, with a period or without one."""
    q = [start]
    for _ in range(239):
        q.append(q[-1] - np.clip(z * np.sin(q[-1]) * (1 + 0.6 * q[-1]), -most, most))
    assert np.ptp(q[-80:]) > 0.03 * np.ptp(q)
    found = diagnose(q, TS)
    assert found.kind not in (Kind.MONOTONE, Kind.NOISE)
    assert found.kind is not Kind.UNDECIDED or "reduce the gain until it does" in found.note


@pytest.mark.parametrize(("z", "d", "names"), [(0.85, 2, True), (1.2, 2, False), (2.0, 1, False)])
def test_a_loop_that_grows_until_it_moves_without_a_rule_is_no_noise(z, d, names):
    """Past its first swings the error of an arm is not linear. Where its growth is long enough, it names dead time."""
    arm = ck.planar_arm([1.0, 0.8, 0.5])
    law, q0 = ck.Law(arm, ck.position("xy"), alpha=z / TS, inverse=ck.damped(0.05)), np.array([0.3, 0.8, 0.6])
    target = ck.hold(np.asarray(ck.forward(arm, q0).position)[:2] + np.array([0.004, -0.006]))
    e = np.asarray(ck.solve(law, target, q0, TS, 300, "EE", drive=Drive(delay=d)).e)
    found = diagnose(e, TS, alpha=z / TS)
    assert found.kind is (Kind.GROWING if names else Kind.UNDECIDED)
    assert found.delay == d and 0.1 < found.recommended_alpha * TS * (d + 1) < 0.75 if names else found.delay is None


@pytest.mark.parametrize(("rows", "columns"), [(40, 1), (40, 2), (300, 3), (300, 12)])
def test_noise_is_as_large_from_the_start(rows, columns):
    """Of 3,000 recordings of noise none seems to have grown; noise that seemed so would be undecided."""
    draws = np.random.default_rng(columns).standard_normal((3000, rows, columns))
    assert sum(map(is_as_large, draws)) >= 3000 - 3 * (columns == 1)
    assert not any(map(is_as_large, draws * (1e-2 + (np.arange(rows) > max(14 // columns + 2, 3))[:, None])))


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("factor", [0.8, 0.9, 0.97])
def test_a_decay_with_offset_and_noise_or_resolution_is_one(factor, noise):
    rng, power = np.random.default_rng(3), factor ** np.arange(300.0)
    y = np.stack([1.0 + power, -0.4 - 0.5 * power], 1) + noise * rng.standard_normal((300, 2))
    assert diagnose(y, TS).kind is Kind.MONOTONE
    assert noise or diagnose(np.round(y, 2), TS).kind is Kind.MONOTONE


def test_a_large_motion_that_rings_to_rest_is_judged():
    """Its last rows are all at rest: they suit any loop, and no loop is likelier than the others."""
    q = [1.0]
    for _ in range(399):
        q.append(q[-1] - 1.6 * np.sin(q[-1]) * (1 + 0.3 * q[-1]))
    assert diagnose(q, TS).kind is Kind.RINGING


@pytest.mark.parametrize("d", [5, 10])
@pytest.mark.parametrize("share", [0.5, 0.75])
def test_the_beginning_of_a_swing_is_no_decay_and_no_noise(d, share):
    """Less than a period of a loop that rings: that no smaller gain is needed is not known."""
    rng = np.random.default_rng(d)
    period = 4 * d + 4
    for _ in range(3):
        y = np.outer(loop(0.85 * stable(d), d, max(int(share * period), 16)), [0.1, -0.04])
        found = diagnose(y + 3e-4 * rng.standard_normal(y.shape), TS)
        assert found.kind not in (Kind.MONOTONE, Kind.NOISE, Kind.QUIET), found
        assert "No smaller gain" not in str(found)


@pytest.mark.parametrize(("d", "rows"), [(7, (16,)), (10, (16, 19, 22, 25)), (15, (28, 34))])
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_the_beginning_of_a_swing_does_not_grow(d, rows, noise):
    """Few rows of a stable loop, at first at rest, were fitted by growing oscillations that are none of a loop's."""
    rng = np.random.default_rng(d)
    for N in rows:
        y = np.outer(loop(0.85 * stable(d), d, N), [0.1, -0.04])
        found = diagnose(y + noise * rng.standard_normal(y.shape), TS)
        assert found.kind is not Kind.GROWING, (N, found)
    grows = np.outer(loop(1.4 * stable(4), 4, 40), [0.1, -0.04])
    assert about(diagnose(grows + noise * rng.standard_normal(grows.shape), TS), 1.4 * stable(4), 4)


@pytest.mark.parametrize("rounding", [0.0, 4e-16])
def test_recorded_commands_beside_joints_are_no_decay_of_a_loop(rounding):
    """A step of all joints with its commands, which have no noise but roundings, or none."""
    command = np.where(np.arange(400)[:, None] < 20, 0.0, [0.1, -0.2, 0.15, 0.1, 0.2, -0.1])
    joints = np.zeros_like(command)
    for k in range(1, 400):
        joints[k] = 0.8187 * joints[k - 1] + 0.1813 * 0.97 * command[max(k - 4, 0)]
    joints += 1e-4 * np.random.default_rng(0).standard_normal(joints.shape)
    command *= 1 + rounding * np.random.default_rng(1).standard_normal(joints.shape)
    found = diagnose(np.hstack([command, joints]), TS)
    assert found.kind is Kind.UNDECIDED and "No smaller gain" not in str(found), found
    assert diagnose(joints, TS).growth == pytest.approx(0.8187, rel=5e-3)


@pytest.mark.parametrize(
    ("signal", "options", "line"),
    [
        (np.zeros(5), {}, "Argument `signal` must have at least 16 rows, but has 5."),
        (np.zeros((50, 0)), {}, "Argument `signal` must have at least 16 rows, but has 0."),
        (np.full(50, np.nan), {}, "Argument `signal` must be finite, but is nan at index (0,)."),
        (-np.geomspace(1, 1e200, 50), {}, "Argument `signal` must be within ±1e+30, but reaches 1e+200."),
        (np.zeros(50), {"Ts": -1.0}, "Argument `Ts` must be positive, but is -1."),
        (np.zeros(50), {"alpha": 0.0}, "Argument `alpha` must be positive, but is 0."),
    ],
)
def test_what_cannot_be_diagnosed(signal, options, line):
    with pytest.raises(ArgumentError) as said:
        diagnose(signal, **{"Ts": TS} | options)
    assert str(said.value) == line


def test_no_decomposition_is_so_large_that_blas_parts_it_among_threads(monkeypatch):
    """Threads that wait for each other on cores that are taken: five of 1,500 small logs took ten seconds of CPU. The
    eigenvalues of 128 rows are found one by one; exponentials of drives call no LAPACK."""
    rng, apart = np.random.default_rng(0), []
    for name in ("qr", "svd", "lstsq", "eigvals", "eigh", "pinv", "solve"):

        def watched(a, *rest, _made=getattr(np.linalg, name), _name=name, **options):
            if a.shape[-2] * a.shape[-1] > 9216:
                apart.append((_name, a.shape))
            return _made(a, *rest, **options)

        monkeypatch.setattr(np.linalg, name, watched)
    monkeypatch.setattr("scipy.linalg.expm", lambda a: apart.append(("expm", a.shape)))
    t = TS * np.arange(4000)
    path = np.outer(np.sin(t), rng.uniform(-1, 1, 20))
    ringing = np.tile(loop(0.3, 4, 1000), 4)
    swinging, _ = in_time([-0.28], Drive(delay=4), TS, np.ones(4000), noise=0.01 * rng.standard_normal(4000))
    for e in (ringing, swinging):
        y = path + np.outer(e[:4000], rng.uniform(0.1, 1, 20)) + 3e-4 * rng.standard_normal((4000, 20))
        assert diagnose(y, TS).rings
    command = np.where(np.arange(1500) > 20, 0.1, 0.0)
    motion = servo(command, TS, 2.0, omega=40.0, zeta=0.8) + 1e-4 * rng.standard_normal(1500)
    assert fit_drive(None, command, motion, TS).drive.order == 2
    assert not apart


OF_THREADS = """
import time
from tests.diagnosis.long import TS, diagnose, log
y = log("rings")
diagnose(y, TS)  # imports
time.sleep(0.2)
own, every = time.thread_time(), time.process_time()
diagnose(y, TS)
print(time.thread_time() - own, time.process_time() - every)
"""


def test_no_thread_of_blas_has_a_part_in_it():
    """On cores that are taken its threads made 0.3 s of work 6 s."""
    line, here = [sys.executable, "-c", OF_THREADS], os.environ | {"OPENBLAS_NUM_THREADS": "2"}
    said = subprocess.run(line, env=here, capture_output=True, text=True, check=True, cwd=ROOT)
    own, every = map(float, said.stdout.split())
    assert every < 1.1 * own


def test_pieces_of_a_tall_matrix_have_its_triangle():
    rng = np.random.default_rng(0)
    for shape in ((5, 8), (100, 7), (9000, 34), (3000, 90)):
        a = rng.standard_normal(shape) * np.geomspace(1, 1e-9, shape[1])
        r = triangle(a)
        np.testing.assert_allclose(r.T @ r, a.T @ a, rtol=1e-9, atol=1e-13 * np.abs(a.T @ a).max() ** 0.5)
        if shape[0] >= shape[1]:
            q, r = orthogonal(a)
            np.testing.assert_allclose(q.T @ q, np.eye(shape[1]), atol=1e-13)
            np.testing.assert_allclose(q @ r, a, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("every", [40, *slow(1)])
def test_16_to_24_rows_of_a_stable_loop_are_not_called_growing(every):
    """Loops that have hardly begun to move: too short to tell. Seven of these 400 were called so."""
    rng, seen = np.random.default_rng(0), []
    for i in range(400):
        N, d, share = int(rng.integers(16, 25)), int(rng.integers(0, 9)), rng.uniform(0.1, 0.98)
        k, noise = rng.integers(1, 4), rng.choice([0, 1e-4, 3e-4, 1e-3, 3e-3])
        lag = rng.choice([0, 0, rng.uniform(1, 10)])
        offset, rest = rng.choice([0, 1]) * rng.uniform(-1, 1, k), rng.integers(0, 4)
        z = share * 0.3 / (d + lag) if lag else share * stable(d)
        weights, noise = rng.uniform(-0.1, 0.1, k), 0.1 * noise * rng.standard_normal((N, k))
        alpha = z / TS if rng.choice([0, 1]) else None
        if i % every == 0 or i in (68, 166, 185, 254, 284, 289, 399):
            e = np.r_[np.ones(rest), late_loop(z, d, lag, N) if lag else loop(z, d, N)][:N]
            seen.append(diagnose(np.outer(e, weights) + offset + noise, TS, alpha=alpha).kind)
    assert not {Kind.GROWING, Kind.DIVERGING} & set(seen) and Kind.RINGING in seen


@pytest.mark.parametrize("growth", [1.2, 1.6, 2.5])
def test_growth_in_few_rows_is_still_seen(growth):
    """A wrong sign and a gain beyond the limit, with noise."""
    rng = np.random.default_rng(2)
    e = growth ** np.arange(24.0)
    found = diagnose(np.outer(e / e[-1], [0.1, -0.04]) + 1e-6 * rng.standard_normal((24, 2)), TS)
    assert found.kind is Kind.DIVERGING and found.growth == pytest.approx(growth, rel=1e-3)
    e = loop(1.3 * stable(1), 1, 24)
    assert diagnose(np.outer(e, [0.1, -0.04]) + 1e-4 * rng.standard_normal((24, 2)), TS).kind is Kind.GROWING


@pytest.mark.parametrize("seed", [0, *slow(2)])
def test_what_moved_before_as_it_does_now_does_not_grow(seed):
    """Modes explain only the last rows of a long log of a stable loop that noise swings: there they may grow."""
    rng = np.random.default_rng(seed)
    t = TS * np.arange(4000)
    path = np.outer(np.sin(t), rng.uniform(-1, 1, 20))
    e, _ = in_time([-0.28], Drive(delay=4), TS, np.ones(4000), noise=0.01 * rng.standard_normal(4000))
    y = path + np.outer(e[:4000], rng.uniform(0.1, 1, 20)) + 3e-4 * rng.standard_normal((4000, 20))
    assert diagnose(y, TS).kind in (Kind.RINGING, Kind.SUSTAINED)
    growing = np.outer(1e-3 * loop(1.05 * stable(4), 4, 400), [0.1, -0.04]) + 1e-6 * rng.standard_normal((400, 2))
    assert diagnose(growing, TS).kind is Kind.GROWING
