"""What is read in a log is what was put into it, and what is named ends it in the simulated loop."""

import pathlib

import numpy as np
import pytest

import cnclik as ck
from cnclik.diagnosis import Kind, diagnose
from cnclik.errors import ArgumentError
from tests.diagnosis import logs
from tests.diagnosis.logs import late_loop
from tests.diagnosis.recordings import loop, monotone, stable

TS = logs.TS
ROOT = pathlib.Path(__file__).parents[2]


def ends(found, z, delay, lag=0.0) -> bool:
    """Whether the gain that is named for a loop of z ends its swing, and is not far too low."""
    calm = logs.limits(delay, lag)[1]
    return bool(logs.is_right(logs.Log(None, None, "late", dict(z=z, delay=delay, lag=lag, calm=calm)), found))


@pytest.mark.parametrize("d", [1, 3, 7])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_the_gain_that_is_named_ends_it(d, noise):
    """Three loops of a dead time, with alpha and without, also with noise of 1 % of the first error."""
    rng, told = np.random.default_rng(d), []
    for share in (0.6, 0.8, 1.02):
        z = share * stable(d)
        y = np.outer(loop(z, d, 160), rng.uniform(-1, 1, 2)) + rng.uniform(-2, 2, 2)
        y = y + noise * np.ptp(y[: d + 4], axis=0) * rng.standard_normal(y.shape)
        for alpha in (z / TS, None):
            found = diagnose(y, TS, alpha=alpha)
            told.append(found.factor is not None and ends(found, z, d))
            assert found.confidence is None or found.confidence <= (0.8 if alpha is None else 1.0)
            assert found.interval is None or found.interval[0] <= d <= found.interval[1]
    assert sum(told) >= len(told) - (noise > 0), told


@pytest.mark.parametrize("alpha", [69.02, None])
def test_pure_dead_time_is_told_from_a_lag(alpha):
    """Five samples of 4 ms, noise of 0.2 mrad, encoders of 0.1 mrad: 4.06 samples and a lag were said, surely."""
    rng, q, sent, seen = np.random.default_rng(0), 0.0, [0.0] * 6, []
    for k in range(300):
        seen.append(1e-4 * np.round((q + 2e-4 * rng.standard_normal()) / 1e-4))
        sent.append(69.02 * TS * (0.05 * (k > 10) - seen[-1]))
        q += sent[-6]
    found = diagnose(seen, TS, alpha=alpha)
    assert found.cause == "dead time" and found.interval[0] <= 5 <= found.interval[1] and found.drive.order == 0
    assert ends(found, 69.02 * TS, 5) and "as with 5 samples (20 ms) of dead time" in str(found)


@pytest.mark.parametrize("d", [1, 4])
def test_what_surrounds_a_swing_does_not_matter(d):
    """A drift, rest before the step of a target, a slow path, several joints, a column that stands still."""
    rng = np.random.default_rng(100 + d)
    z = 0.9 * stable(d)
    e, t = loop(z, d, 300), np.arange(300.0)
    late = np.concatenate([np.zeros(40), 1 - e])
    long = loop(0.97 * stable(d), d, 1200)
    path = np.sin(2 * np.pi * np.arange(1200) / 700) + 0.3 * np.cos(2 * np.pi * np.arange(1200) / 431)
    for y, gain in (
        (0.1 * e + 1.5 - 0.002 * t, z),
        (late + 0.005 * rng.standard_normal(len(late)), z),
        (path + 0.2 * long + 0.001 * rng.standard_normal(1200), 0.97 * stable(d)),
    ):
        assert ends(diagnose(y, TS, alpha=gain / TS), gain, d)
    joints = np.stack([0.3 * long + 1, -0.1 * long - 2, np.full(1200, 0.7), 0.02 * long], 1)
    joints[:, [0, 1, 3]] += 0.002 * rng.standard_normal((1200, 3))
    found = diagnose(joints, TS)
    assert ends(found, 0.97 * stable(d), d)
    assert found.amplitude[0] > found.amplitude[1] > found.amplitude[3] > found.amplitude[2]


@pytest.mark.parametrize("size", [1e-250, 1e-9, 1e20])
def test_the_unit_of_a_log_does_not_matter(size):
    found, same = (diagnose(scale * loop(0.35, 3, 60), TS) for scale in (size, 1.0))
    assert found.kind is same.kind and found.recommended_alpha == pytest.approx(same.recommended_alpha, rel=1e-3)


def test_joints_and_errors_of_a_whole_arm():
    arm = ck.planar_arm([1.0, 0.8])
    law, q0 = ck.Law(arm, ck.position("xy"), alpha=40.0), np.array([0.4, 1.1])
    target = ck.hold(ck.forward(arm, q0).position[:2] + np.array([0.005, -0.01]))
    run = ck.solve(law, target, q0, 0.01, 120, "EE", drive=ck.Drive(delay=2))
    for signal in (run.q, run.e):
        found = diagnose(np.asarray(signal), 0.01, alpha=40.0)
        assert found.rings and ends(found, 0.4, 2) and found.factor == pytest.approx(found.recommended_alpha / 40)


