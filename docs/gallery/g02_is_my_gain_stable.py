"""
Is my gain stable?
==================

Explicit Euler keeps 1 − z of an error in each step. The error decays up to z = 2, and has no overshoot up to z = 1.
Beyond z = 2 it grows.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import series

jax.config.update("jax_enable_x64", True)
arm, q0, Ts = ck.planar_arm([1.0, 0.8]), np.array([0.4, 0.9]), 0.05
target = ck.hold(np.asarray(ck.forward(arm, q0).position)[:2] + np.array([0.02, 0.0]))

figure, panel = plt.subplots(figsize=(6, 2.8))
for i, z in enumerate((0.3, 1.0, 1.7, 2.1)):
    law = ck.Law(arm, ck.position("xy"), alpha=z / Ts)
    run = ck.solve(law, target, q0, Ts, 20, "EE")
    panel.plot(run.t, 1000 * run.e[:, 0], **series(i), label=f"z = {z:g}")
panel.axhline(0, color="0.6", lw=0.6)
panel.set(xlabel="time [s]", ylabel="error in x [mm]", ylim=(-60, 60))
panel.legend(ncols=2)

# %%
# The same in numbers, for any robot and posture:

print(ck.gains(Ts=Ts, drive=ck.Drive(), method="EE"))
