"""What is read in a log is what was put into it, and what is named ends it in the simulated loop."""

import numpy as np
import pytest

from cnclik.cli import main
from cnclik.diagnosis import check_log, diagnose, diagnose_tasks
from tests.diagnosis import logs
from tests.diagnosis.logs import TS, ends, limits, loop, monotone, stable
from tests.refusals import refusals


@pytest.mark.parametrize("alpha", [69.02, None])
def test_pure_dead_time_is_told_from_a_lag(alpha):
    """Five samples of 4 ms, noise of 0.2 mrad, encoders of 0.1 mrad: 4.06 samples and a lag were said, surely."""
    noise = 2e-4 * np.random.default_rng(0).standard_normal(290)
    e = np.pad(loop(69.02 * TS, 5, 290, push=0.05, noise=noise) + noise, (10, 0))
    found = diagnose(1e-4 * np.round(e / 1e-4), TS, alpha=alpha)
    assert found.cause == "dead time" and found.interval[0] <= 5 <= found.interval[1] and found.drive.order == 0
    assert ends(found, 69.02 * TS, 5) and found.drive.delay == pytest.approx(5, abs=0.1)


def test_what_surrounds_a_swing_does_not_matter():
    """A slow path, several joints, a column that stands still, units."""
    rng, z, t = np.random.default_rng(104), 0.97 * stable(4), np.arange(1200)
    e = loop(z, 4, 1200)
    path = np.sin(2 * np.pi * t / 700) + 0.3 * np.cos(2 * np.pi * t / 431)
    assert ends(diagnose(0.2 * (path + e) + 0.001 * rng.standard_normal(1200), TS, alpha=z / TS), z, 4)
    joints = np.outer(e, [0.3, -0.1, 0.0, 0.02]) + np.array([1.0, -2.0, 0.7, 0.0])
    joints[:, [0, 1, 3]] += 0.002 * rng.standard_normal((1200, 3))
    found = diagnose(joints, TS, alpha=z / TS)
    assert ends(found, z, 4)
    assert np.nanstd(found.fitted - joints) < 0.02
    assert diagnose(0.5 * loop(0.13, 7, 425) - 1e-3 * t[:425], TS).cause == "dead time"  # drifts
    held = np.repeat(loop(stable(2), 2, 60) + 0.02 * rng.standard_normal(60), 10)  # by a slow sensor
    assert diagnose(held, TS / 10).kind != "calm"
    rested = np.pad(loop(1.04 * stable(2), 2, 60), (300, 0))  # before a push: its steps were taken for an encoder's
    assert diagnose(rested, TS).kind == "growing oscillation"
    for size in (1e-250, 1e20):
        same = diagnose(size * e, TS)
        assert same.recommended_alpha == pytest.approx(diagnose(e, TS).recommended_alpha, rel=1e-3)


@pytest.mark.parametrize(("d", "lag", "clip"), [(1, 8, 9), (1, 10, 9), (6, 3, 9), (5, 0, 9), (1, 4, 0.3), (2, 6, 0.4)])
def test_a_push_tells_dead_time_from_a_lag(d, lag, clip):
    """Without alpha up to 5.6 times the gain that a lag tolerates was named. A limit of velocity tells nothing else."""
    most, calm = limits(d, lag)
    e = np.pad(loop(1.04 * most, d, 250, lag, clip=clip * most), (20, 0))
    found = diagnose(e + 1e-3 * np.random.default_rng(0).standard_normal(270), TS)
    assert ends(found, 1.04 * most, d, lag) and found.factor * 1.04 * most > 0.5 * calm


@pytest.mark.parametrize("d", [2, 5])
def test_a_clipped_oscillation_is_sustained_and_a_mended_loop_calm(d):
    """By a limit of velocity; a linear loop near its limit is not called clipped."""
    rng, z = np.random.default_rng(2), 2.0 * stable(d)
    e = loop(z, d, 400, clip=0.3) + 0.002 * rng.standard_normal(400)
    found = diagnose(e, TS, alpha=z / TS)
    assert found.kind == "sustained oscillation" and found.growth == pytest.approx(1, abs=2e-3) and ends(found, z, d)
    z = 0.97 * stable(d)
    found = diagnose(loop(z, d, 400), TS, alpha=z / TS)
    assert found.drive is not None and found.confidence >= 0.8 and "clip" not in str(found)
    assert "Use an alpha of " in str(found) and "at the measured joints a smaller gain may not" in found.note
    calm = diagnose(loop(z * found.factor, d, 400), TS)
    assert calm.kind == "calm" and calm.cause is calm.confidence is None


