"""Stacks in plain names: task, gain, J#, references and limits from tables of several tasks and walls."""

import functools
import math
import operator
import os
import pathlib
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax

from cnclik import errors
from cnclik.law.inverse import Levels, Pseudoinverse, by_damping, not_growing
from cnclik.law.paths import hold, hold_at
from cnclik.law.reference import References, of_each, references
from cnclik.law.walls import Wall, support_polygon, wall
from cnclik.problem import words
from cnclik.problem.magnitudes import check_units, remark_on_lengths
from cnclik.problem.names import fitting, gain_from, inverse_from, task_from
from cnclik.problem.options import DEFAULTS, NAME, NAMES, OF_SHAPE, OF_STACK, PATH, TABLES, in_own_units
from cnclik.problem.reference import as_written, reference_from
from cnclik.reading import read_toml
from cnclik.record import replace
from cnclik.robot.chain import Chain
from cnclik.task.build import center_of_mass, joints, stack
from cnclik.task.shapes import distance
from cnclik.task.task import Task

_NAME = re.compile(r"[A-Za-z_]\w*")
_DAMPING = ("inverse", "damping", "threshold")  # options of the loop, or of one level
# Options of a loop with one task, and what replaces them in a stack.
_OF_ONE = dict.fromkeys(("task", "tip", "reference", *PATH), "its tasks have their own")
_OF_ONE |= dict.fromkeys(("posture", "posture_rate"), 'a posture is one of its tasks, task = "joints"')
_NOT_OF = {"joints": ("tip", "relative_to", "axes"), "center_of_mass": ("tip", "joints")}


class Written(NamedTuple):
    """The given tables of a stack."""

    tasks: Any  # {name of a task: {option: value}}
    walls: Any  # {name of a wall: {option: value}}


class Table(NamedTuple):
    """One given task, wall or shape of a stack."""

    where: str  # "tasks.NAME"
    given: dict  # {option: value}, numbers in the option's own unit
    written: dict  # {option: the unit of each number, or None}


def read_stack(file) -> Written:
    written = read_toml("stack", file)
    for key in written:
        if key not in Written._fields:
            hint = errors.nearest(key, Written._fields) or ": a stack has [tasks.NAME] and [walls.NAME] tables alone"
            raise errors.fail("stack", "hold known keys", f"holds {key!r}{hint}")
    found, folder = Written(written.get("tasks", {}), written.get("walls", {})), pathlib.Path(file).parent
    for table in found.tasks.values() if isinstance(found.tasks, dict) else ():
        if isinstance(table, dict) and os.path.isfile(path := folder / str(table.get("reference"))):
            table["reference"] = str(path)  # a file of waypoints beside it
    return found


def tables_from(written: Written, given: dict) -> Written:
    """The stack with a checked `Table` for each task and wall; texts such as "50 mm" become numbers.

    Args: given: options of the whole loop, by the names that a user writes.
    Raises: ArgumentError naming the entry that does not fit, such as `tasks.hands.alpha`.
    """
    for name, instead in _OF_ONE.items():
        value = given.get(name)
        if value is not None and not (isinstance(value, str) and value == DEFAULTS.get(name)):
            raise errors.fail(name, f"be left out with a stack: {instead}", f"is {value!r}")
    found = Written(*(_each(kind, tables) for kind, tables in written._asdict().items()))
    if not found.tasks:
        raise errors.fail("tasks", "be tables of tasks, [tasks.NAME]", "are none")
    for name in ("alpha", *_DAMPING):  # an option that no task uses is refused
        if not _is_default(name, given.get(name)) and all(name in one.given for one in found.tasks.values()):
            raise errors.fail(name, "be left out where every task has its own", f"is {given[name]!r}")
    return found


def _each(kind, tables) -> dict[str, Table]:
    if not isinstance(tables, Mapping):
        raise errors.fail(kind, f"be tables of {kind}, [{kind}.NAME]", f"is {tables!r}")
    if strange := [name for name in tables if not isinstance(name, str) or not _NAME.fullmatch(name)]:
        raise errors.fail(kind, "have names of letters, digits and _", f"has {strange[0]!r}")
    return {name: table_from(f"{kind}.{name}", table, OF_STACK[kind]) for name, table in tables.items()}


