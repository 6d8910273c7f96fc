"""Builders that turn a user's words, tables and Python files into records: nothing is accepted silently."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik import problem as p
from cnclik import quantities
from cnclik.problem import names, problem_of
from cnclik.problem.options import NAME, OPTIONS
from cnclik.problem.tables import read_columns, read_points
from cnclik.task.build import orientation, pose, position
from tests.refusals import refusals


def test_the_papers_case_in_words():
    asked = {"reference": "line", "target": [0, 1], "q0": [0, np.pi / 2], "Ts": 0.1, "N": 30, "method": "CN"}
    made = p.problem_from("planar-clockwise:1,1", **asked)
    run = ck.solve(made.law, made.reference, made.q0, made.Ts, made.N, made.method, made.stage)
    rms = float(np.sqrt(np.mean(np.sum(np.asarray(run.e[1:]) ** 2, 1))))
    assert abs(rms - 1.89e-4) < 0.01e-4  # CN, M = 5, from the theory notes' independent program


@pytest.mark.parametrize("robot", ["panda", "planar:1,1,1"])
def test_defaults_begin_where_the_tip_is(robot):
    for reference in ("hold", "line", "circle", "lissajous"):
        made = p.problem_from(robot, reference=reference, damping=1e-3)
        tip = ck.forward(made.law.chain, made.q0)
        position, rotation = made.reference.curve(0.0)
        begins = np.abs(position - tip.position[: len(position)]).max() < 1e-12
        if rotation is not None:
            begins &= np.abs(rotation - tip.rotation).max() < 1e-12
        assert begins == (reference != "hold"), reference


def test_a_target_without_an_orientation_keeps_that_of_the_start():
    made = p.problem_from("panda", target=[0.4, 0.1, 0.5])
    start = ck.forward(made.law.chain, made.q0).rotation
    np.testing.assert_allclose(made.reference.curve(0.0)[1], start, atol=1e-12)


def test_a_future_may_be_unknown():
    for future in ("known", "unknown"):
        made = p.problem_from("planar:1,1", reference="circle", radius=0.3, future=future)
        assert made.reference.known == (future == "known")


def test_numbers_may_be_texts_with_a_unit():
    made = p.problem_from("planar:1,1", Ts="4ms", delay="34ms", measurement_delay="8ms", q0="0 90 deg", lag="20ms")
    assert (made.Ts, made.drive.delay, made.drive.measurement_delay, made.drive.lag) == (0.004, 8.5, 2, 0.02)
    np.testing.assert_allclose(made.q0, [0, np.pi / 2])
    for q0 in (["0deg", "90deg"], (0.0, "90 deg")):  # a sweep's file takes them
        np.testing.assert_allclose(p.problem_from("planar:1,1", q0=q0).q0, [0, np.pi / 2])
    assert p.problem_from("planar:1", q0=["90deg"], task="x").q0.shape == (1,)
    assert p.problem_from("planar:1,1", damping="20 mm").law.inverse == ck.damped(0.02)
    for options, told in (
        ({"q0": ["0deg", "1m"]}, "joint 'q2' is in rad, and m is given"),
        ({"q0": ["0deg", "nonsense"]}, "`q0` must be numbers, but is 'nonsense'"),
        ({"q0": ["0deg", "1 2 deg"]}, "`q0` must have 2 joint values, but has 3"),
        ({"q0": ["0deg", None]}, "`q0` must be an array of real numbers"),
        ({"delay": ["34ms"]}, "`delay` must be"),
        ({"delay": "34kg"}, r"but is '34kg' \(units: s, ms"),
        ({"delay": "34ms", "Ts": [0.1]}, "`Ts` must be a number"),
        ({"measurement_delay": "9ms"}, "`measurement_delay` must be an integer, but is '9ms'"),
    ):
        with pytest.raises(ck.ArgumentError, match=told):
            p.problem_from("planar:1,1", **options)


TASKS = {"pose": ("xyz", "xyz"), "position": ("xyz", ""), "orientation": ("", "xyz"), "xz": ("xz", ""), "rz": ("", "z")}


@pytest.mark.parametrize(("text", "axes"), [*TASKS.items(), ("xyrz", ("xy", "z")), (None, ("xyz", "xyz"))])
def test_tasks_by_name(text, axes):
    """Words mean the plane on a planar arm."""
    task = names.task_from(text, ck.panda())
    assert (task.position, task.orientation) == axes
    planar = {"pose": ("x", "y", "rz"), "position": ("x", "y"), "orientation": ("rz",), None: ("x", "y")}
    assert text not in planar or names.task_from(text, ck.planar_arm([1.0, 1.0])).names == planar[text]


def test_waypoint_files(tmp_path):
    text = "time,x,y,z,qw,qx,qy,qz\n# half way there\n0,0.3,0,0.5,0,1,0,0\n1,0.4,0.1,0.6,0,1,0,0"
    (tmp_path / "way.csv").write_text(text, encoding="utf-8-sig")  # as spreadsheets write it
    position, rotation = p.problem_from("panda", reference=str(tmp_path / "way.csv"), damping=0.01).reference.curve(1.0)
    np.testing.assert_allclose(position, [0.4, 0.1, 0.6], atol=1e-12)
    np.testing.assert_allclose(rotation, np.diag([1, -1, -1]), atol=1e-12)


def test_a_path_begins_at_the_tip_that_is_named():
    fork = ck.join(ck.planar_arm([1.0, 0.8]), ck.planar_arm([0.5]), prefix="b_", keep=True)
    for tip in ("tip", "b_tip"):
        made = p.problem_from(fork, tip=tip, task="xy", reference="circle", q0=[0.3, 0.8, 0.5])
        at = ck.forward(fork, made.q0, tip=tip).position[:2]
        np.testing.assert_allclose(made.reference.curve(0.0)[0], at, atol=1e-6)


def test_a_joint_may_stop_at_its_limit_in_one_step():
    made = p.problem_from("panda", damping=0.1, limits="bounded", Ts=0.5)
    assert float(made.law.limits.rate) == 2.0 and made.robot is None  # nor are meshes in a folder called panda


def test_waypoints_with_a_speed_in_place_of_times(tmp_path):
    file, asked = tmp_path / "way.csv", {"task": "xyz", "damping": 0.01}
    for head, first in (("x,y,z\n", ""), ("", ""), ("time,x,y,z\n", "0,")):
        file.write_text(f"{head}{first}0.3,0,0.4\n{first}0.3,0.4,0.1\n{first}0.3,0.4,0.6\n")
        curve = p.problem_from("panda", reference=str(file), speed="500mm/s", **asked).reference.curve
        np.testing.assert_allclose(curve.times, [0.0, 1.0, 2.0])
        np.testing.assert_allclose(curve(1.0)[0], [0.3, 0.4, 0.1], atol=1e-6)
    file.write_text("x,y,z\n0.3,0,0.4\n0.3,0,0.4\n")
    for options, told in (
        ({"speed": 0.5}, "points that differ, with a speed"),
        ({}, "have columns time x y z, or a --speed, but way.csv has x y z"),
    ):
        with pytest.raises(ck.ArgumentError, match=told):
            p.problem_from("panda", reference=str(file), **asked, **options)


@pytest.mark.parametrize(
    "text, told",
    [
        ("", "way.csv has none"),
        ("time,x,y,z,qw,qx,qy,qz", "two waypoints"),
        ("0,1,2,3", "two waypoints"),
        ("0,1,2,3\n1,1,2", "as many in every row"),
        ("0,1,2,3\n1,1,2,3\n0.5,1,2,3", "way.csv has times 0, 1, 0.5"),
        ("O.0,1,2,3\n1,1,2,3\n2,1,2,3", "row 1 of way.csv holds 'O.0'"),
        ("0,1,2,3\n1,1,2,x", "as many in every row"),
        ("0,1\n1,1", "have columns time x y z qw qx qy qz, in this order or by name, but way.csv has 2"),
        ("time,x,y,z,x\n0,1,2,3,4\n1,1,2,3,5", "name each column once, but way.csv has time x y z x"),
        ("0,1,2,3\n0,1,2,3", "increase"),
        ("-inf,1,2,3\n-inf,1,2,3", "increase"),
        ("0,1,2,3\n1,1,2,nan", "finite"),
    ],
)
def test_bad_waypoint_files(tmp_path, text, told):
    file = tmp_path / "way.csv"
    file.write_text(text)
    with pytest.raises(ck.ArgumentError, match=told):
        p.problem_from("panda", reference=str(file))


def test_every_option_has_a_help_and_takes_its_units():
    assert set(OPTIONS) >= {"robot", "q0", "alpha", "delay", "smoothed"} and OPTIONS["alpha"].default == 5.0
    for name, option in OPTIONS.items():
        assert len(option.help) > 10 and option.help[0].isupper(), name
        if option.kind != NAME and option.unit not in ("1",):
            assert quantities.units(option.unit), name
        for text, (factor, _) in quantities.units(option.unit).items():
            found = quantities.read(f"2 {text}", option.unit, Ts=0.5)
            over = 0.5 if option.unit == quantities.SAMPLES and text not in ("sample", "samples") else 1.0
            assert found == pytest.approx([2 * factor / over]), (name, text)


test_what_does_not_fit_is_named = refusals(
    ({"robot": "planar:"}, "planar:1,1,1"),
    ({"robot": "planar:1,1", "task": "pose"}, "`task` must have at most 2 coordinates, one per joint"),
    ({"robot": "planar:1,-1"}, "at least 0"),
    ({"task": ""}, "`task`"),
    ({"task": ["x"]}, "`task`"),
    ({"reference": "circle", "speed": 0.1}, "`speed` must be left out for the reference 'circle'"),
    ({"period": 2.0}, "`period` must be left out for the reference 'hold'"),
    ({"robot": "planar"}, "`robot` must give link lengths such as planar:1,1,1"),
    ({"robot": "panda:1"}, "`robot` must be panda, but is 'panda:1'"),
    ({"reference": "circle", "radius": 0}, "positive"),
    ({"reference": "circle", "task": "orientation"}, "`reference` .* without position"),
    ({"reference": "lissajous", "task": "rz"}, "`reference` .* without position"),
    ({"reference": "circle", "task": "xrz"}, "`reference` must be hold, .* of one coordinate of a position, but is"),
    ({"reference": "line", "period": 0}, "`period`"),
    ({"alpha": [1, 2]}, "alpha"),
    ({"N": 0}, "N"),
    ({"method": "BDF"}, "method"),
    ({"stage": "picrad"}, "did you mean 'picard'"),
    ({"M": -1}, "M"),
    ({"seed": 1.5}, "`seed` must be an integer, but is 1.5"),
    ({"damping": 0}, "damping"),
    ({"threshold": 0.1}, "`threshold` must come with `damping`"),
    ({"damping_ratio": 0.7}, "`damping_ratio` must come with a natural_frequency"),
    ({"future": "unkown"}, "`future` must be one of known, unknown, but is 'unkown' (did you mean 'unknown'?)"),
    ({"limits": "bounded"}, "`limits` must come with `damping`, such as 0.05, but comes without"),
    ({"sped": 3}, r"`option` must be one of .* \(did you mean 'speed'\?\)"),
    of=lambda **options: p.problem_from(**({"robot": "panda"} | options)),
)


W = Rotation.from_rotvec([[0.3, -1.1, 0.7], [0.1, 0.2, 2.9]]).as_quat(scalar_first=True)
P = np.array([[0.3, -0.2, 0.5], [0.4, 0.1, 0.45]])
VALUES = dict(zip(("x", "y", "z", "qw", "qx", "qy", "qz"), np.hstack([P, W]).T, strict=True))


def written(path, head, columns):
    lines = [",".join(f"{v:.17g}" for v in row) for row in np.stack(columns, 1)]
    path.write_text("\n".join([*[head] * bool(head), *lines]) + "\n", encoding="utf-8-sig")  # as spreadsheets do
    return path


def test_columns_have_names_in_any_order_or_their_order_without(tmp_path):
    for columns in itertools.islice(itertools.permutations(VALUES), 0, 5040, 631):
        file = written(tmp_path / "f.csv", ",".join(columns), [VALUES[name] for name in columns])
        for task, wanted in ((pose(), np.hstack([P, W])), (position("xy"), P), (orientation(), W)):
            np.testing.assert_array_equal(read_points("TARGETS", file, task)[1], wanted)
    file = written(tmp_path / "f.csv", "", [np.array([0.0, 2.0]), *VALUES.values()])
    times, points = read_points("reference", file, pose(), timed=True)
    np.testing.assert_array_equal(times, [0.0, 2.0])
    np.testing.assert_array_equal(points, np.hstack([P, W]))
    (tmp_path / "log.csv").write_text("# made by us\n\nt,state,q\n0,run,1.5\n1,,\n")
    columns, table = read_columns("LOG", tmp_path / "log.csv")
    assert columns == ("t", "state", "q")
    np.testing.assert_array_equal(table, [[0.0, np.nan, 1.5], [1.0, np.nan, np.nan]])


@pytest.mark.parametrize("slip", ["1_0", "０．５", "1٫5", "0x10", "1e", "--1", "${len}", "1d5", "½"])
def test_numbers_are_what_they_look_like(slip, tmp_path):
    (tmp_path / "f.csv").write_text(f"1,2,3\n{slip},2,3\n", encoding="utf-8")
    with pytest.raises(ck.ArgumentError, match="row 2 of f"):
        read_points("TARGETS", tmp_path / "f.csv", pose())
    with pytest.raises(ck.ArgumentError, match="`robot` must give link lengths"):
        ck.problem.problem_from(f"planar:1,{slip}")


TWO = """
import cnclik as ck
arm = ck.planar_arm([1.0, 0.8, 0.5])
def problem(alpha=5.0):
    tasks = ck.stack(hand=ck.position("xy"), rest=ck.joints())
    levels = ck.levels(["hand"], ["rest"], damping=(1e-3, 0.1))
    return ck.Law(arm, tasks, alpha=alpha, inverse=levels), None, [0.3, 0.5, 0.2]
