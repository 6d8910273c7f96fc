"""Motion: what is shown of a run, instant by instant; a viewer and a page know nothing else of it."""

import dataclasses
import functools

import numpy as np

from cnclik.integrate.status import Status, names
from cnclik.integrate.trajectory import check_run, one_lane
from cnclik.robot.chain import Chain
from cnclik.show import style
from cnclik.show.viewer.body import link_poses
from cnclik.stability.case import UNSTABLE

GOOD, WARNING, BAD = 0, 1, 2
LEVELS = (style.GREEN, style.ORANGE, style.RED)  # colours of the three
_BAD = Status.NON_FINITE | Status.DIVERGED | Status.GROWING
_NO_DEFECT = Status.RESTARTED


@dataclasses.dataclass(frozen=True, kw_only=True)
class Motion:
    """A robot at K instants.

    Attributes:
      name: what it is called. chain: the robot.
      t: (K,) [s], or numbers of targets where `unit` is "target".
      q: (K, n) joint values, all finite.
      target: (K, 3) where the tip is to be [m], or None.
      error: {what: (K,)}, such as {"position error [m]": …}.
      level: (K,) GOOD, WARNING or BAD. words: (K,) of what is wrong, or how it went.
      note: the answer in a sentence, or nothing. unit: of t. links: (URDF file, tip, base), where there is one.
    """

    name: str
    chain: Chain
    t: np.ndarray
    q: np.ndarray
    target: np.ndarray | None
    error: dict
    level: np.ndarray
    words: tuple
    note: str = ""
    unit: str = "s"
    links: tuple | None = None

    @functools.cached_property
    def poses(self) -> np.ndarray:
        """(K, j + 2, 4, 4): the base, what each joint moves, and the tip."""
        return link_poses(self.chain, self.q)

    @property
    def way(self) -> np.ndarray:
        """(K, 3) of the tip [m]."""
        return self.poses[:, -1, :3, 3]

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
    about = dict(axes=law.task.names, units=law.task.units, name=name, note=note, links=links)
    made = from_arrays(law.chain, *known, **about)
    if not radius > UNSTABLE:
        return made
    words = tuple("UNSTABLE" if w == "OK" else f"UNSTABLE|{w}" for w in made.words)
    return dataclasses.replace(made, level=np.full_like(made.level, BAD), words=words)


def from_arrays(chain, t, q, x, e, status, *, axes, units, **about) -> Motion:
    """A run from its numbers: t (N + 1,), q, x, e (N + 1, ·), status (N,), and names and units of task coordinates.

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
        target=None,
        error=_errors(e, units),
        level=np.where(status & int(_BAD), BAD, np.where(status & ~int(_NO_DEFECT), WARNING, GOOD)),
        words=tuple(map(names, status)),
        **about,
    )
    return dataclasses.replace(made, target=_target(made.way, x, e, axes))


def _errors(e, units):
    parts = {"position error [m]": "m", "orientation error [rad]": "rad"}
    chosen = {name: np.array([u == unit for u in units]) for name, unit in parts.items()}
    return {name: np.linalg.norm(e[:, some], axis=1) for name, some in chosen.items() if some.any()}


def _target(way, x, e, axes):
    """x + e where the task has the coordinate, the tip's own elsewhere; None for a task without position."""
    found = np.array(way)
    for i, axis in enumerate(axes):
        if axis in ("x", "y", "z"):
            found[:, "xyz".index(axis)] = x[:, i] + e[:, i]
    return found if {"x", "y", "z"} & set(axes) else None
