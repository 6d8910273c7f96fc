"""Trace: what is exported, as a graph with named arguments and results."""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.export.graph import INT, REAL, Graph
from cnclik.export.reader import Reader, repeats
from cnclik.hints import few_lanes, use_form, use_hints
from cnclik.integrate.cells import array_of
from cnclik.integrate.history import blank, packed
from cnclik.integrate.solve import step_and_least
from cnclik.law.curves import Tangent
from cnclik.law.law import look
from cnclik.law.reference import Reference
from cnclik.record import cast, is_literal
from cnclik.robot import spatial as sp
from cnclik.robot.frames import frames, jacobian_rows

WHAT = ("step", "solve", "fk", "jacobian")


class Field(NamedTuple):
    """An argument or a result."""

    name: str
    shape: tuple
    kind: str = REAL
    about: str = ""
    value: object = None  # what it is where nothing else is said

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


class Program(NamedTuple):
    """A traced function: its arguments and results in groups, and the graph between them."""

    graph: Graph
    inputs: dict  # {group: [Field]}: parameters, input, history
    outputs: dict  # {group: [(Field, nodes)]}: output, history

    @property
    def ends(self) -> list:
        """All result nodes."""
        return [node for group in self.outputs.values() for _, nodes in group for node in nodes]


class Asked(NamedTuple):
    """What is to be exported."""

    law: object
    reference: object  # None: the target is an argument
    method: object
    stage: object
    dtype: np.dtype
    what: str
    runtime: object  # names of parameters that stay arguments; None for all


def trace(asked: Asked) -> Program:
    """The program of what is asked. Raises: `UnsupportedError` naming what has no C form."""
    make = {"fk": _pose, "jacobian": _jacobian, "solve": functools.partial(_step, timed=True)}.get(asked.what, _step)
    return make(asked)


def trace_loop(asked: Asked, wanted=None) -> Program:
    """The loop in time of `steps` steps: joints, error and coordinates at its end, and what is told of all steps.

    Args:
      wanted: names of results; None for all.
    """
    return _step(asked, timed=True, wanted=wanted or (), looped=True)


# --- parameters ---------------------------------------------------------------------------------------


def leaves(tree, path=()):
    """(path, array) of every array in a tree of records, in JAX's order."""
    if dataclasses.is_dataclass(tree):
        for field in dataclasses.fields(tree):
            yield from leaves(getattr(tree, field.name), (*path, field.name))
    elif isinstance(tree, (tuple, list)):
        for i, item in enumerate(tree):
            yield from leaves(item, (*path, str(i)))
    elif tree is not None and not is_literal(tree):
        yield path, tree


def names(paths) -> list:
    """A short name for each path: its last words, as many as it takes to tell them apart."""
    found = []
    for path in paths:
        for count in range(1, len(path) + 1):
            short = path[-count:]
            if not short[0].isdigit() and sum(p[-count:] == short for p in paths) == 1:
                break
        found.append("_".join(short))
    return found


_ABOUT = {
    "alpha": "gain of the error [1/s]",
    "damping": "lambda of the damped inverse [unit of J]",
    "threshold": "below which it is damped",
    "near_singular": "least singular value below which NEAR_SINGULAR is set",
    "feedforward": "factor of the desired velocity",
    "error_clamp": "largest error that the gain sees [m, rad]",
    "rate": "[1/s]",
    "rest": "joint values to draw towards [rad, m]",
    "weights": "of the task coordinates",
}


def _parameters(asked, tree):
    """Fields of the arrays in a tree, and the function that puts others in their place."""
    flat, treedef = jax.tree.flatten(tree)
    found = list(leaves(tree))
    if len(found) != len(flat):
        raise errors.fail("law", "be made of cnclik's own records", "holds other trees of arrays")
    fields = []
    for (path, value), name in zip(found, names([p for p, _ in found]), strict=True):
        value = np.asarray(value)
        kind = REAL if value.dtype.kind == "f" else INT
        about = next((_ABOUT[word] for word in reversed(path) if word in _ABOUT), "")
        fields.append(Field(name, value.shape, kind, about, value))
    if asked.runtime is not None:
        for name in asked.runtime:
            errors.one_of("runtime", name, [f.name for f in fields])
    return fields, functools.partial(jax.tree.unflatten, treedef)


# --- what is exported ---------------------------------------------------------------------------------


