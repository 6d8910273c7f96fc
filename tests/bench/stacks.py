"""`python -m tests.bench.stacks [ROBOT ...]`: steps of stacks on one core, beside Pinocchio's C++, pink and mink.

The same step for all: poses of several tips, of the hand positions, weighted, damped, explicit Euler; the C++ is
compared first, to 1e-9, and the texts of `users` by where their tips end. By CPU time, in one run, in turn; medians.
`pin`, `cmeel-eigen`, pin-pink, mink, daqp and example-robot-data are needed; what is not installed
is left out. Ten minutes.
"""

import argparse
import ctypes
import functools
import statistics
from xml.etree import ElementTree

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik.measure.files import markdown
from cnclik.robot.chain import PRISMATIC
from cnclik.robot.model import modelled
from cnclik.robot.tree import BALL
from tests.bench import timing, users
from tests.bench.bodies import FEET, TIPS
from tests.bench.cases import end
from tests.bench.pinocchio_cpp import HERE, compiled
from tests.oracles import robots

ALPHA, DAMPING, WEIGHTS, TS = 10.0, 0.05, (1.0, 0.5), 0.01
LANES, STEPS, ROUNDS, ALONE = 8192, 10, 5, 200
G1 = "g1_description/urdf/g1_29dof_rev_1_0.urdf"
HANDS = ["left_rubber_hand", "right_rubber_hand"]
MORE = [f"{side}_{part}_link" for side in ("left", "right") for part in ("knee", "elbow", "shoulder_yaw", "hip_yaw")]
HAND = "Allegro, 4 fingertips"
ROBOTS = {  # file, tips, base
    "TIAGo on its base": ("tiago_description/robots/tiago_no_hand.urdf", ["arm_tool_link", "head_2_link"], "planar"),
    "Baxter, both arms": ("baxter_description/urdf/baxter.urdf", ["left_gripper", "right_gripper"], "fixed"),
    "G1, 5 tips": (G1, [*FEET, *HANDS, "torso_link"], "fixed"),
    "G1, 13 frames": (G1, [*FEET, *HANDS, "torso_link", *MORE], "fixed"),
    "G1, free base, 5 tips": (G1, [*FEET, *HANDS, "torso_link"], "free"),
    "G1, free base, 14 frames": (G1, TIPS, "free"),
    HAND: (
        "allegro_hand_description/urdf/allegro_right_hand.urdf",
        [f"link_{i}.0_tip" for i in (3, 7, 11, 15)],
        "fixed",
    ),
}


class Case:
    """A robot with tips, starts (B, n) and targets (B, tips, 4, 4) a little off them."""

    def __init__(self, name, batch=LANES):
        file, tips, self.base = ROBOTS[name]
        self.name, self.path, self.tips = name, robots() / file, tips
        self.robot = ck.load_urdf(self.path, tips=tips, base=self.base)
        self.weights = (WEIGHTS[0], 0.0) if name == HAND else WEIGHTS
        self.task = ck.stack(**{f"tip{i}": self._one(tip) for i, tip in enumerate(tips)})
        self.law = ck.Law(self.robot, self.task, alpha=ALPHA, inverse=ck.damped(DAMPING))
        self.limited = ck.replace(self.law, limits=ck.bounded(rate=1 / TS))
        rng = np.random.default_rng(0)
        low, high = (np.clip(np.array(b), -1.0, 1.0) for b in (self.robot.lower, self.robot.upper))
        inside = (np.array(b) for b in (self.robot.lower, self.robot.upper))
        self.q = rng.uniform(0.5 * low, 0.5 * high, (batch, self.robot.n))
        self.q[0, : {"fixed": 0, "planar": 3, "free": 6}[self.base]] = 0.0
        off = np.clip(self.q + 0.1 * rng.normal(size=self.q.shape), *inside)
        self.targets = np.asarray(jax.jit(jax.vmap(self._tips))(off))

    def _one(self, tip):
        if not self.weights[1]:
            return ck.position(tip=tip)
        return ck.pose(tip=tip, weights=[self.weights[0]] * 3 + [self.weights[1]] * 3)

    def _tips(self, q):
        def one(tip):
            at = ck.forward(self.robot, q, tip=tip)
            top = jnp.concatenate([at.rotation, at.position[:, None]], axis=1)
            return jnp.concatenate([top, jnp.array([[0.0, 0.0, 0.0, 1.0]])])

        return jnp.stack([one(tip) for tip in self.tips])

    def reference(self, targets):
        holds = {f"tip{i}": ck.hold(targets[i, :3, 3], targets[i, :3, :3]) for i in range(len(self.tips))}
        return ck.references(**holds)

    def given(self, limits):
        """What the texts of `users` are told of the first start."""
        speeds = dict(zip(self.robot.joint_names, self.robot.velocity_limit, strict=True))
        root = ElementTree.parse(self.path).getroot()
        inner = {joint.find("child").get("link") for joint in root.findall("joint")}
        (top,) = {link.get("name") for link in root.findall("link")} - inner
        return dict(
            URDF=str(self.path), BASE=self.base, ROOT=top, TIPS=self.tips, WEIGHTS=self.weights, LIMITS=limits,
            TARGETS=self.targets[0].tolist(), ALPHA=ALPHA, TS=TS, DAMPING=DAMPING, N=ALONE,
            START={n: v for n, v in zip(self.robot.joint_names, self.q[0].tolist(), strict=True) if v},
            SPEEDS={name: speed for name, speed in speeds.items() if np.isfinite(speed)},
        )  # fmt: skip

    def loop(self, N, limits=False):
        """(q, targets) to q after N steps."""

        def run(q, targets):
            law = self.limited if limits else self.law
            return end(law, self.reference(targets), q, TS, N)[0]

        return run


