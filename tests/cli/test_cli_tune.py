"""`cnclik tune` as a user meets it."""

import json
import re

import numpy as np
import pytest

from cnclik.cli import main

ARM = ["tune", "planar-clockwise:1,1", "--reference", "line", "--from", "1", "1", "--to", "0", "1", "--q0", "0"]
ARM += [str(np.pi / 2), "--method", "EE", "--Ts", "0.1", "--N", "30", "--steps", "40"]
KEYS = {"alpha", "Ts", "N", "method", "values", "start", "bounds", "units", "margin", "ringing", "satisfied"}
KEYS |= {"before", "after", "loss", "status", "why", "gradient", "lines", "history", "conditions", "config"}


def tuned(tmp_path, *options):
    main([*ARM, *map(str, options), "--out", str(tmp_path)])
    return json.loads((tmp_path / "tuned.json").read_text())


def test_everything_a_controller_needs(tmp_path, capsys):
    made = tuned(tmp_path, "--margin", 0.5, "--damping", 0.01, "--ringing")
    assert set(made) >= KEYS
    assert made["config"]["margin"] == 0.5 and made["config"]["damping"] == 0.01 and made["config"]["steps"] == 40
    assert made["satisfied"] and 0.49 < made["after"]["radius"] <= 0.5 * (1 + 1e-9)
    np.testing.assert_allclose(made["after"]["z"], made["alpha"] * 0.1, rtol=1e-12)
    assert made["after"]["loss"] < made["before"]["loss"] and made["ringing"]
    # A rate: the line itself, run as a controller would, is the step of the loop that was tuned.
    import cnclik as ck

    arm, q = ck.planar_arm([1.0, 1.0], clockwise=True), np.array([0.1, 1.4])
    J, e, xdot_d = np.asarray(ck.jacobian(arm, q))[:2], np.array([0.03, -0.02]), np.array([-1 / 3, 0.0])
    J_damped = J.T @ np.linalg.inv(J @ J.T + 1e-4 * np.eye(2))
    line = made["lines"]["rate"].split("#")[0].removeprefix("qdot = ")
    qdot = eval(line, {"J_damped": J_damped, "e": e, "xdot_d": xdot_d})
    np.testing.assert_allclose(qdot, J_damped @ (xdot_d + made["alpha"] * e), rtol=1e-5)
    # pink and mink: a gain per step, at most 1. What they can't run isn't printed as something else.
    assert made["after"]["z"] > 1.4 and made["lines"]["pink_mink"].startswith("no line: z = 1.")
    summary = (tmp_path / "summary.md").read_text()
    for name in ("history", "error", "operating", "front", "responses"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000 and f"({name}.png)" in summary
    assert made["lines"]["rate"] in summary and "| constraints | kept |" in summary
    assert "Wrote" in capsys.readouterr().out


def test_a_gain_that_pink_and_mink_take(tmp_path, monkeypatch, capsys):
    """With a sample of dead time to spare z ends at 1/4. A figure that fails costs nothing that was found."""
    from cnclik.show import tuning

    def broken(*_):
        raise RuntimeError("no such font")

    monkeypatch.setattr(tuning, "drawings", lambda found: dict.fromkeys(("history", "error"), broken))
    with pytest.raises(SystemExit) as stopped:
        tuned(tmp_path, "--damping", 0.01)
    err = capsys.readouterr().err
    assert stopped.value.code == 1 and "no such font" in err.splitlines()[-1]
    made = json.loads((tmp_path / "tuned.json").read_text())
    assert "every constraint is kept" in (tmp_path / "summary.md").read_text() and not list(tmp_path.glob("*.png"))
    gain, dt, damping = (
        float(re.search(rf"{k}=([^,)]+)", made["lines"]["pink_mink"])[1]) for k in ("gain", "dt", "damping")
    )
    assert 0.2499 < gain <= 0.25005 and dt == 0.1 and made["satisfied"]
    np.testing.assert_allclose(damping, 1e-4)


def test_infeasible_margin_is_in_the_summary(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        tuned(tmp_path, "--margin", 0.5, "--damping", 0.01, "--alpha-bounds", 0.1, 1, "--no-figures")
    made, out = json.loads((tmp_path / "tuned.json").read_text()), capsys.readouterr().out
    assert not made["satisfied"] and made["status"] == "infeasible" and 0.7 < made["after"]["violation"] < 0.9
    assert (
        stopped.value.code == 1
        and "# Not tuned" in out
        and "Assumed: the drives follow at once, without dead time, lag or servo" in out
    )
    assert (
        "| constraints | NOT kept, " in out and "## Nothing for a controller\n\nThe constraints are NOT kept, " in out
    )
    assert all(line.startswith("no line") for line in made["lines"].values()) and "qdot" not in out


@pytest.mark.slow
def test_a_path_that_no_gain_makes_slow_enough_is_the_cause(tmp_path, capsys):
    """A metre in the 0.3 s of the run, at 1 rad/s: as told, whatever the gain; with a period of 9 s it is tuned."""
    short = ["--N", "3", "--velocity-limit", "1", "--steps", "10", "--no-figures", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as stopped:
        main([*ARM, *short])
    out = capsys.readouterr().out
    assert stopped.value.code == 1 and "Worst, the bound on joint velocity is exceeded by" in out
    assert re.search(r"The path itself takes \d+ % of a joint's velocity limit, with nearly no gain", out)
    assert "This run lasts 0.3 s" in out and "--period" in out and "For a controller" not in out
    main([*ARM, *short, "--period", "9"])
    assert "For a controller" in capsys.readouterr().out


DRIVE = ["--delay", 1, "--command", "position", "--no-figures", "--lag"]


@pytest.mark.slow
def test_the_slowest_joint_decides_as_where_all_are_as_slow(tmp_path):
    each, slow = (tuned(tmp_path, *DRIVE, *lags) for lags in ((0.05, 0.2), (0.2,)))
    assert each["satisfied"] and each["after"]["z"] == pytest.approx(slow["after"]["z"], rel=1e-6)
    assert each["after"]["delay_margin"] == pytest.approx(slow["after"]["delay_margin"], rel=1e-6)
    assert each["after"]["radius"] >= slow["after"]["radius"] - 1e-9


def test_a_drive_for_each_joint_as_a_fit_prints_it(tmp_path):
    made = tuned(tmp_path, *DRIVE, 0.2, 0.2)
    rows = [line.strip("| ").split(" | ") for line in (tmp_path / "summary.md").read_text().splitlines() if "|" in line]
    names = [row[0] for row in rows]
    assert len(names) == len(set(names))  # each is said once, and is what tuned.json has
    said, before, after = dict(row for row in rows if len(row) == 2), made["before"], made["after"]
    room = after["delay_margin"]
    assert said["z = alpha·Ts"] == f"{after['z']:.5g} (before {before['z']:.5g})"
    assert (
        said["error removed per step"]
        == f"{100 * after['correction']:.4g} % (before {100 * before['correction']:.4g} %)"
    )
    assert said["stable with further dead time"] == f"up to {room:.4g} samples ({1e3 * room * made['Ts']:.4g} ms)"
    assert said["noise"] == f"1 mrad RMS of measurement noise moves the joints by {after['noise_gain']:.3g} mrad RMS"
    assert (
        said["dead time"].startswith("1 sample (")
        and said["drive"] == "250 ms behind its command, dead time included; order 1"
    )
    assert said["constraints"] == "kept"


@pytest.mark.parametrize(
    "options, told",
    [
        ("--loss trakcing", "did you mean 'tracking'"),
        ("--loss jerk=x", "weights as numbers"),
        ("--loss tracking=0", "weight above 0"),
        ("--loss tracking=1 tracking=2", "name each loss once"),
        ("--margin 1.5", "`--margin` must be at most 1"),
        ("--alpha-bounds 5 1", "must increase"),
        ("--over gian", "must be one of alpha"),
        ("--over damping", "a law that has damped(...) alone"),
        ("--over", "must be given values, but has no value"),
        ("--shape square", "shape"),
        ("--steps 0", "steps"),
        ("--delay -1", "`--delay` must be at least 0"),
        ("--delay-margin -1", "`--delay-margin` must be at least 0"),
        ("--noise-gain 0", "`--noise-gain` must be positive"),
        ("--lag 0.1 --over Ts", "not hold Ts where the drive has a lag"),
    ],
)
def test_one_line_and_exit_code_2(options, told, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        main([*ARM, *options.split(), "--out", str(tmp_path / "out")])
    err = capsys.readouterr().err
    assert stopped.value.code == 2 and err.count("\n") == 1 and told in err
    assert not (tmp_path / "out").exists()
