"""cnclik stability: numbers on the terminal, one line for what can't be used, figures and data in the folder."""

import json
import re

import numpy as np
import pytest

import cnclik as ck
from cnclik.cli import main
from cnclik.writing import LIST


def test_advice_on_the_terminal(capsys):
    main(["stability", "planar:1,1", "--alpha", "5", "--Ts", "0.1", "--method", "EE"])
    out = capsys.readouterr().out
    assert re.search(r"largest stable, if[\w ]* +│ +20 │ +2 │", out)  # 2/Ts
    assert re.search(r"fastest without[\w ,]* +│ +10 │ +1 │", out)
    assert "gain (alpha = 5 1/s) is stable on the assumed drives: it may grow by a factor of " in out
    # What is assumed comes before the numbers, with the command that measures it.
    assert 0 < out.index("30 ms of dead time and a lag of 100 ms") < out.index("cnclik diagnose LOG.csv --step")
    assert out.index("cnclik diagnose") < out.index("largest stable")


def test_a_posture_drawn_to_too_fast_for_explicit_euler(capsys):
    """1 − κ Ts = −2, or so, by explicit Euler; e^(−κ Ts) by the exponential step, which is then advised alone."""
    fast = ["stability", "planar:1,1,1", "--posture", "0.1", "0.4", "0.6", "--posture-rate", "30", "--Ts", "0.1"]
    fast += ["--delay", "0"]
    main(fast)
    out = capsys.readouterr().out
    assert len(re.findall(r"│ +none │\n", out)) == 3 and "elsewhere" not in out
    with pytest.raises(SystemExit) as left:
        main([*fast, "--method", "EE"])
    said = capsys.readouterr().err
    assert left.value.code == 2 and said.count("\n") == 1
    assert "`null_velocity` must leave some gain stable" in said and re.search(r"by 1\.9\d* each step", said)


def advice(capsys, *options):
    main(["stability", "ur5", *map(str, options), "--json"])
    return json.loads(capsys.readouterr().out)


def test_advice_for_an_arm_with_17_samples_of_dead_time(capsys):
    """2 sin(π/70) and 17¹⁷/18¹⁸ per sample of 2 ms; recommended 18¹⁸/19¹⁹; behind a ramp by 1/alpha."""
    said = advice(capsys, "--Ts", 0.002, "--delay", 17, "--speed", 0.25, "--method", "EE")
    assert said["largest_stable_alpha"] == pytest.approx(1000 * np.sin(np.pi / 70), rel=1e-6)
    assert said["fastest_monotone_alpha"] == pytest.approx(500 * 17.0**17 / 18.0**18, rel=1e-5)
    assert said["recommended_alpha"] == pytest.approx(500 * 18.0**18 / 19.0**19, rel=1e-5)
    assert said["explicit_euler"]["largest_stable_alpha"] == said["largest_stable_alpha"]
    assert said["recommended"]["lag"] == pytest.approx(1 / said["recommended_alpha"], rel=2e-3)
    assert said["recommended"]["overshoot"] < 1e-3 and said["recommended"]["delay_margin"] > 1
    assert said["recommended_method"] in ck.METHODS and said["stable"] and said["drive"]["delay"] == 17


def test_advice_where_nothing_is_known_of_the_drives(capsys):
    """Any gain is stable by an exponential step, and one is recommended that a servo of k_p/k_v = 10 bears, 30 ms late:
    at most 1/(4·(0.1 + 0.03)), and a tenth more, of a loop whose lag and dead time were one."""
    said = advice(capsys, "--Ts", 0.002)
    assert said["largest_stable_alpha"] is None and said["assumed_dead_time"] == pytest.approx(0.03)
    assert said["assumed_lag"] == 0.1 and 1 / (4 * 0.13) < said["recommended_alpha"] < 1.15 / (4 * 0.13)
    assert said["recommended"]["overshoot"] < 0.01 and "no k_val can be given" in said["settings"]["Isaac Lab"]
    assert said["now"]["overshoot"] > 0.05  # of alpha = 5 on these drives
    said = advice(capsys, "--Ts", 0.002, "--delay", 0, "--method", "EE")
    assert said["assumed_dead_time"] is None and said["recommended_alpha"] == pytest.approx(125, rel=1e-6)
    assert said["assumption"].startswith("Assumed: the drives follow at once, without dead time")
    said = advice(capsys, "--Ts", 0.01, "--delay", 3, "--method", "EE")  # no word of a lag: what it would mean is told
    least = float(re.search(r"at most ([\d.]+) 1/s", said["assumption"])[1])
    with_lag = advice(capsys, "--Ts", 0.01, "--delay", 3, "--lag", 0.1, "--method", "EE")
    assert least == pytest.approx(with_lag["recommended_alpha"], rel=5e-3) and least < 0.3 * said["recommended_alpha"]
    assert with_lag["assumption"] == ""


