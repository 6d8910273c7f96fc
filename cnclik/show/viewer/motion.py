"""Motion: the data that viewer and page show of a run, instant by instant."""

import dataclasses
import functools

import numpy as np

from cnclik import markup
from cnclik.integrate.status import Status, level, names
from cnclik.integrate.trajectory import check_run, one_lane
from cnclik.measure.dataset import Axes, axes_of
from cnclik.robot.chain import Chain
from cnclik.show.viewer.body import link_poses
from cnclik.stability.loop import UNSTABLE
from cnclik.task.parts import AXES

GOOD, WARNING, BAD = 0, 1, 2
LEVELS = markup.LEVELS  # colours of the three


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """A robot at K instants.

    Attributes:
      name: what it is called. chain: the robot.
      t: (K,) [s], or numbers of targets where `unit` is "target".
      q: (K, n) joint values, all finite.
      targets: of each tip (K, 3) where it is to be in the base frame [m], or None.
      error: {what: (K,)}, such as {"position error [m]": …}.
      level: (K,) GOOD, WARNING or BAD. words: (K,) of what is wrong, or how it went.
      note: the answer in a sentence, or nothing. unit: of t. links: (URDF file, tips, base), where there is one.
    """

    name: str
    chain: Chain
    t: np.ndarray
    q: np.ndarray
    targets: tuple[np.ndarray | None, ...]
    error: dict
    level: np.ndarray
    words: tuple
    note: str = ""
    unit: str = "s"
    links: tuple | None = None

    @functools.cached_property
    def poses(self) -> np.ndarray:
        """(K, 1 + j + tips, 4, 4): the base, what each joint moves, and the tips."""
        return link_poses(self.chain, self.q)

    @property
    def ways(self) -> np.ndarray:
        """(tips, K, 3) of each tip [m]."""
        return self.poses[:, -len(self.chain.tips) :, :3, 3].swapaxes(0, 1)

    @property
    def color(self) -> str:
        """Of the worst instant."""
        return LEVELS[int(self.level.max(initial=0))]


def motion_of(run, law, *, name="", note="", links=None, radius=0.0) -> Motion:
    """A run as it is shown.

    Args:
      run: `Trajectory` of solve(law, …), one lane.
      radius: spectral radius of its loop, where it is known: beyond UNSTABLE all of the run is marked BAD, which a
        run through drives doesn't tell by itself.

    Raises: ArgumentError for a batch.
    """
    one_lane(run)
    check_run(run, law)
    known = [np.asarray(v) for v in (run.t, run.q, run.x, run.e, run.status)]
    made = from_arrays(law.chain, *known, axes=axes_of(law.task, law.chain), name=name, note=note, links=links)
    if not radius > UNSTABLE:
        return made
    words = tuple("UNSTABLE" if w == "OK" else f"UNSTABLE|{w}" for w in made.words)
    return dataclasses.replace(made, level=np.full_like(made.level, BAD), words=words)


def from_arrays(chain, t, q, x, e, status, *, axes: Axes, **about) -> Motion:
    """A run from its numbers: t (N + 1,), q, x, e (N + 1, ·), status (N,), and what the task's coordinates are.

    It ends before its first instant that is not finite, and is marked there.
    """
    finite = np.isfinite(q).all(1) & np.isfinite(e).all(1) & (np.abs(q).max(1) < 1e6)
    count = max(int(np.argmin(finite)) if not finite.all() else len(q), 1)
    status = np.append(status, status[-1:] if len(status) else 0).astype(int)[: len(q)]
    if count < len(q):
        status[count - 1] |= int(Status.NON_FINITE)
    t, q, x, e, status = (v[:count] for v in (t, np.nan_to_num(q), x, e, status))
    made = Motion(
        chain=chain,
        t=np.asarray(t, float),
        q=np.asarray(q, float),
        targets=(),
        error=_errors(e, axes),
        level=level(status),
        words=tuple(map(names, status)),
        **about,
    )
    wanted = {}  # of each tip's label
    for i, (axis, tip) in enumerate(zip(axes.names, axes.tips, strict=True)):
        wanted.setdefault(str(tip), {}).setdefault(str(axis).rpartition(".")[2], x[:, i] + e[:, i])
    return dataclasses.replace(made, targets=in_base(made, wanted))


_WORDS = {"m": "position error", "rad": "orientation error"}


def _errors(e, axes) -> dict:
    """{what: (K,)} of each task, for each of its units."""
    found = {}
    tasks = axes.tasks if len(axes.tasks) else [""] * len(axes.names)
    for i, (task, tip, unit) in enumerate(zip(tasks, axes.tips, axes.units, strict=True)):
        word = "joint error" if tip == "joints" else _WORDS.get(unit, "error")
        found.setdefault(f"{task} {word} [{unit}]".lstrip(), []).append(i)
    return {what: np.linalg.norm(e[:, some], axis=1) for what, some in found.items()}


def in_base(motion, wanted) -> tuple:
    """Where each tip is to be in the base frame (K, 3): what is wanted of it, its own coordinate elsewhere, or None.

    Args: wanted: {"left", or "left in right" as seen from another tip: {"x", "y" or "z": (K,)}}.
    """
    tips, at = [tip.name for tip in motion.chain.tips], motion.poses[:, -len(motion.chain.tips) :]
    found = []
    for k, name in enumerate(tips):
        labels = [label for label in wanted if label.partition(" in ")[0] == name and set(wanted[label]) & set(AXES)]
        if not labels:
            found.append(None)
            continue
        label = min(labels, key=len)  # in the base frame, where it is wanted there
        other = label.partition(" in ")[2]
        frame = at[:, tips.index(other)] if other else np.broadcast_to(np.eye(4), (len(motion.t), 4, 4))
        place = np.einsum("kji,kj->ki", frame[:, :3, :3], at[:, k, :3, 3] - frame[:, :3, 3])
        for i, axis in enumerate(AXES):
            place[:, i] = wanted[label].get(axis, place[:, i])
        found.append(frame[:, :3, 3] + np.einsum("kij,kj->ki", frame[:, :3, :3], place))
    return tuple(found)
