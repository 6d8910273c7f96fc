"""What was asked stands above every answer: tip, dead time, start, target; what nobody gave is called default."""

import json
import re
import warnings

import numpy as np
import pytest

import cnclik as ck
from cnclik import errors
from cnclik.cli import main
from cnclik.cli.common import as_options
from cnclik.problem import heading
from cnclik.problem.build import problem_from
from cnclik.robot import poses

JAWED = """<robot name="hand"><link name="base"/><link name="arm"/><link name="wrist"/><link name="{jaw}"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" velocity="3"/></joint>
<joint name="j2" type="revolute"><parent link="arm"/><child link="wrist"/><origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>
  <limit lower="-2" upper="2" velocity="3"/></joint>
<joint name="{joint}" type="revolute"><parent link="wrist"/><child link="{jaw}"/><origin xyz="0.3 0 0"/>
  <axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="3"/></joint></robot>"""
VERBS = {
    "solve": ["--no-figures", "--N", "5", "--out", "out"],
    "tune": ["--no-figures", "--N", "5", "--steps", "2", "--out", "out"],
}


@pytest.mark.parametrize("verb", ["solve", pytest.param("tune", marks=pytest.mark.slow)])
def test_what_nobody_gave_is_said_and_called_default(verb, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main([verb, "planar:1,1", "--method", "EE", *VERBS[verb]])
    shown = " ".join(capsys.readouterr().out.split())
    assert "tip end of the last link" in shown and "10 ms" in shown and "no dead time given" in shown
    assert "Start: q0 = [-1.0576, 1.5654] rad (default)." in shown
    assert "Target x y = -0.20756 1.1731 m (default)." in shown  # every joint by 0.3 rad towards 0
    main([verb, "planar:1,1", "--method", "EE", "--Ts", "0.004", "--q0", "0.5", "1", "--target", "0.3", "1.2",
          "--alpha", "4", "--delay", "8", *VERBS[verb]])  # fmt: skip
    shown = " ".join(capsys.readouterr().out.split())
    assert "8 samples (32 ms) of dead time" in shown and "default" not in shown
    assert "q0 = [0.5, 1] rad." in shown and "Target x y = 0.3 1.2 m." in shown


def test_reach_and_export_begin_with_what_was_asked(capsys, tmp_path):
    main(["reach", "planar:1,1", "--target", "1", "0.5", "0", "--near", "0", "1", "--json"])
    assert json.loads(capsys.readouterr().out)["asked"][1:] == [
        "Target 1 0.5 0 m.",
        "Search within the joint limits from [0, 1] rad, to 1 µm and 1 µrad (default).",
    ]
    main(["reach", "panda", "--task", "orientation", "--target", "0", "1", "0", "0", "--json"])
    assert json.loads(capsys.readouterr().out)["asked"][1] == "Target 0 1 0 0, quaternion w x y z."
    main(["reach", "planar:1,1", "--random", "3", "--path", "--tolerance", "1mm", "1mrad"])
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith("planar:1,1, tip end of the last link, task ")
    assert shown[1:3] == [
        "Targets: 3 random reachable ones, seed 0.",
        "Search within the joint limits, each from the answer before it, to 1 mm and 1 mrad.",
    ]
    main(
        ["export", "planar:1,1", "--damping", "0.1", "--method", "EE", "--reference", "circle", "--out", str(tmp_path)]
    )
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].endswith("step in double, EE along circle")
    loop = "EE, damped, alpha = 5 1/s (default), z = alpha·Ts = 0.05 with Ts = 10 ms (default); Ts is an argument."
    assert shown[1] == loop
    assert shown[2].startswith("Start: q0 = ") and shown[3].startswith("Path circle, from x y")


