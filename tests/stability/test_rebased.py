"""Loops whose position commands begin at the measured joints: when no small gain is stable, and what is said then."""

import json

import numpy as np
import pytest
import scipy.linalg

import cnclik as ck
from cnclik import stability, tuning
from cnclik.cli import main
from cnclik.errors import ArgumentError
from cnclik.integrate.drive import Drive
from cnclik.stability.advice import advise
from cnclik.stability.rebased import INERTIA, bearable_delay, critical_delay, runs_away

TS = 1e-3
ARM = ck.planar_arm([1.0, 0.8])
LAW, Q = ck.Law(ARM, ck.position("xy"), alpha=5.0), np.array([0.3, 1.1])


def grows(w, ratio, late, z=1e-4, seconds=30.0):
    """Whether q swings up after a push, run in time with SciPy: q̈ + 2ζω₀q̇ + ω₀²(q − u) = 0, and u = (1 − z) q some
    whole samples ago."""
    a = np.array([[0.0, 1.0, 0.0], [-(w**2), -2 * ratio * w, w**2], [0.0, 0.0, 0.0]])
    phi = scipy.linalg.expm(a * TS)
    x, line = np.array([0.0, 1.0]), [0.0] * (late + 1)
    speed = np.empty(round(seconds / TS))
    for k in range(len(speed)):
        line[k % (late + 1)] = (1 - z) * x[0]
        u = line[(k - late) % (late + 1)]
        x = phi[:2, :2] @ x + phi[:2, 2] * u
        speed[k] = x[1]
        if abs(x[1]) > 1e6:
            return True
    third = len(speed) // 3
    return bool(np.abs(speed[-third:]).max() > np.abs(speed[third : 2 * third]).max())


@pytest.mark.parametrize(
    ("w", "ratio"),
    [(65.0, 0.45), (38.0, 0.25)]
    + [pytest.param(w, r, marks=pytest.mark.slow) for w in (30, 60) for r in (0.1, 0.4, 0.6)],
)
def test_the_law_of_instability_is_what_a_simulation_does(w, ratio):
    """Stable 4 % below the critical dead time, of which the hold has half a sample, and unstable 4 % above."""
    edge = critical_delay(w, ratio) / TS - 0.5
    assert not grows(w, ratio, int(0.96 * edge)) and grows(w, ratio, int(np.ceil(1.04 * edge)))


def test_it_is_a_root_of_the_equation_and_there_is_none_above_a_damping_ratio_of_0_71():
    for ratio in (0.05, 0.3, 0.5, 0.7):
        at = 1j * np.sqrt(2 - 4 * ratio**2)
        assert abs(at**2 + 2 * ratio * at + 1 - np.exp(-at * critical_delay(1.0, ratio))) < 1e-12
    assert critical_delay(30.0, [np.sqrt(0.5) + 1e-9, 2.0]).tolist() == [np.inf, np.inf]
    assert not grows(65.0, 0.75, 400)


def servo(delay, ratio=0.45, w=65.0, feedback="rebased", command="position"):
    return Drive(delay=delay, natural_frequency=w, damping_ratio=ratio, command=command, feedback=feedback)


@pytest.mark.parametrize("own", [False, True])
def test_no_gain_is_named_where_none_is_safe(own):
    """One line with the remedy, which names a gain; and `recommend` says why in words."""
    drive = servo(8.0, *((np.array([0.45, 1.2]), np.array([65.0, 80.0])) if own else ()))
    line = r"`feedback` must be commanded .* is rebased, with 8 samples \(80 ms\)"
    with pytest.raises(ArgumentError, match=line) as said:
        advise(LAW, None, Q, Ts=0.01, method="EE", drive=drive)
    assert "\n" not in str(said.value)
    found = ck.recommend(LAW, None, Q, Ts=0.01, method="EE", drive=drive)
    assert found.z_recommended == found.z_monotone == 0 and found.recommended == 0
    assert "none is recommended" in str(found) and 'feedback="commanded"' in str(found)
    for mended in (ck.replace(drive, feedback="commanded"), ck.replace(drive, feedback="measured", command="velocity")):
        assert advise(LAW, None, Q, Ts=0.01, method="EE", drive=mended).recommended.overshoot < 0.01


def test_the_command_line_says_so_in_one_line(capsys):
    servo = "--natural-frequency 65 --damping-ratio 0.45 --command position --feedback rebased"
    for more in ((), ("--json",)):
        with pytest.raises(SystemExit) as left:
            main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "8", *servo.split(), *more])
        told = capsys.readouterr()
        assert left.value.code == 2 and told.err.count("\n") == 1 and "feedback" in told.err and "1/s" not in told.out


@pytest.mark.parametrize(
    ("drive", "Ts"),
    [
        (servo(8.0), 0.002),
        (servo(2.0), 0.01),
        (servo(8.0, 1.2), 0.01),
        (Drive(delay=8, lag=0.03, command="position", feedback="rebased"), 0.01),
    ],
    ids=["short", "early", "damped", "lag"],
)
def test_a_gain_is_named_where_it_is_fine(drive, Ts):
    """Short sampling times, little dead time, enough damping: and a loop in time with it settles without overshoot."""
    said = advise(LAW, None, Q, Ts=Ts, method="EE", drive=drive)
    law = ck.replace(LAW, alpha=said.recommended_alpha)
    x = np.asarray(ck.forward(ARM, Q).position)[:2]
    run = ck.solve(law, ck.hold(x + np.array([1e-6, 0])), Q, Ts, round(3.0 / Ts), "EE", drive=drive)
    e = np.asarray(run.e)[:, 0] / 1e-6
    assert said.recommended_alpha > 0 and -e.min() < 0.02 and np.abs(e[-10:]).max() < 0.02