def test_the_answer_in_words():
    found = diagnose(loop(0.4, 3, 200), TS, alpha=100.0)
    assert found.kind is Kind.RINGING and found.confidence >= 0.9
    assert str(found).startswith("ringing: period 14.") and "Use an alpha of " in str(found)
    assert "times the present gain" in str(found) and "at the measured joints a smaller gain may not" in found.note
    quiet = diagnose(loop(0.4 * found.factor, 3, 200), TS)
    assert quiet.kind is Kind.CALM and quiet.cause is quiet.confidence is None


@pytest.mark.parametrize("d", [2, 5])
def test_a_clipped_oscillation_is_sustained(d):
    """By a limit of velocity; a linear loop near its limit is not called clipped."""
    rng, z = np.random.default_rng(2), 2.0 * stable(d)
    e = loop(z, d, 400, clip=0.3) + 0.002 * rng.standard_normal(400)
    found = diagnose(e, TS, alpha=z / TS)
    assert found.kind is Kind.SUSTAINED and found.growth == pytest.approx(1, abs=2e-3) and ends(found, z, d)
    linear = diagnose(loop(0.97 * stable(d), d, 400), TS, alpha=0.97 * stable(d) / TS)
    assert linear.rings and "clip" not in str(linear)


@pytest.mark.parametrize(("z", "d"), [(9.0, 1), (1.5, 2), (0.9, 3), (1.1 * stable(4), 4), (1.003 * stable(3), 3)])
def test_growing_oscillations_of_any_speed(z, d):
    N = 1500 if z < 1.01 * stable(d) else 60 if z > 1.2 * stable(d) else 200
    found = diagnose(loop(z, d, N), TS, alpha=z / TS)
    assert found.kind in (Kind.GROWING, Kind.SUSTAINED) and ends(found, z, d), str(found)


@pytest.mark.parametrize(("delay", "lag"), [(1.0, 5.0), (3.4, 6.0)])
def test_a_lag_is_not_taken_for_dead_time(delay, lag):
    most, _ = logs.limits(delay, lag)
    for share, noise in ((0.6, 0.0), (0.8, 2e-3)):
        z = share * most
        e = late_loop(z, delay, lag, 300)
        e = e + noise * np.random.default_rng(2).standard_normal(len(e))
        for alpha in (z / TS, None):
            found = diagnose(e, TS, alpha=alpha)
            assert found.cause == "drive" and ends(found, z, delay, lag), str(found)


@pytest.mark.parametrize("delay", [1, 3])
def test_loops_that_noise_keeps_swinging(delay):
    right = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        z = rng.uniform(0.7, 0.9) * stable(delay)
        noise = rng.standard_normal(800)
        found = diagnose(late_loop(z, delay, 0.0, 800, 0.0, noise) + (seed % 2) * noise, TS, alpha=z / TS)
        right += found.rings and ends(found, z, delay)
    assert right >= 3


# --- what no smaller gain ends ------------------------------------------------------------------------


@pytest.mark.parametrize(("growth", "noise"), [(1.005, 0.0), (1.05, 1e-3), (1.3, 0.0), (2.0, 0.0), (3.0, 1e-3)])
def test_growth_without_swinging_is_a_wrong_sign(growth, noise):
    rng = np.random.default_rng(1)
    e = 0.1 * growth ** np.arange(max(min(8000, int(np.log(1e5) / np.log(growth))), 16), dtype=float)
    y = np.stack([0.3 + e, 1 - 0.5 * e], 1)
    found = diagnose(y + noise * np.ptp(y, axis=0) * rng.standard_normal(y.shape), TS)
    assert found.kind is Kind.DIVERGING and found.cause == "wrong sign", str(found)
    assert np.log(found.growth) == pytest.approx(np.log(growth), rel=0.1) and found.factor is None
    assert "the sign of error, Jacobian or command is wrong" in str(found)


def test_the_sign_of_one_column_alone():
    found = diagnose(np.stack([loop(0.1, 1, 120), loop(-0.05, 2, 120)], 1), TS, alpha=0.05 / TS)
    assert found.cause == "wrong sign" and found.recommended_alpha is None


@pytest.mark.parametrize(
    ("degrees", "third"), [(-150.0, True), (-90.0, False), (-45.0, True), (40.0, False), (90.0, True), (115.0, False)]
)
def test_turned_frames_are_named_with_their_angle(degrees, third):
    z, turn = 0.15, np.radians(degrees)
    spiral = 0.1 * (1 - z * np.exp(1j * turn)) ** np.arange(160 if abs(degrees) < 140 else 60)
    y = np.stack([spiral.real, spiral.imag] + [0.05 * (1 - z) ** np.arange(len(spiral))] * third, 1)
    y += 1e-4 * np.ptp(y) * np.random.default_rng(0).standard_normal(y.shape)
    found = diagnose(y, TS, alpha=z / TS)
    assert found.cause == "turned frames" and found.angle == pytest.approx(degrees, abs=2), str(found)
    np.testing.assert_allclose(found.axis, [0, 0, 1], atol=0.05)
    assert found.factor is None and found.z == pytest.approx(z, rel=0.05) and f"{abs(found.angle):.3g}°" in str(found)
    mended = np.exp(-1j * np.radians(found.angle))  # the remedy: the error turned back before J#
    assert abs(1 - z * np.exp(1j * turn) * mended) < 1 - 0.9 * z


