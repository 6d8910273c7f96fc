"""
What does a limit on velocity do to a path?
===========================================

Joints with a limit of 0.6 rad/s follow a circle that needs more. Clipping each joint leads the tip off the circle.
`velocity_scaling` slows all joints by one share: the tip keeps its direction, and lags.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, path = ck.replace(ck.planar_arm([1.0, 0.8]), velocity_limit=(0.6, 0.6)), ck.circle([0.9, 0.7], 0.35, period=4.0)
law = ck.Law(arm, ck.position("xy"), alpha=10.0)
q0 = np.asarray(ck.solve(law, ck.hold([1.25, 0.7]), np.array([0.0, 0.9]), 0.05, 80).q[-1])
scaled = ck.solve(ck.replace(law, limits=ck.velocity_scaling()), path, q0, 0.01, 900, "EE")
q, places, speeds = q0, [], []
for k in range(900):
    step = ck.step(law, path, q, 0.01 * k, 0.01, "EE")
    qdot = np.clip(step.qdot, -0.6, 0.6)
    q = q + 0.01 * qdot
    places.append(step.x)
    speeds.append(qdot)

figure, panels = plt.subplots(1, 2, figsize=(7, 3))
turn = np.linspace(0, 2 * np.pi, 200)
panels[0].plot(0.9 + 0.35 * np.cos(turn), 0.7 + 0.35 * np.sin(turn), color="0.8", lw=4)
clipped, all_scaled = (places, speeds, VERMILION, "clipped, joint by joint"), (scaled.x, scaled.qdot, BLUE, "scaled")
for x, qdot, color, name in (clipped, all_scaled):
    panels[0].plot(*np.asarray(x).T, color=color, label=name)
    panels[1].plot(0.01 * np.arange(900), np.abs(qdot).max(1), color=color)
panels[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
panels[0].legend(loc="center")
panels[1].axhline(0.6, color="0.5", lw=0.8, ls=":")
panels[1].set(xlabel="time [s]", ylabel="largest joint speed [rad/s]")
