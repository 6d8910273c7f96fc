"""Stacks of tasks of a robot with two arms: as dicts, files, specs, command lines, and put together from records."""

import copy
import functools
import operator

import jax
import numpy as np

import cnclik as ck
from cnclik.law.law import check_loop
from cnclik.problem.build import problem_from
from cnclik.problem.options import OF_SHAPE, OF_TASK, OF_WALL, SWEPT
from tests.specs import reaching
from tests.stress.fuzz import arguments, toml
from tests.stress.fuzz.nasty import TEXTS, VALUES, any_of, chance

_JOINT = """<link name="{0}"/><joint name="j_{0}" type="{2}"><parent link="{1}"/><child link="{0}"/>
<origin xyz="{3}"/><axis xyz="{4}"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint>"""
_ARM = ("{0}1 trunk revolute 0,0.2,0 0,0,1", "{0}2 {0}1 revolute 0.3,0,0 0,1,0", "{0} {0}2 revolute 0.3,0,0 1,0,0")
_LINKS = ["trunk base prismatic 0,0,0.2 0,0,1", *(one.format(tip) for tip in ("left", "right") for one in _ARM)]
_JOINTS = "".join(_JOINT.format(*one.replace(",", "|").split()) for one in _LINKS).replace("|", " ")
URDF = f'<robot name="two"><link name="base"/>{_JOINTS}</robot>'.encode()

BASES = (
    {
        "hands": {"task": "position", "tip": ["left", "right"], "alpha": 10.0, "level": 1, "damping": 1e-3},
        "rest": {"task": "joints", "level": 2, "damping": 0.1},
    },
    {
        "hand": {"tip": "left", "task": "xy", "reference": "circle", "radius": "20 mm", "period": 2.0},
        "rest": {"joints": ["j_right1", "j_right2"], "target": [0.1, "20 deg"], "alpha": [1.0, 2.0]},
    },
    {"apart": {"task": "position", "tip": "left", "relative_to": "right", "weights": [1.0, 1.0, 0.1]}},
    {"a": {"task": "xz", "tip": "right", "reference": "line", "to": [0.5, 0.1], "alpha": 3}, "b": {"tip": "left"}},
    {"look": {"task": "orientation", "tip": "left", "target": [1.0, 0.0, 0.0, 0.0]}, "rest": {"task": "joints"}},
)
WALLS = (
    {},
    {"a": {"task": "z", "tip": "left", "above": "-1 m", "margin": 0.1}, "b": {"joints": "j_left1", "below": "100 deg"}},
    {"apart": {"distance": [{"tip": "left", "radius": 0.1}, {"tip": "right", "from": [0, 0, 0], "to": "0 0 50 mm"}]}},
    {"floor": {"distance": [{"tip": "trunk"}, {"normal": [0, 0, 1], "offset": -0.5}], "above": 0.1, "rate": 5}},
    {"soles": {"corners": "-50 -50 50 -50 0 80 mm", "relative_to": "left", "margin": 0.01}},
)
OPTIONS = (
    {"damping": 0.05},
    {"damping": 0.05, "limits": "bounded", "limit_rate": 4.0},
    {"limits": "bounded"},
    {"damping": 0.05, "inverse": "singular-damped", "threshold": 0.1},
    {"delay": 2, "lag": 0.02},
    {},
)
NAMES = (*OF_TASK, *OF_WALL, *OF_SHAPE, *SWEPT, "tasks", "walls")
TIPS = ("left", "right", "trunk", "base", None)
NUMERIC = (1.0, 5, 0.0, -1.0, 1e-3, 1e-320, 1e308, float("nan"), True, None, "0.1", [1.0, 2.0], [[1.0]], {})
DOORS = ("dict", "dict", "file", "spec", "command", "records", "records")


def draw(rng):
    """(the door, what is handed in there)."""
    door = any_of(rng, DOORS)
    if door == "records":
        return door, _records(rng)
    if chance(rng, 0.02):  # many
        count = int(10 ** rng.uniform(1, 2.5))
        return door, {"tasks": {f"t{k}": {"tip": "left", "task": "x"} for k in range(count)}, "fixed": {"damping": 0.1}}
    walls = copy.deepcopy(any_of(rng, WALLS)) if chance(rng, 0.3) else {}
    written = {"tasks": copy.deepcopy(any_of(rng, BASES)), "walls": walls, "fixed": dict(any_of(rng, OPTIONS))}
    for _ in range(int(rng.integers(4))):
        toml.mutate(rng, written, NAMES, ("tasks", "walls", "fixed"))
    try:
        repr(written)
    except RecursionError:  # so deep that only TOML can say it
        door = "spec"
    return door, written


