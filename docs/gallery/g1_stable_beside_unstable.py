"""
What does a gain that is too large look like?
=============================================

The arm, the path and the explicit Euler steps are the same on both sides. On the left z = alpha·Ts = 0.5; on the right
z = 2.1, just beyond the limit of 2.

.. image:: /_static/safe-gain.gif
   :alt: Two planar arms follow a line; one smoothly, one shaking ever harder
   :width: 640
"""

import sys

import jax
import matplotlib.animation
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, VERMILION

jax.config.update("jax_enable_x64", True)
arm, q0, Ts, N = ck.planar_arm([1.0] * 5, clockwise=True), np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0]), 0.1, 42
path = ck.line([4.0, 1.0], [2.0, 1.0], duration=4.0)
runs = {}
for z in (0.5, 2.1):
    law = ck.Law(arm, ck.position("xy"), alpha=z / Ts)
    runs[z] = np.asarray(ck.solve(law, path, q0 + 0.01, Ts, N, "EE").q)


def joints(q):
    """Where the joints and the tip of a planar arm are, from its angles, (N, 6, 2)."""
    turn = -np.cumsum(q, axis=-1)
    links = np.stack([-np.sin(turn), np.cos(turn)], axis=-1)
    return np.concatenate([np.zeros((*q.shape[:-1], 1, 2)), np.cumsum(links, axis=-2)], axis=-2)


figure, panels = plt.subplots(1, 2, figsize=(6.4, 2.9), sharey=True)
drawn = []
for panel, (z, q), color, word in zip(panels, runs.items(), (BLUE, VERMILION), ("stable", "unstable"), strict=True):
    places = joints(q)
    panel.plot([4, 2], [1, 1], color="0.6", lw=3, alpha=0.6)
    trail = panel.plot([], [], color=color, lw=0.8, alpha=0.8)[0]
    links = panel.plot([], [], "o-", color=color, lw=3, ms=5, mfc="white")[0]
    panel.set(xlim=(-1.4, 4.6), ylim=(-1.2, 3.2), aspect="equal", xticks=[], yticks=[])
    panel.set_title(f"alpha = {z / Ts:g} 1/s, z = {z:g}: {word}")
    panel.grid(False)
    panel.spines[:].set_visible(False)
    drawn.append((trail, links, places))


def frame(k):
    """Both arms at sample k."""
    for trail, links, places in drawn:
        trail.set_data(*places[: k + 1, -1].T)
        links.set_data(*places[k].T)
    return [line for trail, links, _ in drawn for line in (trail, links)]


frame(N)

# %%
# ``python g1_stable_beside_unstable.py safe-gain.gif`` writes the moving picture.

if __name__ == "__main__" and sys.argv[1:] and sys.argv[1].endswith(".gif"):
    moving = matplotlib.animation.FuncAnimation(figure, frame, frames=[*range(N + 1), *[N] * 8])
    moving.save(sys.argv[1], writer="pillow", fps=12, dpi=100)
