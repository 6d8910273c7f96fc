"""Sweeps over stacks of tasks: tables in the spec or in a file, options that are expressions or axes of their own."""

import tomllib

import jax
import numpy as np
import pytest

import cnclik as ck
from cnclik import sweeps
from cnclik.errors import ArgumentError
from cnclik.sweeps import check, files
from tests.oracles import close
from tests.robot.test_trees import BAXTER, GRIPPERS

TEXT = f"""
question = "Which gains?"
expectation = "These."
metrics = ["final_error", "final_position_error", "rest.final_error"]
[fixed]
robot = "{BAXTER}"
N = 5
method = "EE"
[tasks.hands]
task = "position"
tip = {GRIPPERS}
reference = "circle"
radius = "2*size"
period = "2 s"
damping = "10 * least"
[tasks.rest]
task = "joints"
target = "0 -45 0 45 0 45 0 0 -45 0 45 0 45 0 deg"
damping = 0.3
[axes]
least = [1e-3, 1e-2]
size = [0.05]
[axes.tasks]
hands.alpha = [5, 10, 20]
"""


def test_a_sweep_is_its_loops():
    """Every option of a task may be an expression, and an axis by its own name."""
    made = check.parse(tomllib.loads(TEXT))
    assert made.shape().shape == (2, 1, 3) and made.all_units()["tasks.hands.alpha"] == "1/s"
    text = TEXT.replace("damping = 0.3\n", "")
    units = check.parse(tomllib.loads(f"{text}rest.damping = [0.3]\n")).all_units()
    assert units["tasks.rest.damping"] == "1" and units["tasks.hands.alpha"] == "1/s"  # λ of joint values has no unit
    data = sweeps.run_spec(made)
    tables = {
        "hands": {"task": "position", "tip": GRIPPERS, "reference": "circle", "radius": "100mm", "period": 2.0,
                  "damping": 0.1, "alpha": 20.0},
        "rest": {"task": "joints", "target": np.deg2rad([0, -45, 0, 45, 0, 45, 0] * 2), "damping": 0.3},
    }  # fmt: skip
    with jax.enable_x64(True):
        run = ck.problem_from(BAXTER, tasks=tables, N=5, method="EE").run()
    close(data.final_error.values[1, 0, 2], np.linalg.norm(run.e[-1]), rtol=1e-9)
    close(data.final_position_error.values[1, 0, 2], np.linalg.norm(run["hands"].e[-1]), rtol=1e-9)
    close(data["rest.final_error"].values[1, 0, 2], np.linalg.norm(run["rest"].e[-1]), rtol=1e-9)
    assert data["rest.final_error"].attrs["long_name"] == "rest: error ‖e‖, at the end"
    assert len(np.unique(data.final_error)) == 6


def test_a_file_of_tasks_may_be_an_axis(tmp_path):
    head, tasks, axes = TEXT.partition("[tasks.hands]")[0], "[tasks.hands]" + TEXT.partition("[tasks.hands]")[2], ""
    tasks = tasks.partition("[axes]")[0].replace("2*size", "50mm").replace('"10 * least"', "0.1")
    (tmp_path / "one.toml").write_text(tasks)
    (tmp_path / "two.toml").write_text(tasks.replace("50mm", "90mm"))
    axes = '[axes]\nstack = ["one.toml", "two.toml"]\nq0 = { samples = 2, low = -0.1, high = 0.1 }\n'
    (tmp_path / "spec.toml").write_text(head + axes)
    made = files.read(tmp_path / "spec.toml")
    data = sweeps.run_spec(made)
    assert data.final_error.shape == (2, 2) and len(made.data()["files"]) == 3


