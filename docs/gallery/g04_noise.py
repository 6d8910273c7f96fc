"""
What does noise cost?
=====================

A large gain follows the target, and the noise too. If the measurement has white noise of standard deviation s, the
motion of explicit Euler has s·√(z/(2 − z)). Simulated loops agree.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, GUIDE

jax.config.update("jax_enable_x64", True)
arm, q0, Ts, noise = ck.planar_arm([1.0, 0.8]), np.array([0.4, 0.9]), 0.01, 1e-4
target = ck.hold(np.asarray(ck.forward(arm, q0).position)[:2])
drawn = np.random.default_rng(0).normal(0, noise, (3000, 2))


@jax.jit
@jax.vmap
def motion(z):
    """Standard deviation of the tip over a long run at rest, per noise."""
    law = ck.Law(arm, ck.position("xy"), alpha=z / Ts)
    run = ck.solve(law, target, q0, Ts, 3000, "EE", noise=drawn)
    return run.e[1000:].std() / noise


z = np.geomspace(0.01, 1.8, 14)
figure, panel = plt.subplots(figsize=(6, 2.8))
fine = np.geomspace(0.01, 1.9, 200)
panel.plot(fine, np.sqrt(fine / (2 - fine)), color=BLUE, label="√(z/(2 − z))")
panel.plot(z, motion(z), "o", color=BLUE, mfc="white", label="3000 steps, simulated")
panel.axhline(0.5, **GUIDE)
panel.text(0.011, 0.53, "half of the noise: z = 0.4", fontsize=6.5, color="0.35")
panel.set(xlabel="z = alpha·Ts", ylabel="motion / noise", xscale="log", yscale="log")
panel.legend()