def attempt(made, folder) -> None:
    """What happens to a stack before anything is traced; the loop that it makes is finite."""
    door, written = made
    if door == "records":
        _looked_at(*_loop(**written))
        return
    tables, options = {name: written[name] for name in ("tasks", "walls") if name in written}, written.get("fixed", {})
    file = folder / "stack.toml"
    file.write_text(toml.as_toml(tables), errors="surrogatepass")
    if door == "spec":
        (folder / "arm.urdf").write_bytes(URDF)
        own = reaching(["final_error"], alpha="[1.0, 2.0]").partition("[fixed]")[0]
        spec = {"fixed": {"robot": "arm.urdf", "N": 5} | (options if isinstance(options, dict) else {"alpha": options})}
        toml.attempt(((own + toml.as_toml(written | spec | {"axes": {"alpha": [1.0, 2.0]}})).encode(), ()), folder)
    elif door == "command":
        given = options.items() if isinstance(options, dict) else ()
        words = [w for name, value in given for w in (f"--{name.replace('_', '-')}", str(value)) if "\0" not in w]
        arguments.attempt((["solve", "arm.urdf", "--stack", "stack.toml", *words], URDF), folder)
    else:
        by = {"tasks": {}} | tables if door == "dict" else {"stack": str(file)}
        options = options if isinstance(options, dict) else {}
        p = problem_from(_two(), **({"N": 5} | {k: v for k, v in options.items() if k != "robot"} | by))
        _looked_at(p.law, p.reference, p.q0)


@functools.cache
def _two():
    return ck.load_urdf(URDF.decode(), tips=["left", "right"])


def _looked_at(law, reference, q0):
    check_loop(law, reference)
    assert repr(law) and law.task.names and [law.task.alone(name) for name, _ in law.task.tasks]
    for leaf in jax.tree.leaves((law, reference, q0)):
        assert not np.isnan(np.asarray(leaf, float)).any(), f"NaN in {law}"


# --- from records -------------------------------------------------------------------------------------


def _records(rng):
    """What `_loop` builds: mostly what fits."""
    odd = any_of(rng, (0.0, 0.05, 0.2))
    names = tuple(any_of(rng, (("hands", "rest"), ("a",), ("a", "b", "c"))))

    def value(right):
        return any_of(rng, (*VALUES, *NUMERIC, *TEXTS[:20])) if chance(rng, odd) else right

    def name():
        return value(any_of(rng, names))

    parts = {one: [_part(rng, value) for _ in range(int(rng.integers(1, 3)))] for one in names}
    groups = [[one] for one in names] if chance(rng, 0.7) else [[name() for _ in names], [name()]]
    dampings = [value(0.001 * 10**k) for k in range(len(groups))]
    inverse = any_of(rng, (
        ("levels", value(groups), value(dampings)),
        ("damped", {one: value(0.1) for one in names} if chance(rng, 0.5) else value(0.1)),
        ("error_damped", value(0.01)),
        ("pseudoinverse",),
    ))  # fmt: skip
    alpha = any_of(rng, (value(5.0), {one: value(any_of(rng, (1.0, [1.0, 2.0], [[1.0]]))) for one in names}))
    limits = any_of(rng, (None, ("bounded",), ("bounded", value(5.0), value(10))))
    held = any_of(rng, (("values", [0.1]), ("at", [0.1, 0.2, 0.3]), ("each", [0.1] * 3)))
    others = {str(name()): (held[0], value(held[1]))} if chance(rng, 0.5) else {}
    return dict(parts=parts, alpha=alpha, inverse=inverse, limits=limits, others=others)


def _part(rng, value):
    kind = any_of(rng, ("position", "orientation", "pose", "joints", "function"))
    weights = value([1.0, 0.5, 0.1][: int(rng.integers(1, 4))]) if chance(rng, 0.1) else None
    if kind == "joints":
        names = any_of(rng, (None, ["j_left1"], ["j_left1", "j_left1"], "j_trunk"))
        return kind, {"names": value(names), "weights": weights}
    if kind == "function":
        return kind, {"names": value(["d"]), "units": value(["m"]), "weights": weights}
    tips = {"tip": value(any_of(rng, TIPS[:2])), "relative_to": value(any_of(rng, TIPS) if chance(rng, 0.2) else None)}
    return kind, {"axes": value(any_of(rng, ("xyz", "xy", "z"))), **tips, "weights": weights}


def _made(kind, about):
    if kind == "function":
        return ck.function(lambda robot, q: q[:1], **about)
    return getattr(ck, kind)(**about)


def _loop(parts, alpha, inverse, limits, others):
    """(law, reference, joint values) of a stack of records."""
    joined = {name: functools.reduce(operator.and_, (_made(*one) for one in its)) for name, its in parts.items()}
    task = ck.stack(**joined)
    kind, *about = inverse
    if kind == "levels":
        groups, dampings = about
        made = ck.levels(*(groups if isinstance(groups, list) else [groups]), damping=dampings)
    else:
        made = getattr(ck, kind)(*about)
    kept = None if limits is None else getattr(ck, limits[0])(*limits[1:])
    law = ck.Law(_two(), task, alpha=alpha, inverse=made, limits=kept)
    q0 = 0.2 * np.ones(law.chain.n)
    held = {name: _held(*one) for name, one in others.items()}
    return law, ck.hold_at(law.chain, law.task, q0, **held), q0


def _held(kind, value):
    if kind == "values":
        return ck.hold(values=value)
    return ck.hold(value) if kind == "at" else ck.references(left=ck.hold(value))
