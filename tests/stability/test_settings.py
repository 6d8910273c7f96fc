"""Settings for other tools, run in the tool or in a copy of its loop: what is promised is what happens."""

import importlib.util

import numpy as np
import pytest

import cnclik as ck
from tests.bench import loops_tools

CASE = "3 samples, lag 30 ms"


def rows(tool, case=CASE):
    return {row["way"]: row for row in loops_tools.measure((tool,), (case,))}


def keeps_its_promise(row):
    return row["overshoot"] < 0.01 and row["settled"] == pytest.approx(row["promised"], rel=0.05, abs=2 * row["Ts"])


@pytest.mark.parametrize("tool", ["pink", "mink", "placo"])
def test_a_tool_itself_with_its_posture_task(tool):
    """And why the posture's gain is told: at its default of 1 the loop runs away."""
    needed = [tool, *["mujoco"] * (tool == "mink")]
    if not all(importlib.util.find_spec(name) for name in needed):
        pytest.skip(f"{tool} is not installed")
    found = rows("Placo" if tool == "placo" else tool)
    assert keeps_its_promise(found["as told"]) and found["as told"]["posture"] < 1e-3
    assert np.isinf(found["posture at its default, 1"]["overshoot"])
    own = found["0.25 of the last command"]
    assert own["overshoot"] < 0.01 and own["posture"] < 1e-3 and np.isfinite(own["settled"])


@pytest.mark.parametrize("tool", ["Isaac Lab", "MoveIt Servo"])
def test_a_copy_of_a_tools_loop(tool):
    assert keeps_its_promise(rows(tool)["as told"])


@pytest.mark.parametrize("drive", [None, ck.Drive(delay=4), ck.Drive(delay=2, lag=0.05)])
def test_the_gain_of_settings_is_the_recommended_one_whatever_the_present_gains(drive):
    """Of a stack at any posture; of one task with damping, whose directions lose some of it."""
    arm, q = ck.planar_arm([0.5, 0.4, 0.3, 0.3]), np.array([0.4, 0.8, -0.5, 0.3])
    one = ck.Law(arm, ck.position("xy"), alpha=10.0, inverse=ck.damped(0.05))
    tasks = ck.stack(hand=ck.position("xy"), rest=ck.joints(weights=0.1))
    stack = ck.Law(
        arm, tasks, alpha={"hand": 40.0, "rest": 10.0}, inverse=ck.levels(["hand"], ["rest"], damping=(1e-3, 0.05))
    )
    even = ck.replace(stack, alpha={"hand": 10.0, "rest": 10.0})
    told = {}
    for law, method in ((one, "EE"), (one, "RK4"), (stack, "EE"), (stack, "EXP-EE"), (even, "EE")):
        said = ck.advise(law, None, q, Ts=0.01, method=method, drive=drive)
        alpha = said.explicit_euler["recommended_alpha"]
        assert f"(gain={0.01 * alpha:.4g})" in said.settings["pink"] and f"{alpha:.4g}" in said.settings["MoveIt Servo"]
        assert f"by explicit Euler ({alpha:.4g} 1/s recommended):" in str(said)
        assert told.setdefault(law.task.tasks, said.settings) == said.settings


def test_what_else_a_law_has_is_named_beside_the_settings():
    law = ck.Law(ck.planar_arm([0.5, 0.4]), ck.position("xy"), alpha=10.0, limits=ck.saturation(5.0))
    (note,) = ck.advise(law, None, [0.4, 0.8], Ts=0.01, method="EE", drive=ck.Drive()).notes
    assert note.startswith("The settings") and note.endswith(": joint limits (rate·Ts = 0.05).")


def test_servoj_adds_to_its_last_command_and_has_its_lag_in_alpha():
    """By the gain of a loop without that lag it overshoots; from the measured joints it does not arrive."""
    found = rows("UR servoj", "5 samples")
    told, measured, whole = (
        found[way] for way in ("as told", "from the measured joints", "alpha without servoj's lag")
    )
    assert told["overshoot"] < 0.01 and told["settled"] < 3.2 / told["set"]
    assert np.isinf(measured["settled"]) and whole["overshoot"] > 0.03
