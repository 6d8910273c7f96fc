"""
How much does float32 cost?
===========================

JAX computes in float32 by default. A loop that reaches a point follows the same path in float32, down to the rounding
of its joint values: a tenth of a micrometre on an arm of two metres. Below that the float32 error is 0, and its line
leaves the figure.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

arm = ck.planar_arm([1.0, 0.8, 0.2])
law = ck.Law(arm, ck.position("xy"), alpha=5.0)
figure, panel = plt.subplots(figsize=(6, 2.8))
for wide, color, dash, name in ((True, BLUE, "-", "float64"), (False, VERMILION, "--", "float32")):
    with jax.enable_x64(wide):
        run = ck.solve(law, ck.hold([0.7, 1.1]), np.array([0.3, 0.6, 0.4]), 0.1, 70, "EE")
        panel.plot(run.t, np.linalg.norm(run.e, axis=1) + 1e-18, color=color, ls=dash, label=name)
panel.set(xlabel="time [s]", ylabel="error [m]", yscale="log", ylim=(1e-17, 10))
panel.legend()