def test_the_largest_stable_gain_of_a_servo_is_not_told(capsys):
    """Its joints' inertia is coupled: only a recording of all of them says between which gains it lies."""
    main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "3", "--lag", "0.05", "--method", "EE"])
    out = capsys.readouterr().out
    assert re.search(r"largest stable +│ +not known │", out) and "times this gain" not in out and "--step" in out
    exactly = "With drives exactly as given the loop stays stable with "
    assert re.search(exactly + r"[\d.]+ samples \([\d.]+ ms\) more dead time\.", out)
    assert "is stable with drives exactly as given: the dead time may grow by" in out
    rebased = ["--command", "position", "--feedback", "rebased"]
    main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "3", "--lag", "0.05", "--method", "EE", *rebased])
    assert f"{exactly}any dead time." in capsys.readouterr().out


def test_a_servo_leaves_a_tenth_of_the_gain(capsys):
    """A position servo of k_v = 400 on 3.7 kg m² is stable to k_v/m = 108 1/s in a fast loop; MuJoCo's UR5 to 109."""
    m, k_p, k_v = 3.7, 2000.0, 400.0
    servo = ("--natural-frequency", np.sqrt(k_p / m), "--damping-ratio", k_v / (2 * np.sqrt(k_p * m)))
    said = advice(capsys, "--Ts", 0.002, *servo, "--command", "position", "--method", "EE", "--alpha", 1.04 * k_v / m)
    assert not said["stable"] and said["now"] is None and "dead time and drive" in said["limit"]
    below = advice(capsys, "--Ts", 0.002, *servo, "--command", "position", "--method", "EE", "--alpha", 0.96 * k_v / m)
    assert below["stable"] and "largest_stable_alpha" not in below  # of one joint's inertia alone: not told
    own = advice(capsys, "--Ts", 0.002, *servo, "--command", "position", "--feedback", "commanded", "--method", "EE")
    assert own["largest_stable_alpha"] == pytest.approx(1000, rel=1e-6)
    assert own["recommended"]["lag_fed_forward"] == pytest.approx(k_v / k_p, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--method", "EULER"], "EXP-RK4, but is 'EULER' (did you mean 'EE'?)."),
        (["--map", "--cells", "1"], "Option `--cells` must be at least 2, but is 1."),
        (["--Ts-range", "1ms", "9ms"], "Option `--Ts-range` must come with --map, which it is for, but comes without."),
        (["--gains", "a", "b"], "Option `--gains` must come with --map, which it is for, but comes without."),
        (["--cells", "8"], "Option `--cells` must come with --map, which it is for, but comes without."),
        (["--out", "mine"], "Option `--out` must come with --plane or --map, which write into it, but comes without."),
        (["--N", "3"], "Option `--N` must be at least 4, but is 3."),
        (["panda", "--map", "--Ts-range", "0.1", "0.01"], "Option `--Ts-range` must increase, but is 0.1 to 0.01."),
        (["planar:1,1", "--target", "3", "0"], "Option `--target` must be one the loop comes to rest on"),
    ],
)
def test_user_errors_are_one_line(arguments, line, capsys):
    with pytest.raises(SystemExit) as left:
        main(["stability", *arguments])
    assert left.value.code == 2
    said = capsys.readouterr().err.strip()
    assert line in said and "\n" not in said