def test_numbers_of_a_files_tasks_may_be_axes(tmp_path):
    """Gains, weights and dampings: of a stack in a file as of one in the spec, and with names to be read."""
    head, tasks = TEXT.partition("[tasks.hands]")[0], TEXT.partition("[tasks.hands]")[2].partition("[axes]")[0]
    tasks = "[tasks.hands]" + tasks.replace("2*size", "50mm").replace("damping = 0.3", "")
    file = tasks.replace('damping = "10 * least"', "damping = 0.1").replace("[tasks.hands]", "[tasks.hands]\nalpha = 3")
    (tmp_path / "stack.toml").write_text(file)  # whose alpha the axis stands for
    axes = "hands.alpha = [5, 10]\nrest.damping = [0.2, 0.3]\nhands.weights = [[1, 1, 1], [1, 1, 2]]"
    inside = head + tasks.replace('damping = "10 * least"', "damping = 0.1") + f"[axes.tasks]\n{axes}\n"
    (tmp_path / "spec.toml").write_text(
        head.replace("N = 5", 'N = 5\nstack = "stack.toml"') + f"[axes.tasks]\n{axes}\n"
    )
    data = sweeps.run_spec(files.read(tmp_path / "spec.toml"))
    same = sweeps.run_spec(check.parse(tomllib.loads(inside)))
    np.testing.assert_array_equal(data.final_error, same.final_error)
    assert len(np.unique(data.final_error)) == 8 and data["tasks.rest.damping"].attrs["long_name"] == "λ of rest"


WALLS = """
[walls.side]
task = "x"
above = "1000 mm"
[walls.bend]
joints = "q3"
below = "3*bend"
rate = "(1 - exp(-6*Ts))/Ts"
[axes]
bend = [0.8, 0.9]
limit_rate = [5, 10]
[axes.walls]
side.margin = ["0 mm", "50 mm"]
side.rate = [20, 30]
"""
HEAD = """
question = "Which walls?"
expectation = "These."
metrics = ["wall_distance", "final_error"]
[fixed]
robot = "planar:1,1,1"
q0 = [-1.2, 0.4, 0.4]
N = 10
method = "EE"
"""
PLACE = """
[tasks.place]
task = "position"
damping = 0.02
target = [0.3, 2.0]
"""