def _step(asked: Asked, *, timed=False, looped=False, wanted=()) -> Program:
    """timed: whether the time is an argument where the target is one, too; it then moves with its velocity."""
    law, n, p, m = asked.law, asked.law.chain.n, len(asked.law.task.position), asked.law.task.m
    turns = bool(law.task.orientation)
    tree = (law, asked.stage) if asked.reference is None else (law, asked.stage, asked.reference)
    parameters, put = _parameters(asked, tree)
    units = ", ".join(dict.fromkeys(law.chain.units))
    given = [Field("q", (n,), about=f"joint values [{units}]")]
    if asked.reference is None:
        given += [Field("position", (p,), about="desired position in the task's coordinates [m]")] * bool(p)
        given += [Field("rotation", (3, 3), about="desired rotation, row by row", value=np.eye(3))] * turns
        given += [Field("velocity", (m,), about="desired task velocity [m/s, rad/s]", value=np.zeros(m))]
    if timed or asked.reference is not None:
        given += [Field("t", (), about="time [s]", value=0.0)]
    given += [Field("Ts", (), about="sampling time [s]")]
    start = jax.eval_shape(lambda q: packed(blank(law, tuple(q), asked.method)), _zeros((n,), asked.dtype))
    past, past_def = jax.tree.flatten(start)
    history = [
        Field(name, leaf.shape, REAL if leaf.dtype.kind == "f" else INT)
        for leaf, name in zip(past, names([path for path, _ in leaves(start)]), strict=True)
    ]

    def fn(*flat):
        values = iter(flat)
        law, stage, *others = put([next(values) for _ in parameters])
        inputs = {f.name: next(values) for f in given}
        reference = others[0] if others else _target(law, inputs)
        memory = jax.tree.unflatten(past_def, list(values))
        q, Ts, t = inputs["q"], inputs["Ts"], inputs.get("t", 0.0)
        made, least = step_and_least(law, reference, q, t, Ts, stage, memory, method=asked.method)
        told = [made.q, made.qdot, made.e, made.x, made.residual, made.contraction, least, made.status]
        return told, jax.tree.leaves(made.history)

    told = [
        Field("q", (n,), about=f"joint values after the step [{units}]"),
        Field("qdot", (n,), about="joint velocities to send to the robot [rad/s, m/s]"),
        Field("e", (m,), about="error before the step [m, rad]"),
        Field("x", (m,), about="task coordinates before the step [m, rad]"),
        Field("residual", (), about="last change of an implicit stage [rad, m]"),
        Field("contraction", (), about="ratio of its last two changes"),
        Field("least", (), about="least singular value of the task Jacobian, an estimate from below [m or 1]"),
        Field("status", (), INT, "bits of the step's status"),
    ]
    groups = {"parameters": parameters, "input": given, "history": history}
    if looped:

        def end(*flat):
            values = iter(flat)
            law, _, *others = put([next(values) for _ in parameters])
            inputs = {f.name: next(values) for f in given}
            law, reference = cast((law, others[0] if others else _target(law, inputs)), asked.dtype)
            at = look(law, reference, inputs["t"], tuple(inputs["q"][i] for i in range(n)))
            return sp.packed(at.e, asked.dtype), sp.packed(at.x(), asked.dtype)

        return _read_loop(asked, fn, end, groups, told, wanted)
    return _read(asked, fn, groups, {"output": told, "history": history})


def _target(law, inputs):
    """The target as an argument: where it is, and how fast it moves."""
    p = len(law.task.position)
    velocity = tuple(inputs["velocity"][i] for i in range(law.task.m))
    rotation = spin = None
    if law.task.orientation:
        about = dict(zip(law.task.angular, velocity[p:], strict=True))
        spin = tuple(about.get(i, jnp.zeros_like(velocity[0])) for i in range(3))
        rotation = tuple(tuple(inputs["rotation"][i, j] for j in range(3)) for i in range(3))
    position = tuple(inputs["position"][i] for i in range(p)) if p else None
    zero = jnp.zeros((), velocity[0].dtype)
    return Reference(
        curve=Tangent(t=zero, position=position or (), velocity=velocity[:p], rotation=rotation, spin=spin)
    )


def _pose(asked: Asked) -> Program:
    def results(chain, q):
        at = frames(chain, q)
        return [sp.packed(at.position, asked.dtype), sp.packed(at.rotation, asked.dtype)]

    told = [
        Field("position", (3,), about="of the tip in the base frame [m]"),
        Field("rotation", (3, 3), about="of the tip, row by row"),
    ]
    return _of_chain(asked, results, told)


def _jacobian(asked: Asked) -> Program:
    def results(chain, q):
        return [sp.packed(jacobian_rows(chain, frames(chain, q), (0, 1, 2), (0, 1, 2)), asked.dtype)]

    n = asked.law.chain.n
    told = [Field("jacobian", (6, n), about="(v, w) = J qdot in the base frame, row by row [m/s, rad/s]")]
    return _of_chain(asked, results, told)


def _of_chain(asked, results, told):
    chain = asked.law.chain
    parameters, put = _parameters(asked, chain)

    def fn(*flat):
        *values, q = flat
        return results(put(values), tuple(q[i] for i in range(chain.n))), []

    given = [Field("q", (chain.n,), about=f"joint values [{', '.join(dict.fromkeys(chain.units))}]")]
    return _read(asked, fn, {"parameters": parameters, "input": given, "history": []}, {"output": told, "history": []})


