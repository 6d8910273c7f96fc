"""What each task of a stack bears, against loops that are run; what it gets of what it asks for; how levels leak."""

import json
import re
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import cnclik as ck
from cnclik.cli import main
from cnclik.problem.targets import at_targets
from cnclik.show.stability import gains
from cnclik.stability import tasks
from cnclik.stability.answer import does_of_tasks
from cnclik.stability.bounds import limit_advice
from cnclik.stability.linear import checked
from cnclik.stability.loop import LoopAtRest, Rates, resting
from cnclik.stability.tasks import LOST, half_shares
from cnclik.stability.verdict import verdict
from tests.oracles import robot_file

ARM = ck.planar_arm([1.0, 0.8, 0.6, 0.5, 0.4])
Q = np.array([0.3, 0.9, -0.5, 0.4, 0.8])
TS = 0.01


def stack(**weights):
    return ck.stack(
        tip=ck.position("xy", weights=weights.get("tip")),
        angle=ck.orientation("z", weights=weights.get("angle")),
        rest=ck.joints(weights=weights.get("rest")),
    )


def law_of(alpha, inverse, **weights):
    return ck.Law(ARM, stack(**weights), alpha=alpha, inverse=inverse)


LAWS = {
    "weighted": law_of({"tip": 20.0, "angle": 10.0, "rest": 5.0}, ck.damped(0.3), rest=[0.3, 0.2, 0.5, 0.3, 0.4]),
    "levels": law_of(
        {"tip": [15.0, 25.0], "angle": 10.0, "rest": 2.0},
        ck.levels(["tip"], ["angle", "rest"], damping=(0.01, 0.3)),
    ),
    "matrix": law_of({"tip": [[20.0, 5.0], [5.0, 10.0]], "angle": 8.0, "rest": 5.0}, ck.damped(0.2)),
}