def table_from(where, table, known) -> Table:
    """A checked table. Args: known: {option: Option} that it may hold."""
    if not isinstance(table, Mapping):
        raise errors.fail(where, "be a table of options", f"is {table!r}")
    table = as_written({key: value for key, value in table.items() if value is not None})
    for key in table:
        if key not in known:
            hint = errors.nearest(key, known) or f" (known are {', '.join(known)})"
            raise errors.fail(where, "hold known options", f"holds {key!r}{hint}")
    with errors.within(where):
        _check_names(table, known)
        if "target" in known and _is_joints(table):
            known = known | {"target": known["target"]._replace(unit="q")}
        for shape in table.get("distance", ()):
            table_from("distance", shape, OF_SHAPE)
        return Table(where, *in_own_units(table, known))


def _is_default(name, value) -> bool:
    value = value[0] if isinstance(value, (list, tuple)) and len(value) == 1 else value
    return value is None or (isinstance(value, (int, float)) and value == DEFAULTS.get(name))


def _check_names(table, known):
    for key, value in table.items():
        kind = known[key].kind
        if kind == TABLES and not (isinstance(value, (list, tuple)) and len(value) == 2):
            raise errors.fail(key, "be two tables, each of a shape", f"is {value!r}")
        names = value if kind == NAMES and isinstance(value, (list, tuple)) and value else [value]
        if kind in (NAME, NAMES) and not all(isinstance(one, str) for one in names):
            must = "be a name or a list of names" if kind == NAMES else "be a name"
            raise errors.fail(key, must, f"is {value!r}")
        if len(set(map(str, names))) < len(names):
            raise errors.fail(key, "hold different names", f"is {value!r}")


def _is_joints(table) -> bool:
    return table.get("task", "joints" if "joints" in table else None) == "joints"


def tips_of(written: Written) -> dict:
    """{name of a link that the robot must have as a tip: the argument that names it}, of tables that are checked."""
    found: dict = {}
    for kind, tables in written._asdict().items():
        for name, table in tables.items():
            shapes = ((f"{kind}.{name}.distance", shape) for shape in table.get("distance") or ())
            for where, given in ((f"{kind}.{name}", table), *shapes):
                for key in ("tip", "relative_to"):
                    for tip in _several(given.get(key)):
                        if tip is not None:
                            found.setdefault(tip, f"{where}.{key}")
    return found


def _several(names) -> list:
    return list(names) if isinstance(names, (list, tuple)) else [names]


def stack_from(tables, chain: Chain) -> Task:
    """The stack's task on its robot, with the names of its tasks."""
    made = {}
    for name, one in tables.items():
        with errors.within(one.where):
            made[name] = task_of(one, chain)
            check_units(chain, made[name], one.written)
    return stack(**made)


def task_of(one: Table, chain: Chain) -> Task:
    """The task of a table, for one tip or several."""
    kind = "joints" if _is_joints(one.given) else one.given.get("task", "")
    for key in _NOT_OF.get(kind, ("joints", "axes")):
        if key in one.given:
            raise errors.fail(key, f"be left out for the task {kind or 'pose'!r}", f"is {one.given[key]!r}")
    weights, to = one.given.get("weights"), one.given.get("relative_to")
    if kind == "joints":
        return joints(one.given.get("joints"), weights=weights).on(chain)
    if kind == "center_of_mass":
        return center_of_mass(one.given.get("axes", "xyz"), relative_to=to, weights=weights).on(chain)
    each = (
        task_from(kind or None, chain, tip=tip, relative_to=to, weights=weights).on(chain)
        for tip in _several(one.given.get("tip"))
    )
    return functools.reduce(operator.and_, each)


