"""
What do a drive and its dead time do to a step?
===============================================

The figure shows each robot with its recommended gain, after the target jumps by 1 cm. One robot follows at once, one
has a dead time, one a lag, and one a position servo.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import COLORS, DASHES

jax.config.update("jax_enable_x64", True)
arm, q0, Ts = ck.planar_arm([1.0, 0.8]), np.array([0.4, 0.9]), 0.01
target = ck.hold(np.asarray(ck.forward(arm, q0).position)[:2] + np.array([0.01, 0.0]))
drives = {
    "at once": ck.Drive(),
    "5 samples of dead time": ck.Drive(delay=5),
    "lag of 50 ms": ck.Drive(lag=0.05),
    "servo, 25 rad/s": ck.Drive(natural_frequency=25.0, damping_ratio=0.7, command="position"),
}
figure, panel = plt.subplots(figsize=(6, 2.9))
for (name, drive), color, dash in zip(drives.items(), COLORS, DASHES, strict=False):
    alpha = ck.gains(Ts=Ts, drive=drive, method="EE").recommended
    run = ck.solve(ck.Law(arm, ck.position("xy"), alpha=alpha), target, q0, Ts, 100, "EE", drive=drive)
    panel.plot(run.t, 1000 * run.e[:, 0], color=color, ls=dash, label=f"{name}: alpha = {alpha:.3g} 1/s")
panel.set(xlabel="time [s]", ylabel="error in x [mm]")
panel.legend()
