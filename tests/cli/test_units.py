"""Numbers with a unit on the command line, and remarks on those that probably have another one."""

import json
import math
import warnings

import numpy as np
import pytest

import cnclik as ck
from cnclik import quantities
from cnclik.cli import arguments, diagnose, main, reach, solve, stability, tune
from cnclik.errors import Remark
from cnclik.problem.magnitudes import remark_on


def parsed(verb, *argv):
    return arguments.parse(verb.Args, argv, prog="cnclik", description="")


NUMBERS = [  # verb, arguments, option, values
    (solve, "--delay 34ms --Ts 4ms", "delay", 8.5),
    (solve, "--Ts 4 ms --delay 34 ms", "delay", 8.5),
    (solve, "--delay 34ms", "delay", 3.4),  # of the default sampling time
    (solve, "--delay 2", "delay", 2.0),
    (solve, "--delay=2samples", "delay", 2.0),
    (solve, "--Ts 0.002 --measurement-delay 6ms", "measurement_delay", 3),
    (solve, "--Ts 500us", "Ts", 5e-4),
    (solve, "--Ts 500µs", "Ts", 5e-4),
    (solve, "--lag 20ms 30ms", "lag", (0.02, 0.03)),
    (solve, "--lag 20 30 ms", "lag", (0.02, 0.03)),
    (solve, ["--q0", "0 -90 90 deg"], "q0", (0, -math.pi / 2, math.pi / 2)),
    (solve, "--q0 0 -90 90 deg", "q0", (0, -math.pi / 2, math.pi / 2)),
    (solve, "--q0 -90deg 0.1m", "q0", (-math.pi / 2, 0.1)),
    (solve, "--q0 -90 45 deg 100 mm", "q0", (-math.pi / 2, math.pi / 4, 0.1)),
    (solve, "--q0 0 0.5 -1", "q0", (0, 0.5, -1)),
    (solve, "--target 300 -300 500 mm 1 0 0 0", "target", (0.3, -0.3, 0.5, 1, 0, 0, 0)),
    (solve, "--target 30cm -300mm 0.5m", "target", (0.3, -0.3, 0.5)),
    (solve, "--radius 50mm", "radius", 0.05),
    (solve, "--phase 90deg", "phase", (math.pi / 2,)),
    (solve, "--natural-frequency 5Hz", "natural_frequency", (10 * math.pi,)),
    (solve, "--error-clamp 10mm 5deg", "error_clamp", (0.01, math.radians(5))),
    (solve, "--alpha 5 1/s", "alpha", (5.0,)),
    (reach, "--random 1 --tolerance 1mm 0.1deg", "tolerance", (1e-3, math.radians(0.1))),
    (reach, "--random 1 --near 0 90 deg --jump 30deg", "jump", math.radians(30)),
    (stability, "--speed 100mm/s", "speed", 0.1),
    (stability, "--Ts-range 1 10 ms", "Ts_range", (1e-3, 1e-2)),
    (tune, "--velocity-limit 90deg/s", "velocity_limit", (math.pi / 2,)),
    (diagnose, "--Ts 2ms", "Ts", 2e-3),
]


@pytest.mark.parametrize(("verb", "argv", "name", "wanted"), NUMBERS)
def test_a_number_may_have_a_unit(verb, argv, name, wanted):
    argv = argv.split() if isinstance(argv, str) else argv
    made = parsed(verb, "log.csv" if verb is diagnose else "panda", *argv)
    assert getattr(made, name) == pytest.approx(wanted, rel=1e-12)
    assert type(getattr(made, name)) is type(wanted) or verb is solve


def test_every_option_with_a_unit_takes_it():
    from cnclik.problem.options import NAME, SWEPT

    for name, option in SWEPT.items():
        if option.kind == NAME or option.unit in ("1", "J", "w"):
            continue
        for text, (factor, _) in quantities.units(option.unit).items():
            found = quantities.read(f"2 {text}", option.unit, Ts=0.5)
            over = 0.5 if option.unit == quantities.SAMPLES and text not in ("sample", "samples") else 1.0
            assert found == pytest.approx([2 * factor / over]), (name, text)


@pytest.mark.parametrize(
    ("argv", "told"),
    [
        ("--q0 0deg 90", "write a unit behind each number, or once at the end, apart"),
        ("--q0 0 90 dog", r"numbers, but is '0 90 dog' \(units: m, cm, mm, um, rad, mrad, deg\)"),
        ("--q0 deg", "but is 'deg'"),
        ("--Ts 4km", r"a number, but is '4km' \(units: s, ms, us\)"),
        ("--Ts 1_0", "but is '1_0': write 10"),
        ("--Ts 0,25", "but is '0,25': write 0.25"),
        ("--Ts ０．０１", "write 0.01|but is"),
        ("--N 1_0", "`--N` must be an integer, but is '1_0'"),
        ("--N 10ms", "`--N` must be an integer"),
        ("--Ts 4ms --measurement-delay 6ms", "`--measurement-delay` must be .*integer.*, but is '6ms', 1.5 samples"),
        ("--feedforward 1m", "`--feedforward` must be .*number.*, but is '1m'"),
    ],
)
def test_what_is_no_number_with_its_unit_is_refused(argv, told):
    with pytest.raises(ck.ArgumentError, match=told):
        parsed(solve, "panda", *argv.split())