# --- what no loop makes, and loops that are calm --------------------------------------------------------


def calm_logs():
    """{name: log} in which nothing is to be found."""
    rng, t = np.random.default_rng(3), np.arange(600)
    s = np.clip(t / 400, 0, 1)
    count = 2 * np.pi / 4096
    return {
        "noise": 1.0 + 1e-4 * rng.standard_normal((200, 4)),
        "noise of an arm at rest": 1e-4 * rng.standard_normal((4000, 6)) + rng.uniform(-1, 1, 6),
        "one count of an encoder": count * np.round(0.3 + (t[:, None] > 200) * [0.0, 0.6, 0.7] + 1e-3 * t[:, None]),
        "a slow wave": np.sin(2 * np.pi * t / 400) + 1e-4 * rng.standard_normal(600),
        "a ramp": 0.3 + 1e-4 * t[:100],
        "rest": np.full(100, 0.3),
        "a motion": 10 * s**3 - 15 * s**4 + 6 * s**5,
        "a noisy motion": np.minimum(2 * s, 1) - s**2 + 1e-4 * rng.standard_normal(600),
        "a sweep": np.sin(2 * np.pi * (3 * t / 600 + 8.5 * (t / 600) ** 2)),
        "a decay": loop(0.9 * monotone(4), 4, 200),
        "a noisy decay": np.outer(0.9 ** np.arange(300.0), [1.0, -0.5]) + 0.01 * rng.standard_normal((300, 2)),
    }


@pytest.mark.parametrize("name", calm_logs())
def test_nothing_is_found_where_there_is_nothing(name):
    found = diagnose(calm_logs()[name], TS)
    assert not found.rings and found.cause is found.confidence is found.recommended_alpha is None, str(found)
    assert found.note and str(found).startswith(found.kind)


@pytest.mark.parametrize("alpha", [10.0, 25.0, 37.0])
@pytest.mark.parametrize(("d", "turns"), [(1, 3.0), (2, 1.2), (2, 3.0), (4, 3.0), (6, 3.0)])
def test_a_circle_is_neither_an_oscillation_nor_a_spiral(alpha, d, turns):
    """At 10 ms a sample: a period of the path gave a lag of 57 ms and a quarter of the gain, surely; errors that go
    round gave turned frames. What is said surely is right; paths and errors alike."""
    Ts, N = 0.01, 400
    path = 0.05 * np.exp(2j * np.pi * turns * np.arange(N + 1) / N)
    e = [0j] * (d + 1)  # the path's velocity is sent, too, and comes late
    for k in range(N):
        e.append(
            e[-1] - alpha * Ts * e[-1 - d] + path[k + 1] - path[k] - (path[k - d + 1] - path[k - d] if k >= d else 0)
        )
    e = np.array(e[d + 1 :])
    for motion in (e, path[1:] - e):
        for noise in (0.0, 1e-6):
            y = np.stack([motion.real, motion.imag], 1) + noise * np.random.default_rng(d).standard_normal((N, 2))
            found = diagnose(y, Ts, alpha=alpha)
            assert found.confidence is None or (found.rings and ends(found, alpha * Ts, d)) or found.confidence < 0.9, (
                found
            )


def test_16_to_24_rows_of_a_stable_loop_are_not_called_growing(every=40):
    """Loops that have hardly begun to move: too short to tell."""
    rng, seen = np.random.default_rng(0), []
    for i in range(400):
        N, d, share = int(rng.integers(16, 25)), int(rng.integers(0, 9)), rng.uniform(0.1, 0.98)
        k, noise, rest = rng.integers(1, 4), rng.choice([0, 1e-4, 1e-3, 3e-3]), rng.integers(0, 4)
        z, weights = share * stable(d), rng.uniform(-0.1, 0.1, k)
        noise = 0.1 * noise * rng.standard_normal((N, k))
        if i % every == 0:
            e = np.r_[np.ones(rest), loop(z, d, N)][:N]
            seen.append(diagnose(np.outer(e, weights) + noise, TS).kind)
    assert not {Kind.GROWING, Kind.DIVERGING} & set(seen), seen


def test_what_is_said_with_confidence_is_right(count=18):
    """Of what is said with 0.9 nine in ten are right; few loops that swing are missed; few calm logs raise an alarm."""
    sure, missed, alarms = [], 0, 0
    for _kind, log, found, right in logs.answers(count, seed=1):
        if right is not None and found.confidence >= 0.9:
            sure.append(right)
        missed += log.truth != "calm" and found.cause is None
        alarms += log.truth == "calm" and found.cause is not None
    assert sure and np.mean(sure) >= 0.9, (sum(sure), len(sure))
    assert missed < 0.1 * count and alarms < 0.03 * count + 1


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
