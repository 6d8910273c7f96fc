"""Parameters: where each goes, what a name stands for in a stack, and the bounds that the drives set."""

import numpy as np
import pytest

import cnclik as ck
from cnclik.tuning import parameters as pm
from tests.refusals import refusals

ARM = ck.planar_arm([1.0, 1.0], clockwise=True)
LAW = ck.Law(ARM, ck.position("xy"), alpha=[4.0, 6.0], inverse=ck.damped(0.1), null_velocity=ck.posture([0.0, 1.0]))
GAINS = ck.gains(Ts=0.02, drive=ck.Drive(delay=1), method="EE")  # z = 4/27 at most
READ = {
    "alpha": lambda law: law.alpha,
    "damping": lambda law: law.inverse.damping,
    "posture_rate": lambda law: law.null_velocity.rate,
    "feedforward": lambda law: law.feedforward,
}


@pytest.mark.parametrize("name", READ)
def test_every_parameter_goes_where_it_belongs(name):
    (p,) = pm.chosen(name, LAW, {}, GAINS)
    value = 0.9 * p.start
    np.testing.assert_allclose(READ[name](pm.put(LAW, (p,), value.ravel())), value, rtol=1e-12)
    assert set(READ) == set(pm.KNOWN)


TASK = ck.stack(hand=ck.position("xy"), turn=ck.orientation("z"), rest=ck.joints(weights=[0.1] * 4))
STACK = ck.Law(
    ck.planar_arm([0.5, 0.4, 0.3, 0.3]),
    TASK,
    alpha={"hand": 8.0, "turn": 4.0, "rest": 1.0},
    inverse=ck.levels(["hand"], ["turn", "rest"], damping=(0.01, 0.1)),
    null_velocity=ck.posture(np.zeros(4)),
)


def test_alpha_of_a_stack_is_a_gain_for_each_task_but_postures():
    chosen = pm.chosen(("alpha", "rest.alpha", "posture_rate"), STACK, {"rest.alpha": (0.5, 2.0)}, GAINS)
    assert [p.name for p in chosen] == ["hand.alpha", "turn.alpha", "rest.alpha", "posture_rate"]
    assert [float(p.upper) for p in chosen] == [GAINS.recommended] * 2 + [2.0, GAINS.recommended]
    made = pm.put(STACK, chosen, np.array([1.0, 2.0, 3.0, 4.0]))
    np.testing.assert_array_equal(made.alpha, [1, 1, 2, 3, 3, 3, 3])
    assert made.null_velocity.rate == 4
    idle = ck.replace(STACK, alpha={"hand": 8.0, "turn": 0.0, "rest": 1.0})
    assert [p.name for p in pm.chosen("alpha", idle, {}, GAINS)] == ["hand.alpha"]  # a gain of 0 stays
    (all_tasks,) = pm.chosen("alpha", ck.replace(STACK, alpha=5.0), {}, GAINS)
    assert all_tasks.name == "alpha" and all_tasks.start.shape == ()
    axes = ck.replace(STACK, alpha={"hand": [8.0, 7.0], "turn": 4.0, "rest": 1.0})
    assert [p.start.tolist() for p in pm.chosen("alpha", axes, {}, GAINS)] == [[8.0, 7.0], 4.0]


test_what_does_not_fit_is_named = refusals(
    ((STACK, "hnad.alpha", {}), r"one of hand, turn, rest, but is 'hnad' \(did you mean 'hand'"),
    ((STACK, "damping", {}), "name damping for a law that has it"),
    ((ck.replace(LAW, null_velocity=None), "posture_rate", {}), "name posture_rate for a law that has it"),
    ((LAW, "gain", {}), "`over` must be one of alpha, .* but is 'gain'"),
    ((LAW, (), {}), "name something"),
    ((LAW, ("alpha", "alpha"), {}), "each once"),
    ((LAW, "alpha", {"alpha": (5, 1)}), "bounds of alpha` must increase"),
    ((LAW, "alpha", {"alpha": 3}), r"be \(lower, upper\)"),
    ((LAW, "alpha", {"alpha": (0.0, 2)}), "be above 0"),
    ((LAW, "alpha", {"alpha": (1, 60)}), "at most the largest stable gain, 50 1/s, but are 1 and 60"),
    ((LAW, "alpha", {"damping": (1, 2)}), "`bounds` must be one of alpha"),
    of=lambda case: pm.chosen(case[1], case[0], case[2], GAINS),
)
