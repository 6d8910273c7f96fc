"""
What happens at a singularity?
==============================

A target beyond the arm's reach stretches the arm. The pseudoinverse then asks for unbounded joint velocities. With a
damping of 0.05 m they stay below 12 rad/s, but the stretched arm does not come to rest; with 0.2 m it does. The cost of
damping is the error on the way there.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import COLORS, DASHES

jax.config.update("jax_enable_x64", True)
arm, q0 = ck.planar_arm([1.0, 1.0]), np.array([-0.9, 1.3])
path = ck.line(np.asarray(ck.forward(arm, q0).position)[:2], [0.4, 2.15], duration=2.0)

figure, panels = plt.subplots(1, 2, figsize=(7, 2.8))
inverses = {"pseudoinverse": ck.pseudoinverse()} | {f"damped({size})": ck.damped(size) for size in (0.05, 0.2)}
for (name, inverse), color, dash in zip(inverses.items(), COLORS, DASHES, strict=False):
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=inverse)
    run = ck.solve(law, path, q0, 0.02, 150, "EE")
    panels[0].plot(run.t[1:], np.abs(run.qdot).max(1), color=color, ls=dash, label=name)
    panels[1].plot(run.t, np.linalg.norm(run.e, axis=1), color=color, ls=dash)
panels[0].set(xlabel="time [s]", ylabel="largest joint speed [rad/s]", yscale="log")
panels[1].set(xlabel="time [s]", ylabel="error [m]", yscale="log")
panels[0].legend()
