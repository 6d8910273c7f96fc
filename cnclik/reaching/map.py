"""Map of reachable positions: the share of orientations that a robot reaches, over a plane or a box."""

from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.precision import of_numbers
from cnclik.reaching.public import reach
from cnclik.reaching.result import Reached
from cnclik.reaching.seeds import seeds
from cnclik.robot.chain import Chain, with_one_tip
from cnclik.robot.model import frames, modelled
from cnclik.robot.posture import evenly, start_posture
from cnclik.robot.rotations import rotation_from_quaternion
from cnclik.task.build import position

PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


class Reachability(NamedTuple):
    """Reachability at each position of a grid."""

    axes: tuple  # names of the grid's axes, such as ("x", "z")
    places: tuple  # one vector of places [m] per axis
    share: np.ndarray  # share of reachable orientations; for a position task 1 or 0
    least_singular_value: np.ndarray  # median over the answers at a position; NaN without one
    arm: np.ndarray  # (j, 3) base, joints and tip of the arm in its start posture [m]
    reached: Reached  # every answer, (cells · orientations,)


@of_numbers
def reachability(
    chain: Chain,
    where: str = "xz",
    *,
    task: str = "pose",
    cells: int = 40,
    orientations: int = 24,
    at: float = 0.0,
    span: float | None = None,
    **options: Any,
) -> Reachability:
    """Reach every position of a grid in many orientations that are spread evenly.

    Args:
      where: a plane, "xy", "xz" or "yz", or "box".
      task: "pose", or "position" for positions alone.
      cells: number of positions along each axis.
      orientations: number of orientations at each position.
      at: position of the plane along the third axis [m].
      span: half the width of the grid [m] around the first joint; default: a little more than the arm's reach.
      options: of `cnclik.reach`, such as `tolerance` and `seeds` (32 here).
    """
    with_one_tip(chain)
    errors.one_of("where", where, (*PLANES, "box"))
    errors.one_of("task", task, ("pose", "position"))
    cells = errors.integer("cells", cells, at_least=2)
    orientations = errors.integer("orientations", orientations, at_least=1)
    count = cells ** (3 if where == "box" else 2) * (orientations if task == "pose" else 1)
    if count > errors.MOST:
        raise errors.fail(
            "cells", f"make at most {errors.MOST:,} targets with `orientations`", f"makes {float(count):.3g}"
        )
    middle = np.array([float(x) for x in chain.joints[0].origin.position])
    over = PLANES.get(where, (0, 1, 2))
    if span is None:
        tips = frames(modelled(chain), seeds(chain).postures).position
        span = 1.08 * np.abs(tips[:, over] - middle[list(over)]).max()
    span = float(errors.number("span", span, positive=True))
    places = tuple(middle[i] + np.linspace(-span, span, cells) for i in over)
    grid = np.stack(np.meshgrid(*places, indexing="ij"), -1).reshape(-1, len(over))
    points = np.full((len(grid), 3), float(errors.number("at", at)))
    points[:, over] = grid
    turns = turns_evenly(orientations if task == "pose" else 1)
    targets = np.repeat(points, len(turns), 0)
    turned = (targets, np.tile(turns, (len(points), 1, 1)))
    made = reach(chain, turned if task == "pose" else targets, task=task, **{"seeds": 32, "explain": False} | options)
    shape = (*(cells,) * len(over), len(turns))
    solved = np.asarray(made.solved).reshape(shape)
    sigma = np.where(solved, made.least_singular_value.reshape(shape), np.nan)
    known = solved.any(axis=-1)
    middling = np.full(known.shape, np.nan)
    middling[known] = np.nanmedian(sigma[known], axis=-1)
    return Reachability(tuple("xyz"[i] for i in over), places, solved.mean(axis=-1), middling, outline(chain), made)


def turns_evenly(count: int) -> np.ndarray:
    """Rotations (count, 3, 3) that fill all turns evenly (Shoemake 1992, of an even sequence)."""
    u, v, w = evenly(count, 3).T
    a, b, v, w = np.sqrt(1 - u), np.sqrt(u), 2 * np.pi * v, 2 * np.pi * w
    rows = rotation_from_quaternion((b * np.cos(w), a * np.sin(v), a * np.cos(v), b * np.sin(w)))
    return np.moveaxis(np.array(rows), -1, 0)


def outline(chain: Chain) -> np.ndarray:
    """Base, joints and tip (j, 3) of the arm in the posture that a loop would start from [m]."""
    q = start_posture(chain, position())
    at = frames(modelled(chain), q)
    return np.concatenate([np.zeros((1, 3)), at.points, at.position[None]])
