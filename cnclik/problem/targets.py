"""Targets of `cnclik reach` in plain names: for one tip, or for several at the same time."""

import functools
import io
import operator
import pathlib
from typing import Any, NamedTuple

import numpy as np

from cnclik import errors
from cnclik.problem.heading import robot_and_task
from cnclik.problem.names import robot_and_tip, robot_name, task_from
from cnclik.problem.options import check_units
from cnclik.problem.tables import read_points
from cnclik.reaching.starts import spans
from cnclik.reaching.targets import by_name
from cnclik.reading import read_bytes
from cnclik.record import replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import modelled
from cnclik.task.aims import aims
from cnclik.task.parts import At
from cnclik.task.task import Task


class Wanted(NamedTuple):
    """The request: robot, task and targets."""

    chain: Chain
    task: Task
    title: str  # robot, tips and task in words
    targets: Any  # as `cnclik.reach` takes them, several for each tip
    line: str  # the targets in words


def wanted_of(args) -> Wanted:
    """The request of the options. Raises: ArgumentError for options that do not fit."""
    if len(args.tip) != len(set(args.tip)):
        raise errors.fail("tip", "be different names", f"is {' '.join(args.tip)}")
    tip, tips = (args.tip[0], None) if len(args.tip) == 1 else (None, dict.fromkeys(args.tip, "tip") or None)
    chain, named = robot_and_tip(args.robot, tip, args.base, tips)
    each = [task_from(args.task, chain, one).on(chain) for one in (args.tip if tips else [None])]
    task = functools.reduce(operator.and_, each)
    check_units(chain, task, args.written)
    title, every = robot_and_task(robot_name(args.robot, tip), named, task), aims(task)
    if args.target:
        if len(args.target) != len(every):
            labels = ", ".join(aim.label for aim in every)
            raise errors.fail("target", f"be given once for each tip ({labels})", f"is given {len(args.target)} times")
        targets = by_name(task, [[errors.array("target", values)] for values in args.target])
        return Wanted(chain, task, title, targets, f"Target {'; '.join(_point(values) for values in args.target)}.")
    if args.random:
        drawn = f"{args.random:,} random reachable ones, seed {args.seed}"
        return Wanted(chain, task, title, _random(args, chain, task), f"Targets: {drawn}.")
    targets = by_name(task, [_read(args.targets, aim, k, len(every)) for k, aim in enumerate(every)])
    return Wanted(chain, task, title, targets, f"Targets: those of {args.targets}.")


def _point(values) -> str:
    units = " m" * (len(values) != 4) + ", quaternion w x y z" * (len(values) > 3)
    return f"{' '.join(f'{v:.5g}' for v in values)}{units}"


def _read(file, aim, number, count):
    """Targets of one tip in a file: CSV, where of several tips columns begin with its name, or an array (.npy)."""
    path = pathlib.Path(file)
    own = Task(parts=tuple(replace(part, tip=None, to=None) for part in aim.parts))
    if errors.ending("TARGETS", path, ".csv", ".npy") == ".csv":
        found = read_points("TARGETS", path, own, tip=aim.label if count > 1 else "")[1]
    else:
        data = read_bytes("TARGETS", path, "a file")
        try:
            found = np.load(io.BytesIO(data), allow_pickle=False)
        except (ValueError, EOFError, OSError):
            raise errors.fail("TARGETS", "name a file that can be read", f"{path.name} is damaged") from None
        if count > 1:
            if found.ndim != 4 or found.shape[1] != count:
                raise errors.fail("TARGETS", f"hold transforms (N, {count}, 4, 4)", f"{path.name} holds {found.shape}")
            found = found[:, number]
    if found.size == 0:
        raise errors.fail("TARGETS", "hold at least one target", f"{path.name} holds none")
    return found


def _random(args, chain, task):
    """Poses of joint values drawn evenly within the limits."""
    low, high = spans(chain)
    at = At(modelled(chain), np.random.default_rng(errors.seed(args.seed)).uniform(low, high, (args.random, chain.n)))
    return by_name(task, [(at.position(aim.tip, aim.to), at.rotation(aim.tip, aim.to)) for aim in aims(task)])
