"""
A redundant arm: what does the posture do?
==========================================

The arm has five joints and the task two coordinates, so the null space has three dimensions. A posture uses the null
space as far as the task allows: the tip stays where it is. The left panel shows the motion of the arm from blue to red,
the right panel the distance of its joints from the posture.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, q0 = ck.planar_arm([1.0] * 5, clockwise=True), np.array([0.2, 1.2, 0.9, 0.2, 0.1])
rest = np.array([-1.2, 1.5, 1.5, 0.9, -0.8])
tip = np.asarray(ck.forward(arm, q0).position)[:2]
law = ck.Law(arm, ck.position("xy"), alpha=5.0, null_velocity=ck.posture(rest, rate=1.0))
run = ck.solve(law, ck.hold(tip), q0, 0.05, 120)


def joints(q):
    """Where the joints and the tip are, (6, 2)."""
    turn = -np.cumsum(q)
    return np.vstack([[0.0, 0.0], np.cumsum(np.stack([-np.sin(turn), np.cos(turn)], axis=1), axis=0)])


figure, panels = plt.subplots(1, 2, figsize=(7, 2.8))
for k in (0, 3, 7, 12, 20, 120):
    color = {0: BLUE, 120: VERMILION}.get(k, "0.7")
    panels[0].plot(*joints(np.asarray(run.q[k])).T, "o-", ms=3, lw=1 + (k in (0, 120)), color=color)
panels[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
panels[1].plot(run.t, np.linalg.norm(run.q - rest, axis=1), color=VERMILION)
panels[1].set(xlabel="time [s]", ylabel="distance from the posture [rad]")
print(f"the tip strays by {1e6 * np.linalg.norm(run.e, axis=1).max():.2g} µm at most")