def test_numbers_of_walls_may_be_axes(tmp_path):
    """A wall's margin and rate, and the rate of limits, as expressions and axes; of a file as of a spec."""
    made = check.parse(tomllib.loads(HEAD + PLACE + WALLS))
    assert [made.all_units()[f"walls.side.{key}"] for key in ("margin", "rate")] == ["m", "1/s"]
    data = sweeps.run_spec(made)
    assert data["walls.side.rate"].attrs["long_name"] == "rate of side" and data.wall_distance.shape == (2,) * 4
    walls = {
        "side": {"task": "x", "above": 1.05, "rate": 30.0},
        "bend": {"joints": "q3", "below": 2.7, "rate": -100 * np.expm1(-0.06)},
    }
    place = {"place": {"task": "position", "damping": 0.02, "target": [0.3, 2.0]}}
    with jax.enable_x64(True):
        loop = ck.problem_from("planar:1,1,1", tasks=place, walls=walls, N=10, method="EE", q0=[-1.2, 0.4, 0.4])
        run = loop.run()
    close(data.wall_distance.values[1, 1, 1, 1], ck.wall_distance(loop.law, run.q).min(), rtol=1e-9)
    assert np.all(np.ptp(data.wall_distance.values, axis=(2, 3)) > 1e-4)
    (tmp_path / "stack.toml").write_text(PLACE + "[walls.side]\ntask = 'x'\nabove = '1000 mm'\nmargin = 3\n")
    (tmp_path / "spec.toml").write_text(HEAD + 'stack = "stack.toml"\n[axes]\nlimit_rate = [5, 10]\n')
    sets = ["axes.walls.side.rate=[20, 30]", "axes.walls.side.margin=['50 mm']"]
    of_file = files.read(tmp_path / "spec.toml", sets)
    assert list(of_file.axes) == ["limit_rate", "walls.side.rate", "walls.side.margin"]
    (wall,) = of_file.build(**of_file.first(last=True)).law.limits.walls
    assert (wall.rate, wall.offset) == (30.0, 1.05)
    levels = check.parse(tomllib.loads(HEAD + PLACE + WALLS + "[axes.tasks]\nplace.level = [1, 2]\n"))
    assert levels.axes["tasks.place.level"].labels == (1, 2) and levels.all_units()["tasks.place.level"] == "1"
    assert len(levels.grid().programs) == 2
    for change, told in (
        (("side.rate", "sid.rate"), r"`axes.walls.sid.rate` must be one of side, bend"),
        (("side.rate", "bend.rate"), r"`axes.walls.bend.rate` must not be in \[walls.bend\] as well"),
        (("3*bend", "3*bent"), "`walls.bend.below` must use names that have a value"),
        (("below =", "belo ="), "`walls.bend` must hold known keys, but holds 'belo'"),
    ):
        with pytest.raises(ArgumentError, match=told):
            check.parse(tomllib.loads(HEAD + PLACE + WALLS.replace(*change)))
    with pytest.raises(ArgumentError, match="`metrics` must be ones of a law with walls"):
        check.parse(tomllib.loads(HEAD + PLACE + "[axes]\nalpha = [1, 2]\n"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("radius", "raduis"), r"`tasks.hands` must hold known keys, but holds 'raduis' \(did you mean 'radius'"),
        (
            ("2*size", "2*sise"),
            r"`tasks.hands.radius` must use names that have a value, but uses 'sise' \(did you mean",
        ),
        (("hands.alpha", "hand.alpha"), r"`axes.tasks.hand.alpha` must be one of hands, rest, but is 'hand'"),
        (
            ("[axes.tasks]", "[axes.walls]\ntable.margin = [0, 1]\n[axes.tasks]"),
            r"`axes.walls.table.margin` must have its table, \[walls.table\], but has none",
        ),
        (("hands.alpha", "hands.alhpa"), r"`axes.tasks.hands.alhpa` must be one of .* \(did you mean 'alpha'"),
        (
            ("hands.alpha = [5,", "hands.damping = [5,"),
            r"`axes.tasks.hands.damping` must not be in \[tasks.hands\] as well",
        ),
        (("hands.alpha = [5,", "hands.alpha = [-5,"), "`axes.tasks.hands.alpha` must hold values that are at least 0"),
        (
            ("[axes.tasks]", "alpha = [1.0, 2.0]\n[axes.tasks]\nrest.alpha = [3]"),
            "`alpha` must be left out where every",
        ),
        (('method = "EE"', 'method = "EE"\ntask = "pose"'), "`task` must be left out with a stack"),
        (('method = "EE"', 'method = "EE"\nstack = "a.toml"'), "`tasks` must be left out where `stack` is given"),
        (
            ('method = "EE"', 'method = "EE"\n"tasks.rest.alpha" = 1'),
            "`fixed` must hold known keys, but holds 'tasks.rest.alpha'",
        ),
        (('method = "EE"', 'method = "EE"\nsiz = 1'), "`fixed` must hold known keys, but holds 'siz'"),
    ],
)
def test_what_is_refused(change, told):
    with pytest.raises(ArgumentError, match=told):
        check.parse(tomllib.loads(TEXT.replace(*change)))


def test_an_option_of_a_task_is_set_from_the_command_line(tmp_path):
    (tmp_path / "spec.toml").write_text(TEXT)
    made = files.read(tmp_path / "spec.toml", ["tasks.rest.damping=0.5", "tasks.hands.period=3 s"])
    assert made.tasks["rest"]["damping"] == 0.5 and made.tasks["hands"]["period"] == "3 s"


def test_the_reference_of_a_task_may_be_an_axis_of_names():
    spec = check.parse(
        {
            "question": "Which path?",
            "expectation": "None.",
            "fixed": {"robot": "planar:1,0.8", "Ts": 0.1, "N": 5, "damping": 0.2},
            "tasks": {"tip": {"task": "xy", "period": 1.0}, "rest": {"task": "joints"}},
            "axes": {"tasks": {"tip": {"reference": ["circle", "line"]}}, "alpha": [1.0, 2.0]},
        }
    )
    circle, line = (spec.build(**{"tasks.tip.reference": name, "alpha": 1.0}).reference for name in ("circle", "line"))
    assert [len(a) for a in spec.axes.values()] == [2, 2] and str(circle) != str(line)
