"""A bank of loops that tests share: four programs, whose gains, sampling times, starts and targets are arrays.

A literal arm, a task, a method or a dtype is a program to trace and to compile; other numbers are not. A test that
needs a loop of no special kind takes one of these, and asks it for numbers.
"""

import functools
from typing import NamedTuple

import numpy as np

import cnclik as ck
from cnclik.law.paths import Reference
from cnclik.paper.readings import WithVelocity
from cnclik.robot.chain import PRISMATIC, REVOLUTE, Joint, assemble, offset_of
from cnclik.robot.fixed import Offset, vsub
from tests.oracles import damped_inverse, robot_file

N, LANES, DAMPING = 5, 7, 0.1
LENGTHS = np.array([1.0, 0.8, 0.6, 0.5])
G1, HANDS = robot_file("g1"), ["left_rubber_hand", "right_rubber_hand"]


@functools.cache
def robot(name):
    """planar2 and planar3, two planar arms on one trunk, or G1 above the pelvis."""
    if name.startswith("planar"):
        return ck.planar_arm(LENGTHS[: int(name[-1])].tolist())
    if name == "two arms":
        trunk, arm = (ck.planar_arm(v.tolist()) for v in (LENGTHS[:2], LENGTHS[2:4]))
        both = ck.join(trunk, arm, prefix="one_", keep=True)
        return ck.join(both, arm, at="tip", prefix="two_")
    return ck.load_urdf(G1, tips=HANDS)


@functools.cache
def law(name):
    """Positions of all tips, damped; the plane's x and y for planar arms."""
    axes = "xyz" if name == "g1" else "xy"
    each = [ck.position(axes, tip=tip.name) for tip in robot(name).tips]
    return ck.Law(robot(name), functools.reduce(lambda a, b: a & b, each), alpha=1.0, inverse=ck.damped(DAMPING))


def places(name, q):
    """Coordinates of the task, (m,), at joint values."""
    count = 3 if name == "g1" else 2
    tips = [ck.forward(robot(name), q, tip=tip.name) for tip in robot(name).tips]
    return np.concatenate([np.asarray(at.position, float)[:count] for at in tips])


@functools.cache
def numbers(name):
    """Gain, sampling time, start and target of each lane: all that differs between runs of one program."""
    rng, chain = np.random.default_rng(len(name)), robot(name)
    low, high = (np.clip(bound, -1.5, 1.5) for bound in (chain.lower, chain.upper))
    low = np.where(np.isinf(chain.lower), 0.2, low)  # bent: planar arms are singular where they are straight
    q0 = rng.uniform(low + 0.3 * (high - low), high - 0.3 * (high - low), (LANES, chain.n))
    target = np.array([places(name, q + 0.1 * np.cos(np.arange(chain.n))) for q in q0])
    return rng.uniform(2, 8, LANES), rng.uniform(0.01, 0.05, LANES), q0, target


def screws(points, axes, home, *, kinds=None, **limits):
    """A robot by points on its joints' axes, the axes' directions, and the tip's pose, all at q = 0."""
    joints, last = [], (0.0, 0.0, 0.0)
    for i, (point, axis) in enumerate(zip(points, axes, strict=True)):
        kind, length = PRISMATIC if kinds and kinds[i] == "P" else REVOLUTE, sum(a * a for a in axis) ** 0.5
        origin, last = Offset(position=vsub(tuple(point), last)), tuple(point)
        joints.append(Joint(kind=kind, axis=tuple(a / length for a in axis), origin=origin, coordinate=i))
    tip = offset_of("home", home)
    return assemble(joints, Offset(position=vsub(tip.position, last), rotation=tip.rotation), **limits)


def told(path, velocity):
    """A path whose feed-forward is another than its own velocity."""
    return Reference(curve=WithVelocity(path=path.curve, velocity=velocity))


class Loop(NamedTuple):
    """One program of the bank."""

    name: str
    method: str
    dtype: str

    def run(self, alpha, Ts, q0, target):
        """A run of N steps, of one lane."""
        changed, tips = ck.replace(law(self.name), alpha=alpha), robot(self.name).tips
        size = len(target) // len(tips)
        if len(tips) == 1:
            aims = ck.hold(target)
        else:
            aims = ck.references(**{t.name: ck.hold(target[i * size : (i + 1) * size]) for i, t in enumerate(tips)})
        run = ck.solve(changed, aims, q0, Ts, N, self.method, ck.picard(3))
        return {name: getattr(run, name) for name in ("q", "e", "x", "qdot", "residual", "status")}

    def numbers(self):
        """`numbers` in the dtype of the loop."""
        return [v.astype(self.dtype) for v in numbers(self.name)]


def by_pinocchio(alpha, Ts, q0, target):
    """q of N explicit Euler steps of G1 on Pinocchio's kinematics."""
    from tests.robot.test_urdf import Pinocchio, oracle

    where, path = Pinocchio(G1, oracle(G1)[0]), [q0]
    for _ in range(N):
        each = [where.at(robot("g1").joint_names, path[-1], tip, "pelvis") for tip in HANDS]
        e = target - np.concatenate([at[0] for at in each])
        path.append(path[-1] + Ts * damped_inverse(DAMPING)(np.vstack([at[2][:3] for at in each])) @ (alpha * e))
    return np.array(path)


LOOPS = [
    Loop("planar2", "CN", "float32"),
    Loop("planar3", "EXP-MIDPOINT", "float64"),
    Loop("two arms", "EXP-MIDPOINT", "float64"),
    Loop("g1", "EE", "float64"),
]
