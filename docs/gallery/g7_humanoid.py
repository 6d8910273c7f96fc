"""
A humanoid reaches down: do its feet stay, and does it keep its balance?
========================================================================

.. image:: /_static/humanoid.gif
   :alt: A humanoid's right hand goes round a large circle down to its shins; the feet stay, the pelvis gives way

The pelvis is a free base. Both feet are the first level, the hand's circle is the second, a posture the third. Walls
keep the centre of mass, the green dot on the floor, over the polygon of the feet.
"""

import importlib.metadata
import sys

import jax
import matplotlib.animation
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial import ConvexHull

import cnclik as ck
from cnclik.show.style import BLUE, GREEN, VERMILION

jax.config.update("jax_enable_x64", True)
installed = importlib.metadata.files("example-robot-data") or []
file = next(one for one in installed if one.name == "g1_29dof_rev_1_0.urdf").locate()
limbs = [f"{side}_{part}_link" for part in ("hip_pitch", "knee", "ankle_roll", "shoulder_pitch", "elbow")
         for side in ("left", "right")]  # fmt: skip
feet, hands = ["left_ankle_roll_link", "right_ankle_roll_link"], ["left_rubber_hand", "right_rubber_hand"]
robot = ck.load_urdf(file, tips=[*limbs, *hands, "pelvis", "torso_link"], base="free")

q0 = np.zeros(robot.n)
for joint, angle in (("hip_pitch", -0.3), ("knee", 0.6), ("ankle_pitch", -0.3), ("elbow", 0.6)):
    for side in ("left", "right"):
        q0[robot.joint_names.index(f"{side}_{joint}_joint")] = angle


def place(q, tip):
    """Where a tip is [m]."""
    return np.asarray(ck.forward(robot, q, tip=tip).position)


floor = place(q0, feet[0])[2] - 0.04
corners = [place(q0, foot)[:2] + np.array([x, y]) for foot in feet for x in (-0.04, 0.11) for y in (-0.03, 0.03)]
edges = ConvexHull(corners).equations  # outwards x + offset ≤ 0
walls = [ck.wall(ck.center_of_mass("xy"), normal=-edge[:2], above=edge[2] + 0.01) for edge in edges]
tasks = ck.stack(
    feet=ck.pose(tip=feet[0]) & ck.pose(tip=feet[1]),
    hand=ck.position(tip=hands[1]),
    rest=ck.joints(),
)
law = ck.Law(
    robot,
    tasks,
    alpha={"feet": 20.0, "hand": 10.0, "rest": 0.5},
    inverse=ck.levels(["feet"], ["hand"], ["rest"], damping=(1e-3, 0.02, 0.3)),
    limits=ck.bounded(walls=walls),
)
start = place(q0, hands[1])
path = ck.circle(start + np.array([0.12, 0.0, -0.25]), 0.28, period=5.0, normal=[0, 1, 0])
run = ck.solve(law, ck.hold_at(robot, tasks, q0, hand=path), q0, 0.02, 300)
moved = 1e3 * np.abs(run["feet"].e).max()
followed = 1e3 * np.abs(run["hand"].e[100:]).max()
print(f"the feet move by at most {moved:.2g} mm or mrad, the hand follows to {followed:.2g} mm")

# %%
# Each limb is a line through its joints.

lines = [["pelvis", "neck", "head"], ["left_shoulder_pitch_link", "neck", "right_shoulder_pitch_link"]]
for side in ("left", "right"):
    lines.append(["pelvis", *(f"{side}_{part}_link" for part in ("hip_pitch", "knee", "ankle_roll"))])
    lines.append([f"{side}_{part}_link" for part in ("shoulder_pitch", "elbow")] + [f"{side}_rubber_hand"])
tips = [*limbs, *hands, "pelvis"]


def seen(q):
    """Where tips are, the neck between the shoulders, the head above it, and the centre of mass [m]."""
    at = {tip: ck.forward(robot, q, tip=tip).position for tip in tips}
    neck = 0.5 * (at["left_shoulder_pitch_link"] + at["right_shoulder_pitch_link"])
    up = ck.forward(robot, q, tip="torso_link").rotation[:, 2]
    return at | {"neck": neck, "head": neck + 0.17 * up, "com": ck.com(robot, q)}


places = {name: np.asarray(at) for name, at in ck.lanes(seen)(run.q[::3]).items()}

figure = plt.figure(figsize=(4.2, 5.0), layout="constrained")
panel = figure.add_subplot(projection="3d", elev=12, azim=-50)
hull = np.array(corners)[[0, 1, 3, 7, 6, 4, 0]] if len(corners) == 8 else np.array(corners)
panel.plot(*hull.T, floor, color="0.5", lw=1)
panel.plot(*places[hands[1]].T, color=VERMILION, lw=0.8)
bones = [panel.plot([], [], [], "o-", color=BLUE, lw=5, ms=4, mfc="white", solid_capstyle="round")[0] for _ in lines]
mass = panel.plot([], [], [], "o", color=GREEN, ms=8)[0]
panel.set(xlim=(-0.45, 0.55), ylim=(-0.5, 0.5), zlim=(floor, floor + 1.3))
panel.set_box_aspect((1, 1, 1.3), zoom=1.3)
panel.set_axis_off()


def frame(k):
    """The robot at a picture."""
    for bone, line in zip(bones, lines, strict=True):
        bone.set_data_3d(*np.array([places[tip][k] for tip in line]).T)
    x, y, _ = places["com"][k]
    mass.set_data_3d([x], [y], [floor])
    return [*bones, mass]


frame(len(places["com"]) // 3)

# %%
# ``python g7_humanoid.py humanoid.gif`` writes the moving picture.

if __name__ == "__main__" and sys.argv[1:] and sys.argv[1].endswith(".gif"):
    moving = matplotlib.animation.FuncAnimation(figure, frame, frames=range(0, len(places["com"]) - 16, 2))
    moving.save(sys.argv[1], writer="pillow", fps=8, dpi=60)
