"""
A redundant arm: what does the posture do?
==========================================

Five joints, two coordinates of the tip: three joints' worth of motion is left over. A posture in the null space uses
it, and the tip stays where it is.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, q0 = ck.planar_arm([1.0] * 5, clockwise=True), np.array([0.2, 1.2, 0.9, 0.2, 0.1])
rest = np.array([-1.2, 1.5, 1.5, 0.9, -0.8])
tip = np.asarray(ck.pose(arm, q0).position)[:2]
law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(rest, rate=1.0))
run = ck.solve(law, ck.hold(tip), q0, 0.05, 120)


def joints(q):
    """Where the joints and the tip are, (6, 2)."""
    turn = -np.cumsum(q)
    return np.vstack([[0.0, 0.0], np.cumsum(np.stack([-np.sin(turn), np.cos(turn)], axis=1), axis=0)])


figure, panels = plt.subplots(1, 2, figsize=(7, 2.8))
for k in range(0, 121, 15):
    share = k / 120
    color = BLUE if k == 0 else VERMILION if k == 120 else str(0.8 - 0.5 * share)
    panels[0].plot(*joints(np.asarray(run.q[k])).T, "o-", ms=3, lw=1 + (k in (0, 120)), color=color)
panels[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
panels[1].plot(run.t, np.linalg.norm(run.q - rest, axis=1), color=VERMILION, label="distance from the posture [rad]")
panels[1].plot(run.t, np.linalg.norm(run.e, axis=1) + 1e-17, color=BLUE, label="error of the tip [m]")
panels[1].set(xlabel="time [s]", yscale="log", ylim=(1e-13, 10))
panels[1].legend()
