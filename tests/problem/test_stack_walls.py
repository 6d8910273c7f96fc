"""Walls in plain names: what the tables of a file build, where they are told of, and what is refused."""

import json

import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik.cli import main
from cnclik.engine.compiler import can_build
from cnclik.problem import OF_SHAPE, OF_WALL
from cnclik.sweeps.files import read
from tests.export.native import native
from tests.oracles import close
from tests.robot.test_trees import BAXTER, GRIPPERS

FILE = f"""
[tasks.hands]
task = "position"
tip = {GRIPPERS}
damping = 0.02

[walls.table]
task = "z"
tip = "{GRIPPERS[0]}"
above = "-300 mm"
margin = "5 mm"

[walls.apart]
distance = [{{ tip = "{GRIPPERS[0]}", radius = "80 mm" }}, {{ tip = "{GRIPPERS[1]}", center = "0 0 20 mm" }}]
rate = 20

[walls.pillar]
distance = [{{ radius = 0.1, from = [0.5, 0, -1], to = [0.5, 0, 1] }}, {{ tip = "left_lower_elbow", radius = 0.06 }}]

[walls.floor]
distance = [{{ normal = [0, 0, 2], offset = "-0.4 m" }}, {{ tip = "left_lower_elbow", radius = "60 mm" }}]
above = "20 mm"

[walls.elbow]
joints = "left_e1"
below = "120 deg"
margin = "2 deg"
"""
ELBOW = "left_lower_elbow"
TOGETHER = ck.load_urdf(BAXTER, tips=[*GRIPPERS, ELBOW])


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    found = tmp_path_factory.mktemp("walls") / "stack.toml"
    found.write_text(FILE)
    return found


def test_a_file_has_the_walls_by_hand(file):
    made = ck.problem_from(BAXTER, stack=file, limit_rate=4.0)
    left, right = (ck.sphere(tip, radius, at) for tip, radius, at in
                   ((GRIPPERS[0], 0.08, (0, 0, 0)), (GRIPPERS[1], 0.0, (0, 0, 0.02))))  # fmt: skip
    elbow = ck.sphere(ELBOW, 0.06)
    walls = [
        ck.wall(ck.position("z", tip=GRIPPERS[0]), above=-0.295),
        ck.wall(ck.distance(left, right), above=0.0, rate=20.0),
        ck.wall(ck.distance(ck.capsule(None, 0.1, (0.5, 0, -1), (0.5, 0, 1)), elbow), above=0.0),
        ck.wall(ck.distance(elbow, ck.half_space((0, 0, 1), -0.4)), above=0.02),
        ck.wall(ck.joints(["left_e1"]), below=np.deg2rad(118)),
    ]
    law = ck.Law(TOGETHER, made.law.task, alpha=5.0, inverse=ck.damped(0.02), limits=ck.bounded(4.0, walls=walls))
    q = np.random.default_rng(0).uniform(-1, 1, (20, TOGETHER.n))
    assert made.law.limits.rate == 4.0 and [w.rate for w in made.law.limits.walls] == [None, 20.0, None, None, None]
    assert made.law.chain.joint_names == TOGETHER.joint_names and made.walls["floor"]["above"] == 0.02
    close(ck.wall_distance(made.law, q), ck.wall_distance(law, q), atol=1e-12)
    assert ck.wall_distance(law, q[0]).shape == (5,) and np.ptp(ck.wall_distance(law, q), axis=0).min() > 0.1


