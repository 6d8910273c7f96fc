"""Arms of `tests.bench.loops` in MuJoCo: their URDF without shapes, servos on their joints, and loops side by side.

A lane is a gain. It starts at rest in the posture, its target 0.5 mm and 1 mrad away, and its commands wait for so many
samples. Python runs at the controller's rate, C at the physics'.
"""

import pathlib
import xml.etree.ElementTree as ET
from typing import NamedTuple

import mujoco
import numpy as np

import cnclik as ck
from tests.oracles import ARMS, robots

STEP = 1e-3  # of the physics [s]
ARMATURE = 0.1  # [kg m²] of each joint's motor, seen behind its gears
TIPS = {"xArm7": "link7"}  # where a file has one tip alone
POSTURES = {
    "UR5": (0.4, -1.2, 1.5, -1.9, -1.3, 0.3),
    "Panda": (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4),
    "Kinova": (4.8, 2.91, 1.0, 4.2, 1.44, 1.32),
    "xArm7": (0.2, -0.4, 0.3, 1.2, -0.2, 1.5, 0.1),
}


class Servo(NamedTuple):
    """A servo on every joint: its command, and gains of the first three joints and of the others."""

    command: str
    kp: tuple
    kv: tuple
    ki: float = 0.0  # of a velocity servo: integral gain [1/s] times k_v


class World(NamedTuple):
    """What a robot has besides its servos, of the first three joints and of the others where there are two numbers."""

    dry: tuple = (0.0, 0.0)  # friction [N m]
    viscous: tuple = (0.0, 0.0)  # [N m s/rad]
    effort: tuple = (np.inf, np.inf)  # largest torque [N m]
    resolution: float = 0.0  # of the encoders [rad]
    gain: float = 1.0  # of a command, from rest


def _each(pair, n):
    """Gains (n,): those of the first three joints, and of the others."""
    return np.where(np.arange(n) < 3, *pair)


class Arm:
    """An arm at rest in its posture; its loop holds the pose of its tip."""

    def __init__(self, name):
        file, tip, _ = ARMS[name]
        self.tip = tip or TIPS[name]
        self.name, self.path = name, robots() / file
        self.q = np.array(POSTURES[name])
        self.chain = ck.load_urdf(self.path, self.tip)
        self.n = self.chain.n
        assert self.n == len(self.q)
        self.text = self._urdf()

    def _urdf(self) -> str:
        """Its URDF without shapes, grippers' joints fixed; MuJoCo is told to keep fixed links."""
        robot = ET.parse(pathlib.Path(self.path)).getroot()
        for link in robot.findall("link"):
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)
        for joint in robot.findall("joint"):
            if joint.get("type") != "fixed" and joint.get("name") not in self.chain.joint_names:
                joint.set("type", "fixed")
        for transmission in (*robot.findall("transmission"), *robot.findall("gazebo")):
            robot.remove(transmission)
        settings = {"fusestatic": "false", "balanceinertia": "true"}
        ET.SubElement(ET.SubElement(robot, "mujoco"), "compiler", settings)
        return ET.tostring(robot, encoding="unicode")

    def model(self, servo: Servo, step=STEP, world=World()):
        """MuJoCo's model: no weight or contact, a servo and ARMATURE on each joint, friction and efforts of the world.

        The second half of the actuators, if any, are the integral parts.
        """
        spec = mujoco.MjSpec.from_string(self.text)
        spec.option.timestep = step
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = np.zeros(3)
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        if not any(world.dry):  # dry friction is a constraint
            spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
        joints = [joint for body in spec.bodies for joint in body.joints]
        assert [joint.name for joint in joints] == list(self.chain.joint_names)
        for joint, kp, kv in zip(joints, _each(servo.kp, self.n), _each(servo.kv, self.n), strict=True):
            joint.armature = ARMATURE
            actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            if servo.command == "position":
                actuator.set_to_position(kp, kv)
            else:
                actuator.set_to_velocity(kv)
            actuator.ctrllimited = actuator.forcelimited = False
        for joint, kv in zip(joints if servo.ki else (), _each(servo.kv, self.n), strict=False):
            actuator = spec.add_actuator(
                name=f"{joint.name} integral", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_intvelocity(kv * servo.ki)
            actuator.ctrllimited = actuator.forcelimited = actuator.actlimited = False
        model = spec.compile()
        model.dof_damping[:], model.dof_frictionloss[:] = (_each(v, self.n) for v in (world.viscous, world.dry))
        # The efforts of the URDF file are left out: at them a loop swings without growing.
        model.jnt_actfrclimited[:] = np.isfinite(world.effort[0])
        most = _each(np.minimum(world.effort, 1e9), self.n)
        model.jnt_actfrcrange[:] = np.stack([-most, most], -1)
        return model


DIRECTION = np.array([0.6, -0.5, 0.62, 0.6, 0.5, -0.6])
SHIFT = (
    DIRECTION
    / np.repeat([np.linalg.norm(DIRECTION[:3]), np.linalg.norm(DIRECTION[3:])], 3)
    * np.repeat([5e-4, 1e-3], 3)
)
LOST = 100.0  # times the first error, from which on a lane is given up
GONE = 1e-6  # of the first error, below which it is rounding that goes up and down
FLAT = 1e-3  # growth up to which an error stays as it is: what the commands alone don't see remains


class Setup(NamedTuple):
    """What the lanes of a run share."""

    arm: object
    servo: object
    Ts: float
    feedback: str = "measured"
    step: float = STEP  # of the physics [s]
    world: World = World()


def turn_from(wanted, rotation):
    """Rotation vectors (B, 3) from rotations (B, 3, 3) to those that are wanted."""
    r = wanted @ np.swapaxes(rotation, -1, -2)
    half = 0.5 * np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], -1)
    sine = np.linalg.norm(half, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(r, axis1=1, axis2=2) - 1.0))
    return half * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None]


