"""
What does a limit on velocity do to a path?
===========================================

Joints with a limit of 0.6 rad/s follow a circle that needs more. Clipping each joint leads the tip off the circle. A
`Pace` slows all joints by one share, and the path waits.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, path = ck.planar_arm([1.0, 0.8]), ck.circle([0.9, 0.7], 0.35, period=4.0)
law = ck.Law(arm, ck.position("xy"), alpha=10.0)
q0 = np.asarray(ck.solve(law, ck.hold([1.25, 0.7]), np.array([0.0, 0.9]), 0.05, 80).q[-1])
cut = ck.solve(law, path, q0, 0.01, 900, "EE", drive=ck.Drive(drive_velocity=0.6))
paced = ck.solve(law, path, q0, 0.01, 900, "EE", pace=ck.Pace(velocity=0.6))

figure, panels = plt.subplots(1, 2, figsize=(7, 3))
turn = np.linspace(0, 2 * np.pi, 200)
panels[0].plot(0.9 + 0.35 * np.cos(turn), 0.7 + 0.35 * np.sin(turn), color="0.8", lw=4)
for run, color, name in ((cut, VERMILION, "cut off, joint by joint"), (paced, BLUE, "paced")):
    panels[0].plot(*np.asarray(run.x).T, color=color, label=name)
    panels[1].plot(run.t[1:], np.abs(run.qdot).max(1), color=color)
panels[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
panels[0].legend(loc="center")
panels[1].axhline(0.6, color="0.5", lw=0.8, ls=":")
panels[1].set(xlabel="time [s]", ylabel="largest joint speed [rad/s]")
late, meant = paced.t[-1], paced.target_time[-1]
print(f"after {late:.3g} s the paced robot is where the path was meant to be after {meant:.3g} s")