def test_corners_of_feet_are_walls_of_the_centre_of_mass():
    corners, q = [[-0.1, -0.1], [0.2, -0.1], [-0.1, 0.1], [0.2, 0.1]], np.linspace(-0.4, 0.6, TOGETHER.n)
    table = {
        "corners": "-100 -100 200 -100 -100 100 200 100 mm",
        "relative_to": ELBOW,
        "margin": "10 mm",
        "rate": 7,
    }
    made = ck.problem_from(TOGETHER, tasks=HAND, walls={"soles": table}).law
    by_hand = ck.support_polygon(corners, relative_to=ELBOW, margin=0.01, rate=7.0)
    law = ck.Law(TOGETHER, made.task, alpha=5.0, inverse=ck.damped(0.02), limits=ck.bounded(walls=by_hand))
    close(ck.wall_distance(made, q), ck.wall_distance(law, q), atol=1e-12)
    assert [one.name for one in made.limits.walls] == [f"soles_{i}" for i in (1, 2, 3, 4)]
    assert all(one.rate == 7.0 for one in made.limits.walls)
    with pytest.raises(ck.ArgumentError, match=r"`walls` must have different names.* have 'soles_2' twice"):
        ck.problem_from(TOGETHER, tasks=HAND, walls={"soles": table, "soles_2": {"joints": "left_s0", "above": 0}})
    other = ck.problem_from(TOGETHER, tasks=HAND, walls={"soles": table | {"corners": corners}}).law
    close(ck.wall_distance(other, q), ck.wall_distance(made, q), atol=1e-12)


def test_walls_of_a_file_stay_where_a_sweep_varies_its_tasks(file, tmp_path):
    head = 'question = "q"\nexpectation = "e"\n'
    fixed = f'[fixed]\nrobot = "{BAXTER}"\nN = 4\nstack = "{file}"\n'
    (tmp_path / "s.toml").write_text(f"{head}{fixed}[axes]\ntasks.hands.alpha = [1, 2]\n")
    spec = read(tmp_path / "s.toml")
    assert len(spec.build(**{"tasks.hands.alpha": 1.0}).law.limits.walls) == 5 and "walls" in spec.data()


STACK = """
[tasks.place]
task = "position"
damping = 0.02
reference = "line"
to = [0.3, 2.0]
period = "1 s"

[walls.side]
task = "x"
above = "1000 mm"
rate = 30

[walls.bend]
joints = "q3"
below = 2.5
"""


def test_what_walls_do_is_said(tmp_path, capsys):
    (tmp_path / "stack.toml").write_text(STACK)
    loop = ["planar:1,1,1", "--stack", str(tmp_path / "stack.toml"), "--q0", "-1.2", "0.4", "0.4"]
    out = tmp_path / "out"
    main(["solve", *loop, "--N", "300", "--method", "EE", "--csv", "--no-figures", "--out", str(out)])
    shown = " ".join(capsys.readouterr().out.split())
    for words in ("wall side active in 2", " of 300 steps, passed by up to", "a step may pass it by",
                  "wall bend active in 0 of 300 steps, nearest", "Held back: wall side held in 2"):  # fmt: skip
        assert words in shown, words
    with xr.open_dataset(out / "trajectory.nc") as data:
        assert list(data.wall.values) == ["side", "bend"] and abs(data.walls.values[-1, 0]) < 1e-4
        assert "walls" in json.loads(data.attrs["config"])
    head, *rows = (out / "trajectory.csv").read_text().splitlines()
    assert head.endswith(",status,status_place,wall_side,wall_bend") and ",4," in rows[-2]
    main(["stability", *loop, "--delay", "2"])
    assert "wall side: 30 1/s (z = 0.3), overshoots: without overshoot up to 14.81 1/s." in capsys.readouterr().out


@pytest.mark.skipif(not can_build(), reason="no C compiler")
def test_a_step_behind_a_wall_is_exported(tmp_path):
    """Breaks where the rounds of descents behind walls have no bound that C knows."""
    (tmp_path / "stack.toml").write_text(STACK)
    made = ck.problem_from("planar:1,1,1", stack=tmp_path / "stack.toml", q0=[-1.2, 0.4, 0.4], N=150, method="EE")
    run, step = made.run(), native(made.law, made.reference, method="EE")
    assert np.sum(np.abs(run.walls[:, 0]) < 1e-6) > 20
    for k in range(0, 150, 5):
        close(step(run.q[k], run.t[k], made.Ts).q, run.q[k + 1], atol=1e-9)


HAND = {"hands": {"task": "position", "tip": GRIPPERS, "damping": 0.02}}


