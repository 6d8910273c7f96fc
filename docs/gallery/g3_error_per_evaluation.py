"""
Which method, per evaluation?
=============================

The cost of a step is its Jacobians, each with its inverse. The figure shows the error on a circle, tracked at
alpha = 5 1/s, against the number of Jacobians per second.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import line

jax.config.update("jax_enable_x64", True)
arm, path = ck.planar_arm([1.0, 0.8, 0.5]), ck.circle([1.2, 0.8], 0.3, period=4.0)
law = ck.Law(arm, ck.position("xy"), alpha=5.0)
q0 = ck.solve(law, ck.hold([1.5, 0.8]), np.array([0.0, 0.9, 0.5]), 0.1, 60).q[-1]
Ts = np.array([0.2, 0.1, 0.05, 0.025])

figure, panel = plt.subplots(figsize=(6, 3.2))
for name in ("EE", "CN", "RK4", "EXP-EE", "EXP-MIDPOINT", "EXP-RK4"):

    @jax.jit
    @jax.vmap
    def error(Ts, name=name):
        """RMS error over the second half of 80 steps, and evaluations a second."""
        run = ck.solve(law, path, q0, Ts, 80, name)
        return ck.measure.measure_run(run, law, path, ["rms_error"])["rms_error"], run.evaluations / (80 * Ts)

    rms, spent = error(Ts)
    panel.plot(spent, rms, **line(name))
panel.set(xlabel="evaluations per second", ylabel="RMS error [m]", xscale="log", yscale="log")
panel.legend(ncols=2)
