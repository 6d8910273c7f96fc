"""Lines for a controller: run as they stand, they are the loop that was tuned."""

import math
import re
import types

import numpy as np
import pytest

import cnclik as ck
from cnclik.tuning.controller import controller_lines

LAW = ck.Law(ck.planar_arm([1.0, 0.8, 0.5]), ck.position("xy"), alpha=30.0)
PATH = ck.circle([1.2, 0.8], 0.3, period=4.0)
START = np.array([0.3, 0.6, 0.4])


def tuned(method, Ts=0.05, law=LAW):
    after = types.SimpleNamespace(z=30.0 * Ts)
    loop = dict(law=law, Ts=Ts, schedule=None, method=ck.METHODS[method], stage=None)
    return types.SimpleNamespace(**loop, after=after, satisfied=True)


@pytest.mark.parametrize("method", ["EXP-MIDPOINT", "EXP-AB2"])
def test_a_rate_run_as_a_controller_would_is_the_loop(method):
    line = controller_lines(tuned(method))["rate"]
    q, known = START, dict(ck=ck, law=LAW, path=PATH, history=None)
    wanted = ck.solve(LAW, PATH, START, 0.05, 4, method)
    for k in range(4):
        known |= dict(q=q, t=0.05 * k)
        exec(line, known)
        np.testing.assert_allclose(known["qdot"], wanted.qdot[k], atol=1e-10)
        q = q + 0.05 * np.asarray(known["qdot"])


def test_pink_and_mink_let_an_error_decay_as_an_exponential_method_does():
    line = controller_lines(tuned("EXP-AB2"))["pink_mink"]
    gain = float(re.search(r"gain=([\d.]+)", line)[1])
    assert gain == pytest.approx(1 - math.exp(-1.5), abs=1e-6)
    assert f"shrinks by {math.exp(-1.5):.4g} per step" in line
    assert "PostureTask takes this gain, too" in line
    assert controller_lines(tuned("HEUN"))["pink_mink"].startswith("no line: z = 1.5")


def test_a_line_names_what_it_leaves_out_of_the_law():
    shelf = ck.wall(ck.position("y"), below=1.5, name="shelf")
    limited = dict(inverse=ck.damped(0.02), limits=ck.bounded(rate=4.0, walls=[shelf]), error_clamp=(0.1, 0.5))
    law = ck.replace(LAW, null_velocity=ck.posture(np.zeros(3)), alpha=10.0, **limited)
    lines = controller_lines(tuned("EE", law=law))
    left = "not in this line: joint limits (rate·Ts = 0.2), wall shelf, error clamp"
    assert lines["rate"].endswith(left)
    assert controller_lines(tuned("EXP-MIDPOINT", law=law))["rate"].count("not in this line") == 0  # a step has them
    short = tuned("EE", 0.02, law)
    assert controller_lines(short)["pink_mink"].endswith(
        "(rate·Ts = 0.08), wall shelf, error clamp, null-space velocity"
    )