class Pinocchio:
    """The step in C++."""

    def __init__(self, case):
        chain, model = case.robot, modelled(case.robot)
        library = ctypes.CDLL(str(compiled(HERE / "pinocchio_stack.cpp")))
        self._new, self._run, self._delete = library.stack_new, library.stack_run, library.stack_delete
        pointer, real, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_int
        self._new.restype, self._new.argtypes = pointer, [whole, *[pointer] * 3, whole, *[pointer] * 2]
        self._run.restype = real
        self._run.argtypes = [pointer, whole, whole, pointer, pointer, real, real, pointer, real]
        self._delete.restype, self._delete.argtypes = None, [pointer]
        # Each joint moves about an axis of its own frame; a frame turned so that this is one of x, y, z. Three joints
        # that are one rotation are a ball joint, a quaternion in q.
        kept = [i for i, joint in enumerate(chain.joints) if joint.kind != BALL or i in {f for f, _ in chain.balls}]
        number = {i: k for k, i in enumerate(kept)} | {f + j: kept.index(f) for f, _ in chain.balls for j in (1, 2)}
        joints = [chain.joints[i] for i in kept]
        which = np.abs([j.axis for j in joints]).argmax(axis=1)
        turns = [np.eye(4) if j.kind == BALL else _onto(j.axis, w) for j, w in zip(joints, which, strict=True)]
        kinds = [6 if j.kind == BALL else w + 3 * (j.kind == PRISMATIC) for j, w in zip(joints, which, strict=True)]
        origins = np.asarray(model.transforms[0]) + np.asarray(model.transforms[2])  # A + C: where the value is 0
        parents = [number.get(chain.parents[i], -1) for i in kept]
        before = [np.eye(4) if p < 0 else turns[p].T for p in parents]
        places = np.stack([b @ origins[i] @ t for b, i, t in zip(before, kept, turns, strict=True)])
        carriers = [number[c] for c in model.carriers]
        offsets = np.stack([turns[c].T @ np.asarray(t) for c, t in zip(carriers, model.tips, strict=True)])
        self._kept = [np.ascontiguousarray(v) for v in (
            np.array(parents, np.int32), np.array(kinds, np.int32), places, np.array(carriers, np.int32), offsets,
        )]  # fmt: skip
        parents, kinds, places, carriers, offsets = (v.ctypes.data for v in self._kept)
        self._stack = self._new(len(joints), parents, kinds, places, len(case.tips), carriers, offsets)
        self._weights, self._balls = np.array(case.weights), [c for _, c in chain.balls]

    def run(self, q, targets, N):
        """(q after N steps, CPU seconds)"""
        q, targets = np.array(q), np.ascontiguousarray(targets)
        for c in self._balls[::-1]:
            q = np.concatenate([q[:, :c], Rotation.from_rotvec(q[:, c : c + 3]).as_quat(), q[:, c + 3 :]], axis=1)
        given = q.ctypes.data, targets.ctypes.data, ALPHA, DAMPING, self._weights.ctypes.data, TS
        seconds = self._run(self._stack, len(q), N, *given)
        for c in self._balls:
            q = np.concatenate([q[:, :c], Rotation.from_quat(q[:, c : c + 4]).as_rotvec(), q[:, c + 4 :]], axis=1)
        return q, seconds