@pytest.mark.parametrize(
    ("joint", "jaw"), [("gripper_joint", "tip"), ("j3", "left_finger"), ("jointGripper", "mover"), ("j3", "Jaw1")]
)
def test_a_jaw_that_nobody_chose_as_the_tip_is_remarked_on(joint, jaw, tmp_path):
    file = tmp_path / "hand.urdf"
    file.write_text(JAWED.format(joint=joint, jaw=jaw))
    with pytest.warns(
        errors.Remark, match=f"tip is '{jaw}', a gripper's jaw that joint '{joint}' moves. The tip 'wrist'"
    ):
        ck.load_urdf(file)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ck.load_urdf(file, tip=jaw).n == 3 and ck.load_urdf(file, tip="wrist").n == 2  # chosen
        file.write_text(JAWED.replace("arm", "upper_finger").replace("wrist", "knuckle").format(joint="j3", jaw="jaw"))
        assert ck.load_urdf(file, base="planar").n == 6  # a finger alone, on a base
    file.write_text(JAWED.replace("wrist", "knuckle").format(joint=joint, jaw=jaw))
    with pytest.warns(errors.Remark, match="jaw that joint 'j2' moves. The tip 'arm' is the arm without the jaw"):
        ck.load_urdf(file)
    file.write_text(JAWED.replace("wrist", "gripper").format(joint="gripper", jaw="jaw"))  # as of an SO-ARM
    with pytest.warns(errors.Remark, match="jaw that joint 'gripper' moves. The tip 'gripper' is the arm without"):
        ck.load_urdf(file)


def test_the_command_line_says_once_that_the_tip_is_a_jaw(tmp_path, capsys):
    file = tmp_path / "hand.urdf"
    file.write_text(JAWED.format(joint="j3", jaw="left_finger"))
    main(["reach", str(file), "--random", "2", "--task", "xy", "--json"])
    said = capsys.readouterr()
    assert said.err.count("gripper's jaw") == 1 and '"remarks": ["The tip is' in said.out
    file.write_text(JAWED.format(joint="j3", jaw="flange"))
    main(["reach", str(file), "--random", "2", "--task", "xy"])
    said = capsys.readouterr()
    assert not said.err and "hand, tip flange, task x y" in said.out
    main(["reach", str(file), "--tip", "flange", "--random", "2", "--task", "xy"])  # "hand flange, tip flange" it was
    assert capsys.readouterr().out.startswith("hand, tip flange, task x y\n")


def test_a_stacks_joints_that_slide_and_turn_have_both_units(tmp_path):
    robot, stack = tmp_path / "hand.urdf", tmp_path / "stack.toml"
    robot.write_text(JAWED.format(joint="j3", jaw="flange").replace("revolute", "prismatic", 1))
    stack.write_text('[tasks.hand]\ntask = "x"\ntip = "flange"\n[tasks.rest]\ntask = "joints"')
    made = problem_from(robot=str(robot), stack=str(stack), alpha=2.0, damping=0.1, q0=[0.1, 0.2, 0.3])
    assert heading.start_and_target(made, {})[-1].endswith("hold from 0.1 0.2 0.3 m, rad (default).")


def test_drives_are_said_and_that_joints_have_their_own():
    made = problem_from("planar:1,1", Ts=0.01, delay=2.0, measurement_delay=1, lag=[0.01, 0.05], smoothing=0.5)
    said = "2 samples (20 ms) of dead time, measured 1 sample (10 ms) late, a lag of 10 to 50 ms, error filtered with"
    assert heading.drive_words(made) == f"{said} ρ = 0.5"
    made = problem_from("planar:1,1", natural_frequency=30.0, damping_ratio=0.4, command="position", feedback="rebased")
    said = "a servo of 30 rad/s, ζ = 0.4, position commands, commands from the measured joints"
    assert heading.drive_words(made) == said
    assert heading.drive_words(problem_from("planar:1,1")) == "no dead time given"
    assert heading.drive_words(problem_from("planar:1,1", delay=0.0)) == "ideal drives"


@pytest.mark.slow
def test_a_tip_that_was_chosen_is_named_once_by_tune(tmp_path, capsys):
    (file := tmp_path / "hand.urdf").write_text(JAWED.format(joint="j3", jaw="flange"))
    main(["tune", str(file), "--tip", "flange", "--task", "xy", "--out", str(tmp_path / "tuned"), *VERBS["tune"][:-2]])
    assert "hand, tip flange, task x y, " in capsys.readouterr().out