@pytest.mark.parametrize(("z", "d"), [(9.0, 1), (1.5, 2), (0.9, 3), (1.1 * stable(4), 4), (1.003 * stable(3), 3)])
def test_growing_oscillations_of_any_speed(z, d):
    N = 1500 if z < 1.01 * stable(d) else 60 if z > 1.2 * stable(d) else 200
    e = loop(z, d, N)
    found = diagnose(e[np.abs(e) < 1e12], TS, alpha=z / TS)
    assert found.kind in ("growing oscillation", "sustained oscillation") and ends(found, z, d), str(found)
    assert diagnose(e[np.abs(e) < 1e12], TS, alpha=z / TS / 3).kind != "calm"  # a third of alpha is no reason to grow


def test_growth_without_swinging_is_a_wrong_sign():
    for growth, noise in ((1.005, 0.0), (1.05, 1e-3), (1.3, 0.0), (2.0, 0.0), (3.0, 1e-3)):
        e = 0.1 * growth ** np.arange(max(int(np.log(1e5) / np.log(growth)), 16), dtype=float)
        y = np.stack([0.3 + e, 1 - 0.5 * e], 1)
        found = diagnose(y + noise * np.ptp(y, axis=0) * np.random.default_rng(1).standard_normal(y.shape), TS)
        assert found.kind == "growth without oscillation" and found.cause == "wrong sign", str(found)
        assert np.log(found.growth) == pytest.approx(np.log(growth), rel=0.1) and found.factor is None
    other = np.stack([loop(0.1, 1, 120), loop(-0.05, 2, 120)], 1)  # the sign of one column alone
    assert diagnose(other, TS, alpha=0.05 / TS).cause == "wrong sign"
    bent = [np.array([0.02, 0.012, 0.008])] * 3  # all columns, on an arm: a turn by 173° was said, surely
    while len(bent) < 86:
        grown = bent[-3] - 0.3 * np.linalg.norm(bent[-3]) * np.cross([0.3, -0.5, 0.8], bent[-3])
        bent.append(bent[-1] + 0.03 * grown)
    assert diagnose(np.array(bent), TS, alpha=0.03 / TS).cause == "wrong sign"
    other = np.stack([0.34 * loop(0.03, 1, 200), 0.9 * loop(-0.01, 2, 200)], 1)
    leaves = np.outer((np.arange(300) / 300) ** 2, [0, 0, 0, 0.2])  # as others come to rest: that was called calm
    assert diagnose(leaves + np.outer(0.985 ** np.arange(300), [0.17, 0.1, -0.05, 0]), TS).kind != "calm"
    found = diagnose(other, TS)  # nor are the frames turned, by 164°
    assert found.cause == "wrong sign" and found.growth == pytest.approx(1.0098, abs=2e-4)
    assert diagnose(other, TS, alpha=0.2 / TS).cause is None  # with that gain it would grow faster


@pytest.mark.parametrize(("degrees", "third"), [(-150, True), (-90, False), (-55, True), (52, False), (115, False)])
def test_turned_frames_are_named_with_their_angle(degrees, third):
    """After a push; six samples of dead time turn it further, by 5 to 14°."""
    e, noise = [0j] * 30 + [1 + 0j], 3e-3 * np.random.default_rng(1).standard_normal((331, 2)) @ [1, 1j]
    for k in range(30, 330):
        e.append(e[k] - 0.04 * np.exp(1j * np.radians(degrees)) * (e[k - 6] + noise[k - 6]))
    y, other = np.array(e) + noise, loop(0.04, 6, 331)
    known = 0.04 / TS if degrees == -90 else None  # else that may be a circular path
    found = diagnose(np.stack([y.real, y.imag] + [other] * third, 1), TS, alpha=known)
    assert found.cause == "turned frames" and found.angle == pytest.approx(degrees, abs=5), str(found)
    assert found.factor is None and f"{abs(found.angle):.3g}° against each other about z" in str(found)
    assert np.isnan(found.fitted).all()


