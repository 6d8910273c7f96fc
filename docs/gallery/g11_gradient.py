"""
Which way should I turn the gain?
=================================

A loop is differentiable from end to end. Each short line has the slope of a tracking cost over alpha, from the
derivative through 60 steps. The cost falls with alpha up to z = 1.69, and grows beyond.
"""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, path = ck.planar_arm([1.0, 0.8]), ck.circle([1.0, 0.6], 0.3, period=3.0)
on_path = ck.solve(ck.Law(arm, ck.position("xy"), alpha=5.0), ck.hold([1.3, 0.6]), np.array([0.0, 0.9]), 0.05, 99).q[-1]


def cost(alpha):
    """Mean squared error plus a price for joint accelerations."""
    law = ck.Law(arm, ck.position("xy"), alpha=alpha, feedforward=0.0)
    run = ck.solve(law, path, on_path, 0.05, 60, "EE")
    return jnp.mean(run.e**2) + 2e-3 * jnp.mean(jnp.diff(run.qdot, axis=0) ** 2)


both = jax.jit(jax.vmap(jax.value_and_grad(cost)))
alpha = np.linspace(1.0, 39.0, 120)
value, slope = both(alpha)
figure, panel = plt.subplots(figsize=(6, 2.9))
panel.plot(alpha, value, color=BLUE)
for k in range(4, 120, 14):
    beside = np.array([-1.6, 1.6])
    tangent = value[k] * np.exp(slope[k] / value[k] * beside)  # straight on a logarithmic axis
    panel.plot(alpha[k] + beside, tangent, color=VERMILION, lw=1.6)
panel.set(xlabel="gain alpha [1/s]", ylabel="cost", yscale="log")
print(f"least at alpha = {alpha[np.argmin(value)]:.3g} 1/s, z = {alpha[np.argmin(value)] * 0.05:.3g}")