@pytest.mark.parametrize(
    ("wall", "options", "told"),
    [
        ({"task": "z"}, {}, "`walls.a.tip` must|`tip` must"),
        ({"task": "z", "tip": GRIPPERS[0]}, {}, "`walls.a.above` must be given, or `below`"),
        ({"tip": GRIPPERS[0], "above": 0}, {}, "`walls.a.task` must be given, or `joints`"),
        ({"task": "pose", "tip": GRIPPERS[0], "above": 0}, {}, "`walls.a.task` must be of positions"),
        ({"distance": [{}, {"radius": 1}]}, {}, "`walls.a.distance` must be of shapes on two links"),
        ({"joints": "left_s0", "above": 0, "below": 1}, {}, "`walls.a.above` must be given, .* but both are"),
        ({"joints": "left_s0", "above": 0.1}, {"limits": "velocity-scaling"}, "`limits` must be bounded, or be left"),
        ({"joints": "left_s0", "above": "10 mm"}, {}, "`walls.a.above` must have the units of what it is for"),
        ({"joints": "left_s0", "above": {"a": 1}}, {}, "`walls.a.above` must be a number"),
        ({"joints": "left_s0", "above": 0, "margin": -1}, {}, "`walls.a.margin` must be at least 0"),
        ({"joints": "left_s0", "above": 0, "rate": 0}, {}, "`walls.a.rate` must be positive"),
        ({"distance": [{"radius": 1}]}, {}, "`walls.a.distance` must be two tables"),
        ({"distance": [{"radius": 1}, 3]}, {}, "`walls.a.distance` must be a table of options"),
        ({"distance": [{"radius": 1}, {"size": 3}]}, {}, "`walls.a.distance` must hold known options"),
        ({"distance": [{"normal": [0, 0, 1]}] * 2}, {}, "`walls.a.distance` must be ck.sphere"),
        ({"distance": [{}, {"to": [0, 0, 1]}]}, {}, "`walls.a.distance.from` must be given for the shape 'capsule'"),
        ({"distance": [{}, {"normal": [0, 0, 1], "radius": 1}]}, {}, "`walls.a.distance.radius` must be left out for"),
        ({"distance": [{}, {"normal": [0, 0, 0]}]}, {}, "`walls.a.distance.normal` must be other than 0"),
        ({"distance": [{}, {}], "joints": "left_s0"}, {}, "`walls.a.joints` must be left out of a wall with `dist"),
        ({"distance": [{"tip": "hand"}, {}]}, {}, "must be one of the"),
        ({"corners": [[0, 0], [1, 0], [0, 1]], "above": 0}, {}, "`walls.a.above` must be left out of a wall"),
        ({"corners": [[0, 0], [1, 0], [2, 0]]}, {}, "`walls.a.corners` must be three or more that are not on one line"),
        ({"corners": "0 0 100 0 50 mm"}, {}, "`walls.a.corners` must be x and y of each corner, but are 5 numbers"),
        ({"corners": [[0, 0], [1, 0], [0, 1]], "margin": "2 deg"}, {}, "`walls.a.margin` must have the units of what"),
        ({"speed": 1}, {}, "`walls.a` must hold known options, but holds 'speed'"),
    ],
)  # fmt: skip
def test_what_is_refused(wall, options, told):
    robot = TOGETHER if "tip` must" not in told and "must be one of the" not in told else BAXTER
    with pytest.raises(ck.ArgumentError, match=told):
        ck.problem_from(robot, tasks=HAND, walls={"a": wall}, **options)


def test_walls_come_with_tasks():
    with pytest.raises(ck.ArgumentError, match="`walls` must come with `tasks`"):
        ck.problem_from("panda", walls={"a": {"task": "z", "above": 0.1}})
    with pytest.raises(ck.ArgumentError, match="`inverse` must be damped"):
        ck.problem_from(TOGETHER, tasks={"a": {"tip": GRIPPERS[0]}}, walls={"a": {"joints": "left_s0", "above": 0}})


def test_every_option_of_a_wall_says_what_it_is():
    assert all(one.help.endswith((".", "].")) for one in (OF_WALL | OF_SHAPE).values())