"""
ONE = """
import cnclik as ck
def problem():
    law, drive = ck.Law(ck.panda(), ck.pose(), alpha=4.0), ck.Drive(delay=2.0, lag=0.05)
    return dict(law=law, drive=drive, Ts=0.004, N=7, method="EE")
"""


@pytest.fixture
def file(tmp_path):
    def write(text):
        (tmp_path / "cell.py").write_text(text)
        return tmp_path / "cell.py"

    return write


def test_a_stack_stays_where_it_starts_and_takes_options_that_are_its_arguments(file):
    made = problem_of(file(TWO.replace("alpha=5.0)", "alpha=5.0, Ts=0.01)")), alpha=3.0, Ts=0.02, N=5, delay=1.0)
    assert made.name == "cell" and float(made.law.alpha) == 3.0 and (made.Ts, made.N) == (0.02, 5)
    assert made.drive == ck.Drive(delay=1.0) and made.reference.still
    run = made.run()
    np.testing.assert_allclose(run.q[-1], [0.3, 0.5, 0.2], atol=1e-12)
    assert run["hand"].e.shape == (6, 2)


def test_what_the_file_says_holds_unless_an_option_is_given(file):
    made = problem_of(file(ONE))
    assert (made.Ts, made.N, str(made.method), made.drive) == (0.004, 7, "EE", ck.Drive(delay=2.0, lag=0.05))
    np.testing.assert_array_equal(made.q0, ck.problem.start_from(ck.panda(), ck.pose()))
    made = problem_of(file(ONE), N=3, method="CN", M=2, delay=0.0)
    assert (made.N, str(made.method), made.stage, made.drive) == (3, "CN", ck.picard(2), ck.Drive(lag=0.05))
    made = problem_of(file(ONE.replace("N=7", "stage=ck.chord(3)")), M=2, delay="34ms")
    assert made.stage == ck.chord(2) and made.drive.delay == 8.5  # of the file's iteration and sampling time
    same = problem_of(
        file("import cnclik as ck\ndef problem(): return ck.problem.problem_from('ur5', Ts=0.002, damping=0.1)")
    )
    assert same.Ts == 0.002 and same.name == "ur5" and same.law.chain.n == 6


@pytest.mark.parametrize(
    ("text", "options", "told"),
    [
        ("x = 1", {}, r"name a Python file with a function problem\(\), but cell.py has none"),
        ("x = (", {}, r"cell.py, line 1: SyntaxError: '\(' was never closed"),
        ("\nimport nothing_such", {}, "cell.py, line 2: ModuleNotFoundError: No module named 'nothing_such'"),
        ("def problem():\n    return 1 / 0", {}, "cell.py, line 2: ZeroDivisionError: division by zero"),
        ("def problem(): return 3", {}, "return a law, a reference and q0, as a tuple or a dict, but returns 3"),
        (ONE.replace("N=7", "steps=7"), {}, r"must be one of .*, but is 'steps'"),
        (ONE.replace("ck.pose()", "ck.position(tip='hand')"), {}, "cell.py, line 4: Argument 'tip' must be"),
        (ONE.replace("alpha=4.0", "gain=4.0"), {}, r"cell.py, line 4: .*'gain' \(did you mean 'alpha'\?\)"),
        (TWO.replace("0.2]", "0.2, 1]"), {}, "`q0` must have 3 joint values, but has 4"),
        (TWO, {"task": "xy"}, r"`task` must be an argument of problem\(\) in cell.py, or be left out"),
        (ONE.replace("N=7", "noise=[0.1, 0.2]"), {}, "`noise` must be a single number or have 6 numbers, but has 2"),
        (ONE.replace("N=7", "noise=[0, 0, 0, 0, 0, -0.1]"), {}, "`noise` must be at least 0, but is"),
        (TWO, {"Ts": -1.0}, "`Ts` must be positive"),
        (TWO.replace("alpha=5.0", "alpha=5.0, delay=2"), {"delay": "34ms"}, "a time, and no sampling time is given"),
        (TWO, {"lag": [0.1, 0.2]}, "`lag` must have 3 numbers, but has 2"),
    ],
)
def test_what_is_wrong_is_one_line(file, text, options, told):
    with pytest.raises(ck.ArgumentError, match=told) as error:
        problem_of(file(text), **options)
    assert "\n" not in str(error.value)


def test_a_file_may_import_what_is_beside_it(file):
    path = file("import beside_it\n" + TWO.replace("[1.0, 0.8, 0.5]", "beside_it.LENGTHS"))
    path.with_name("beside_it.py").write_text("LENGTHS = [1.0, 0.5, 0.25]\n")
    assert problem_of(path).law.chain.n == 3