def said(capsys, *argv):
    with pytest.raises(SystemExit) as left:
        main(list(argv))
    assert left.value.code == 2
    return capsys.readouterr().err


def test_units_fit_what_they_stand_behind(capsys, tmp_path):
    run = ["solve", "planar:1,1", "--N", "2", "--out", str(tmp_path / "out"), "--no-figures"]
    assert "joint 'q1' is in rad, and m is given" in said(capsys, *run, "--q0", "100mm", "0.2m")
    assert "number 1 is in m, and rad is given" in said(capsys, *run, "--noise", "5deg")
    assert "number 1 is in m, and rad is given" in said(
        capsys, "reach", "planar:1,1", "--random", "1", "--tolerance", "1deg", "1mm"
    )


IMPLAUSIBLE = [
    ("--delay 0.034", "`delay` is in samples: 0.034 samples (0.34 ms) of dead time. .* --delay 34ms"),
    ("--Ts 2", "`Ts` is 2 s, .* --Ts 2ms"),
    ("--lag 20", "`lag` is 20 s. .* --lag 20ms"),
    ("--q0 0 90", "`q0` has a joint at 90 rad, .* --q0 0 90 deg"),
    ("--posture 0 -45", "`posture` has a joint at -45 rad, .* --posture 0 -45 deg"),
    ("--target 300 800", "`target` has 800 m, and the arm is 2 m long. .* --target 300 800 mm"),
    ("--target 4 -5", "`target` has 5 m, and the arm is 2 m long. .* --target 4 -5 mm"),
    ("--reference circle --radius 50 --phase 90", "`phase` is 90 rad"),
    ("--reference circle --radius 50", "`radius` has 50 m"),
]


@pytest.mark.parametrize(("argv", "told"), IMPLAUSIBLE)
def test_what_is_implausible_is_remarked_on_and_done(argv, told):
    with pytest.warns(Remark, match=told.replace("(", r"\(").replace(")", r"\)")):
        _problem("planar:1,1", argv)


@pytest.mark.parametrize(
    "argv",
    ["--delay 0.5", "--delay 0", "--delay 3ms", "--Ts 1", "--Ts 2000ms", "--q0 0 90 deg", "--q0 6.28 -3", "--lag 1",
     "--target 0.3 1.2", "--target 2 3", "--target 300 1200 mm", "--q0 6rad 0rad"],
)  # fmt: skip
def test_what_is_plausible_or_has_a_unit_is_not(argv):
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        _problem("planar:1,1", argv)


@pytest.mark.parametrize("place", [[9.0, 0.0, 0.0], [-3.0, -3.0, 2.0]])
def test_lengths_are_those_from_where_the_arm_stands_and_those_of_slides_are_not_known(place):
    stands = ck.with_base(ck.from_dh([0.5, 0.5], [0.0, 0.0], [0.0, 0.0]), place)
    gantry = ck.from_dh([0.0] * 3, [np.pi / 2, np.pi / 2, 0.0], [0.0] * 3, kinds="PPP")
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        remark_on({"target": tuple(np.add(place, [0.9, 0.2, 0.0]))}, stands, ck.position(), 0.01, {})
        remark_on({"target": (4.0, 5.0, 1.0)}, gantry, ck.position(), 0.01, {})
    with pytest.warns(Remark, match="Millimetres"):
        remark_on({"target": (300.0, 200.0, 100.0)}, stands, ck.position(), 0.01, {})


def _problem(robot, argv):
    from cnclik.cli.problem import problem

    return problem(parsed(solve, robot, *argv.split()))


def test_remarks_are_on_stderr_and_in_json(capsys):
    main(["reach", "planar:1,1", "--random", "2", "--near", "0", "90", "--json"])
    told = capsys.readouterr()
    assert told.err.startswith("cnclik: `--near` has a joint at 90 rad") and told.err.count("\n") == 1
    assert json.loads(told.out)["remarks"] == [told.err.strip().removeprefix("cnclik: ")]
    main(["reach", "planar:1,1", "--random", "2", "--near", "0", "1", "--json"])
    told = capsys.readouterr()
    assert not told.err and json.loads(told.out)["remarks"] == []


