"""A humanoid on a free base: its feet stay, its hand goes round a circle, and its balance stays over the soles."""

import numpy as np
from scipy.spatial import ConvexHull

import cnclik as ck

FEET, HAND = ["left_ankle_roll_link", "right_ankle_roll_link"], "right_rubber_hand"
BENT = {"hip_pitch": -0.3, "knee": 0.6, "ankle_pitch": -0.3, "elbow": 0.6}


def problem(alpha=10.0):
    robot = ck.load("g1.urdf", tips=[*FEET, HAND], base="free")
    q0 = [next((angle for part, angle in BENT.items() if f"_{part}_" in name), 0.0) for name in robot.joint_names]
    tasks = ck.stack(
        feet=ck.pose(tip=FEET[0]) & ck.pose(tip=FEET[1]),
        balance=ck.center_of_mass("xy"),
        hand=ck.position(tip=HAND),
        rest=ck.joints(),
    )
    soles = [ck.forward(robot, q0, tip=foot).position[:2] for foot in FEET]
    corners = [place + np.array([x, y]) for place in soles for x in (-0.05, 0.12) for y in (-0.03, 0.03)]
    edges = ConvexHull(corners).equations  # outwards x + offset ≤ 0
    walls = [ck.wall(ck.center_of_mass("xy"), normal=-edge[:2], above=edge[2] + 0.01) for edge in edges]
    above = ck.forward(robot, q0, tip=HAND).position + np.array([0, 0, 0.05])  # the circle begins at its lowest point
    law = ck.Law(
        robot,
        tasks,
        alpha={"feet": 5 * alpha, "balance": 4.0, "hand": alpha, "rest": 1.0},
        inverse=ck.levels(["feet"], ["balance"], ["hand"], ["rest"], damping=(1e-3, 0.02, 0.05, 1.0)),
        limits=ck.bounded(walls=walls),
    )
    circle = ck.circle(above, 0.05, period=4.0, normal=[1, 0, 0])
    return {"law": law, "reference": ck.hold_at(robot, tasks, q0, hand=circle), "q0": q0, "robot": "g1.urdf"}