def _onto(axis, k):
    """A rotation (4, 4) that takes the unit vector k onto an axis."""
    unit = np.eye(3)[k]
    v, c = np.cross(unit, axis), float(unit @ axis)
    made = np.eye(4)
    if c < -1 + 1e-12:
        made[:3, :3] = np.diag([-1.0 if i != (k + 1) % 3 else 1.0 for i in range(3)])
    else:
        cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
        made[:3, :3] = np.eye(3) + cross + cross @ cross / (1 + c)
    return made


def compare(case, peer):
    """The largest difference of joint values from Pinocchio's after all steps, of some lanes."""
    some = slice(0, 64)
    made = np.asarray(ck.lanes(case.loop(STEPS), cores=1)(case.q[some], case.targets[some]))
    return float(np.abs(made - peer.run(case.q[some], case.targets[some], STEPS)[0]).max())


def measure(name):
    """(case, rad off Pinocchio, rows (contender, µs a step, times Pinocchio's; seconds of a first call))."""
    case = Case(name)
    peer = Pinocchio(case)
    off = compare(case, peer)
    assert off < 1e-9, f"{name}: {off:g} rad off Pinocchio"
    rows: dict = {}
    found, calls = {}, {}
    for dtype, limits in (("float64", False), ("float32", False), ("float64", True)):
        given = case.q.astype(dtype), case.targets.astype(dtype)
        call = functools.partial(ck.lanes(case.loop(STEPS, limits), cores=1), *given)
        row = f"{dtype}, limits" if limits else dtype
        rows[f"first call of lanes, {row} [s]"] = timing.first(call)
        calls[f"cnclik in lanes, {row}"] = call, LANES * STEPS
    reference = case.reference(case.targets[0])
    whole = lambda: ck.solve(case.law, reference, case.q[0], TS, ALONE, "EE")  # noqa: E731
    with ck.use_engine("native"):
        whole()
    calls["cnclik, one loop, a step of 200"] = whole, ALONE
    for _ in range(ROUNDS):
        found.setdefault("Pinocchio C++", []).append(peer.run(case.q[:512], case.targets[:512], STEPS)[1] / 512 / STEPS)
        for row, (call, steps) in calls.items():
            with ck.use_engine("native"):
                found.setdefault(row, []).append(timing.cpu(call, 0.2) / steps)
    base = found["Pinocchio C++"]
    for row, seconds in found.items():
        rows[row] = (1e6 * statistics.median(seconds), timing.ratio(base, seconds))
    return case, off, rows


def beside(case, rounds) -> str:
    """What users' texts tell of the first start of a case, as Markdown."""
    rows = []
    for name in users.TEXTS:
        told = [users.run(name, case.given(limits), rounds) for limits in (False, True)]
        if None in told:
            continue
        free, held = told
        times = (f"{free.first:.2f}", f"{free.again:.2f}", f"{1e6 * free.step:.1f}", f"{1e6 * held.step:.1f}")
        rows.append((name, *times, f"{1e3 * free.off:.2g}", f"{1e3 * held.off:.2g}", users.lines(name)))
    head = ("", "first answer [s]", "next process [s]", "a step [µs]", "with limits [µs]", "off [mm]")
    return markdown((*head, "with limits, off [mm]", "lines"), rows)


def main(argv=None):
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(prog="python -m tests.bench.stacks", description=__doc__)
    parser.add_argument("robots", nargs="*", help=", ".join(ROBOTS))
    parser.add_argument("--rounds", type=int, default=3, help="processes of each user's text, cold and again")
    args = parser.parse_args(argv)
    for name in args.robots or ROBOTS:
        case, off, rows = measure(name)
        print(f"{name}: {case.task.m} rows × {case.robot.n} joints; within {off:.1e} rad of Pinocchio")
        for row, found in rows.items():
            print(
                f"  {row:<36}" + (f"{found:8.2f}" if isinstance(found, float) else "{:8.3f} µs {:7.2f}".format(*found))
            )
        if name != HAND:
            print(beside(case, args.rounds), flush=True)


if __name__ == "__main__":
    timing.one_core()
    main()
