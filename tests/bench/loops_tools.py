"""Part of `tests.bench.loops`: each of `Gains.elsewhere`, run as it is in the tool that it names.

pink, mink and Placo are run themselves; Isaac Lab's differential IK, MoveIt Servo's pose tracking and a loop around a
UR's servoj are copies of what their sources and manuals say, with Pinocchio's kinematics. The robot is a Panda whose
joints follow through a `Drive`, sampled exactly; its posture task draws along the null space. Needs Pinocchio, and of
pink, mink (with MuJoCo) and Placo what is to be run.
"""

import functools
import importlib
import xml.etree.ElementTree as ET
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import cnclik as ck
from cnclik.integrate.drive import Drive, sampled
from cnclik.stability.gain import ASSUMED_DELAY, LOOKAHEAD, OWN_COMMANDS, gains
from tests.oracles import ARMS, late_by, robots

FILE, TIP, _ = ARMS["Panda"]
Q = np.array([0.1, -0.7, 0.1, -2.2, 0.1, 1.7, 0.8])
SHIFT, TURN = np.array([0.02, -0.015, 0.02]), np.array([0.04, 0.05, -0.06])  # of the target [m], [rad]
AWAY = 0.2  # of the posture along the null space [rad]
LOST = 10.0  # [rad] of a joint, from which on a loop is given up
CASES = {  # Ts and drive; None: nothing is said, and the robot has what is assumed
    "5 samples": (0.008, Drive(delay=5)),
    "3 samples, lag 30 ms": (0.01, Drive(delay=3, lag=0.03)),
    "nothing said": (0.01, None),
}


@functools.cache
def arm():
    """Pinocchio's model without the fingers, its tip's frame, and cnclik's chain."""
    full = pin.buildModelFromUrdf(str(robots() / FILE))
    fingers = [i for i, name in enumerate(full.names) if "finger" in name]
    model = pin.buildReducedModel(full, fingers, pin.neutral(full))
    return model, model.getFrameId(TIP, pin.FrameType.BODY), ck.load_urdf(robots() / FILE, TIP)


@functools.cache
def goal() -> pin.SE3:
    at, _ = kinematics(Q)
    return pin.SE3(pin.exp3(TURN) @ at.rotation, at.translation + SHIFT)


@functools.cache
def posture():
    """Where the posture task draws: from Q along the null space."""
    _, j = kinematics(Q)
    return Q + AWAY * np.linalg.svd(j)[2][-1]


def kinematics(q):
    """(pose of the tip, J (6, n)), axes of the world."""
    model, tip, _ = arm()
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    return data.oMf[tip].copy(), pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)


def error(q):
    at, j = kinematics(q)
    to = goal()
    return np.concatenate([to.translation - at.translation, pin.log3(to.rotation @ at.rotation.T)]), j


class Plant:
    """Joints that follow commands through a drive."""

    def __init__(self, drive, Ts):
        self.model, self.Ts, self.positions = sampled(drive, Ts), Ts, drive.steps_positions
        self.x = np.zeros((len(Q), self.model.size))
        self.x[:, 0] = Q
        self.line = ((Q if self.positions else 0.0 * Q),) * self.model.remembered
        self.sent = Q

    def moved(self, step, begin=None):
        """Measured joints after a step of the controller [rad]; begin: where a position command begins, if not at the
        last one."""
        self.sent = (self.sent if begin is None else begin) + step
        u = self.sent if self.positions else step / self.Ts
        self.x, self.line = self.model.moved(self.x, self.line, u), (u, *self.line)[: self.model.remembered]
        return self.x[:, 0]


class Ran(NamedTuple):
    """What a loop did: largest overshoot of position or orientation as a share of the step, time until 2 % are left
    [s], and what is left of the way to the posture, as a share; inf where it was given up."""

    overshoot: float
    settled: float
    posture: float


def ran(controller, drive, Ts, seconds, *, own=False, rebased=False) -> Ran:
    """A loop: controller(q) -> q̇ from measured joints, or, with own, from its last command."""
    plant, q, errors = Plant(drive, Ts), Q, []
    for _ in range(round(seconds / Ts)):
        errors.append(error(q)[0])
        seen = plant.sent if own else q
        q = plant.moved(controller(seen) * Ts, q if rebased else None)
        if not np.abs(q).max() < LOST:
            return Ran(np.inf, np.inf, np.inf)
    e = np.array([*errors, error(q)[0]])
    over, settled = 0.0, 0.0
    for part in (slice(0, 3), slice(3, 6)):
        first = e[0, part]
        over = max(over, float((-e[:, part] @ first).max() / (first @ first)))
        left = np.flatnonzero(np.linalg.norm(e[:, part], axis=1) > 0.02 * np.linalg.norm(first))
        settled = max(settled, np.inf if left[-1] == len(e) - 1 else (left[-1] + 1) * Ts)
    null = np.linalg.svd(kinematics(q)[1])[2][-1]
    return Ran(over, settled, abs(float(null @ (posture() - q))) / AWAY)


# --- tools --------------------------------------------------------------------------------------------


def with_pink(gain, posture_gain, Ts):
    pink = importlib.import_module("pink")
    model, _, _ = arm()
    at = pink.Configuration(model, model.createData(), Q.copy())
    task = pink.tasks.FrameTask(TIP, position_cost=1.0, orientation_cost=1.0, gain=gain)
    task.set_target(goal())
    still = pink.tasks.PostureTask(cost=1e-3, gain=posture_gain)
    still.set_target(posture())

    def velocity(q):
        at.update(q)
        return pink.solve_ik(at, [task, still], Ts, solver="daqp", limits=[], damping=1e-12, safety_break=False)

    return velocity


