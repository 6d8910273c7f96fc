"""Targets in plain names: for one tip, for several, or for the tips of a stack.

`args` has the options of `cnclik reach`, and `written` as for `cnclik.problem.magnitudes.check_units`.
"""

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.law.reference import of_each
from cnclik.problem.heading import robot_and_task
from cnclik.problem.magnitudes import remark_on, remark_on_lengths, remark_on_places
from cnclik.problem.names import robot_and_tip, robot_name, start_from, task_from
from cnclik.problem.reference import reference_from
from cnclik.problem.stack import Table, ranks_of, read_stack, references_of, stack_from, tables_from, task_of, tips_of
from cnclik.problem.tables import read_targets
from cnclik.reaching.starts import spans
from cnclik.reaching.targets import by_name, read, transforms, wanted_at
from cnclik.record import replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.task.aims import aims, of_tips
from cnclik.task.parts import At
from cnclik.task.task import Task

YIELDS = 1e-4  # weight of a level's squared errors relative to the level before
PERIOD = 10.0  # [s] of paths without one, as of a loop of 1000 steps of 10 ms


class Wanted(NamedTuple):
    """The request: robot, task and targets."""

    chain: Chain
    task: Task
    title: str  # robot, tips and task in words
    targets: Any  # as `cnclik.reach` takes them, several for each tip
    lines: tuple  # the other lines at the head of the answer


def wanted_of(args) -> Wanted:
    """The request of the options. Raises: ArgumentError for options that do not fit."""
    if args.stack is not None:
        return _of_stack(args)
    chain, tip = _robot(args, dict.fromkeys(args.tip, "tip") if len(args.tip) > 1 else None)
    task = task_from(args.task, chain) if len(args.tip) < 2 else _of_each(args, chain)
    name = robot_name(args.robot, args.tip[0] if len(args.tip) == 1 else None)
    title, every = robot_and_task(name, tip, task), aims(task)
    if args.target:
        if len(args.target) != len(every):
            labels = ", ".join(aim.label for aim in every)
            raise errors.fail("target", f"be given once for each tip ({labels})", f"is given {len(args.target)} times")
        for values in args.target:
            errors.array("target", values)
        _look_at_units(args, chain, task)
        several = len(every) > 1
        of = [
            f"{aim.label} " * several + " ".join(f"{v:.5g}" for v in v_d)
            for aim, v_d in zip(every, args.target, strict=True)
        ]
        sizes = set(map(len, args.target))  # a quaternion alone has four numbers
        units = " m" * (sizes != {4}) + ", quaternion w x y z" * (max(sizes) > 3)
        lines = (f"Target {'; '.join(of)}{units}.",)
        return Wanted(chain, task, title, by_name(task, [[one] for one in args.target]), lines)
    _look_at_units(args, chain, task)
    drawn = f"{args.random:,} random reachable ones, seed {args.seed}" if args.random else f"those of {args.targets}"
    return Wanted(chain, task, title, _given(args, chain, task), (f"Targets: {drawn}.",))


def _robot(args, tips):
    if len(args.tip) != len(set(args.tip)):
        raise errors.fail("tip", "hold different names", f"is {' '.join(args.tip)}")
    return robot_and_tip(args.robot, args.tip[0] if len(args.tip) == 1 else None, args.base, args.lengths, tips)


def _of_each(args, chain):
    """The same task for each of several tips."""
    return task_of(Table("", {"task": args.task, "tip": args.tip}, {}), chain)


def _given(args, chain, task):
    """Targets from a file, or random ones, for all aims of a task."""
    every, file = aims(task), args.targets
    if args.random:
        return _random(args, chain, task)
    each = []
    for k, aim in enumerate(every):
        own, several = Task(parts=tuple(replace(part, tip=None, to=None) for part in aim.parts)), len(every) > 1
        names = {"number": k, "tip": (aim.label, aim.path[-1])} if several else {}
        each.append(read_targets(file, own, **names))
        if aim.linear and aim.to is None:
            places = transforms(read(each[-1], own)[0])[:, :3, 3]
            remark_on_places(Path(file).name, places, chain, own, aim.tip)
    return by_name(task, each)