def test_joint_values_beyond_their_limits_are_remarked_on(capsys):
    """`solve` judges such a run; advice was given without a word."""
    beyond = map(str, [0, 0, 0, -1.5, 0, 4.0525, 0])
    with pytest.raises(SystemExit):  # for --gains, before anything runs
        main(["stability", "panda", "--map", "--gains", "a", "b", "--q0", *beyond])
    assert "`--q0` has panda_joint6 0.3 rad beyond its limit." in capsys.readouterr().err


@pytest.mark.parametrize(("delay", "told"), [(None, "drives without delay"), (2.0, "2 samples (20 ms) of dead time")])
def test_the_title_of_a_map_has_the_drives_of_its_loops(delay, told):
    """Beside advice for assumed drives, the map showed another gain margin and not of which loop."""
    from cnclik.cli.stability import titled

    found = ck.problem_from("planar:1,1", Ts=0.01, **({} if delay is None else {"delay": delay}))
    assert titled("planar", found).startswith(f"planar\n{told}")


def test_map_writes_labelled_data_and_figures(tmp_path, capsys, monkeypatch):
    import xarray as xr

    small = ["--cells", "8", "--passes", "2", "--Ts", "0.1"]
    main(["stability", "planar:1,1", "--method", "IE", "--map", *small, "--out", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map.nc", "map.png", "passes.nc", "passes.png"]
    with xr.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as data:
        assert data.ending.dims == ("Ts", "alpha") and data.sizes == {"Ts": 8, "alpha": 8}
        np.testing.assert_allclose(data.limit, 1 / data.Ts, rtol=1e-6)  # picard(5)
        assert '"robot": "planar:1,1"' in data.attrs["config"]
    assert "64 loops" in capsys.readouterr().out
    monkeypatch.setattr("cnclik.stability.maps.stability_map", None)
    for name in ("passes.png", "passes.nc"):  # in the way: said before the work
        (tmp_path / name).write_text("mine")
        with pytest.raises(SystemExit):
            main(["stability", "planar:1,1", "--method", "IE", "--map", *small, "--out", str(tmp_path)])
        assert f"{name} there is not cnclik's own" in capsys.readouterr().err


def test_map_through_a_drive_agrees_with_its_boundary(tmp_path, capsys):
    import xarray as xr

    drive = ["--Ts", "0.01", "--delay", "3", "--lag", "0.05", "--N", "300"]
    main(["stability", "planar:1,1", "--method", "EE", "--map", *drive, "--cells", "10", "--out", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["map.nc", "map.png"]
    with xr.open_dataset(tmp_path / "map.nc", engine="h5netcdf") as data:
        assert data.ending.attrs["flag_meanings"].split()[3] == "DIVERGED"
        beyond = data.alpha / data.limit
        assert (data.ending.where(beyond > 1.1, 3) == 3).all() and (data.ending.where(beyond < 0.9, 0) < 2).all()
        assert ((beyond > 1.1).any(), (beyond < 0.9).any()) == (True, True)
        z = data.limit * data.Ts
        assert z.max() > 1.2 * z.min()  # a lag has a time of its own: no hyperbola
    assert "100 loops" in capsys.readouterr().out


def test_plane_writes_the_limits_of_every_M_and_of_late_errors(tmp_path, capsys):
    main(["stability", "--plane", "--methods", "EE", "IE", "--passes", "2", "--out", str(tmp_path)])
    assert sorted(p.name for p in tmp_path.iterdir()) == [LIST, "plane.md", "plane.nc", "plane.png"]
    text = (tmp_path / "plane.md").read_text(encoding="utf-8")
    assert "| IE | picard(1) | 1.0000 |" in text and "| IE | picard(2) | 1.3532 |" in text
    assert "| EE | 2.0000 | 1.0000 | 0.6180 | 0.4450 | 0.3473 |" in text


def test_a_loop_too_slow_to_settle_is_not_said_to_settle(capsys):
    main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "6", "--lag", "40"])
    shown = " ".join(capsys.readouterr().out.split())
    assert "does not settle to within 2 % in the simulated time" in shown and "inf" not in shown
