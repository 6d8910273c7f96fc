"""Part of `tests.bench.loops`: the loops of pink and mink, their largest gain, and whether cnclik's gain is quiet.

Each library's own loop: a task at the tip, solve_ik, integrate. Delay: it computes from joint values some samples old.
"""

import mink
import mujoco
import numpy as np
import pink
import pinocchio as pin

from cnclik.integrate.drive import Drive
from cnclik.stability.gain import gains
from tests.bench.loops_mujoco import Arm

DT = 0.005  # [s]
DELAYS = (0, 1, 2, 5)
STEPS = 240
SHIFT, TURN = np.array([0.6, -0.5, 0.62]) * 1e-3, np.array([1.2, 1.0, -1.2]) * 1e-3  # of the target [m], [rad]
REVERSED = 1e-3  # share of its fastest by which a joint may go back: the Jacobian is another at each step
NEAR = 0.9  # of the largest z, where joints do go back, to compare
SOLVER = "daqp"


class WithPink:
    """pink's loop on an arm."""

    def __init__(self, arm, dt=DT):
        self.dt = dt
        self.model = pin.buildModelFromXML(arm.text)
        self.seen = pink.Configuration(self.model, self.model.createData(), arm.q.copy())
        self.task = pink.tasks.FrameTask(arm.tip, position_cost=1.0, orientation_cost=1.0)
        start = self.seen.get_transform_frame_to_world(arm.tip)
        self.task.set_target(pin.SE3(start.rotation @ pin.exp3(TURN), start.translation + SHIFT))

    def velocity(self, q):
        self.seen.update(q)
        return pink.solve_ik(self.seen, [self.task], self.dt, solver=SOLVER, limits=[], damping=1e-12)

    def error(self, q):
        self.seen.update(q)
        return self.task.compute_error(self.seen)


class WithMink(WithPink):
    """mink's."""

    def __init__(self, arm, dt=DT):
        self.dt = dt
        self.seen = mink.Configuration(mujoco.MjModel.from_xml_string(arm.text), q=arm.q.copy())
        self.task = mink.FrameTask(arm.tip, "body", position_cost=1.0, orientation_cost=1.0)
        start = self.seen.get_transform_frame_to_world(arm.tip, "body")
        turned = start.rotation() @ mink.SO3.exp(TURN)
        self.task.set_target(mink.SE3.from_rotation_and_translation(turned, start.translation() + SHIFT))

    def velocity(self, q):
        self.seen.update(q)
        return mink.solve_ik(self.seen, [self.task], self.dt, SOLVER, limits=[], damping=1e-12)


LOOPS = {"pink": WithPink, "mink": WithMink}


def held(loop, q, z, delay, steps=STEPS):
    """Errors (k, 6) and velocities (k, n) of a loop with the gain z; it ends where the error is 20 times the first."""
    loop.task.gain = z  # as an attribute: mink's constructor refuses gains above 1, its loop takes them
    late, errors, velocities = [q.copy()] * (delay + 1), [], []
    for _ in range(steps):
        errors.append(loop.error(late[-1]))
        if np.linalg.norm(errors[-1]) > 20 * np.linalg.norm(errors[0]):
            break
        velocities.append(loop.velocity(late[-1 - delay]))
        late = [*late, late[-1] + velocities[-1] * loop.dt][-delay - 1 :]
    return np.array(errors), np.array(velocities)


def grows(loop, q, z, delay) -> bool:
    """Whether the error's envelope grows in the end."""
    errors, _ = held(loop, q, z, delay)
    size = np.linalg.norm(errors, axis=1)
    part = STEPS // 4
    if len(size) < STEPS:
        return True
    return size[-part:].max() > 1e-6 * size[0] and size[-part:].max() > size[-2 * part : -part].max()


def largest(loop, q, delay, low=0.02, high=4.0) -> float:
    """The largest z under which the error doesn't grow, to 0.5 %."""
    while high / low > 1.005:
        middle = np.sqrt(low * high)
        low, high = (low, middle) if grows(loop, q, middle, delay) else (middle, high)
    return float(np.sqrt(low * high))


def quiet(loop, q, z, delay) -> dict:
    """How far the error ever rises and a joint ever goes back, as shares; whether both are within REVERSED."""
    errors, v = held(loop, q, z, delay)
    size = np.linalg.norm(errors, axis=1)
    rise = float(np.max(np.diff(size), initial=0.0) / size[0])
    back = float(np.max(-v * np.sign(v[0]) / np.abs(v).max(), initial=0.0))
    return {"rise": rise, "back": back, "quiet": rise < REVERSED and back < REVERSED}


def measure(names=("UR5", "Panda")) -> list:
    """A row for each arm, library and delay."""
    rows = []
    for name in names:
        arm = Arm(name)
        for delay in DELAYS:
            ours = gains(Ts=DT, method="EE", drive=Drive(delay=delay))
            z, calm = ours.largest_stable * DT, ours.recommended * DT
            for peer, make in LOOPS.items():
                loop = make(arm)
                found = largest(loop, arm.q, delay)
                row = {"robot": name, "library": peer, "delay": delay, "predicted": z, "measured": found}
                near = quiet(loop, arm.q, NEAR * z, delay)["back"]
                rows.append(row | {"recommended": calm} | quiet(loop, arm.q, calm, delay) | {"back_near": near})
    return rows