def test_numbers_of_a_run_have_no_powers_of_ten(capsys, tmp_path):
    """ "1.67e+05 % of a joint's limit, up to 1.67e+03 times it; 0 µs a step; 0.00918 µm"."""
    file, run = tmp_path / "hand.urdf", ["--task", "xy", "--no-figures", "--out", str(tmp_path / "out")]
    file.write_text(JAWED.format(joint="j3", jaw="flange").replace('velocity="3"', 'velocity="0.001"'))
    main(["solve", str(file), "--q0", "0.5", "0.9", "0.2", "--alpha", "20", "--target", "0.3", "0.2", *run])
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"up to [\d.]+ rad/s \(j2\), \d{1,3},\d{3} times its limit ", said), said
    assert said.index("Target x y") < said.index("velocity limit, by") < said.index("position error")  # the answer
    assert re.search(r"exceed a joint's velocity limit, by up to \d{1,3}(,\d{3})+ %", said), said
    main(["solve", str(file), "--q0", "0.5", "0.9", "0.2", "--reference", "circle", "--radius", "0.05", *run])
    said = " ".join(capsys.readouterr().out.split())
    assert re.search(r"the error is at most [\d.]+ nm", said) and not re.search(r" 0 µs|e-\d+ µ", said), said


@pytest.mark.slow
def test_a_path_may_begin_where_the_arm_is_not_or_the_arm_on_the_path(tmp_path, capsys):
    way = tmp_path / "way.csv"
    way.write_text("time,x,y\n0,0.8,0.9\n2,0.5,1.1\n")
    run = ["solve", "planar:1,1", "--reference", str(way), "--N", "3", "--no-figures", "--out", str(tmp_path / "out")]
    main([*run, "--q0", "0.3", "0.9"])
    shown = capsys.readouterr().out
    here = np.array(ck.forward(ck.planar_arm([1.0, 1.0]), np.array([0.3, 0.9])).position)[:2]
    jump = 1e3 * np.linalg.norm(here - [0.8, 0.9])
    assert f"from x y = 0.8 0.9 m; the start is {jump:.3g} mm away from it (--begin on-path begins there)." in shown
    main([*run, "--q0", "0.3", "0.9", "--begin", "on-path"])
    shown = capsys.readouterr().out
    assert "rad (on the path)." in shown and "away from it" not in shown
    with pytest.raises(SystemExit):
        way.write_text("time,x,y\n0,8,0.9\n2,0.5,1.1\n")
        main([*run, "--begin", "on-path"])
    assert "`--begin` must be q0 for a path that begins where the arm doesn't reach" in capsys.readouterr().err


@pytest.mark.parametrize("task", ["pose", "position", "orientation", "xyrz"])
def test_a_loop_begins_on_its_path_for_any_task(task):
    q0 = np.array([0.4, -1.1, 1.3, -0.5, 0.7, 0.2])
    at = ck.forward(ck.ur5(), q0 + 0.3)
    end = [*np.array(at.position), *poses.quaternions(at.rotation)]
    first = end[3:] if task == "orientation" else end if task in ("pose", "xyrz") else end[:3]
    made = problem_from("ur5", task=task, reference="line", start=first, q0=q0, begin="on-path", N=2)
    run = made.run()
    assert np.abs(np.array(run.e[0])).max() < 1e-5
    assert np.abs(np.array(made.q0) - q0).max() < 1.0  # near it


@pytest.mark.parametrize(
    ("python", "option"),
    [
        ("use inverse=damped(0.066), and run for N=500 steps", "--inverse damped --damping 0.066, and run for --N 500"),
        ("with error_clamp=(0.1, 0.05)", "with --error-clamp 0.1 0.05"),
        ("use stage=chord(2)", "use --stage chord --M 2"),
        ('use method="EXP-MIDPOINT", which has', "use --method EXP-MIDPOINT, which has"),
        ("by limits=velocity_scaling() or limits=bounded().", "by --limits velocity-scaling or --limits bounded."),
        ("period=-12.5 s (left out, it grows with N)", "--period -12.5 s (left out, it grows with N)"),
        (
            "FrameTask(gain=0.5), dt=0.1, jerk=1e-4, drive=ck.Drive()",
            "FrameTask(gain=0.5), dt=0.1, jerk=1e-4, drive=ck.D",
        ),
    ],
)
def test_options_that_the_library_writes_as_python_are_those_of_the_command_line(python, option):
    assert option in as_options(python)
