"""`python -m tests.diagnosis.arms 44 29`: logs of 15 arms in MuJoCo whose loops shake or do not, and what is said.

The arms have inertia, servos, friction, encoders and torque limits. Each joint has its own bandwidth; the controller
sees encoders, and its commands arrive late. A push moves the target by up to 2 cm; a run that strays by 4 cm is
stopped, as by a safety system. What is right is found by running: the largest gain with which the tip overshoots by
less than 5 %.
"""

import argparse
import collections
import functools
import xml.etree.ElementTree as ET
from typing import NamedTuple

import mujoco
import numpy as np

import cnclik as ck
from tests.oracles import robots

ROBOTS = {  # file below example-robot-data's robots, tip, base
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8", None),
    "UR3": ("ur_description/urdf/ur3_robot.urdf", "tool0", None),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", None),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", "link7", None),
    "Z1": ("z1_description/urdf/z1.urdf", "link06", None),
    "SO100": ("so_arm_description/urdf/so100.urdf", "gripper", None),
    "SO101": ("so_arm_description/urdf/so101.urdf", "gripper_link", None),
    "iCub": ("icub_description/robots/icub.urdf", "l_hand", "chest"),
    "Talos": ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", "torso_2_link"),
    "PR2": ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", "torso_lift_link"),
    "Tiago": ("tiago_description/robots/tiago_no_hand.urdf", "arm_tool_link", "torso_lift_link"),
    "Baxter": ("baxter_description/urdf/baxter.urdf", "left_gripper", "torso"),
    "G1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", "left_rubber_hand", "torso_link"),
}
STRAY = 0.04  # [m] of error at which a run is stopped
PHYSICS = 1e-3  # [s] of a step, at most


class Setup(NamedTuple):
    """A robot, and what lies between its commands and its motion; quantities of joints (n,)."""

    robot: str
    Ts: float
    delay: int  # samples
    servo: str  # position, velocity, integral
    frequency: np.ndarray  # ω₀ of position servos, 1/lag of velocity servos [rad/s]
    damping: float
    armature: np.ndarray  # in shares of the inertia
    friction: float  # [rad, rad/s] at which a servo just overcomes it
    resolution: float  # of the encoders [rad]
    noise: float  # of the measurement [rad]
    acceleration: float  # at the torque limit [rad/s²]


def drawn(rng, robot) -> Setup:
    n = chain(robot).n
    Ts = float(rng.choice([1e-3, 2e-3, 4e-3, 5e-3, 8e-3, 1e-2]))
    late = np.exp(rng.uniform(np.log(0.004), np.log(0.06)))
    return Setup(
        robot=robot,
        Ts=Ts,
        delay=int(np.clip(round(late / Ts), 0, 40)),
        servo=str(rng.choice(["position", "position", "velocity", "integral"])),
        frequency=np.exp(rng.uniform(np.log(12), np.log(120))) * rng.uniform(0.8, 1.25, n),
        damping=rng.uniform(0.5, 1.3),
        armature=rng.uniform(0.3, 3.0, n),
        friction=float(rng.choice([0.0, 2e-4, 5e-4])),
        resolution=float(rng.choice([0.0, 2 * np.pi / 2**12, 2 * np.pi / 2**16])),
        noise=float(rng.choice([0.0, 0.0, 1e-5, 1e-4])),
        acceleration=float(rng.choice([np.inf, np.inf, rng.uniform(10, 60)])),
    )


@functools.cache
def chain(robot):
    file, tip, base = ROBOTS[robot]
    return ck.load_urdf(robots() / file, tip=tip, base=base)