T = np.arange(600)
S, STEPS = np.clip(T / 400, 0, 1), np.random.default_rng(4).standard_normal((4000, 6))
CALM = {
    "noise of an arm at rest": 1e-4 * STEPS + 0.3,
    "one count of an encoder": np.pi / 2048 * np.round(0.3 + np.outer(T > 200, [0.0, 0.6, 0.7]) + 1e-3 * T[:, None]),
    "a slow wave": np.sin(2 * np.pi * T / 400) + 1e-4 * STEPS[:600, 0],
    "a ramp": 0.3 + 1e-4 * T[:100],
    "a bend": T / 600 + (T / 600) ** 3 + 0.15 * np.sin(np.pi * T / 429) + 5e-3 * STEPS[:600, 0],
    "rest": np.full(100, 0.3),
    "a noisy motion": np.minimum(2 * S, 1) - S**2 + 1e-4 * STEPS[:600, 0],
    "a sweep": np.sin(2 * np.pi * (3 * T / 600 + 8.5 * (T / 600) ** 2)),
    "a decay": loop(0.9 * monotone(4), 4, 200),
    "a noisy decay": np.outer(0.9 ** np.arange(300.0), [1.0, -0.5]) + 0.01 * STEPS[:300, :2],
    "frames turned by 40°": ((1 - 0.15 * np.exp(0.7j)) ** np.arange(160)).view(float).reshape(-1, 2),
    "a swing of one axis, of which alpha would tell": np.outer(loop(0.75 * stable(3), 3, 200), [0.0, 0.0, 0.5])
    + np.outer(loop(0.5 * monotone(3), 3, 200), [1.0, -0.6, 0.0]),
    "joints on a circle": np.tile(((1 - 0.15 * np.exp(1j)) ** np.arange(160)).view(float).reshape(-1, 2), 2),
    "a path, read as a gain of 500 times the limit": logs.drawn(np.random.default_rng(2), "path").signal,
}


@pytest.mark.parametrize("name", CALM)
def test_nothing_is_found_where_there_is_nothing(name):
    found = diagnose(CALM[name], TS)
    assert found.drive is None and found.cause is found.confidence is found.recommended_alpha is None, str(found)
    assert found.note and str(found).startswith(found.kind)
    assert ("passes its end by 67 %" in found.note) == ("one axis" in name)
    if name == "frames turned by 40°":  # at the rate of a known gain no path turns
        assert diagnose(CALM[name], TS, alpha=0.15 / TS).angle == pytest.approx(np.degrees(0.7), abs=0.1)


@pytest.mark.parametrize("alpha", [10.0, 25.0, 37.0])
@pytest.mark.parametrize(("d", "turns"), [(1, 3.0), (2, 1.2), (4, 3.0)])
def test_a_circle_is_neither_an_oscillation_nor_a_spiral(alpha, d, turns):
    """At 10 ms a sample: a period of the path gave a quarter of the gain, surely; errors gave turned frames."""
    Ts, N = 0.01, 400
    path = 0.05 * np.exp(2j * np.pi * turns * np.arange(N + 1) / N)
    sent = np.concatenate([np.zeros(d), np.diff(path)])  # the path's velocity is sent, too, and comes late
    e = [0j] * (d + 1)
    for k in range(N):
        e.append(e[-1] - alpha * Ts * e[-1 - d] + path[k + 1] - path[k] - sent[k])
    e = np.array(e[d + 1 :])
    for motion in (e, path[1:] - e):
        found = diagnose(np.stack([motion.real, motion.imag], 1), Ts, alpha=alpha)
        assert (found.confidence or 0) < 0.9 or (found.drive is not None and ends(found, alpha * Ts, d)), str(found)


def test_what_is_said_is_right_in_the_simulated_loop(count=18):
    """Of nine kinds of logs; without alpha no confidence is above 0.8. Short logs do not grow."""
    told = [(log, found, right) for _, log, found, right in logs.answers(count, seed=1)]
    assert all((found.confidence or 0) <= 0.8 for log, found, _ in told if log.alpha is None)
    assert all(right for log, found, right in told if (found.confidence or 0.0) >= 0.9)
    assert sum(log.truth != "calm" and not right for log, _, right in told) <= 1
    assert not any(log.truth == "calm" and found.cause for log, found, _ in told)
    rng = np.random.default_rng(0)
    for N, d, share in zip(rng.integers(16, 25, 10), rng.integers(0, 9, 10), rng.uniform(0.1, 0.98, 10), strict=True):
        y = np.outer(loop(share * stable(d), int(d), N), rng.uniform(-0.1, 0.1, 2))
        assert diagnose(y, TS).kind not in ("growing oscillation", "growth without oscillation")