def with_mink(gain, posture_gain, Ts):
    mink, mujoco = importlib.import_module("mink"), importlib.import_module("mujoco")
    from tests.bench.loops_mujoco import Arm

    model = mujoco.MjModel.from_xml_string(Arm("Panda").text)
    at = mink.Configuration(model, q=Q.copy())
    task = mink.FrameTask(TIP, "body", position_cost=1.0, orientation_cost=1.0, gain=gain)
    to = goal()
    task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(to.rotation), to.translation))
    still = mink.PostureTask(model, cost=1e-3, gain=posture_gain)
    still.set_target(posture())

    def velocity(q):
        at.update(q)
        return mink.solve_ik(at, [task, still], Ts, "daqp", limits=[], damping=1e-12)

    return velocity


def with_placo(gain, posture_gain, Ts):
    placo = importlib.import_module("placo")
    robot = placo.RobotWrapper(str(robots() / FILE), placo.Flags.ignore_collisions, _without_shapes())
    solver = placo.KinematicsSolver(robot)
    names = list(arm()[2].joint_names)
    solver.mask_fbase(True)
    for name in robot.joint_names():
        if name not in names:
            solver.mask_dof(name)
    task, still = solver.add_frame_task(TIP, np.eye(4)), solver.add_joints_task()
    task.configure("tip", "soft", 1.0, 1.0)
    still.configure("posture", "soft", 1e-6)
    solver.dt = Ts
    solver.enable_joint_limits(False)
    solver.enable_velocity_limits(False)

    def velocity(q):
        for name, value in zip(names, q, strict=True):
            robot.set_joint(name, value)
        robot.update_kinematics()
        now = robot.get_T_world_frame(TIP)
        task.T_world_frame = placo.interpolate_frames(now, goal().homogeneous, gain)
        still.set_joints({n: v + posture_gain * (w - v) for n, v, w in zip(names, q, posture(), strict=True)})
        solver.solve(True)
        return np.array([robot.get_joint(name) for name in names]) / Ts - q / Ts

    return velocity


def _without_shapes() -> str:
    robot = ET.parse(robots() / FILE).getroot()
    for link in robot.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    return ET.tostring(robot, encoding="unicode")


MADE = {"pink": with_pink, "mink": with_mink, "Placo": with_placo}


def isaac_lab(k_val):
    """Position target = measured joints + k_val·pinv(J)·e, as DifferentialIKController.compute."""

    def step(q):
        e, j = error(q)
        return k_val * np.linalg.pinv(j) @ e

    return step


def proportional(gain):
    """MoveIt Servo: a PID on each axis of the position error and on the angle, its twist through the pseudoinverse;
    velocities are published. The same law in a loop of one's own around servoj."""

    def velocity(q):
        e, j = error(q)
        return np.linalg.pinv(j) @ (gain * e)

    return velocity


# --- what is measured ---------------------------------------------------------------------------------


def measure(tools=("pink", "mink", "Isaac Lab", "MoveIt Servo", "UR servoj"), cases=CASES) -> list:
    """A row for each tool, case and way of setting it: what is set, what was promised, and what the loop did."""
    return [row for case in cases for tool in tools for row in _measured(tool, case)]


def _measured(tool, case):
    Ts, drive = CASES[case]
    if tool == "Isaac Lab" and drive is not None and drive.order:
        drive = ck.replace(drive, command="position")  # its servos are of position: of a velocity's no gain is named
    advised = gains(Ts=Ts, method="EE", drive=drive)
    real, settles, value = advised.drive, advised.response.settling_time, advised.elsewhere[tool].value

    def row(way, value, found, promised=settles):
        about = {"tool": tool, "case": case, "Ts": Ts, "way": way, "set": value, "promised": promised}
        return about | {name: float(v) for name, v in found._asdict().items()}

    if tool in MADE:
        for way, posture_gain in (("as given", value), ("posture at its default, 1", 1.0)):
            yield row(way, value, ran(MADE[tool](value, posture_gain, Ts), real, Ts, 2.5 * settles))
        seconds, own = 40 * Ts + 12 * late_by(real, Ts), OWN_COMMANDS
        yield row(f"{own} of the last command", own, ran(MADE[tool](own, own, Ts), real, Ts, seconds, own=True), None)
    elif tool == "Isaac Lab" and value is None:
        return
    elif tool == "Isaac Lab":
        servo = ck.replace(real if real.order else Drive(delay=real.delay, lag=1e-9), command="position")
        looped = gains(Ts=Ts, method="EE", drive=ck.replace(servo, feedback="rebased"))
        promised, step = looped.at(value / Ts).settling_time, isaac_lab(value)
        found = ran(lambda q: step(q) / Ts, servo, Ts, 2.5 * promised, rebased=True)
        yield row("as given", value, found, promised)
    elif tool == "MoveIt Servo":
        yield row("as given", value, ran(proportional(value), real, Ts, 2.5 * settles))
    elif value is not None:
        ur = Drive(delay=ASSUMED_DELAY / Ts if drive is None else drive.delay, lag=LOOKAHEAD, command="position")
        for way, rebased in (("as given", False), ("from the measured joints", True)):
            yield row(way, value, ran(proportional(value), ur, Ts, 8 / value, rebased=rebased), None)
        if drive is not None:
            whole = advised.recommended
            yield row("alpha without servoj's lag", whole, ran(proportional(whole), ur, Ts, 8 / value), None)
