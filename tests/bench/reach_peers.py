"""Robots, targets and checks by Pinocchio's kinematics for `tests.bench.reach`; Pinocchio's search in C++."""

import ctypes
import time
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import cnclik as ck
from cnclik.robot.chain import REVOLUTE
from tests.bench.cases import matrix
from tests.bench.pinocchio_cpp import HERE, compiled
from tests.integrate.test_real_robots import ROBOTS, folder

TOLERANCE = 1e-6  # [m], [rad]
SLACK = 1e-9  # [m, rad] between two forward kinematics
LEAF = "link_eef"  # xArm7's only leaf


class Robot:
    """A robot as cnclik has it, beside Pinocchio's model of the same file."""

    def __init__(self, name):
        file, tip, base = ROBOTS[name]
        self.name, self.path = name, folder() / file
        self.chain = ck.load_urdf(self.path, tip, base)
        self.model = pin.buildModelFromUrdf(str(self.path))
        self._data = self.model.createData()
        self._tip = self.model.getFrameId(tip or LEAF, pin.FrameType.BODY)
        self._root = self.model.getFrameId(base, pin.FrameType.BODY) if base else None
        self._joints = [self.model.joints[self.model.getJointId(name)] for name in self.chain.joint_names]
        on_the_way, at = [], self.model.frames[self._tip].parentJoint
        stop = self.model.frames[self._root].parentJoint if base else 0
        while at != stop:
            on_the_way.insert(0, self.model.names[at])
            at = self.model.parents[at]
        assert tuple(on_the_way) == tuple(self.chain.joint_names)  # and so no joint that only mimics another
        low = [self.model.lowerPositionLimit[j.idx_q] if j.nq == 1 else -np.inf for j in self._joints]
        high = [self.model.upperPositionLimit[j.idx_q] if j.nq == 1 else np.inf for j in self._joints]
        self.lower, self.upper = np.array(low), np.array(high)

    def range(self):
        """Where joints are drawn: the limits, one turn where there are none."""
        return np.where(np.isfinite(self.lower), self.lower, -np.pi), np.where(
            np.isfinite(self.upper), self.upper, np.pi
        )

    def drawn(self, count, seed=17):
        """Joint values (count, n) in that range."""
        low, high = self.range()
        return low + (high - low) * np.random.default_rng(seed).random((count, len(low)))

    def pose(self, q):
        """Pinocchio's 4×4 transforms of the tip, seen from the base, for (B, n) joint values."""
        out = np.tile(np.eye(4), (len(q), 1, 1))
        for k, values in enumerate(q):
            pin.forwardKinematics(self.model, self._data, self._full(values))
            m = pin.updateFramePlacement(self.model, self._data, self._tip)
            if self._root is not None:
                m = pin.updateFramePlacement(self.model, self._data, self._root).actInv(m)
            out[k, :3, :3], out[k, :3, 3] = m.rotation, m.translation
        return out

    def right(self, q, targets, tolerance=(TOLERANCE, TOLERANCE)):
        """Which of (B, n) answers put the tip at their targets (B, 4, 4) and keep the limits."""
        at = self.pose(np.where(np.isfinite(q), q, 0.0))
        away = np.linalg.norm(at[:, :3, 3] - targets[:, :3, 3], axis=1)
        chord = np.linalg.norm((at - targets)[:, :3, :3], axis=(1, 2)) / np.sqrt(8)
        there = (away <= tolerance[0] + SLACK) & (2 * np.arcsin(np.minimum(chord, 1)) <= tolerance[1] + SLACK)
        kept = ((q >= self.lower - SLACK) & (q <= self.upper + SLACK)).all(axis=1)
        return there & kept & np.isfinite(q).all(axis=1)

    def _full(self, q):
        full = pin.neutral(self.model)
        for joint, v in zip(self._joints, q, strict=True):
            full[joint.idx_q : joint.idx_q + joint.nq] = [np.cos(v), np.sin(v)] if joint.nq == 2 else v
        return full

    def about_z(self):
        """(origins (n, 4, 4), tip (4, 4)) of the same arm with every joint about the z of its own frame."""
        origins, before = [], np.eye(4)
        for joint in self.chain.joints:
            assert joint.kind == REVOLUTE and joint.multiplier == 1 and joint.offset == 0
            turned = np.eye(4)
            turned[:3, :3] = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(joint.axis)).matrix()
            origins.append(before.T @ matrix(joint.origin) @ turned)
            before = turned
        return np.stack(origins), before.T @ matrix(self.chain.tip)


class PinocchioOptions(NamedTuple):
    """λ² = damping + of_error ‖e‖², at most so many iterations from each of so many random starts."""

    damping: float
    of_error: float
    iterations: int
    starts: int = 50


class PinocchioReach:
    """Inverse kinematics of an arm of 6 or 7 revolute joints in C++."""

    def __init__(self, robot):
        library, self._n = ctypes.CDLL(str(compiled(HERE / "pinocchio_reach.cpp"))), robot.chain.n
        new, self._run = (getattr(library, f"reach_{self._n}_{verb}") for verb in ("new", "run"))
        pointer, real, whole = ctypes.c_void_p, ctypes.c_double, ctypes.c_int64
        new.restype, new.argtypes = pointer, [pointer] * 4
        self._run.restype = None
        self._run.argtypes = [pointer, *[real] * 4, whole, whole, ctypes.c_uint64, whole, *[pointer] * 5]
        self._kept = [np.ascontiguousarray(a, float) for a in (*robot.about_z(), *robot.range())]
        self._solver = new(*(a.ctypes.data for a in self._kept))  # lives as long as the process

    def run(self, targets, options: PinocchioOptions, tolerance=(TOLERANCE, TOLERANCE), seed=1):
        """(q (B, n), found (B,), evaluations (B,)) for targets (B, 4, 4)."""
        B = len(targets)
        where, turn = np.ascontiguousarray(targets[:, :3, 3]), np.ascontiguousarray(targets[:, :3, :3])
        q, found, looks = np.empty((B, self._n)), np.empty(B, np.uint8), np.empty(B, np.int64)
        arrays = (a.ctypes.data for a in (where, turn, q, found, looks))
        damped = options.damping, options.of_error, *tolerance, options.iterations, options.starts
        self._run(self._solver, *damped, seed, B, *arrays)
        return q, found.astype(bool), looks

    def best(self, targets) -> PinocchioOptions:
        """Of a grid, the options that take the least time, of those that find (but for 0.5 %) the most."""
        grid = [
            PinocchioOptions(damping, of_error, iterations)
            for damping in (1e-9, 1e-6, 1e-4, 1e-2)
            for of_error in (0.0, 0.01, 0.1, 1.0)
            for iterations in (20, 40, 100)
        ]
        tried = []
        for options in grid:
            begun = time.perf_counter()
            _, found, _ = self.run(targets, options)
            tried.append((found.mean(), time.perf_counter() - begun, options))
        most = max(share for share, *_ in tried)
        return min((seconds, options) for share, seconds, options in tried if share >= most - 0.005)[1]