def _random(args, chain, task):
    """Poses of joint values drawn evenly within the limits."""
    low, high = spans(chain)
    at = At(modelled(chain), np.random.default_rng(errors.seed(args.seed)).uniform(low, high, (args.random, chain.n)))
    return by_name(task, [(at.position(aim.tip, aim.to), at.rotation(aim.tip, aim.to)) for aim in aims(task)])


def _look_at_units(args, chain, task) -> None:
    """Check units, and remark on numbers that are probably in another one."""
    remark_on({} if args.near is None else {"near": args.near}, chain, task, None, args.written)
    for aim, values in zip(aims(task), args.target, strict=False):
        if aim.to is None and not any(args.written.get("target", ())):
            remark_on_lengths({"target": values}, chain, Task(parts=aim.parts))


def _upper_first(task, tables) -> tuple:
    """The task with weights by which the nearest pose keeps upper levels, and a line about that."""
    ranks = ranks_of(tables, [name for name, _ in task.tasks])
    if not any(ranks.values()):
        return task, ()
    weights = np.ones(task.m) if task.weights is None else np.array(task.weights, float)
    for name, at in task.each:
        weights[at] *= YIELDS ** ranks[name]
    order = (", ".join(name for name in ranks if ranks[name] == k) for k in range(max(ranks.values()) + 1))
    return replace(task, weights=weights), (f"Where not all can be had: {' before '.join(order)}.",)


def _of_stack(args) -> Wanted:
    """The tips of a stack's tasks, with targets on its paths unless others are given."""
    alone = {"task": args.task, "tip": args.tip or None, "target": args.target or None}
    written = read_stack(args.stack)
    tables = tables_from(written, alone).tasks
    chain, tip = _robot(args, tips_of(written))
    stack = stack_from(tables, chain)
    title = robot_and_task(robot_name(args.robot), tip, stack)
    task, first = _upper_first(of_tips(stack), tables)
    left = [name for name, _ in stack.tasks if name not in dict(task.tasks)]
    left += written.walls
    lines = (f"Left out: {', '.join(left)}. Reach is of positions and orientations of tips.",) * bool(left)
    lines += first
    _look_at_units(args, chain, task)
    if args.targets is not None or args.random:
        return Wanted(chain, task, title, _given(args, chain, task), lines)
    near = None if args.near is None else errors.array("near", args.near, (chain.n,))
    q0 = start_from(chain, stack, near)
    paths = references_of(tables, chain, stack, q0, PERIOD)
    end = paths.duration
    if args.points > 1 and not end:
        raise errors.fail("points", "be left out where targets stand still", f"is {args.points}")
    times = np.linspace(0.0, end, args.points)
    _, targets = wanted_at(paths, stack, times)
    where = f"{args.points} points of the paths over {end:g} s" if args.points > 1 else "where the paths begin"
    labels = ", ".join(aim.label for aim in aims(task))
    return Wanted(chain, task, title, targets, (f"Targets of {labels}: {where}.", *lines))


def at_targets(found, targets):
    """The problem with new targets for its first tips, in order; the other tips keep theirs."""
    law = found.law
    tips = aims(of_tips(law.task))
    if len(targets) > len(tips):
        must = f"be given at most once for each tip ({', '.join(aim.label for aim in tips)})"
        raise errors.fail("target", must, f"is given {len(targets)} times")
    given = iter(targets)

    def other(one, parts):
        target = next(given, None) if hasattr(parts.parts[0], "axes") else None
        return one if target is None else reference_from("hold", law.chain, parts, found.q0, target=target)

    named = {aim.path[0]: {"target": None} for aim in tips[: len(targets)]}
    tables = {name: table | named.get(name, {}) for name, table in found.tables.items()}
    return dataclasses.replace(found, reference=of_each(other, found.reference, law.task), tables=tables)
