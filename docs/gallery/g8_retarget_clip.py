"""
A motion clip on G1: how close can it follow?
=============================================

A person's motion, or here G1's own with noise, stands in a CSV file: a row for each frame, and for each of 14 links
its position and quaternion in columns such as ``left_knee_link.x``. Any motion-capture tool can write one. G1 follows
it on a free base with two steps a frame. Its feet come first, and its joints stay within their limits. Scale a person's
proportions to the robot's first; hold a foot that stands at the mean of its places, or it slides with the noise.
"""

import functools
import importlib.metadata
import operator
import pathlib
import tempfile

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik.robot.poses import quaternions, rotations
from cnclik.show.style import BLUE

jax.config.update("jax_enable_x64", True)
QUATERNION = ("qw", "qx", "qy", "qz")
installed = importlib.metadata.files("example-robot-data") or []
file = pathlib.Path(next(one for one in installed if one.name == "g1_29dof_rev_1_0.urdf").locate())
sides, parts = ("left", "right"), ("hip_roll", "knee", "shoulder_yaw", "elbow", "wrist_yaw")
feet = [f"{side}_ankle_roll_link" for side in sides]
body = ["pelvis", "torso_link", *(f"{side}_{part}_link" for side in sides for part in parts)]
g1 = ck.load_urdf(file, tips=feet + body, base="free")
fps, t = 30.0, np.arange(300) / 30.0  # 10 s

# %%
# The clip: G1 steps in place and waves.
q = np.zeros((len(t), g1.n))
step, wave = np.sin(2 * np.pi * 0.9 * t), np.clip(t - 3, 0, 1) * np.clip(8 - t, 0, 1)
q[:, g1.joint_names.index("base_z")] = 0.76
moves = {"right_shoulder_pitch": -1.2 * wave, "right_shoulder_roll": -0.9 * wave, "right_elbow": wave * np.sin(9 * t)}
for side, lifted in zip(sides, (np.maximum(step, 0), np.maximum(-step, 0)), strict=True):
    moves |= {f"{side}_hip_pitch": -0.3 - 0.5 * lifted, f"{side}_knee": 0.6 + 0.9 * lifted}
    moves |= {f"{side}_ankle_pitch": -0.3 - 0.4 * lifted}
for name, values in moves.items():
    q[:, g1.joint_names.index(f"{name}_joint")] = values
places = jax.jit(jax.vmap(lambda q: {tip: ck.forward(g1, q, tip=tip) for tip in feet + body}))
seen, rng = places(q), np.random.default_rng(0)

# %%
# As a file: 5 mm of noise, and the columns of each link.
columns = {"time": t}
for tip, at in seen.items():
    noisy = np.asarray(at.position) + 0.005 * rng.normal(size=(len(t), 3))
    turned = np.asarray(quaternions(np.asarray(at.rotation)))
    named = {f"{tip}.{name}": value for name, value in zip("xyz", noisy.T, strict=True)}
    columns |= named | {f"{tip}.q{name}": value for name, value in zip("wxyz", turned.T, strict=True)}
clip = pathlib.Path(tempfile.mkdtemp()) / "clip.csv"
np.savetxt(clip, np.stack([*columns.values()], 1), delimiter=",", header=",".join(columns), comments="", fmt="%.6g")

# %%
# Retargeted: z = alpha·Ts = 1, and two steps a frame. Orientations weigh less than positions.
table = np.genfromtxt(clip, delimiter=",", names=True, deletechars="")


def path(tip):
    """The path of one link, from its columns."""
    position, turn = (np.stack([table[f"{tip}.{name}"] for name in names], 1) for names in ("xyz", QUATERNION))
    return ck.waypoints(table["time"], position, rotations("clip", turn))


weights = [1.0] * 3 + [0.22] * 3
links = [functools.reduce(operator.and_, (ck.pose(tip=tip, weights=weights) for tip in some)) for some in (feet, body)]
tasks = ck.stack(feet=links[0], body=links[1])
levels = ck.levels(["feet"], ["body"], damping=(0.02, 0.05))
law = ck.Law(g1, tasks, alpha=2 * fps, inverse=levels, limits=ck.bounded(rate=2 * fps))
paths = ck.hold_at(g1, tasks, q[0], **{name: ck.references(**{tip: path(tip) for tip in some}) for name, some in
                                       (("feet", feet), ("body", body))})  # fmt: skip
run = ck.solve(law, paths, q[0], Ts=0.5 / fps, N=2 * len(t) - 2, method="EE")

# %%
# Grey: the links' true places. Blue: G1 as it follows the noisy clip, twice a second.
found = np.asarray(run.q)[::2]
moved = places(found)
off = {tip: 1e3 * np.linalg.norm(moved[tip].position - seen[tip].position, axis=1) for tip in feet + body}
room = np.minimum(found - np.array(g1.lower), np.array(g1.upper) - found).min()
legs, arms = ("hip_roll_link", "knee_link", "ankle_roll_link"), ("shoulder_yaw_link", "elbow_link", "wrist_yaw_link")


def bones(at, frame):
    """Lines through the joints of one frame: spine and head, legs, arms."""
    here = {tip: at[tip].position[frame] for tip in feet + body}
    neck = sum(here[f"{side}_shoulder_yaw_link"] for side in sides) / 2 + np.array([0.0, 0.0, 0.12])
    yield [here["pelvis"], neck, neck + np.array([0.0, 0.0, 0.18])]
    for side in sides:
        yield [here["pelvis"], *(here[f"{side}_{part}"] for part in legs)]
        yield [neck, *(here[f"{side}_{part}"] for part in arms)]


figure, axes = plt.subplots(figsize=(7.2, 2.6))
for k, frame in enumerate(range(85, 205, 15)):
    for at, color, width in ((seen, "0.75", 5.0), (moved, BLUE, 1.5)):
        for bone in bones(at, frame):
            x, y, z = np.array(bone).T
            axes.plot(0.65 * k - y - 0.5 * x, z - 0.2 * x, color=color, lw=width, solid_capstyle="round")
axes.set(aspect="equal")
axes.set_axis_off()
print(f"RMS {np.sqrt(np.mean(np.square([*off.values()]))):.2g} mm; least room to a joint limit {room:.2g} rad")