def _zeros(shape, dtype):
    return jax.ShapeDtypeStruct(shape, dtype)


def _traced(asked, fn, fields):
    shapes = [_zeros(f.shape, asked.dtype if f.kind == REAL else np.int32) for f in fields]
    # With hints, so that what is fenced off is a call: what is called several times becomes a function.
    with use_hints(True), use_form("unrolled"), few_lanes(0), jax.enable_x64(asked.dtype == np.float64):
        return jax.make_jaxpr(fn)(*shapes)


def _arguments(asked, reader, groups):
    """Nodes of all arguments, {group: [array]}, and the fields that are left at run time."""
    kept, values = {}, {}
    for group, some in groups.items():
        kept[group], values[group] = [], []
        for field in some:
            if group == "parameters" and asked.runtime is not None and field.name not in asked.runtime:
                cells = [reader.graph.const(v, field.kind) for v in np.ravel(field.value).tolist()]
            else:
                clean = field.name == "velocity"  # what is not finite there makes the joints' velocities so
                key = f"{group}.{field.name}"
                cells = [reader.graph.input(key, i, field.kind, clean=clean) for i in range(field.size)]
                kept[group].append(field)
            values[group].append(array_of(cells, field.shape))
    return values, kept


def _read(asked, fn, groups, told) -> Program:
    traced = _traced(asked, fn, [f for group in groups.values() for f in group])
    graph = Graph(asked.dtype)
    reader = Reader(graph, repeats(traced.jaxpr))
    values, kept = _arguments(asked, reader, groups)
    found = iter(reader.run(traced.jaxpr, traced.consts, [v for some in values.values() for v in some]))
    outputs = {group: [(field, list(next(found).flat)) for field in some] for group, some in told.items()}
    return Program(graph, kept, outputs)


_OVER_TIME = {"residual": "max", "contraction": "max", "least": "min", "status": "or"}  # of all steps together


def _read_loop(asked, fn, end, groups, told, wanted) -> Program:
    one = _traced(asked, fn, [f for group in groups.values() for f in group])
    last = _traced(asked, end, [f for group in ("parameters", "input") for f in groups[group]])
    graph = Graph(asked.dtype)
    reader = Reader(graph, repeats(one.jaxpr))
    values, kept = _arguments(asked, reader, {g: groups[g] for g in ("parameters", "input")})
    names = [f.name for f in groups["input"]]
    q0, t0, Ts = (values["input"][names.index(name)] for name in ("q", "t", "Ts"))
    told = [f for f in told if f.name not in ("e", "x")]
    carried = [*told, *groups["history"]]

    def at(q, k):
        """The arguments of step k, a node."""
        inputs = list(values["input"])
        moved = graph.apply("add", t0.flat[0], graph.apply("mul", graph.apply("to_real", k), Ts.flat[0]))
        inputs[names.index("q")], inputs[names.index("t")] = q, array_of([moved], ())
        return [*values["parameters"], *inputs]

    def apart(cells):
        cells = iter(cells)
        return [array_of([next(cells) for _ in range(f.size)], f.shape) for f in carried]

    def body(k, cells):
        state = apart(cells)
        made = reader.run(one.jaxpr, one.consts, [*at(state[0], k), *state[len(told) :]])
        by_name = dict(zip([f.name for f in told_all], made, strict=False))
        new = []
        for field, old in zip(told, state, strict=False):
            now = by_name[field.name]
            if field.name in _OVER_TIME:
                now = array_of([graph.apply(_OVER_TIME[field.name], old.flat[0], now.flat[0])], ())
            new.append(now)
        return [cell for value in (*new, *made[len(told_all) :]) for cell in value.flat]

    told_all = [Field(v, ()) for v in ("q", "qdot", "e", "x", "residual", "contraction", "least", "status")]
    first = {"q": list(q0.flat), "least": [graph.const(np.inf, REAL)]}
    start = [c for f in carried for c in first.get(f.name if f in told else "", [graph.const(0, f.kind)] * f.size)]
    kinds = [f.kind for f in carried for _ in range(f.size)]
    ended = apart(graph.loop("steps", start, body, kinds=kinds))
    steps = graph.input("steps", 0, INT)
    e, x = reader.run(last.jaxpr, last.consts, at(ended[0], steps))
    found = dict(zip([f.name for f in told], ended, strict=False)) | {"e": e, "x": x}
    m = asked.law.task.m
    fields = [*told[:1], Field("e", (m,)), Field("x", (m,)), *told[1:]]
    outputs = [(f, list(found[f.name].flat)) for f in fields if not wanted or f.name in wanted]
    return Program(graph, kept, {"output": outputs})
