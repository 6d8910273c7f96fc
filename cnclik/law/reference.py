"""References: the desired path x_d(t) and its exact velocity, by `jax.jvp` of the curve."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.tracing import of_the_model, together
from cnclik.law.paths import A_REFERENCE, Hold, Path, Reference, Tangent
from cnclik.record import ArrayLike, Float, record, replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.robot.rotations import safe_sqrt
from cnclik.task.parts import At, spin
from cnclik.task.task import Task


@record
class References:
    """Desired paths of several tasks and tips, see `references`.

    Attributes:
      names: of the tasks, or tips, that they are for.
      each: a `Reference`, or `References` by tip, of each.
    """

    names: tuple[str, ...]
    each: tuple[Reference | References, ...]

    @property
    def known(self) -> bool:
        return all(one.known for one in self.each)

    @property
    def still(self) -> bool:
        return all(one.still for one in self.each)

    def __getitem__(self, name):
        return self.each[self.names.index(errors.one_of("name", name, self.names))]


REFERENCE = (Reference, References)


def references(**by_name: Reference | References) -> References:
    """Give each task of a stack its reference, by name: `references(hands=circle(...), feet=hold(...))`.

    A task of several tips takes its own `references`, by the names of the tips (for joints(): "joints"); so does a law
    whose task consists of several parts joined by `&`.
    """
    for name, one in by_name.items():
        errors.kind(name, one, REFERENCE, A_REFERENCE)
    return References(names=tuple(by_name), each=tuple(by_name.values()))


def hold_at(
    chain: Chain, task: Task, q: Float[ArrayLike, " n"], **others: Reference | References
) -> Reference | References:
    """Hold the pose at q (n,): a constant reference for each target of a task; other references are given by name.

    `hold_at(robot, task, q0, hands=circle(...))` moves the hands only.

    Returns: `Reference`, or `References` for a task with several targets.
    """
    q, task = errors.array("q", q, (chain.n,), of="joint values"), errors.kind("task", task, Task).on(chain)
    if all(map(errors.concrete, jax.tree.leaves((chain, q)))):
        q = np.asarray(q, float)  # NumPy compiles nothing
    robot = At(modelled(chain), q)

    def held(_, parts):
        target: dict = {"position": None, "rotation": None}
        for part in parts.parts:
            target["rotation" if part.turns else "position"] = part.here(robot)
        return Reference(curve=Hold(**target))

    paths = of_each(held, None, task)
    if not others:
        return paths
    if isinstance(paths, Reference):
        if not task.tasks:
            raise errors.fail("others", "be left out for one task that is no stack", f"are {', '.join(others)}")
        paths = references(**{task.tasks[0][0]: paths})
    for name in others:
        errors.one_of("others", name, paths.names)
    return references(**(dict(zip(paths.names, paths.each, strict=True)) | others))


def of_each(fn, reference, task):
    """Return references with each target's reference replaced by fn(reference, parts); None: made by fn(None, parts).

    Args: task: or some of its targets.
    Raises: ArgumentError if a target has no reference, or a reference no target.
    """
    targets = task.targets if isinstance(task, Task) else task
    keys = list(dict.fromkeys(path[0] for path, _ in targets if path))
    if isinstance(reference, Reference) or (reference is None and len(targets) == 1):
        if len(targets) > 1:
            needed = ", ".join(f"{key}=..." for key in keys)
            raise errors.fail("reference", f"give a target for each, by ck.references({needed})", "is a single one")
        return fn(reference, targets[0][1])
    if reference is not None and set(reference.names) != set(keys):
        raise errors.fail(
            "reference", f"be for {' and '.join(keys) or 'one tip'}", f"is for {', '.join(reference.names)}"
        )
    under = {key: [(path[1:], one) for path, one in targets if path[0] == key] for key in keys}
    each = (of_each(fn, None if reference is None else reference[key], under[key]) for key in keys)
    return References(names=tuple(keys), each=tuple(each))


def by_target(reference, task: Task) -> list[tuple[Reference, Task]]:
    """Return the reference of each target of a task, with the parts it is for."""
    pairs: list = []
    of_each(lambda *pair: pairs.append(pair), reference, task)
    return pairs


# --- sampling -----------------------------------------------------------------------------------------


def sample(reference, task: Task, t):
    """Return the target of each part of a task at time t and its velocity: (aims, ẋ_d (m,)).

    ẋ_d holds linear velocities [m/s], then components of the angular velocity vee(Ṙ Rᵀ) [rad/s].
    """
    aims, motions = [], []
    for path, parts in by_target(reference, task):
        targets, rates = _moving(path, parts, t)
        aims += targets
        motions += [part.motion(*v) for part, *v in zip(parts.parts, targets, rates, strict=True)]
    return tuple(aims), jnp.concatenate(motions)


def aims_of(reference, task: Task, t) -> tuple:
    """Return the target of each part of a task at time t."""
    targets = [(parts.parts, path.curve(t)) for path, parts in by_target(reference, task)]
    return tuple(part.aim(*target) for parts, target in targets for part in parts)


def _moving(reference, parts, t):
    """Return aims of one target's parts, and their derivatives."""
    t = jnp.asarray(t)

    def curve(t):
        target = reference.curve(t)
        return [part.aim(*target) for part in parts.parts]

    target, motion = jax.jvp(curve, (t,), (jnp.ones_like(t),))
    if isinstance(reference.curve, Hold):
        motion = of_the_model(motion)  # zeros, and zero times anything is zero
    return target, motion


def tangent(reference, task: Task, t):
    """Return the reference, with paths whose future is unknown extrapolated from time t with their velocity."""

    t = jnp.asarray(t)

    def extrapolated(path):
        (position, rotation), (velocity, turning) = jax.jvp(path.curve, (t,), (jnp.ones_like(t),))
        turning = None if rotation is None else spin(rotation, turning)
        return replace(path, curve=Tangent(t=t, position=position, velocity=velocity, rotation=rotation, spin=turning))

    return of_each(lambda path, _: path if path.known else extrapolated(path), reference, task)


def motion(reference, task: Task, t):
    """Return an upper bound (N,) of the target's motion between the instants t (N + 1,).

    That of a rotation is by its chord ‖R₂ − R₁‖ (Frobenius): the angle is at most π/√8 times it.
    """

    def chart(t):
        each = zip(task.parts, aims_of(reference, task, t), strict=True)
        return jnp.concatenate([1.111 * aim.ravel() if part.turns else aim for part, aim in each]).astype(t.dtype)

    # A user's path may allow no vmap.
    users = any(isinstance(path.curve, Path) for path, _ in by_target(reference, task))
    places = jax.lax.map(chart, t) if users else together(chart, t)
    return safe_sqrt(jnp.sum((places[1:] - places[:-1]) ** 2, axis=1))


def check(reference, task: Task) -> None:
    """Raise ArgumentError if the reference's targets do not fit the task."""
    for path, (one, parts) in zip(task.target_names, by_target(reference, task), strict=True):
        with errors.called("reference", ".".join(("reference", *path))):
            target = errors.traced("reference", one.curve, 0.0)
            for part in parts.parts:
                part.check(*target)