test_what_cannot_be_diagnosed = refusals(
    (lambda: diagnose(np.zeros(5), TS), "`signal` must have at least 16 rows, but has 5.$"),
    (lambda: diagnose(np.zeros((50, 0)), TS), "`signal` must hold numbers, but is empty"),
    (lambda: diagnose(np.full(50, np.nan), TS), r"`signal` must be finite, but is nan at index \(0,\).$"),
    (lambda: diagnose(-np.geomspace(1, 1e200, 50), TS), r"`signal` must be within ±1e\+30, but reaches 1e\+200.$"),
    (lambda: diagnose_tasks({}, TS), "`signals` must hold a task, but is empty.$"),
    (lambda: check_log(None, np.zeros(9), Ts=TS, chain="panda"), "`chain` must be a Chain"),
    (lambda: check_log(None, np.zeros(9), Ts=TS, units=["rad", "m"]), "`units` must be rad or m of each of 1 columns"),
    (lambda: check_log(None, np.zeros(9), Ts=TS, names="elbow"), "`names` must be a list of 1 names, but is 'elbow'"),
    (lambda: check_log(None, np.zeros(9), Ts=TS, limits={"velocity": -1.0}), "`limits.velocity` must be at least 0"),
    (lambda: diagnose(np.zeros(50), -1.0), "`Ts` must be positive, but is -1.$"),
    (lambda: diagnose(np.zeros(50), TS, alpha=0.0), "`alpha` must be positive, but is 0.$"),
)


def test_a_joint_that_passes_pi_swings_as_one_that_does_not():
    """Without alpha it was calm, by a log of which each swing wraps."""
    q = 3.1 + 0.1 * loop(0.3, 4, 300)
    plain, wrapped = diagnose(q, TS), diagnose((q + np.pi) % (2 * np.pi) - np.pi, TS)
    assert wrapped.recommended_alpha == pytest.approx(plain.recommended_alpha, rel=1e-6)
    shown = np.isfinite(wrapped.fitted[:, 0])
    assert shown.any() and np.nanmax(np.abs(wrapped.fitted[:, 0])) < 3.3


def coupled(gains, N=300, d=4):
    """{task: errors (N, 3)} of hands and feet that share joints, 5 ms a sample."""
    rng = np.random.default_rng(3)
    J = rng.normal(size=(6, 9))
    S = J @ J.T @ np.linalg.inv(J @ J.T + 0.09 * np.eye(6))
    e = [0.05 * rng.normal(size=6)] * (d + 1)
    while len(e) < N:
        e.append(e[-1] - 0.005 * S @ (np.repeat(gains, 3) * e[-1 - d]))
    e = np.array(e) + 1e-4 * rng.normal(size=(N, 6))
    return {"hands": e[:, :3], "feet": e[:, 3:]}


def test_the_limit_of_one_task_binds_all(tmp_path, capsys):
    """The task that is too fast is named, not one that swings along; units do not decide."""
    for gains, hidden, change in (
        ((62.0, 10.0), 10.0, ("hands",)),
        ((10.0, 62.0), 62.0, ("feet",)),
        ((62.0, 10.0), 30.0, ("hands", "feet")),  # too large as well, hidden behind the first
    ):
        signals, known = coupled(gains), {"hands": gains[0], "feet": hidden}
        found = diagnose_tasks(signals, 0.005, alpha=known)
        assert found.change == change and 0.04 / 0.005 < found.recommended_alpha < monotone(4) / 0.005
        assert diagnose_tasks(signals | {"feet": np.rad2deg(signals["feet"])}, 0.005, alpha=known).change == change
    assert change[0] in diagnose_tasks(signals, 0.005).change  # also where no gain is known
    both = diagnose_tasks(dict.fromkeys("ab", signals[change[0]]), 0.005, alpha={"a": 62.0, "b": 10.0}).tasks["b"]
    assert both.factor == pytest.approx(both.recommended_alpha / 10.0)  # of its own gain
    alone = diagnose_tasks({change[0]: signals[change[0]], "rest": np.zeros((900, 1))}, 0.005, alpha={change[0]: 5.0})
    assert alone.change == () and str(alone).endswith(f"above {alone.recommended_alpha:.4g} 1/s.")
    head = ",".join(f"{name}.{axis}" for name in signals for axis in "xyz")
    np.savetxt(tmp_path / "log.csv", np.hstack([*signals.values()]), delimiter=",", header=head, comments="")
    words = [f"{name}={gain}" for name, gain in known.items()]
    main(["diagnose", str(tmp_path / "log.csv"), "--Ts", "5ms", "--tasks", *words])
    assert f"No task may have an alpha above {found.recommended_alpha:.4g} 1/s: {change[0]}" in capsys.readouterr().out
