"""Arms of `tests.bench.loops`: their URDF without shapes, as cnclik and MuJoCo read it, and servos on their joints."""

import pathlib
import xml.etree.ElementTree as ET
from typing import NamedTuple

import mujoco
import numpy as np

import cnclik as ck
from tests.integrate.test_real_robots import ROBOTS, folder

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


SERVOS = {  # the first as the UR5e of the MuJoCo menagerie has it
    "position": Servo("position", (2000.0, 500.0), (400.0, 100.0)),
    "position, stiff": Servo("position", (20000.0, 5000.0), (400.0, 100.0)),
    "velocity, kv 400": Servo("velocity", (0.0, 0.0), (400.0, 400.0)),
    "velocity, kv 40": Servo("velocity", (0.0, 0.0), (40.0, 40.0)),
}


def _each(pair, n):
    """Gains (n,): those of the first three joints, and of the others."""
    return np.where(np.arange(n) < 3, *pair)


class Arm:
    """An arm at rest in its posture; its task is the pose of its tip."""

    def __init__(self, name):
        file, tip, _ = ROBOTS[name]
        self.tip = tip or TIPS[name]
        self.name, self.path = name, folder() / file
        self.q = np.array(POSTURES[name])
        self.chain = ck.load_urdf(self.path, self.tip)
        self.law = ck.Law(self.chain, ck.pose(), alpha=1.0, inverse=ck.pseudoinverse())
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

    def inertia(self) -> np.ndarray:
        """The joints' inertia (n, n) in the posture, armature in it [kg m²]."""
        model = self.model(SERVOS["position"])
        data = mujoco.MjData(model)
        data.qpos[:] = self.q
        mujoco.mj_forward(model, data)
        full = np.zeros((self.n, self.n))
        mujoco.mj_fullM(model, data, full)
        return full

    def jacobian(self) -> np.ndarray:
        """J (6, n) of the tip in the posture, by MuJoCo."""
        model = self.model(SERVOS["position"])
        data, j = mujoco.MjData(model), np.zeros((6, self.n))
        data.qpos[:] = self.q
        mujoco.mj_forward(model, data)
        mujoco.mj_jacBody(model, data, j[:3], j[3:], model.body(self.tip).id)
        return j

    def gains(self, servo: Servo):
        """k_p (n,), k_v (n,)."""
        return _each(servo.kp, self.n), _each(servo.kv, self.n)
