"""Walls in plain names: walls of `bounded` from the tables of a stack's walls."""

from cnclik import errors
from cnclik.law.walls import Wall, support_polygon, wall
from cnclik.problem import words
from cnclik.problem.magnitudes import check_units
from cnclik.problem.names import fitting
from cnclik.problem.options import OF_SHAPE
from cnclik.problem.stack import Table, table_from, task_of
from cnclik.robot.chain import Chain
from cnclik.task.shapes import distance

_OF_TASK = ("task", "tip", "joints", "axes", "normal")
_EXTRA = {"distance": (*_OF_TASK, "relative_to", "corners"), "corners": (*_OF_TASK, "above", "below")}


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
    kept = {key: given[key] for key in ("rate", "level") if key in given}
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
        task, sides = distance(*shapes), sides or {"above": 0.0}
    else:
        task = task_of(one, chain)
    check_units(chain, task.on(chain), one.written)
    sides = {side: value + margin * (1 if side == "above" else -1) for side, value in sides.items()}
    return (wall(task, normal=given.get("normal"), name=name, **kept, **sides),)


def _shape(table):
    """A shape from its table."""
    given = table_from("shape", table, OF_SHAPE).given
    kind = "half-space" if "normal" in given else "capsule" if {"from", "to"} & set(given) else "sphere"
    given = fitting("shape", kind, words.SHAPES[kind], given)
    if kind == "half-space":
        return words.SHAPES[kind].make(**given)
    ends = {new: given.pop(old) for old, new in (("from", "start"), ("to", "end")) if old in given}
    return words.SHAPES[kind].make(**({"tip": None, "radius": 0.0} | given | ends))