def gains_from(tables, task: Task, alpha):
    """The gain of a stack: each task's own, or that of the loop."""
    if not any("alpha" in one.given for one in tables.values()):
        return gain_from(alpha)
    found = {}
    for name, one in tables.items():
        m = task.alone(name).m
        with errors.within(one.where):
            found[name] = errors.array("alpha", gain_from(one.given.get("alpha", alpha)), (), (m,))
    return found


def inverse_of(tables, task: Task, chain: Chain, **of_all):
    """J# of a stack: the loop's, if no task has a damping or a level of its own; else levels."""
    own = {key for one in tables.values() for key in one.given} & {"level", *_DAMPING}
    if not own:
        found = inverse_from(*(of_all[key] for key in _DAMPING))
        if isinstance(found, Pseudoinverse) and task.m > chain.n:
            must = f"be given for {task.m} coordinates of tasks and {chain.n} joints, such as 0.05"
            raise errors.fail("damping", must, "is not")
        return found
    numbered, groups = "level" in own, {}
    for i, (name, one) in enumerate(tables.items()):
        if numbered and "level" not in one.given:
            raise errors.fail(f"{one.where}.level", "be given where others have one", "is not")
        level = errors.integer(f"{one.where}.level", one.given.get("level", i + 1), at_least=1)
        groups.setdefault(level, []).append(name)
    each = {level: _of_level([tables[name] for name in groups[level]], of_all) for level in sorted(groups)}
    order = list(each) if numbered else by_damping(each)  # without numbers a smaller damping makes a level come first
    found = Levels(names=tuple(tuple(groups[level]) for level in order), damping=tuple(each[level] for level in order))
    if numbered and (wrong := not_growing(found.damping)):
        names = found.names[wrong.level]
        name = next((name for name in names if "damping" in tables[name].given), names[0])
        raise errors.fail(f"tasks.{name}.damping", wrong.must, wrong.found)
    return found


def _of_level(own, of_all):
    """The damping of one level: what one of its tasks gives, or the loop's."""
    first = next((one for one in own if set(_DAMPING) & set(one.given)), own[0])
    given = {key: first.given.get(key) for key in _DAMPING}
    damped, inverse = [name for name, kind in words.INVERSES.items() if kind.needs], of_all["inverse"]
    if given["inverse"] is None and inverse is not None:
        errors.one_of("inverse", inverse, damped, " for a stack whose tasks have levels or dampings")
    with errors.within(first.where):
        if given["inverse"] is not None:
            errors.one_of("inverse", given["inverse"], damped)
        if first.given.get("damping", of_all["damping"]) is None:
            must = "be given, for its level or for all tasks, such as 0.001 for the first level and 0.05 for the next"
            raise errors.fail("damping", must, "is not")
        found = inverse_from(*(of_all[key] if value is None else value for key, value in given.items()))
    for one in own:
        for key, value in given.items():
            if one.given.get(key) not in (None, value):
                raise errors.fail(f"{one.where}.{key}", f"be that of its level, {value!r}", f"is {one.given[key]!r}")
    return found


def ranks_of(tables, names) -> dict[str, int]:
    """The rank of each task, from 0: by its level, or by its damping if no task has a level."""
    key = "level" if any("level" in one.given for one in tables.values()) else "damping"
    values = {name: float(tables[name].given.get(key, math.inf)) for name in names}
    order = sorted(set(values.values()))
    return {name: order.index(value) for name, value in values.items()}


def references_of(tables, chain: Chain, task: Task, q0, horizon) -> References:
    """The paths of a stack's tasks, for each tip; a tip without a path stays where q0 has it."""
    made = {}
    for name, one in tables.items():
        with errors.within(one.where):
            own = replace(task.alone(name), weights=None)
            made[name] = of_each(functools.partial(_path, one, chain, q0, horizon), None, own)
        first = own.targets[0][1]
        if first.of_one_tip:
            known = {k: v for k, v in one.given.items() if all(map(errors.concrete, jax.tree.leaves(v)))}
            bare = {key: v for key, v in known.items() if not any(one.written.get(key, ()))}
            remark_on_lengths(bare, chain, first, f"{one.where}.")
    return references(**made)


