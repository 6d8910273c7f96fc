"""Tuning of stacks: gains, dampings and weights by task, safe at any posture, and lines that are the tuned loop."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cnclik.stability.loop import parts_at_rest

import cnclik as ck
from cnclik.stability.spectrum import at_rest, of_error, step_map
from cnclik.tuning import Conditions, Descent, controller_lines, tune
from cnclik.tuning import parameters as pm
from cnclik.tuning.linear import maps_at_rest

ARM = ck.planar_arm([0.5, 0.4, 0.3, 0.3])
Q = np.array([0.4, 0.8, -0.5, 0.3])
TASK = ck.stack(hand=ck.position("xy"), turn=ck.orientation("z", weights=[2.0]), rest=ck.joints(weights=[0.1] * 4))
LEVELS = ck.levels(["hand"], ["turn", "rest"], damping=(0.01, 0.1))
LAW = ck.Law(ARM, TASK, alpha={"hand": 8.0, "turn": 4.0, "rest": 1.0}, inverse=LEVELS)
AIM = ck.hold_at(ARM, TASK, Q, hand=ck.hold(ck.forward(ARM, Q).position + np.array([0.05, 0.05, 0.0])))


def test_every_name_goes_to_its_task():
    loop = pm.Adjustable(law=LAW, Ts=jnp.asarray(0.02))
    chosen = pm.chosen(("alpha", "damping", "weights", "Ts", "rest.alpha"), loop, {"alpha": (1.0, 50.0)})
    names, tasks = [p.name for p in chosen], ["hand", "turn"]  # the posture only by its name
    assert all(p.upper == 50.0 for p in chosen if p.name.endswith("alpha"))
    assert names == [
        *(f"{t}.alpha" for t in tasks),
        "hand.damping",
        "turn.damping",
        *(f"{t}.weights" for t in tasks),
        "Ts",
        "rest.alpha",
    ]
    read = {
        "turn.alpha": lambda law: np.asarray(law.alpha)[2],
        "rest.damping": lambda law: law.inverse.damping[1].damping,
        "rest.weights": lambda law: np.asarray(law.task.weights)[3:],
    }
    for name, of in read.items():
        p = pm.named(name, loop)
        made = pm.put(loop, (p,), (jnp.asarray(1.1 * p.start),)).law
        np.testing.assert_allclose(of(made), 1.1 * of(LAW))
    idle = ck.replace(loop, law=ck.replace(LAW, alpha={"hand": 8.0, "turn": 0.0, "rest": 1.0}))
    assert [p.name for p in pm.chosen("alpha", idle, {})] == ["hand.alpha"]  # a gain of 0 stays
    mixed = ck.replace(LAW, alpha={"hand": [8.0, 6.0], "turn": 4.0, "rest": [1.0, 2.0, 3.0, 4.0]})
    loop = ck.replace(loop, law=mixed)
    each = pm.chosen(("alpha", "rest.alpha"), loop, {})
    assert [np.shape(p.start) for p in each] == [(2,), (), (4,)]
    np.testing.assert_allclose(pm.put(loop, each, [2 * p.start for p in each]).law.alpha, 2 * np.asarray(mixed.alpha))


def test_levels_keep_their_order():
    """Whatever the optimizer comes up with: each damping stays below what lies half the way to the next."""
    first, second = pm.chosen("damping", pm.Adjustable(law=LAW, Ts=jnp.asarray(0.02)), {})
    assert first.upper == second.lower == pytest.approx(np.sqrt(0.01 * 0.1))


@pytest.mark.parametrize(
    ("over", "told"),
    [
        ("hnad.alpha", r"one of hand, turn, rest, but is 'hnad' \(did you mean 'hand'"),
        ("hand.alhpa", "did you mean 'alpha'"),
        (("turn.damping", "rest.damping"), "name the damping of a level once"),
    ],
)
def test_what_does_not_fit_is_named(over, told):
    with pytest.raises(ck.ArgumentError, match=told):
        tune(LAW, AIM, Q, Ts=0.02, N=10, over=over)


AXES = ck.replace(LAW, alpha={"hand": [8.0, 6.0], "turn": 4.0, "rest": 1.0})
SINGLE = ck.Law(ARM, ck.position("xy", weights=[1.0, 2.0]), alpha=np.array([8.0, 6.0]))


LAWS = {"levels": LAW, "axes": AXES, "single": SINGLE, "damped": ck.replace(SINGLE, inverse=ck.damped(0.3))}
QUICK = [("levels", "CN"), ("axes", "RK4"), ("single", "EXP-MIDPOINT")]


@pytest.mark.parametrize(
    ("law", "method"),
    [
        pytest.param(*one, marks=[pytest.mark.slow] * (one not in QUICK))
        for one in itertools.product(LAWS, ["EE", "RK4", "CN", "EXP-MIDPOINT"])
    ],
)
def test_maps_of_rates_are_those_of_the_step(law, method):
    """Without a derivative of the step: its eigenvalues, and of a stack those of its gains where no joint can help."""
    law, method, stage = LAWS[law], ck.METHODS[method], ck.chord(2)
    with jax.enable_x64(True):
        found, _, taken, _ = map(np.asarray, maps_at_rest(law, jnp.asarray(Q), 0.05, method, stage))
        moved, rows = step_map(*at_rest(law, None, Q), Q, 0.05, method, stage)
    there = rows @ np.linalg.pinv(rows)
    np.testing.assert_allclose(found @ there, of_error(moved, rows, np) @ there, atol=1e-9)
    largest = np.abs(np.linalg.eigvals(taken)).max()
    assert np.abs(1 - np.linalg.eigvals(found)).max() <= largest + 1e-9
    if law.task.tasks and method.name == "EE":
        np.testing.assert_allclose(largest, 0.05 * np.max(law.alpha))


def test_a_posture_is_not_bought_by_the_hand_and_who_pays_is_told():
    """The posture never arrives, so that in a loss it would outweigh the hand. Here both gains begin too large."""
    arm, q = ck.planar_arm([0.5, 0.4]), Q[:2]
    tasks = ck.stack(hand=ck.position("xy"), rest=ck.joints(weights=0.1))
    aims = ck.hold_at(arm, tasks, q, hand=ck.hold(ck.forward(arm, q).position + np.array([0.05, 0.05, 0.0])))
    law = ck.Law(
        arm, tasks, alpha={"hand": 30.0, "rest": 40.0}, inverse=ck.levels(["hand"], ["rest"], damping=(0.01, 0.1))
    )
    found = tune(law, aims, q, Ts=0.02, N=10, method="EE", descent=Descent(steps=2, rounds=1))
    assert found.satisfied and found.kept == ("rest",)
    assert 12 < found.values["rest.alpha"] <= 12.5  # z = 1/4: lowered to what no step overshoots with, and no more
    before, after = found.before.errors["hand [m]"], found.after.errors["hand [m]"]
    assert after == pytest.approx(np.sqrt((np.asarray(found.after.run["hand"].e)[1:] ** 2).sum(1).mean()))
    assert f"RMS of hand [m]: {before:.4g} -> {after:.4g}\n" in str(found)
    assert f"(as given, overshoot is beyond its bound): RMS of hand [m] {before:.3g} -> {after:.3g}" in found.why


@pytest.mark.slow
def test_each_gain_is_one_that_any_posture_bears():
    """Two tasks of one tip ask for the same: each gets half of it here, and none may count on that elsewhere."""
    twice = ck.stack(one=ck.position("xy"), other=ck.position("xy"))
    law = ck.Law(ARM, twice, alpha=2.0, inverse=ck.damped(1e-3))
    aim = ck.hold(ck.forward(ARM, Q).position + np.array([0.05, 0.05, 0.0]))
    aims = ck.hold_at(ARM, twice, Q, one=aim, other=aim)
    late = Conditions(drive=ck.Drive(delay=1))
    found = tune(law, aims, Q, Ts=0.02, N=40, method="EE", conditions=late, descent=Descent(steps=60))
    z = 0.02 * np.array([found.values["one.alpha"], found.values["other.alpha"]])
    assert found.satisfied and found.after.radius < 1
    np.testing.assert_allclose(z.max(), 4 / 27, rtol=1e-2)  # d^d/(d + 1)^(d + 1) of two samples
    assert z.max() <= 4 / 27 * (1 + 1e-6)
    said = ck.advise(found.law, None, Q, Ts=0.02, method="EE", drive=ck.Drive(delay=1)).stack
    assert all(one.alpha <= one.recommended_alpha * (1 + 1e-6) for one in said.tasks.values())


def test_a_stack_is_tuned_for_its_levels_and_its_lines_are_the_loop():
    found = tune(LAW, AIM, Q, Ts=0.02, N=40, method="EE", over=("alpha", "damping"), descent=Descent(steps=30))
    assert found.satisfied and found.after.loss < 0.9 * found.before.loss  # of the hand: the others count by 1/100
    norms = [np.linalg.norm(run.run["hand"].e, axis=1).sum() for run in (found.before, found.after)]
    assert norms[1] < 0.9 * norms[0]
    assert "rest.alpha" not in found.values and "unless rest.alpha is named" in str(found)
    lines = controller_lines(found)
    assert f"alpha: {float(found.values['hand.alpha']):.6g} of hand" in lines["rate"] and "J_levels" in lines["rate"]
    gains, costs = (
        [float(one) for one in re.findall(rf"{word}=([-+.\de]+)", lines["pink_mink"])] for word in ("gain", "cost")
    )
    (damping,) = re.findall(r"damping=([-+.\de]+)", lines["pink_mink"])
    rows, columns, _ = map(np.asarray, parts_at_rest(found.law, ck.hold_at(ARM, TASK, Q), jnp.asarray(Q)))
    weights = np.asarray(LAW.task.weights)
    sizes = [at.stop - at.start for _, at in LAW.task.each]
    rows, gains, costs = rows / weights[:, None], np.repeat(gains, sizes), np.repeat(costs, sizes)
    weighed = costs[:, None] * rows
    pink = np.linalg.solve(weighed.T @ weighed + float(damping) * np.eye(4), weighed.T * (costs * gains))
    np.testing.assert_allclose(pink, 0.02 * (columns * weights) * np.asarray(found.law.alpha), rtol=1e-3, atol=1e-6)