def grows(law, name, factor, method, delay, q=Q):
    """Whether a small error grows in the run with one task's gain times a factor."""
    alpha = np.array(law.alpha)
    at = law.task.of(name)
    alpha[(at,) * alpha.ndim] *= factor
    drive, N = (ck.Drive(delay=delay), 3000) if delay else (None, 600)  # through dead time a loop grows slowly
    changed = ck.Law(law.chain, law.task, alpha=alpha, inverse=law.inverse)
    q0 = q + 1e-7 * np.cos(2.0 * np.arange(len(q)))
    run = ck.solve(changed, ck.hold_at(law.chain, law.task, q), q0, TS, N, method, drive=drive)
    size = np.linalg.norm(np.diff(run.q, axis=0), axis=1)  # what is lost to conflicts stays, and moves nothing
    late = np.nan_to_num(size[-100:], nan=np.inf).max()
    return bool(late > max(size[N // 3 : N // 3 + 50].max(), 1e-12))  # below it is rounding


WAYS = [("EE", 0), ("EE", 3), ("RK4", 2), ("EXP-EE", 4), ("AB2", 0)]
QUICK = [
    ("weighted", *WAYS[0]),
    ("levels", *WAYS[1]),
    ("matrix", *WAYS[2]),
    ("levels", *WAYS[3]),
    ("weighted", *WAYS[4]),
]


@pytest.mark.parametrize(
    ("name", "method", "delay"),
    [pytest.param(name, *way, marks=[pytest.mark.slow] * ((name, *way) not in QUICK)) for name in LAWS for way in WAYS],
)
def test_up_to_the_largest_gain_the_run_shrinks_and_beyond_it_grows(name, method, delay):
    law = LAWS[name]
    said = ck.advise(law, None, Q, Ts=TS, method=method, drive=ck.Drive(delay=delay)).stack
    for task, one in said.tasks.items():
        factor = one.largest_stable_alpha / one.alpha
        assert one.recommended_alpha <= one.fastest_monotone_alpha < one.largest_stable_alpha
        if factor == np.inf:  # of an exponential step that gets too little of what it asks for to grow
            assert method == "EXP-EE" and one.least < 0.5 and not grows(law, task, 1e3, method, delay)
            continue
        assert not grows(law, task, 0.99 * factor, method, delay)
        assert grows(law, task, 1.01 * factor, method, delay)
    room = {task: one.largest_stable_alpha / one.alpha for task, one in said.tasks.items()}
    assert said.least_room == min(room, key=room.get)


ROBOTS = {  # tips of hands, and of another task
    "baxter": (["left_gripper", "right_gripper"], None),
    "g1": (["left_rubber_hand", "right_rubber_hand"], "left_ankle_roll_link"),
    "pr2": (["l_gripper_palm_link", "r_gripper_palm_link"], "head_tilt_link"),
    "talos": (["gripper_left_base_link", "gripper_right_base_link"], "head_2_link"),
}


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("name", ROBOTS)
def test_robots(name, delay):
    hands, other = ROBOTS[name]
    robot = ck.load_urdf(robot_file(name), tips=hands + [other] * (other is not None))
    tasks = {"hands": ck.pose(tip=hands[0]) & ck.position(tip=hands[1]), "rest": ck.joints()}
    tasks |= {"other": ck.orientation(tip=other)} if other else {}
    levels = ck.levels(["hands"], [task for task in tasks if task != "hands"], damping=(0.01, 0.3))
    law = ck.Law(robot, ck.stack(**tasks), alpha=dict.fromkeys(tasks, 5.0), inverse=levels)
    low, high = (np.clip(v, -2.0, 2.0) for v in (robot.lower, robot.upper))
    q = 0.5 * (low + high) + 0.2 * (high - low) * np.cos(np.arange(robot.n))
    said = ck.advise(law, None, q, Ts=TS, method="EE", drive=ck.Drive(delay=delay)).stack
    for task, one in said.tasks.items():
        factor = one.largest_stable_alpha / one.alpha
        assert not grows(law, task, 0.99 * factor, "EE", delay, q) and grows(law, task, 1.01 * factor, "EE", delay, q)


def random_stack(rng):
    """Rows, dampings and gains of a random stack of two to four tasks; some in conflict, some unstable."""
    n, sizes = rng.integers(2, 9), rng.integers(1, 5, rng.integers(2, 5))
    rows = [rng.normal(size=(k, n)) * 10 ** rng.uniform(-1, 0.5) for k in sizes]
    if rng.random() < 0.5:
        rows[-1] = np.concatenate([rows[0], rows[-1]])[: sizes[-1]] + 1e-3 * rng.normal(size=(sizes[-1], n))
    alpha = np.repeat(10 ** rng.uniform(0, 2.4, len(sizes)), sizes)
    return np.concatenate(rows), np.repeat(10 ** rng.uniform(-2, 0, len(sizes)), sizes), alpha, sizes


@pytest.mark.slow
def test_random_stacks(monkeypatch):
    """No gain that is called safe grows, none called unstable by more than 1 % decays: explicit Euler, run in NumPy.
    Of a loop that is unstable those gains are named that must be lowered, and none else.

    Without what gains do in time, which has no part in it and takes 0.8 of the 0.9 s of a stack.
    """
    monkeypatch.setattr(tasks, "gain_of", lambda *_: None)
    rng, looked, several, limits = np.random.default_rng(0), 0, 0, {}
    for _ in range(2000):
        rows, root, alpha, sizes = random_stack(rng)
        columns, delay = rows.T @ np.linalg.inv(rows @ rows.T + np.diag(root**2)), int(rng.integers(0, 6))
        ends = np.cumsum([0, *sizes])
        parts = [ck.joints([f"j{i}_{k}" for k in range(size)]) for i, size in enumerate(sizes)]
        task = ck.stack(**{f"t{i}": part for i, part in enumerate(parts)})
        law = type(
            "Law",
            (),
            dict(chain=type("Chain", (), {"n": rows.shape[1]}), task=task, inverse=ck.damped(0.1), null_velocity=None),
        )
        rates = Rates(rows, columns, root, alpha, np.eye(len(rows)), np.linalg.svd(rows, False)[2].T)
        drive = ck.Drive(delay=delay)
        loop = LoopAtRest(law, None, None, ck.EE, None, float(alpha.max()), drive, {"rates": rates})
        if delay not in limits:
            limits[delay] = tasks.at_any_posture(loop, TS)
        said = tasks.stack_advice(loop, drive, limits[delay], TS)
        several += len(said.unstable) > 1
        beside = alpha.copy()
        for task in said.unstable:
            beside[law.task.of(task)] = said.tasks[task].recommended_alpha
        i = int(rng.integers(len(sizes)))
        if said.unstable and rng.random() < 0.5:
            i = int(rng.choice(said.unstable)[1:])
        most = said.tasks[f"t{i}"].largest_stable_alpha
        assert most > 0 and (f"t{i}" in said.unstable) == (most < alpha[ends[i]])
        for factor in (0.99, 1.01) if most < np.inf else ():
            gains = beside.copy()
            gains[ends[i] : ends[i + 1]] = factor * most
            step, n = TS * columns @ (gains[:, None] * rows), rows.shape[1]
            run = np.eye(n * (delay + 1), k=-n)  # of the joints now and at the instants before, one step on
            run[:n, :n] += np.eye(n)
            run[:n, -n:] -= step
            seen = []
            with np.errstate(all="ignore"):
                for _ in range(20):  # 2, 4, 8, ... steps: near the limit of another task it grows slowly
                    run = run @ run
                    seen.append(np.abs(step @ run[:n]).max())
            grew = not seen[-1] <= max(
                min(seen[-2], 1e300), 1e-6
            )  # what is left of 1 is rounding of all these products
            assert grew == (factor > 1), (i, most, delay)
            looked += 1
    assert looked > 3000 and several > 50


def test_arms_of_their_own_share_nothing_and_two_tasks_of_one_tip_share_it():
    robot = ck.load_urdf(robot_file("baxter"), tips=["left_gripper", "right_gripper"])
    q = np.linspace(0.2, 0.8, robot.n)
    arms = ck.stack(left=ck.position(tip="left_gripper"), right=ck.position(tip="right_gripper"))
    said = ck.advise(ck.Law(robot, arms, alpha=5.0, inverse=ck.damped(1e-3)), None, q, Ts=TS).stack
    for one in said.tasks.values():
        np.testing.assert_allclose([one.got, one.alone, one.least], [3, 3, 1], rtol=1e-3)
        assert one.yields_to == ""
    np.testing.assert_allclose([said.growth, said.error_growth], 1, atol=1e-9)

    twice = ck.stack(first=ck.position("xy"), second=ck.position("x", weights=[2.0]))
    said = ck.advise(ck.Law(ARM, twice, alpha=5.0, inverse=ck.damped(1e-4)), None, Q, Ts=TS).stack
    first, second = said.tasks["first"], said.tasks["second"]
    np.testing.assert_allclose([first.got, first.least, second.got], [1.2, 0.2, 0.8], rtol=1e-5)
    assert (first.yields_to, second.yields_to) == ("second", "first")
    np.testing.assert_allclose(np.abs(first.direction), [1, 0], atol=1e-6)


def test_where_no_joint_moves_a_task_it_yields_to_none():
    """z of a planar arm, of which no posture has more."""
    task = ck.stack(tip=ck.position("xyz"), rest=ck.joints())
    said = ck.advise(ck.Law(ARM, task, alpha=5.0, inverse=ck.damped(0.01)), None, Q, Ts=TS).stack.tasks["tip"]
    assert said.yields_to == "" and said.least == said.least_alone == 0
    np.testing.assert_allclose(np.abs(said.direction), [0, 0, 1], atol=1e-9)


@pytest.mark.parametrize("first", [1e-2, 1e-3])
def test_levels_leak_as_the_square_of_their_dampings(first):
    law = law_of(5.0, ck.levels(["tip"], ["angle", "rest"], damping=(first, 0.1)))
    (leak,) = ck.advise(law, None, Q, Ts=TS).stack.leaks
    assert leak.into.startswith("tip.") and not leak.source.startswith("tip.")
    assert 0.05 < leak.share / (first / 0.1) ** 2 < 20


def test_errors_grow_by_no_more_than_gains_differ():
    """Kantorovich: (κ + 1)/(2 √κ) in the norm of weights and levels."""
    for ratio in (1.0, 3.0, 30.0):
        law = law_of({"tip": 10.0, "angle": 10.0 / ratio, "rest": 10.0}, ck.damped(0.3))
        growth = ck.advise(law, None, Q, Ts=TS).stack.growth
        assert 1 <= growth <= (ratio + 1) / (2 * np.sqrt(ratio)) + 1e-9


UNSTABLE = {  # gains, and which of them make the loop unstable
    "one": ({"tip": 500.0, "angle": 10.0, "rest": 5.0}, ("tip",)),
    "two": ({"tip": 500.0, "angle": 10.0, "rest": 700.0}, ("tip", "rest")),
    "together": ({"tip": 20.0, "angle": 235.0, "rest": 240.0}, ("angle",)),  # each of them alone is stable
}


@pytest.mark.parametrize(("name", "delay"), [("one", 3), ("two", 0), ("together", 0)])
def test_gains_that_make_the_loop_unstable_are_named_and_the_others_keep_theirs(name, delay):
    alpha, unstable = UNSTABLE[name]
    law = law_of(alpha, ck.damped(0.3), rest=[0.3, 0.2, 0.5, 0.3, 0.4])
    said = ck.advise(law, None, Q, Ts=TS, method="EE", drive=ck.Drive(delay=delay)).stack
    assert said.unstable == unstable and said.least_room in unstable and said.growth == np.inf
    for task, one in said.tasks.items():
        assert one.recommended_alpha == pytest.approx((delay + 1) ** (delay + 1) / (delay + 2) ** (delay + 2) / TS)
        assert (one.now is None) == (one.largest_stable_alpha < one.alpha) == (task in unstable) and one.recommended
        lowered = alpha | {other: said.tasks[other].recommended_alpha for other in unstable if other != task}
        beside = ck.Law(ARM, law.task, alpha=lowered, inverse=law.inverse)
        assert not grows(beside, task, 0.99 * one.largest_stable_alpha / one.alpha, "EE", delay)
        assert grows(beside, task, 1.01 * one.largest_stable_alpha / one.alpha, "EE", delay)


def test_a_remedy_lowers_the_gains_that_advise_names_and_leaves_the_others():
    """All were lowered: the limit of one gain for all was too much for one beside the others as they are."""
    gains = {"tip": [[500.0, 90.0], [90.0, 200.0]], "angle": 10.0, "rest": 5.0}
    law = law_of(gains, ck.damped(0.3), rest=[0.3, 0.2, 0.5, 0.3, 0.4])
    how, goal = dict(method="EE", drive=ck.Drive(delay=3)), ck.hold_at(ARM, law.task, Q)
    unstable = ck.advise(law, None, Q, Ts=TS, **how).stack.unstable
    found = verdict(law, goal, ck.solve(law, goal, Q + 0.01, TS, 100, **how), Ts=TS, **how)
    share = np.diag(found.remedies[0].change["alpha"]) / np.diag(law.alpha)
    assert tuple(name for name, at in law.task.each if (share[at] < 1).all()) == unstable == ("tip",)
    assert (share[2:] == 1).all() and "for tip" in found.remedy and "angle" not in found.remedy
    assert not grows(law, "tip", share[0], "EE", 3)


@pytest.mark.parametrize(("method", "tip"), [("EE", 0.25), ("EXP-EE", 1.0)])
def test_gains_above_half_of_what_is_stable_are_lowered_to_it(method, tip):
    """None is where any gain is stable: shares were NaN there."""
    law = law_of({"tip": 400.0, "angle": 10.0, "rest": 0.0}, ck.damped(0.3))
    shares = half_shares(resting(law, Q, *checked(method, None), ck.Drive()), TS)
    np.testing.assert_allclose(shares, [tip, tip, 1, 1, 1, 1, 1, 1], rtol=1e-6)


def test_limits_are_loops_of_their_own():
    arm = ck.load_urdf(robot_file("panda"), tip="panda_hand")
    for rate, said in ((5.0, "even with one more sample"), (9.0, "joints pass them"), (60.0, "UNSTABLE")):
        law = ck.Law(arm, ck.position(), alpha=2.0, inverse=ck.damped(0.05), limits=ck.bounded(rate=rate))
        q = np.array([0.0, 0.3, 0.0, -1.8, 0.0, 2.0, 0.7])
        found = ck.advise(law, None, q, Ts=TS, drive=ck.Drive(delay=4)).limits
        assert said in found.words and found.z == pytest.approx(rate * TS)
        assert found.fastest_rate == pytest.approx(4**4 / 5**5 / TS, rel=1e-3)
    assert ck.advise(ck.Law(arm, ck.position(), alpha=2.0), None, q, Ts=TS).limits is None
    table = ck.wall(ck.position("z"), above=0.05, rate=30.0)
    law = ck.Law(arm, ck.position(), alpha=2.0, inverse=ck.damped(0.05), limits=ck.bounded(rate=5.0, walls=[table]))
    found = ck.advise(law, None, q, Ts=TS, drive=ck.Drive(delay=4)).limits
    assert found.rate == 30.0 and found.words.startswith("wall 1, rate = 30 1/s (z = 0.3): the robot passes it")
    for rate, count, said in (
        (30.0, 3, "3 walls, rate = 30 1/s (z = 0.3): the robot passes them"),
        (None, 1, "joint limits and wall 1, rate = 5 1/s (z = 0.05): the robot stays within them"),
        (None, 2, "joint limits and 2 walls, rate = 5 1/s"),
    ):
        walls = [ck.wall(ck.position("z"), above=0.05, rate=rate)] * count
        law = ck.replace(law, limits=ck.bounded(rate=5.0, walls=walls))
        assert limit_advice(law, ck.Drive(delay=4), TS).words.startswith(said)


FILE = """
[tasks.left]
task = "pose"
tip = "left_gripper"
alpha = 10
level = 1
damping = 0.01
[tasks.right]
task = "position"
tip = "right_gripper"
alpha = 20
level = 1
[tasks.rest]
task = "joints"
alpha = 1
level = 2
damping = 0.3
"""


def test_a_stack_at_the_command_line(tmp_path, capsys):
    file = tmp_path / "stack.toml"
    file.write_text(FILE)
    asked = ["stability", robot_file("baxter"), "--stack", str(file), "--Ts", "10ms", "--delay", "4"]
    main(asked)
    told = capsys.readouterr().out
    for words in (
        "│ right",
        "2.98 of 3",
        "right has the smallest margin",
        "Above the recommended gain: left, right",
        "Levels leak",
    ):
        assert words in told
    main([*asked, "--json"])
    said = json.loads(capsys.readouterr().out)["stack"]
    assert set(said["tasks"]) == {"left", "right", "rest"} and said["least_room"] == "right"
    assert 0 < said["tasks"]["left"]["recommended_alpha"] < 10 and LOST < 1 and said["unstable"] == []
    with pytest.raises(SystemExit):
        main([*asked, *["--target", "1", "2", "3"] * 3])
    assert "`--target` must be given at most once for each tip (left.left_gripper, right" in capsys.readouterr().err


def test_a_task_without_a_gain_keeps_it_and_is_not_called_unstable():
    """Its largest gain is that of the same stack in which it has one."""
    tiny, none = (law_of({"tip": 20.0, "angle": alpha, "rest": 5.0}, ck.damped(0.3)) for alpha in (1e-7, 0.0))
    said, other = (ck.advise(law, None, Q, Ts=TS, method="EE", drive=ck.Drive()).stack for law in (none, tiny))
    assert [row[3] for row in does_of_tasks(SimpleNamespace(Ts=TS), SimpleNamespace(stack=said))][1] == "no gain"
    angle, given = said.tasks["angle"], other.tasks["angle"]
    assert angle.recommended_alpha == 0 and angle.recommended is None
    assert angle.largest_stable_alpha == pytest.approx(given.largest_stable_alpha, rel=1e-6) and given.recommended


def test_a_gain_of_zero_stays_on_the_command_line(tmp_path, capsys):
    file = tmp_path / "stack.toml"
    file.write_text('[tasks.tip]\ntask = "xy"\n[tasks.off]\ntask = "z"\nalpha = 0\n[tasks.rest]\ntask = "joints"\n')
    loop = ["planar:1,0.8,0.6", "--stack", file, "--damping", "0.2", "--Ts", "0.1", "--method", "EE", "--delay", "0"]
    main(["stability", *map(str, loop)])
    said = capsys.readouterr().out
    assert re.search(r"off +\S+ +0 +\S+ +0 .* 0 \S*\n", said) and "A gain of 0 stays 0, and its task" in said
    with pytest.raises(SystemExit):
        main(["stability", *map(str, loop), "--map", "--gains", "tip", "off"])
    assert "`--gains` must be one of tip, rest (tasks with a gain), but is 'off'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("rest", "options", "words"),
    [
        (0, (), "leave it out, or give another task an alpha above 0, but only 'tip' has one"),
        (0, ("--gains", "tip", "rest"), "leave it out, or give another task an alpha above 0, but only 'tip' has one"),
        (1, ("--gains", "tip"), "`--gains` must name two tasks with a gain, of tip, rest, but is tip"),
        (1, ("--inverse", "transpose"), "`--map` must be left out where the inverse is transpose"),
    ],
)
def test_a_map_of_gains_names_the_tasks_that_have_one(rest, options, words, tmp_path, capsys):
    file = tmp_path / "stack.toml"
    file.write_text(f'[tasks.tip]\ntask = "xy"\n[tasks.rest]\ntask = "joints"\nalpha = {rest}\n')
    inverse = () if "--inverse" in options else ("--damping", "0.2")
    with pytest.raises(SystemExit):
        main(["stability", "planar:1,0.8", "--stack", str(file), *inverse, "--delay", "0", "--map", *options])
    assert words in capsys.readouterr().err


def test_tips_without_a_target_keep_that_of_the_file():
    tasks = {"a": {"task": "x"}, "rest": {"task": "joints"}, "b": {"task": "y", "target": [0.4]}}
    made = ck.problem_from("planar:1,0.8,0.6", tasks=tasks, damping=0.1)
    found = at_targets(made, [(1.5,)])
    assert made.reference["b"] is found.reference["b"] and made.reference["rest"] is found.reference["rest"]
    assert found.reference["a"].curve.position[0] == 1.5 and "target" in found.tables["a"]
    assert found.tables["rest"] == made.tables["rest"]


@pytest.mark.parametrize(("method", "delay"), [("EE", 0), ("EXP-MIDPOINT", 3)])
def test_a_map_of_two_gains_has_its_boundary_where_the_tasks_have_theirs(method, delay):
    law, drive = LAWS["weighted"], ck.Drive(delay=delay)
    said = ck.advise(law, None, Q, Ts=TS, method=method, drive=drive).stack.tasks
    most = said["tip"].largest_stable_alpha
    tip = np.array([0.5, 0.999, 1.001]) * (most if np.isfinite(most) else 1e3)
    data = ck.stability.gains_map(law, Q, alpha={"tip": tip, "rest": [5.0, 50.0]}, Ts=TS, method=method, drive=drive)
    np.testing.assert_array_equal(data.radius.values[0] > 1 + 1e-9, [False, False, np.isfinite(most)])
    other = ck.Law(ARM, law.task, alpha={"tip": tip[0], "angle": 10.0, "rest": 50.0}, inverse=law.inverse)
    if not delay:
        np.testing.assert_allclose(
            data.radius[1, 0], ck.stability.spectrum(other, None, Q, TS, method).radius, atol=1e-9
        )
    found = np.array([data[f"limit of {name}"].dropna("ray of limit") for name in ("tip", "rest")])
    assert (found.size > 0) == np.isfinite(most)
    assert not found.size or np.interp(said["rest"].alpha, found[1, ::-1], found[0, ::-1]) == pytest.approx(most, 1e-2)
    limit = ck.stability.driven_limits(method, Ts=TS, drive=drive)
    np.testing.assert_allclose([data.stable, data.recommended], [limit.stable / TS, limit.recommended / TS])


def test_a_map_of_few_cells_draws_the_limit_where_it_is():
    """A slow task makes the radius flat up to the limit of a fast one: between cells it says nothing of it."""
    robot, task = ck.planar_arm([1.0, 0.8]), ck.stack(tip=ck.position("x"), turn=ck.position("y"))
    law = ck.Law(robot, task, alpha={"tip": 40.0, "turn": 0.3}, inverse=ck.damped(1e-4))
    alpha, drive = {"turn": np.geomspace(0.1, 2, 8), "tip": np.geomspace(3, 200, 8)}, ck.Drive(delay=1)
    data = ck.stability.gains_map(law, [0.4, 0.9], alpha=alpha, Ts=0.01, method="EE", drive=drive)
    most = ck.stability.driven_limits("EE", Ts=0.01, drive=drive).stable / 0.01
    figure = gains(data)
    line = next(one.get_xydata() for one in figure.axes[0].lines if one.get_color() == "black")
    assert figure.axes[0].get_xlabel() == "α of turn [1/s]"  # the order in which they are given
    np.testing.assert_allclose(line[:, 1], most, rtol=1e-4)
    assert line[:, 0].min() < 0.11 and line[:, 0].max() > 1.9
    plt.close(figure)
    with pytest.raises(ck.ArgumentError, match="names one radius"):
        ck.stability.gains_map(law, [0.4, 0.9], alpha={"radius": [1.0], "tip": [1.0]}, Ts=0.01)


def test_a_map_of_two_gains_on_the_command_line(tmp_path, capsys):
    file, out = tmp_path / "stack.toml", tmp_path / "out"
    file.write_text('[tasks.tip]\ntask = "xy"\n[tasks.turn]\ntask = "z"\nalpha = 9\n[tasks.rest]\ntask = "joints"\n')
    loop = ["planar:1,0.8,0.6", "--stack", file, "--damping", "0.2", "--map", "--cells", "12", "--out", out]
    main(["stability", *map(str, loop), "--gains", "turn", "rest"])
    with xr.open_dataset(out / "map.nc") as data:
        assert data.radius.dims == ("rest", "turn") and data.radius.shape == (12, 12)
    assert (out / "map.png").exists() and "turn" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["stability", *map(str, loop), "--gains", "turn", "rset"])
    assert "`--gains` must be one of tip, turn, rest (tasks with a gain), but is 'rset'" in capsys.readouterr().err


@pytest.mark.parametrize("alpha", [40.0, 60.0, 80.0])
def test_what_a_task_does_is_told_only_where_each_joints_drive_bears_its_gain(alpha):
    robot, q = ck.planar_arm([0.5, 0.4, 0.3, 0.2]), np.array([0.3, 0.5, 0.4, 0.6])
    tasks = ck.stack(tip=ck.position("xy"), rest=ck.joints())
    inverse = ck.levels(["tip"], ["rest"], damping=(0.001, 0.1))
    law = ck.Law(robot, tasks, alpha={"tip": alpha, "rest": 1.0}, inverse=inverse)
    drive = ck.Drive(delay=2, lag=[0.01, 0.01, 0.01, 0.4])  # at 60 1/s the last one for all joints would swing out
    found = ck.advise(law, ck.hold_at(robot, tasks, q), q, Ts=0.01, drive=drive).stack
    tip = found.tasks["tip"]
    assert found.unstable == (("tip",) if alpha == 80.0 else ())
    assert (0.01 < tip.now.lag < 0.1) if alpha == 40.0 else tip.now is None