ROBOTS = {
    "An angle of `alpha` is 90 rad": lambda: ck.from_dh([0.3, 0.0], [0.0, 90.0], [0.0, 0.0]),
    "An angle of `theta` is -180 rad": lambda: ck.from_dh([0.3], [0.0], [0.0], [-180.0]),
    "Joint 'q2' is 425 m from the joint before it: lengths are in metres": lambda: ck.from_dh(
        [425.0, 392], [0, 0], [0, 0]
    ),
    "The tip is 290 m": lambda: ck.from_screws([[0, 0, 0]], [[0, 0, 1]], [290, 0, 0]),
    "Joint 'q1' has a limit of -180 rad: angles": lambda: ck.from_dh([0.3], [0], [0], lower=[-180], upper=[180]),
    "Joint 'q1' has a velocity limit of 180 rad/s": lambda: ck.from_dh([0.3], [0], [0], velocity_limit=[180]),
    "The rpy of joint 'j' in the text is 90 rad": lambda: ck.load_urdf(
        '<robot name="a"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><origin rpy="0 0 90"/></joint></robot>'
    ),
}


@pytest.mark.parametrize("told", ROBOTS)
def test_a_robot_in_degrees_or_millimetres_is_remarked_on(told):
    with pytest.warns(Remark, match=told) as found:
        ROBOTS[told]()
    assert found[0].filename == __file__  # the user's own line


def test_targets_and_waypoints_of_a_file_in_millimetres_are_remarked_on(tmp_path, capsys):
    targets, way = tmp_path / "targets.csv", tmp_path / "way.csv"
    for row, remarked in (("300,-350,400", True), ("0.3,-0.35,0.4", False)):
        targets.write_text(f"x,y,z\n{row}\n")
        way.write_text(f"t,x,y,z\n0,{row}\n1,{row}\n")
        main(["reach", "panda", str(targets), "--task", "position"])
        said = "1 of 1 positions in targets.csv are far out of reach: up to 400 m"
        assert (said in capsys.readouterr().err) is remarked
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", Remark)
            _problem("panda", f"--task position --reference {way}")
        said = "2 of 2 positions in way.csv are far out of reach: up to 400 m"
        assert any(said in str(one.message) for one in found) is remarked


def test_each_door_remarks_on_a_sampling_time_in_milliseconds(tmp_path, capsys):
    log, spec = tmp_path / "log.csv", tmp_path / "spec.toml"
    log.write_text("q\n" + "\n".join(str(0.9**k) for k in range(40)))
    spec.write_text('question = "?"\nexpectation = "."\n[fixed]\nrobot = "planar"\nlengths = [1, 1]\ntask = "xy"\n'
                    "Ts = 4\nN = 2\ndelay = 0.03\n[axes]\nalpha = [1, 2]\n")  # fmt: skip
    main(["diagnose", str(log), "--Ts", "4"])
    assert "`--Ts` is 4 s, a controller slower than once a second. Milliseconds are written" in capsys.readouterr().err
    main(["diagnose", str(log), "--Ts", "4ms"])
    assert "Ts`" not in capsys.readouterr().err
    main(["sweep", "--check", str(spec)])
    told = capsys.readouterr().err
    assert "`Ts` is 4 s" in told and "`delay` is in samples: 0.03 samples (120 ms)" in told


def test_degrees_of_many_joints_are_said_once():
    joints = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="continuous"><parent link="{f"l{k - 1}" if k else "a"}"/>'
        f'<child link="l{k}"/><origin rpy="0 0 {90 if k else 0}"/></joint>' for k in range(6)
    )  # fmt: skip
    with pytest.warns(Remark) as found:
        ck.load_urdf(f'<robot name="a"><link name="a"/>{joints}</robot>')
    assert len(found) == 1 and str(found[0].message).startswith("The rpy of joint 'j1' in the text is 90 rad")


def test_robots_as_they_are_are_not():
    from cnclik.robot.tree import read_urdf
    from cnclik.robot.urdf import chain
    from tests.oracles import robots

    files = [
        f for f in robots().rglob("*.urdf") if f.stem in ("panda", "ur5_robot", "kinova", "talos_reduced", "tiago")
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error", Remark)
        ck.ur5(), ck.panda(), ck.planar_arm([1.0])
        for file in files:
            tree = read_urdf(file)
            for tip in tree.tips():
                chain(tree, tip)
    assert len(files) >= 4


def test_a_number_read_aloud_has_at_most_three_digits():
    """A wall was missed by "1e+03 mm/s"."""
    said = [quantities.aloud(v, "m") for v in (0.99996, -0.0009999, 9.996e-7, 0.0123, 3e-10, 0.0)]
    assert said == ["1 m", "-1 mm", "1 µm", "12.3 mm", "3e-10 m", "zero"]
    said = [quantities.aloud(0.00123, unit) for unit in ("rad/s, m/s", "1", "", "1/s")]
    assert said == ["0.00123 rad/s, m/s", "0.00123", "0.00123", "0.00123 1/s"]