@functools.cache
def text(robot) -> str:
    """The URDF without shapes; other joints than the arm's are fixed, links that the arm does not move have no mass."""
    root, names = ET.parse(robots() / ROBOTS[robot][0]).getroot(), chain(robot).joint_names
    moved = {joint.find("child").get("link") for joint in root.findall("joint") if joint.get("name") in names}
    for link in root.findall("link"):
        for part in [p for p in link if p.tag != "inertial" or link.get("name") not in moved]:
            link.remove(part)
    for joint in root.findall("joint"):
        if joint.get("name") not in names:
            joint.set("type", "fixed")
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    for other in [child for child in root if child.tag in ("transmission", "gazebo", "mujoco")]:
        root.remove(other)
    settings = {"fusestatic": "false", "balanceinertia": "true", "boundmass": "0.02", "boundinertia": "1e-5"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", settings)
    return ET.tostring(root, encoding="unicode")


def built(setup):
    """(model, index of the tip, posture (n,)) of a setup."""
    arm, servo, w = chain(setup.robot), setup.servo, setup.frequency
    low, high = (np.clip(np.asarray(v, float), -2.0, 2.0) for v in (arm.lower, arm.upper))
    q = 0.5 * (low + high) + 0.25 * (high - low) * np.random.default_rng(5).uniform(-1, 1, arm.n)
    spec = mujoco.MjSpec.from_string(text(setup.robot))
    spec.option.timestep = PHYSICS
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.gravity = np.zeros(3)
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    joints = [joint for body in spec.bodies for joint in body.joints]
    assert [joint.name for joint in joints] == list(arm.joint_names)
    bare = spec.compile()
    data, mass = mujoco.MjData(bare), np.zeros((arm.n, arm.n))
    data.qpos[:] = q
    mujoco.mj_forward(bare, data)
    mujoco.mj_fullM(bare, data, mass)
    inertia = np.maximum(np.diag(mass), 1e-3 * np.diag(mass).max())
    heavy = inertia * (1 + setup.armature)
    kp, kv = (heavy * w**2, 2 * setup.damping * w * heavy) if servo == "position" else (0 * w, heavy * w)
    for i, joint in enumerate(joints):
        joint.armature = (heavy - np.diag(mass))[i]
        actuator = spec.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        if servo == "position":
            actuator.set_to_position(kp[i], kv[i])
        else:
            actuator.set_to_velocity(kv[i])
        actuator.ctrllimited = actuator.forcelimited = False
    for i, joint in enumerate(joints if servo == "integral" else ()):
        actuator = spec.add_actuator(name=f"{i}", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        actuator.set_to_intvelocity(kv[i] * 0.25 * w[i])
        actuator.ctrllimited = actuator.forcelimited = actuator.actlimited = False
    model = spec.compile()
    model.dof_damping[:] = 0.0
    model.dof_frictionloss[:] = setup.friction * (kp if servo == "position" else 4 * kv)
    model.jnt_actfrclimited[:] = np.isfinite(setup.acceleration)
    most = heavy * min(setup.acceleration, 1e9)
    model.jnt_actfrcrange[:] = np.stack([-most, most], -1)
    return model, model.body(ROBOTS[setup.robot][1]).id, q


class Run(NamedTuple):
    """Measured joints (N, n), commands (N, n), errors of the tip as the controller sees them and as they are (N, 3)."""

    q: np.ndarray
    command: np.ndarray
    seen: np.ndarray
    e: np.ndarray


def run(setup, plant, alpha, N, target, seed=0) -> Run:
    """N steps of q̇ = J#(α e) from rest. target (N, 3): how far the tip's target is from its first place [m]."""
    model, tip, q = plant
    n, rng = len(q), np.random.default_rng(seed)
    data, look = mujoco.MjData(model), mujoco.MjData(model)
    position, sub = setup.servo == "position", round(setup.Ts / PHYSICS)
    data.qpos[:] = look.qpos[:] = q
    mujoco.mj_forward(model, look)
    first, j = look.xpos[tip].copy(), np.zeros((3, n))
    rest = q if position else np.zeros(n)
    data.ctrl[:n] = rest
    sent, line, made = q.copy(), [rest] * (setup.delay + 1), ([], [], [], [])
    for k in range(N):
        mujoco.mj_kinematics(model, data)
        true = first + target[k] - data.xpos[tip]
        measured = data.qpos + setup.noise * rng.standard_normal(n)
        if setup.resolution:
            measured = np.round(measured / setup.resolution) * setup.resolution
        look.qpos[:] = measured
        mujoco.mj_kinematics(model, look)
        mujoco.mj_comPos(model, look)
        mujoco.mj_jac(model, look, j, None, look.xpos[tip], tip)
        e = first + target[k] - look.xpos[tip]
        rate = alpha * j.T @ np.linalg.solve(j @ j.T + 1e-6 * np.eye(3), e)
        sent = sent + setup.Ts * rate
        command = sent if position else rate
        for row, value in zip(made, (measured.copy(), command, e, true), strict=True):
            row.append(value)
        if np.linalg.norm(true) > STRAY:
            break
        line = [*line[1:], command]
        data.ctrl[:n] = line[0]
        data.ctrl[n:] = line[0][: model.nu - n]
        mujoco.mj_step(model, data, sub)
    return Run(*map(np.array, made))


def late(setup) -> float:
    """About how late the motion is [s]."""
    slow = 2 * setup.damping / setup.frequency if setup.servo == "position" else 1 / setup.frequency
    return (setup.delay + 1.5) * setup.Ts + float(np.max(slow))


def push(setup, rng, N, size=None):
    away = rng.standard_normal(3)
    away = away / np.linalg.norm(away) * (rng.uniform(0.004, 0.02) if size is None else size)
    return np.tile(away, (N, 1))


def pushed(setup, plant, alpha, rows, least):
    """A push of 1 cm without noise: (rows, whether it was stopped, errors of the tip (N, 3), direction of the push)."""
    N = int(np.clip(rows / setup.Ts, least, 4000))
    target = push(setup, np.random.default_rng(1), N, 0.01)
    e = run(setup._replace(noise=0.0), plant, alpha, N, target).e
    return N, len(e) < N, e, target[0] / 0.01


def over(setup, plant, alpha) -> float:
    """By how much the tip passes its target after a push of 1 cm, as a share of it; inf where the run is stopped."""
    _, stopped, e, away = pushed(setup, plant, alpha, max(25 * late(setup), 4 / alpha), 60)
    return np.inf if stopped else float(np.max(-e @ away) / 0.01)


def growing(setup, plant, alpha) -> bool:
    N, stopped, e, _ = pushed(setup, plant, alpha, 40 * late(setup), 120)
    e = np.linalg.norm(e, axis=1)
    return stopped or e[2 * N // 3 :].max() > 0.95 * e[N // 3 : 2 * N // 3].max() > 0.003


def limits(setup, plant):
    """(the largest gain that overshoots by less than 5 %, the largest stable one) [1/s], to some per cent."""
    best = 0.12 / late(setup)
    while over(setup, plant, best) > 0.05:
        best /= 1.5
        if best < 1e-2:
            return None
    while over(setup, plant, best * 1.3) <= 0.05 and best < 300:
        best *= 1.3
    for step in (1.14, 1.07):
        best = best * step if over(setup, plant, best * step) <= 0.05 else best
    most = best
    while not growing(setup, plant, most * 1.25) and most < 20 * best:
        most *= 1.25
    return best, most * 1.12


class Log(NamedTuple):
    """A log and what is true of it; `plant` is None where nothing shakes."""

    setup: Setup
    plant: tuple
    q: np.ndarray
    command: np.ndarray
    e: np.ndarray
    alpha: float
    best: float
    shakes: bool
    about: str


def log(seed, robot, kind) -> Log:
    """A log of a robot. kind: "shakes", "calm", "rest" or "path"."""
    rng = np.random.default_rng([seed, *kind.encode(), *robot.encode()])
    while True:
        setup = drawn(rng, robot)
        plant = built(setup)
        ends = limits(setup, plant)
        if ends is None or ends[1] < 1.5 * ends[0]:
            continue
        best, most = ends
        N = int(np.clip(rng.uniform(12, 40) * late(setup) / setup.Ts, 60, 3000))
        rest = int(rng.integers(3, 40))
        target = np.zeros((N + rest, 3))
        alpha = rng.uniform(0.25, 0.85) * best
        if kind == "shakes":
            alpha = rng.uniform(min(1.7 * best, 0.75 * most), 1.35 * most)
        if kind in ("shakes", "calm"):
            target[rest:] = push(setup, rng, N)
        if kind == "path":
            t = np.arange(N + rest)[:, None] / (N + rest)
            target = 0.03 * rng.standard_normal(3) * np.sin(2 * np.pi * rng.uniform(0.3, 1.2) * t) ** 2
        made = run(setup, plant, alpha, N + rest, target, seed=int(rng.integers(1 << 30)))
        if len(made.q) < rest + 16 or (kind == "shakes" and over(setup, plant, alpha) < 0.12):
            continue
        return Log(setup, plant, made.q, made.command, made.seen, alpha, best, kind == "shakes", kind)


def verdict(log, gain) -> str:
    """What a gain [1/s] that is named for a log is worth: right, over or low; "false" where nothing shook."""
    if not log.shakes:
        return "false" if gain < log.alpha else "right"
    if over(log.setup, log.plant, gain) > 0.05:
        return "over"
    return "right" if gain > 0.25 * log.best else "low"


def logs(seed, count=44, calm=29):
    """`count` logs that shake, `calm` that do not, of all robots in turn."""
    names = list(ROBOTS)
    for i in range(count):
        yield log(seed + i // len(names), names[i % len(names)], "shakes")
    for i in range(calm):
        yield log(seed + i // len(names), names[i % len(names)], ("calm", "rest", "path")[i % 3])


def main() -> None:
    """Print what `diagnose` says of the errors of each log, with alpha and without."""
    parser = argparse.ArgumentParser(prog="python -m tests.diagnosis.arms")
    parser.add_argument("shake", type=int, nargs="?", default=44)
    parser.add_argument("calm", type=int, nargs="?", default=29)
    parser.add_argument("--seed", type=int, default=0)
    args, told, sure = parser.parse_args(), collections.defaultdict(collections.Counter), []
    for log in logs(args.seed, args.shake, args.calm):
        for alpha in (log.alpha, None):
            found = ck.diagnose(log.e, log.setup.Ts, alpha=alpha)
            said = "no gain" if found.cause is None else "false cause"
            if found.factor is not None:
                said = verdict(log, found.factor * log.alpha)
            told["shakes" if log.shakes else "calm", "alpha" if alpha else "no alpha"][said] += 1
            sure += [said == "right"] if (found.confidence or 0.0) >= 0.9 else []
            if said not in ("right", "no gain"):
                print(log.about, log.setup.robot, log.setup.servo, alpha, said, log.best, found, flush=True)
    for row, each in told.items():
        print(*row, dict(each))
    print(f"Of what is said with 0.9 or more {sum(sure)} of {len(sure)} are right.")


if __name__ == "__main__":
    main()