def test_what_is_safe_is_so_for_other_inertias_and_a_sample_more():
    """k_p and k_v stay, and the inertia is another: below the dead time that is named each such loop falls."""
    drive, Ts = servo(0.0), 0.01
    most = bearable_delay(drive, Ts)
    assert runs_away(servo(most + 1e-6), Ts) and not runs_away(servo(most - 1e-6), Ts)
    for share in (1 / INERTIA, 0.8, 1.0, INERTIA):
        late = critical_delay(65.0 / np.sqrt(share), 0.45 / np.sqrt(share)) / Ts - 0.5
        assert most + 1 <= late + 1e-9
        lighter = servo(most + 1, 0.45 / np.sqrt(share), 65.0 / np.sqrt(share))
        assert np.abs(stability.driven_factors(np.array([[-1e-3]]), lighter, Ts)).max() < 1


@pytest.mark.parametrize(
    "drive", [None, Drive(delay=3), servo(8.0, feedback="measured")], ids=["nothing", "delay", "servo"]
)
def test_isaac_lab_has_no_gain_where_the_servo_is_unknown_or_runs_away(drive):
    """And what must be known first, or what to do instead, is said; of damped servos a gain is."""
    line = advise(LAW, None, Q, Ts=0.01, method="EE", drive=drive).settings["Isaac Lab"]
    assert "no k_val" in line and "ik_params" not in line
    assert "commanded" in line if drive is not None and drive.order else "diagnose LOG.csv --step" in line
    for known in (servo(8.0, 1.2, feedback="measured"), Drive()):
        assert "ik_params" in advise(LAW, None, Q, Ts=0.01, method="EE", drive=known).settings["Isaac Lab"]


def test_numbers_of_velocity_servos_are_none_of_a_position_servo():
    """A lag of m/k_v says nothing of k_p: the same numbers of a position servo have a k_val and an alpha."""
    for numbers in (dict(lag=0.02), dict(natural_frequency=60.0, damping_ratio=1.2)):
        lines = [
            advise(LAW, None, Q, Ts=0.01, method="EE", drive=Drive(delay=2, command=command, **numbers)).settings
            for command in ("velocity", "position")
        ]
        assert "a velocity servo" in lines[0]["Isaac Lab"] and "ik_params" not in lines[0]["Isaac Lab"]
        assert "ik_params" in lines[1]["Isaac Lab"] and "MoveIt Servo" in lines[0]
        assert "a velocity servo" in lines[0]["UR servoj"] and "no alpha can be given" in lines[0]["UR servoj"]
        assert lines[1]["UR servoj"].startswith("alpha = ")


def test_tune_says_where_only_another_inertia_makes_the_loop_run_away():
    """With ζ = 0.75 no small gain swings; with twice the inertia it is 0.53, and from 136 ms on each does."""
    heavy, Ts = np.sqrt(INERTIA), 0.02
    edge = critical_delay(65.0 / heavy, 0.75 / heavy)
    late = int(1.1 * edge / TS)
    assert grows(65.0 / heavy, 0.75 / heavy, late) and not grows(65.0, 0.75, late)
    risky, safe = servo(TS * late / Ts, 0.75), servo(1.0, 0.75)
    loop = dict(Ts=Ts, N=25, method="EE", velocity_limit=None, conditions=tuning.Conditions(drive=risky))
    path = ck.line([1.0, 1.0], [1.01, 1.0], duration=0.5)
    found = tuning.tune(LAW, path, Q, descent=tuning.Descent(steps=2, starts=1), **loop)
    assert found.satisfied and found.after.radius < 1 and 'feedback="commanded"' in found.why
    assert 'feedback="commanded"' not in ck.replace(found, conditions=tuning.Conditions(drive=safe)).why
    for drive in (risky, safe):
        gain = stability.recommend(LAW, None, Q, Ts=Ts, method="EE", drive=drive).z_recommended
        assert (gain == 0) == (drive is risky)


@pytest.mark.parametrize("alpha", [3.0, 10.0])
def test_the_remedy_of_a_run_that_grew_is_no_gain_and_no_damping(alpha):
    """Damping and a clamp were named, which leave less of the gain. What is named ends the growth."""
    x, drive = np.asarray(ck.forward(ARM, Q).position)[:2], servo(8.0)
    law, path = ck.replace(LAW, alpha=alpha), ck.hold(x + np.array([0.02, 0.01]))
    run = ck.solve(law, path, Q, 0.01, 1300, "EE", drive=drive)
    said = stability.verdict(law, path, run, Ts=0.01, method="EE", drive=drive)
    assert [one.change for one in said.remedies] == [{"feedback": "commanded"}]
    mended = ck.solve(law, path, Q, 0.01, 1300, "EE", drive=ck.replace(drive, **said.remedies[0].change))
    assert np.linalg.norm(run.e[-1]) > 0.1 and np.linalg.norm(mended.e[-1]) < 1e-6


def test_json_leaves_out_what_rests_on_a_largest_gain_that_is_not_known(capsys):
    def told(*more):
        main(["stability", "planar:1,1", "--Ts", "0.01", "--delay", "3", "--method", "EE", "--json", *more])
        return json.loads(capsys.readouterr().out)

    known, lagging = told(), told("--lag", "0.05")
    names = ("largest_stable_alpha", "gain_margin")
    assert all(f'"{name}"' in json.dumps(known) and f'"{name}"' not in json.dumps(lagging) for name in names)
    assert "not_known" not in known and "lag or servo alone" in lagging["not_known"]
    assert "Record a step" not in lagging["not_known"]  # those who give a lag may have done just that
    assert lagging["recommended_alpha"] > 0 and lagging["recommended"]["overshoot"] < 0.01
