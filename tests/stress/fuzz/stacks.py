"""Stacks of tasks of a robot with two arms, put together from records."""

import functools
import operator

import jax
import numpy as np

import cnclik as ck
from cnclik.law.law import check_loop
from tests.stress.fuzz.nasty import TEXTS, VALUES, any_of, chance

_JOINT = """<link name="{0}"/><joint name="j_{0}" type="{2}"><parent link="{1}"/><child link="{0}"/>
<origin xyz="{3}"/><axis xyz="{4}"/><limit lower="-2" upper="2" velocity="2" effort="1"/></joint>"""
_ARM = ("{0}1 trunk revolute 0,0.2,0 0,0,1", "{0}2 {0}1 revolute 0.3,0,0 0,1,0", "{0} {0}2 revolute 0.3,0,0 1,0,0")
_LINKS = ["trunk base prismatic 0,0,0.2 0,0,1", *(one.format(tip) for tip in ("left", "right") for one in _ARM)]
_JOINTS = "".join(_JOINT.format(*one.replace(",", "|").split()) for one in _LINKS).replace("|", " ")
URDF = f'<robot name="two"><link name="base"/>{_JOINTS}</robot>'.encode()

TIPS = ("left", "right", "trunk", "base", None)
NUMERIC = (1.0, 5, 0.0, -1.0, 1e-3, 1e-320, 1e308, float("nan"), True, None, "0.1", [1.0, 2.0], [[1.0]], {})


def attempt(made, folder) -> None:
    """Build the loop; it is finite."""
    law, reference, q0 = _loop(**made)
    check_loop(law, reference)
    assert repr(law) and law.task.names and [law.task.alone(name) for name, _ in law.task.tasks]
    for leaf in jax.tree.leaves((law, reference, q0)):
        assert not np.isnan(np.asarray(leaf, float)).any(), f"NaN in {law}"


@functools.cache
def _two():
    return ck.load_urdf(URDF.decode(), tips=["left", "right"])


def draw(rng):
    """Arguments of `_loop`, mostly ones that fit."""
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
