"""Errors of a stack's tasks: whose gain makes them swing, told from those that swing along."""

import json

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.diagnosis import diagnose_tasks
from tests.diagnosis.recordings import monotone, stable
from tests.oracles import robot_file

TS, DELAY = 0.005, 4


def coupled(rng, gains, N=300, noise=1e-4):
    """Errors (N, 6) of two tasks of three coordinates that share joints, and J J# of them."""
    J = rng.normal(size=(6, 9))
    S = J @ J.T @ np.linalg.inv(J @ J.T + 0.09 * np.eye(6))
    e = [0.05 * rng.normal(size=6)] * (DELAY + 1)
    while len(e) < N:
        e.append(e[-1] - TS * S @ (np.repeat(gains, 3) * e[-1 - DELAY]))
    return np.array(e) + noise * rng.normal(size=(N, 6)), S


@pytest.mark.parametrize("fast", [0, 1])
def test_the_task_that_is_too_fast_is_told_from_one_that_swings_along(fast):
    rng, gains = np.random.default_rng(3), np.array([10.0, 10.0])
    gains[fast] = 62.0
    names = ["hands", "feet"]
    e, _ = coupled(rng, gains)
    signals, alpha = dict(zip(names, np.split(e, 2, axis=1), strict=True)), dict(zip(names, gains, strict=True))
    found = diagnose_tasks(signals, TS, alpha=alpha)
    assert found.change == (names[fast],) and found.share[names[fast]] > 0.98
    assert 0.04 / TS < found.recommended_alpha < 0.09 / TS
    assert names[1 - fast] not in found.factor and f"{names[fast]}: ringing, " in str(found)
    assert names[fast] in diagnose_tasks(signals, TS).change  # also where no gain is known


@pytest.mark.slow
def test_random_stacks():
    """Of stacks of two or three tasks, one of which is too fast for 1 to 7 samples of dead time, under noise."""
    rng, told = np.random.default_rng(7), []
    for _ in range(60):
        d, m, tasks = int(rng.integers(1, 8)), int(rng.integers(2, 4)), int(rng.integers(2, 4))
        J = rng.normal(size=(m * tasks, int(rng.integers(m * tasks - 1, m * tasks + 5))))
        S = J @ J.T @ np.linalg.inv(J @ J.T + rng.uniform(0.05, 0.5) ** 2 * np.eye(len(J)))
        z, fast = np.full(tasks, 0.6 * monotone(d)), int(rng.integers(tasks))
        z[fast] = stable(d) * rng.uniform(0.75, 0.98)
        gains = np.repeat(z, m)
        if np.linalg.eigvals(S * gains).real.max() < 0.7 * stable(d):
            continue  # it gets so little of what it asks for that nothing swings
        e = [0.05 * rng.normal(size=len(J))] * (d + 1)
        while len(e) < 250:
            e.append(e[-1] - S @ (gains * e[-1 - d]))
        e = np.array(e) + 2e-4 * rng.normal(size=(250, len(J)))
        names = [f"t{i}" for i in range(tasks)]
        signals = dict(zip(names, np.split(e, tasks, axis=1), strict=True))
        found = diagnose_tasks(signals, TS, alpha=dict(zip(names, z / TS, strict=True)))
        told.append(found.change == (names[fast],))
    assert len(told) > 40 and np.mean(told) > 0.9, np.mean(told)


def test_the_limit_of_one_task_binds_tasks_that_do_not_swing_and_units_do_not_decide():
    """A second gain that is too large, hidden behind the first; errors in degrees are larger numbers."""
    e, _ = coupled(np.random.default_rng(4), np.array([62.0, 10.0]))
    signals = {"hands": e[:, :3], "feet": e[:, 3:]}
    found = diagnose_tasks(signals, TS, alpha={"hands": 62.0, "feet": 30.0})
    assert found.change == ("hands", "feet") and found.recommended_alpha < 0.09 / TS
    assert f"No task may have an alpha above {found.recommended_alpha:.4g} 1/s." in str(found)
    signals["feet"] = np.rad2deg(signals["feet"])
    assert diagnose_tasks(signals, TS, alpha={"hands": 62.0, "feet": 10.0}).change == ("hands",)


def test_no_named_gain_is_above_what_one_task_tolerates():
    """The hands get two thirds of what they ask for here, and may get all of it elsewhere."""
    e = [np.full(3, 0.05)] * (DELAY + 1)
    while len(e) < 150:
        e.append(e[-1] - TS * 0.66 * np.array([85.0, 85.0, 10.0]) * e[-1 - DELAY])
    signals = {"hands": np.array(e)[:, :2], "feet": np.array(e)[:, 2:]}
    found = diagnose_tasks(signals, TS, alpha={"hands": 85.0, "feet": 10.0})
    assert found.change == ("hands",) and 0.04 / TS < found.recommended_alpha < monotone(DELAY) / TS, found


