"""
How does it go through my waypoints?
====================================

`ck.waypoints` makes a curve in time through points, smooth in velocity and acceleration. Here a Panda's tip goes
through five points in eight seconds, from rest to rest, and back to its start. The orientation of the tip is free.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION, series

jax.config.update("jax_enable_x64", True)
arm = ck.panda()
q0 = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8])
start = np.asarray(ck.forward(arm, q0).position)
moves = np.array([[0, 0, 0], [0.1, 0.15, 0.1], [0.0, 0.3, 0.0], [-0.1, 0.15, -0.1], [0, 0, 0]])
times = np.array([0.0, 2.0, 4.0, 6.0, 8.0])
path = ck.waypoints(times, start + moves)
law = ck.Law(arm, ck.position(), alpha=5.0)
run = ck.solve(law, path, q0, 0.02, 400)

figure, panels = plt.subplots(1, 2, figsize=(7, 2.8))
panels[0].plot(*np.asarray(run.x)[:, 1:].T, color=BLUE)
panels[0].plot(*(start + moves)[:, 1:].T, "o", color=VERMILION, mfc="white")
panels[0].set(xlabel="y [m]", ylabel="z [m]", aspect="equal")
for i in range(7):
    panels[1].plot(run.t[1:], run.qdot[:, i], **series(i, markevery=50), label=f"joint {i + 1}")
figure.legend(loc="outside upper right", ncols=7, fontsize=6)
panels[1].set(xlabel="time [s]", ylabel="joint velocities [rad/s]")
print(f"largest error on the way {1e6 * np.linalg.norm(run.e, axis=1).max():.3g} µm")
