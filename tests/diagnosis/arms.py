"""`python -m tests.diagnosis.arms 44 29 SEED`: logs of 15 arms in MuJoCo whose loops shake or do not, and what is said.

The arms have inertia, servos, friction, encoders and torque limits; each joint has its own bandwidth, and commands
arrive late. A push moves the target by up to 2 cm; a run that strays by 4 cm is stopped, as by a safety system. What is
right is found by running: the largest gain with which the tip overshoots by less than 5 %.
"""

import collections
import sys

import mujoco
import numpy as np

import cnclik as ck
from tests.diagnosis.logs import between, largest, report
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
PHYSICS = 1e-3  # [s] of a step

# An arm at rest at q (n,), and what lies between its commands, positions or velocities, and its motion: samples of
# delay, about how late the motion is [s], the encoders' resolution and the measurement's noise [rad].
Plant = collections.namedtuple("Plant", "model tip q Ts delay position late resolution noise")


def drawn(rng, robot) -> Plant:
    """A robot with drawn servos."""
    file, tip, base = ROBOTS[robot]
    arm = ck.load_urdf(robots() / file, tip=tip, base=base)
    Ts = float(rng.choice([1e-3, 2e-3, 4e-3, 5e-3, 8e-3, 1e-2]))
    delay = int(np.clip(round(between(rng, 0.004, 0.06) / Ts), 0, 40))
    servo = str(rng.choice(["position", "position", "velocity", "integral"]))
    w = between(rng, 12, 120) * rng.uniform(0.8, 1.25, arm.n)  # ω₀, or 1/lag
    damping, armature = rng.uniform(0.5, 1.3), rng.uniform(0.3, 3.0, arm.n)  # in shares of the inertia
    friction = float(rng.choice([0.0, 2e-4, 5e-4]))  # [rad, rad/s] at which a servo just overcomes it
    resolution = float(rng.choice([0.0, 2 * np.pi / 2**12, 2 * np.pi / 2**16]))
    noise = float(rng.choice([0.0, 0.0, 1e-5, 1e-4]))
    acceleration = float(rng.choice([np.inf, np.inf, rng.uniform(10, 60)]))  # at the torque limit [rad/s²]
    low, high = (np.clip(np.asarray(v, float), -2.0, 2.0) for v in (arm.lower, arm.upper))
    q = 0.5 * (low + high) + 0.25 * (high - low) * np.random.default_rng(5).uniform(-1, 1, arm.n)

    spec = mujoco.MjSpec.from_file(str(robots() / file))
    others = [joint for joint in spec.joints if joint.name not in arm.joint_names]
    for part in (*spec.geoms, *spec.meshes, *spec.equalities, *others):
        spec.delete(part)
    for body in (body for body in spec.bodies[1:] if not body.joints):  # some have no proper inertia
        body.explicitinertial, body.mass, body.fullinertia = False, 0.0, np.full(6, np.nan)
    spec.compiler.fusestatic, spec.compiler.balanceinertia = False, True
    spec.compiler.boundmass, spec.compiler.boundinertia = 0.02, 1e-5
    spec.option.timestep, spec.option.gravity = PHYSICS, np.zeros(3)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for i, name in enumerate(arm.joint_names * (1 + (servo == "integral"))):
        actuator = spec.add_actuator(name=str(i), target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        kind = actuator.set_to_position if servo == "position" else actuator.set_to_velocity
        (kind if i < arm.n else actuator.set_to_intvelocity)(1.0)
        actuator.ctrllimited = actuator.forcelimited = actuator.actlimited = False
    model = spec.compile()
    assert [model.joint(i).name for i in range(arm.n)] == list(arm.joint_names)
    data, mass = mujoco.MjData(model), np.zeros((arm.n, arm.n))
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    mass = np.diag(mass)
    heavy = np.maximum(mass, 1e-3 * mass.max()) * (1 + armature)
    kp, kv = (heavy * w**2, 2 * damping * w * heavy) if servo == "position" else (0 * w, heavy * w)
    model.dof_armature[:], model.dof_damping[:] = heavy - mass, 0.0
    mujoco.mj_setConst(model, data)  # what friction needs of them
    model.actuator_gainprm[: arm.n, 0] = kp if servo == "position" else kv
    model.actuator_biasprm[: arm.n, 1:3] = np.stack([-kp, -kv], -1)
    model.actuator_gainprm[arm.n :, 0] = (0.25 * kv * w)[: model.nu - arm.n]
    model.actuator_biasprm[arm.n :, 1] = -model.actuator_gainprm[arm.n :, 0]
    model.dof_frictionloss[:] = friction * (kp if servo == "position" else 4 * kv)
    model.jnt_actfrclimited[:] = np.isfinite(acceleration)
    model.jnt_actfrcrange[:] = heavy[:, None] * min(acceleration, 1e9) * np.array([-1, 1])
    late = (delay + 1.5) * Ts + float(np.max(2 * damping / w if servo == "position" else 1 / w))
    return Plant(model, model.body(tip).id, q, Ts, delay, servo == "position", late, resolution, noise)


def run(plant, alpha, target, seed=0):
    """Errors (N, 3) of the tip, as the controller sees them and as they are, with q̇ = J#(α e) from rest.

    target (N, 3): how far the tip's target is from its first place [m].
    """
    model, tip, q = plant[:3]
    n, rng = len(q), np.random.default_rng(seed)
    data, look = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[:] = look.qpos[:] = q
    mujoco.mj_forward(model, look)
    first, j = look.xpos[tip].copy(), np.zeros((3, n))
    rest = q if plant.position else np.zeros(n)
    data.ctrl[:n] = rest
    sent, line, errors, step = q.copy(), [rest] * (plant.delay + 1), [], plant.resolution
    for away in target:
        mujoco.mj_kinematics(model, data)
        true = first + away - data.xpos[tip]
        measured = data.qpos + plant.noise * rng.standard_normal(n)
        look.qpos[:] = np.round(measured / step) * step if step else measured
        mujoco.mj_kinematics(model, look)
        mujoco.mj_comPos(model, look)
        mujoco.mj_jac(model, look, j, None, look.xpos[tip], tip)
        errors.append((first + away - look.xpos[tip], true))
        if np.linalg.norm(true) > STRAY:
            break
        rate = alpha * j.T @ np.linalg.solve(j @ j.T + 1e-6 * np.eye(3), errors[-1][0])
        sent = sent + plant.Ts * rate
        line = [*line[1:], sent if plant.position else rate]
        data.ctrl[:] = np.tile(line[0], model.nu // n)
        mujoco.mj_step(model, data, round(plant.Ts / PHYSICS))
    return np.array(errors).swapaxes(0, 1)


def direction(rng):
    away = rng.standard_normal(3)
    return away / np.linalg.norm(away)


def pushed(plant, alpha):
    """(By how much the tip passes its target after a push of 1 cm, as a share of it, inf where the run is stopped;
    whether its swing grows)."""
    N, away = int(np.clip(max(40 * plant.late, 4 / alpha) / plant.Ts, 120, 4000)), direction(np.random.default_rng(1))
    e = run(plant._replace(noise=0.0), alpha, np.tile(0.01 * away, (N, 1)))[1]
    if len(e) < N:
        return np.inf, True
    middle, last = (np.linalg.norm(e[i * N // 3 : (i + 1) * N // 3], axis=1).max() for i in (1, 2))
    return np.max(-e @ away) / 0.01, last > 0.95 * middle > 0.003


def log(seed, robot, kind):
    """(plant, errors (N, 3), gain, largest right gain) of a log that "shakes", is "calm", at "rest", or of a "path"."""
    rng = np.random.default_rng([seed, *kind.encode(), *robot.encode()])
    while True:
        plant = drawn(rng, robot)
        best = largest(lambda alpha, plant=plant: pushed(plant, alpha)[0] <= 0.05, 0.01 / plant.late, 3 / plant.late)
        most = largest(lambda alpha, plant=plant: not pushed(plant, alpha)[1], best, 20 * best)
        if best < 0.011 / plant.late or most < 1.5 * best:
            continue
        N = int(np.clip(rng.uniform(12, 40) * plant.late / plant.Ts, 60, 3000))
        rest = int(rng.integers(3, 40))
        target, alpha = np.zeros((N + rest, 3)), rng.uniform(0.25, 0.85) * best
        if kind == "shakes":
            alpha = rng.uniform(min(1.7 * best, 0.75 * most), 1.35 * most)
        if kind in ("shakes", "calm"):
            target[rest:] = direction(rng) * rng.uniform(0.004, 0.02)
        if kind == "path":
            t = np.arange(N + rest)[:, None] / (N + rest)
            target = 0.03 * rng.standard_normal(3) * np.sin(2 * np.pi * rng.uniform(0.3, 1.2) * t) ** 2
        e = run(plant, alpha, target, seed=int(rng.integers(1 << 30)))[0]
        if len(e) >= rest + 16 and (kind != "shakes" or pushed(plant, alpha)[0] >= 0.12):
            return plant, e, alpha, best


def answers(shake, calm, seed):
    """(group, gain or None, answer, what it is worth) of logs of all robots in turn, with alpha and without."""
    kinds = [(i, "shakes") for i in range(shake)] + [(i, ("calm", "rest", "path")[i % 3]) for i in range(calm)]
    for i, kind in kinds:
        plant, e, present, best = log(seed + i // len(ROBOTS), list(ROBOTS)[i % len(ROBOTS)], kind)
        for alpha in (present, None):
            found = ck.diagnose(e, plant.Ts, alpha=alpha)
            gain = (found.factor or 0.0) * present
            right = gain >= present if kind != "shakes" else gain > 0.25 * best and pushed(plant, gain)[0] <= 0.05
            worth = "no cause" if found.cause is None else "right" if right else "wrong"
            yield f"{'shakes' if kind == 'shakes' else 'calm'}, {'no ' * (alpha is None)}alpha", alpha, found, worth


if __name__ == "__main__":
    report(answers(*map(int, sys.argv[1:])))