def test_a_share_is_what_the_gain_does_to_the_mode():
    """∂ log z/∂ log k of a task is its part of K e² in the mode (norm of weights and levels)."""
    K = np.array([62.0] * 3 + [50.0] * 3)
    _, S = coupled(np.random.default_rng(5), np.array([62.0, 50.0]), N=10)

    def largest(gains):
        z, modes = np.linalg.eig(S @ np.diag(gains))
        return z.real.max(), modes[:, np.argmax(z.real)].real

    (z, mode), more = largest(K), np.r_[np.full(3, 1e-6), np.zeros(3)]
    slope = (largest(K * (1 + more))[0] / z - 1) / 1e-6
    np.testing.assert_allclose(np.sum((K * mode**2)[:3]) / np.sum(K * mode**2), slope, rtol=1e-4)
    t = np.arange(200)[:, None]
    e = mode * 0.98**t * np.cos(0.33 * t)
    found = diagnose_tasks({"hands": e[:, :3], "feet": e[:, 3:]}, TS, alpha={"hands": 62.0, "feet": 50.0})
    assert found.share["hands"] == pytest.approx(slope, abs=0.02)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Two arms, one of them too fast for four samples of dead time, each target a step away."""
    robot, tips = ck.load_urdf(robot_file("baxter"), tips=["left_gripper", "right_gripper"]), {}
    q = np.linspace(0.2, 0.8, robot.n)
    arms = ck.stack(
        left=ck.position(tip="left_gripper"), right=ck.position(tip="right_gripper", relative_to="left_gripper")
    )
    law = ck.Law(robot, arms, alpha={"left": 62.0, "right": 8.0}, inverse=ck.damped(0.01))
    for tip in ("left_gripper", "right_gripper"):
        tips[tip] = ck.forward(robot, q, tip=tip)
    away = ck.hold(tips["left_gripper"].position + np.array([0.01, 0.02, -0.01]))
    paths = ck.hold_at(robot, arms, q, left=away)
    run = ck.solve(law, paths, q, TS, 200, "EE", drive=ck.Drive(delay=DELAY))
    file = tmp_path_factory.mktemp("log") / "log.csv"
    head = "time," + ",".join(f"{name}.{axis}" for name in ("left", "right") for axis in "xyz")
    e = np.asarray(run.e) + 1e-5 * np.random.default_rng(0).normal(size=run.e.shape)
    np.savetxt(file, np.column_stack([TS * np.arange(len(e)), e]), delimiter=",", header=head, comments="")
    return file


def test_a_log_of_two_arms(log, tmp_path, capsys):
    main(["diagnose", str(log), "--tasks", "left=62", "right=8", "--out", str(tmp_path)])
    told = capsys.readouterr().out
    assert (
        "left: ringing" in told and "No task may have an alpha above" in told and (tmp_path / "diagnose.png").exists()
    )
    main(["diagnose", str(log), "--tasks", "left", "right", "--json"])
    said = json.loads(capsys.readouterr().out)
    assert said["change"][0] == "left" and 0.1 < said["factor"]["left"] < 0.3  # no gain is known
    # As `cnclik solve --csv` writes them, tasks are found by themselves.
    own = tmp_path / "trajectory.csv"
    head, rows = log.read_text().split("\n", 1)
    own.write_text(",".join(c if c == "time" else f"e_{c}" for c in head.split(",")) + "\n" + rows)
    main(["diagnose", str(own), "--json"])
    assert json.loads(capsys.readouterr().out)["change"][0] == "left"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--tasks", "left=fast"], "`--tasks` must give gains as positive numbers"),
        (["--tasks", "left=62", "left=8"], "`--tasks` must name each task once, but names left twice"),
        (["--tasks", "lfet"], "`--tasks` must have columns such as lfet.x in LOG"),
        (["--tasks", "left", "--alpha", "5"], "`--alpha` must be left out with --tasks; gains are given as"),
        (["--tasks", "left", "--step"], "`--step` must be left out with --tasks"),
    ],
)
def test_what_does_not_fit_is_named(options, told, log, capsys):
    with pytest.raises(SystemExit):
        main(["diagnose", str(log), *options])
    assert told in capsys.readouterr().err


def test_gains_that_are_no_table_are_refused():
    with pytest.raises(ck.ArgumentError, match=r"`alpha` must be {task: gain}, but is 3"):
        diagnose_tasks({"a": np.zeros(50)}, 0.01, alpha=3)