def _path(one, chain, q0, horizon, _, task):
    kind, path = one.given.get("reference", "hold"), {key: one.given.get(key) for key in PATH}
    of_tip = hasattr(task.parts[0], "axes")
    if not of_tip:
        errors.one_of("reference", kind, ("hold",))
    if kind == "hold":
        path = fitting("reference", kind, words.REFERENCES[kind], path)
        if "target" not in path:
            return hold_at(chain, task, q0)
        if not of_tip:
            shapes = (task.m,), *[()] * (task.m == 1)  # for one joint it may be a number
            return hold(values=errors.array("target", path["target"], *shapes).reshape(task.m))
    return reference_from(kind, chain, task, q0, horizon=horizon, **path)


# --- walls --------------------------------------------------------------------------------------------

_OF_COORDINATES = ("task", "tip", "joints", "axes", "normal")
_EXTRA = {"distance": (*_OF_COORDINATES, "relative_to", "corners"), "corners": (*_OF_COORDINATES, "above", "below")}


def walls_from(tables: dict[str, Table], chain: Chain) -> tuple[Wall, ...]:
    """The walls of a stack, on its robot. Raises: ArgumentError naming the entry, such as `walls.table.above`."""
    made = []
    for name, one in tables.items():
        with errors.within(one.where):
            made += _walls(name, one, chain)
    names = [wall.name for wall in made]
    if twice := [name for name in names if names.count(name) > 1]:
        must = "have different names; `corners` make NAME_1, NAME_2, ..."
        raise errors.fail("walls", must, f"have {twice[0]!r} twice")
    return tuple(made)


def _walls(name, one, chain) -> tuple[Wall, ...]:
    given = one.given
    for kind, others in _EXTRA.items():
        if kind in given and (extra := [key for key in others if key in given]):
            raise errors.fail(extra[0], f"be left out of a wall with `{kind}`", f"is {given[extra[0]]!r}")
    kept = {"rate": given["rate"]} if "rate" in given else {}
    margin = errors.number("margin", given.get("margin", 0.0), at_least=0)
    if "corners" in given:
        corners = errors.array("corners", given["corners"], (None, 2), (None,))
        if corners.size % 2:
            raise errors.fail("corners", "be x and y of each corner", f"are {corners.size} numbers")
        about = given.get("relative_to")
        made = support_polygon(corners.reshape(-1, 2), relative_to=about, margin=margin, name=name, **kept)
        check_units(chain, made[0].task.on(chain), one.written)
        return made
    sides: dict = {side: errors.number(side, given[side]) for side in ("above", "below") if side in given}
    if "distance" in given:
        with errors.within("distance"):  # a half-space comes second, as `distance` takes it
            shapes = sorted(map(_shape, given["distance"]), key=lambda shape: not hasattr(shape, "ends"))
        with errors.called("one", "distance"):
            task, sides = distance(*shapes), sides or {"above": 0.0}
    else:
        if not {"task", "joints"} & set(given):
            raise errors.fail("task", "be given, or `joints`, `distance` or `corners`", "is not")
        task = task_of(one, chain)
    check_units(chain, task.on(chain), one.written)
    sides = {side: value + margin * (1 if side == "above" else -1) for side, value in sides.items()}
    with errors.called("task", "distance" if "distance" in given else "task"):
        return (wall(task, normal=given.get("normal"), name=name, **kept, **sides),)


def _shape(table):
    given = table_from("shape", table, OF_SHAPE).given
    kind = "half-space" if "normal" in given else "capsule" if {"from", "to"} & set(given) else "sphere"
    given = fitting("shape", kind, words.SHAPES[kind], given)
    if kind == "half-space":
        return words.SHAPES[kind].make(**given)
    ends = {new: given.pop(old) for old, new in (("from", "start"), ("to", "end")) if old in given}
    return words.SHAPES[kind].make(**({"tip": None, "radius": 0.0} | given | ends))
