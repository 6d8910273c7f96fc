"""reach: joint values for targets, as a record with one status each."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.reaching.asked import asked_of
from cnclik.reaching.result import Reached, from_rows
from cnclik.reaching.search import AT_ONCE, MOST_DRAWN, Targets, path, search_of, several
from cnclik.reaching.starts import turned
from cnclik.reaching.targets import read
from cnclik.reaching.traced import traced
from cnclik.record import ArrayLike, Float
from cnclik.robot.chain import Chain
from cnclik.robot.poses import PoseLike
from cnclik.task.task import Task

POOL = 1 << 17  # targets of one search, as it needs memory


@np.errstate(over="ignore", invalid="ignore")  # by targets far beyond any robot, whose status reports it
def reach(
    chain: Chain,
    targets: PoseLike | tuple[ArrayLike | None, ArrayLike | None] | Mapping[str, Any],
    *,
    task: str | Task = "pose",
    tolerance: ArrayLike = (1e-6, 1e-6),
    near: Float[ArrayLike, "*B n"] | str | None = None,
    jump: float | None = None,
    solutions: int = 1,
    limits: bool = True,
) -> Reached:
    """Find joint values that put the tip, or several tips, at each of some targets, or the reason why there are none.

    Called with numbers it works in float64, whatever JAX's setting, on all cores, and returns NumPy arrays; the same
    numbers give the same answers. Under jit, vmap and grad it is a pure function in JAX's dtype; in float32 the
    tolerance is at least 8e-6. Derivatives with respect to targets and geometry are dq = J# de, with joints at their
    limits held constant.

    Args:
      chain: the robot.
      targets: one target, or several along a first axis: 4×4 transforms; position and quaternion [x, y, z, w, x, y, z];
        positions (3,) for a position task, or its own coordinates, such as (2,) for xy; rotations (3, 3) or quaternions
        (4,) for an orientation task; a `Pose`; or a pair (positions, rotations). [m] For several tips a dict of them by
        the names of a stack's tasks, or of the tips.
      task: "pose", "position", "orientation" or a `Task` of tips; its weights define the nearest pose.
      tolerance: tolerance of position [m] and orientation [rad].
      near: joint values (n,) or (B, n) from which to search, such as the present ones, within the limits or not;
        "previous" for a path: each target from the answer before it, the first one from a default posture.
      jump: largest distance of any joint from `near` [rad, m]; where all answers are farther away the status is JUMP.
      solutions: number of different answers for each target, along an axis of the results, the nearest to `near`, or to
        the middle of the limits, first. They differ by 0.1 rad or m in some joint, beyond whole turns, or by 0.5
        for a redundant arm. Two take some 15 times as long as one; more than there are, 400 times.
      limits: whether to keep the joint limits. A joint that can turn more than once is in the turn nearest to `near`.

    Returns: `Reached`.
    Raises: ArgumentError for shapes, types and concrete values that do not fit.
    """
    asked = asked_of(chain, task, tolerance, jump, limits)
    errors.integer("solutions", solutions, at_least=1, at_most=1000)
    pose, alone = read(targets, asked.task)
    known = isinstance(pose, np.ndarray) and all(map(errors.concrete, jax.tree.leaves((chain, near, jump))))
    previous, begin = isinstance(near, str), cast(Any, None)
    if previous:
        errors.one_of("near", near, ("previous",))
    elif near is not None:
        begin = errors.array("near", near, (chain.n,), (len(pose), chain.n), finite=False)
        begin = (np if known else jnp).broadcast_to(begin, (len(pose), chain.n)).astype(pose.dtype)
    elif jump is not None:
        raise errors.fail("near", "be given with `jump`", "is not")
    for name, refused in (("solutions", solutions > 1), ("near", previous)):
        if refused and not known:
            raise errors.fail(name, "be left out under jit, vmap and grad", "is given")
    if previous and solutions > 1:
        raise errors.fail("solutions", "be 1 along a path (near='previous')", f"is {solutions}")
    if not known:
        rows = jax.vmap(functools.partial(traced, asked), (0, None if begin is None else 0))(pose, begin)
    elif previous:
        rows = path(search_of(asked), pose)
    else:
        inside = begin if begin is None else turned(begin, begin, np.array(chain.periodic), *asked.limited())
        search, of = search_of(asked), Targets(pose, begin, inside)
        size = POOL if solutions == 1 else min(POOL, AT_ONCE // (MOST_DRAWN + solutions))
        parts = (of.some(slice(i, i + size)) for i in range(0, len(pose), size))
        rows = np.concatenate([several(search, v, solutions) if solutions > 1 else search.rows(v) for v in parts])
    return from_rows(chain, asked.task, rows[0] if alone else rows)
