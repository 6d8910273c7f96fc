"""Two arms carry a tray: the left hand goes round a circle, the right one keeps its place in the frame of the left."""

import numpy as np

import cnclik as ck

LEFT, RIGHT = "left_gripper", "right_gripper"


def problem(alpha=10.0):
    robot = ck.load("baxter.urdf", tips=[LEFT, RIGHT, "left_lower_forearm"])
    tasks = ck.stack(grip=ck.pose(tip=RIGHT, relative_to=LEFT), tray=ck.pose(tip=LEFT), rest=ck.joints())
    q0 = ck.problem.start_from(robot, tasks)
    left = ck.forward(robot, q0, tip=LEFT)
    above = left.position + np.array([0, 0, 0.06])  # the circle begins at its lowest point
    circle = ck.circle(above, 0.06, period=4.0, normal=[1, 0, 0], rotation=left.rotation)
    forearm = ck.capsule("left_lower_forearm", 0.08, [0, 0, 0], [0, 0, 0.1])
    torso = ck.capsule(None, 0.15, [0, 0, -1], [0, 0, 1])
    walls = [
        ck.wall(ck.position("z", tip=LEFT), below=left.position[2] + 0.1, name="shelf"),
        ck.wall(ck.distance(forearm, torso), above=0.02, rate=20.0, name="elbow"),
    ]
    law = ck.Law(
        robot,
        tasks,
        alpha={"grip": 4 * alpha, "tray": alpha, "rest": 0.5},
        inverse=ck.levels(["grip"], ["tray"], ["rest"], damping=(1e-3, 0.02, 0.3)),
        limits=ck.bounded(walls=walls),
    )
    return law, ck.hold_at(robot, tasks, q0, tray=circle), q0
