"""Motion: the data of one run as poses of the robot and a target of each tip, instant by instant."""

from typing import Any, NamedTuple

import numpy as np

from cnclik.robot.chain import Chain
from cnclik.robot.model import joint_frames, modelled
from cnclik.task.parts import AXES

FAR = 1e6  # [rad, m] joint values beyond it are not shown


class Motion(NamedTuple):
    """A robot at K instants, the last before one that is not finite."""

    chain: Chain
    data: Any  # the run's dataset, up to the last instant
    poses: np.ndarray  # (K, 1 + j + tips, 4, 4) of the base, of what each joint moves, and of the tips
    targets: tuple  # of each tip: where it is to be in the base frame (K, 3) [m], or None

    @property
    def paths(self) -> np.ndarray:
        """Positions (tips, K, 3) of the tips [m]."""
        return self.poses[:, -len(self.chain.tips) :, :3, 3].swapaxes(0, 1)


def motion_of(data, chain: Chain) -> Motion:
    """Return the motion of a run. Args: data: of `cnclik.measure.to_dataset`, one lane."""
    q, e = data.q.values, data.e.values
    finite = np.isfinite(q).all(1) & np.isfinite(e).all(1) & (np.abs(q).max(1, initial=0.0) < FAR)
    count = len(q) if finite.all() else max(int(np.argmin(finite)), 1)
    data = data.isel(time=slice(count), step=slice(max(count - 1, 1)))
    poses = link_poses(chain, np.nan_to_num(data.q.values))
    return Motion(chain, data, poses, _targets(data, chain, poses))


def link_poses(chain, q):
    """Return the frames of base, joints and tips (K, 1 + j + tips, 4, 4) at q (K, n), in NumPy."""
    model, q = modelled(chain), np.asarray(q, float)
    joints = joint_frames(model, q)
    base = np.broadcast_to(np.eye(4), (len(q), 1, 4, 4))
    return np.concatenate([base, joints, joints[:, np.array(model.carriers)] @ np.stack(model.tips)], 1)


def error_parts(data) -> list:
    """Return [(task or "", unit, which coordinates)]: those of one task and one unit, which have a common norm."""
    units = data.axis_unit.values
    tasks = data.axis_task.values if "axis_task" in data.coords else np.full(len(units), "")
    pairs = dict.fromkeys(zip(tasks.tolist(), units.tolist(), strict=True))
    return [(task, unit, (tasks == task) & (units == unit)) for task, unit in pairs]


def _targets(data, chain, poses) -> tuple:
    """Return where each tip is to be in the base frame: what its tasks ask for, its own coordinates elsewhere."""
    names = [tip.name for tip in chain.tips]
    labels = data.axis_tip.values.tolist() if "axis_tip" in data.coords else [names[0]] * data.sizes["axis"]
    wanted: dict = {}  # of each tip, "left", or of a tip as seen from another one, "left in right"
    for label, axis, place in zip(labels, data.axis.values.tolist(), (data.x + data.e).values.T, strict=True):
        if (axis := axis.rpartition(".")[2]) in AXES:
            wanted.setdefault(label, {})[axis] = place
    poses, found = poses[:, -len(names) :], []
    for k, name in enumerate(names):
        label = min((label for label in wanted if label.partition(" in ")[0] == name), key=len, default=None)
        if label is None:
            found.append(None)
            continue
        other = label.partition(" in ")[2]
        frame = poses[:, names.index(other)] if other else np.broadcast_to(np.eye(4), poses[:, k].shape)
        place = np.linalg.inv(frame) @ poses[:, k, :, 3:]
        for axis, values in wanted[label].items():
            place[:, AXES.index(axis), 0] = values
        found.append((frame @ place)[:, :3, 0])
    return tuple(found)
