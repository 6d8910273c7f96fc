"""
Two tasks that can't both be had: who gives way?
================================================

A torso of one link has an arm on each side, and the two targets are too far apart. With weights both hands miss. With
levels the left hand, which is the first level, is at its target. A conflict leaks into the first level as the square of
the ratio of the two dampings.
"""

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.show.style import BLUE, GREEN, VERMILION

jax.config.update("jax_enable_x64", True)
TORSO, ARM = [1.0], [0.8, 0.6]
robot = ck.planar_arm(TORSO)
for side in ("left", "right"):
    robot = ck.join(robot, ck.planar_arm(ARM), at="tip", prefix=f"{side}_", keep=True)
tasks = ck.stack(left=ck.position("xy", tip="left_tip"), right=ck.position("xy", tip="right_tip"))
targets = {"left": np.array([-1.7, 0.9]), "right": np.array([1.7, 0.9])}
paths = ck.references(**{side: ck.hold(place) for side, place in targets.items()})
q0 = np.array([0.1, 0.6, 0.5, -0.7, -0.6])


def end(damping):
    """The last q, with these dampings of left and right."""
    law = ck.Law(robot, tasks, alpha=5.0, inverse=ck.levels(["left"], ["right"], damping=(damping[0], damping[1])))
    return ck.solve(law, paths, q0, 0.02, 1500).q[-1]


def bodies(q):
    """Where the torso and each arm's joints and tip are."""
    torso = [np.zeros(2), np.array([-np.sin(q[0]), np.cos(q[0])])]
    yield np.array(torso)
    for some in (q[1:3], q[3:5]):
        turn = q[0] + np.cumsum(some)
        links = np.array(ARM)[:, None] * np.stack([-np.sin(turn), np.cos(turn)], axis=1)
        yield torso[1] + np.vstack([np.zeros(2), np.cumsum(links, axis=0)])


def missed(q):
    """How far off each hand is [m]."""
    return [np.linalg.norm(list(bodies(q))[i][-1] - targets[side]) for i, side in ((1, "left"), (2, "right"))]


ratios = np.geomspace(1, 100, 13)
ends = np.asarray(ck.lanes(end)(np.stack([0.1 / ratios, 0.1 + 0 * ratios], axis=1)))

figure, panels = plt.subplots(1, 2, figsize=(7, 3), layout="constrained")
for q, color, label in ((ends[0], "0.6", "weights"), (ends[-1], BLUE, "levels")):
    for k, points in enumerate(bodies(q)):
        panels[0].plot(*points.T, "o-", ms=3, color=color, label=label if k == 0 else None)
for place in targets.values():
    panels[0].plot(*place, "x", color=VERMILION, ms=8)
panels[0].set(aspect="equal", xlabel="x [m]", ylabel="y [m]", ylim=(-0.2, 2.0))
panels[0].legend(loc="upper center", ncols=2)
off = np.array([missed(q) for q in ends])
panels[1].loglog(ratios, off[:, 0], "o-", color=BLUE, label="left, level 1")
panels[1].loglog(ratios, off[:, 1], "s-", color=GREEN, label="right, level 2")
panels[1].loglog(ratios, off[3, 0] * (ratios[3] / ratios) ** 2, "--", color="0.5", label="square")
panels[1].set(xlabel="ratio of the dampings", ylabel="distance from the target [m]")
panels[1].legend()
print(f"with equal dampings the left hand is {off[0, 0]:.2g} m off, with a ratio of 100 {1e3 * off[-1, 0]:.2g} mm")