def rotation_of(v):
    """Rotation matrix of a rotation vector (3,)."""
    quaternion, out = np.empty(4), np.empty(9)
    angle = float(np.linalg.norm(v))
    mujoco.mju_axisAngle2Quat(quaternion, v / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def run(setup: Setup, alphas, delay, N, shift=SHIFT):
    """Errors (N + 1, B, 6) of the true tip [m, rad] of lanes with gains alphas (B,); NaN after a lane is given up.

    Args: delay [samples]; shift: (6,) of the target from the posture's pose [m, rad].
    """
    arm, servo, Ts, feedback, physics, world = setup
    model = arm.model(servo, physics, world)
    tip, n, B, sub = model.body(arm.tip).id, arm.n, len(alphas), round(Ts / physics)
    look = mujoco.MjData(model)  # what the controller computes, and where the true tip is
    datas = [mujoco.MjData(model) for _ in range(B)]
    position, steps = servo.command == "position", np.asarray(alphas)[:, None] * Ts
    rest = arm.q if position else np.zeros(n)
    for data in datas:
        begin(data, arm.q, rest)
    qs, us = [d.qpos for d in datas], [d.ctrl for d in datas]
    j, at, rotation = np.zeros((B, 6, n)), np.zeros((B, 3)), np.zeros((B, 3, 3))
    line = np.tile(rest, (delay + 1, B, 1))  # commands of the last samples, those of before the start at rest
    sent, size = np.tile(arm.q, (B, 1)), line.shape[0]
    look.qpos[:] = arm.q
    mujoco.mj_kinematics(model, look)
    goal, wanted = look.xpos[tip] + shift[:3], rotation_of(shift[3:]) @ look.xmat[tip].reshape(3, 3)
    e = np.full((N + 1, B, 6), np.nan)
    alive = list(range(B))

    def seen(values, b, jacobian):
        look.qpos[:] = values
        mujoco.mj_kinematics(model, look)
        if jacobian:
            mujoco.mj_comPos(model, look)
            mujoco.mj_jacBody(model, look, j[b, :3], j[b, 3:], tip)
        at[b], rotation[b] = look.xpos[tip], look.xmat[tip].reshape(3, 3)

    def error():
        return np.concatenate([goal - at, turn_from(wanted, rotation)], -1)

    def measured(values):
        return np.round(values / world.resolution) * world.resolution if world.resolution else values

    exact = feedback != "commanded" and not world.resolution
    for k in range(N + 1):
        for b in alive:
            seen(qs[b], b, exact)
        e[k, alive] = error()[alive]
        told = e[k]
        if not exact:
            for b in alive:
                seen(sent[b] if feedback == "commanded" else measured(qs[b]), b, True)
            told = error()
        big = np.abs(e[k]).max(-1) > max(LOST * np.abs(SHIFT).max(), 10 * np.abs(shift).max())
        if big.any():
            alive = [b for b in alive if not big[b]]
            if not alive:
                break
        told = np.where(np.isfinite(told), told, 0.0)[..., None]
        if n == 6:
            step = np.linalg.solve(j, told)[..., 0] * steps
        else:
            across = np.swapaxes(j, -1, -2)
            step = (across @ np.linalg.solve(j @ across, told))[..., 0] * steps
        sent = (measured(np.stack(qs)) if feedback == "rebased" else sent) + step
        line[k % size] = rest + world.gain * ((sent if position else step / Ts) - rest)
        for b in alive:
            us[b].reshape(-1, n)[:] = line[(k - delay) % size, b]
            mujoco.mj_step(model, datas[b], sub)
    return e


# --- what is measured ---------------------------------------------------------------------------------


def growth(e) -> np.ndarray:
    """Logarithm (B,) of how the envelope of ‖e‖ changed from the last sixth but one of a run to the last; inf if given
    up. By then what decays has gone, and what swings at the limit is left. An error that is larger than the first one
    counts as growing: fast joints may swing without end."""
    size = np.linalg.norm(e * np.repeat([1.0, 0.5], 3), axis=-1)
    part = len(size) // 6
    with np.errstate(all="ignore"):
        found = np.log(size[-part:].max(0) / size[-2 * part : -part].max(0))
    found = np.where(size[-part:].max(0) < GONE * size[0], -1.0, found)
    found = np.where(size[-part:].max(0) > size[0], np.maximum(found, FLAT), found - FLAT)
    return np.where(np.isfinite(size[-1]), found, np.inf)


def begin(data, q, command):
    """At rest at q, and commanded to be there, integral parts as well."""
    data.qpos[:] = q
    data.ctrl.reshape(-1, len(q))[:] = command
    data.act[:] = q[: len(data.act)]


def step_response(setup, size, N):
    """Motions (N + 1, n) of the joints from rest after a step of all their commands at once."""
    arm, servo, Ts, _, physics, world = setup
    model = arm.model(servo, physics, world)
    data, motions = mujoco.MjData(model), np.zeros((N + 1, arm.n))
    begin(data, arm.q, arm.q if servo.command == "position" else np.zeros(arm.n))
    data.ctrl.reshape(-1, arm.n)[:] += world.gain * size
    for k in range(N):
        mujoco.mj_step(model, data, round(Ts / physics))
        motions[k + 1] = data.qpos - arm.q
    return motions
