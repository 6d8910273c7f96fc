"""Robots, targets and checks by Pinocchio's kinematics for `tests.bench.reach`."""

import numpy as np
import pinocchio as pin

import cnclik as ck
from tests.oracles import ARMS, robots

TOLERANCE = 1e-6  # [m], [rad]
SLACK = 1e-9  # [m, rad] between two forward kinematics
LEAF = "link_eef"  # xArm7's only leaf


class Robot:
    """A robot as cnclik has it, beside Pinocchio's model of the same file."""

    def __init__(self, name):
        file, tip, base = ARMS[name]
        self.name, self.path = name, robots() / file
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
