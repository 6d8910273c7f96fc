"""
From where does a loop arrive?
==============================

Theory holds for small errors. Forty thousand starts of a two-joint arm, run side by side, show how far it carries. Each
point is a start; its colour is the number of steps until the tip is within 1 mm of the target. The two crosses are the
postures with the tip at the target.
"""

import jax.numpy as jnp
import matplotlib.pyplot as plt

import cnclik as ck

arm, target, N = ck.planar_arm([1.0, 1.0]), ck.hold([0.5, 1.2]), 60


def steps(q1, q2, method, z):
    """Steps until the tip stays within 1 mm, NaN if it never does."""
    law = ck.Law(arm, ck.position("xy"), alpha=z / 0.1)
    run = ck.solve(law, target, jnp.stack([q1, q2]), 0.1, N, method)
    near = jnp.linalg.norm(run.e, axis=1) < 1e-3
    return jnp.where(near[-1], N + 1 - jnp.sum(near), jnp.nan)


elbow = 2 * jnp.arccos(jnp.hypot(0.5, 1.2) / 2)  # of links of 1 m
there = jnp.arctan2(-0.5, 1.2) - elbow / 2 * jnp.array([1, -1]), elbow * jnp.array([1, -1])  # q = 0 is along y
q1, q2 = jnp.meshgrid(jnp.linspace(-3.14, 3.14, 200), jnp.linspace(-3.14, 3.14, 200))
figure, panels = plt.subplots(1, 3, figsize=(7.16, 2.9), sharey=True)
for panel, (method, z) in zip(panels, (("EE", 0.5), ("EE", 1.5), ("EXP-MIDPOINT", 1.5)), strict=True):
    found = ck.lanes(lambda a, b, m=method, z=z: steps(a, b, m, z))(q1.ravel(), q2.ravel()).reshape(q1.shape)
    mesh = panel.pcolormesh(q1, q2, found, vmin=0, vmax=N, cmap="viridis_r", rasterized=True)
    panel.set(title=f"{method}, z = {z:g}", xlabel="q1 [rad]", aspect="equal")
    panel.plot(*there, "x", color="k", ms=5, mew=1)
    panel.set_facecolor("0.3")
    panel.grid(False)
    arrived = jnp.isfinite(found)
    print(f"{method}, z = {z:g}: {arrived.mean():.2%} arrive, half of them within {jnp.nanmedian(found):.0f} steps")
panels[0].set_ylabel("q2 [rad]")
figure.colorbar(mesh, ax=panels, label="steps to 1 mm; grey: never", location="bottom", shrink=0.6, aspect=40)
