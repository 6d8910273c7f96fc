"""Loop: the loop in time as one program, for many lanes; and what marks a step that grew."""

import numpy as np

from cnclik.engine.cells import array_of
from cnclik.export.trace import Asked, Stepping, read_as
from cnclik.native.graph import INT, Graph
from cnclik.native.program import Field, Program, arguments, traced
from cnclik.native.reader import Reader, repeats

RESULTS = ("q", "e", "x", "qdot", "residual", "contraction", "least", "status")
_OVER_TIME = {"residual": "max", "contraction": "max", "least": "min", "status": "or"}  # of all steps together


def trace_loop(asked: Asked, wanted=RESULTS) -> Program:
    """A loop of `steps` steps: joints, error and coordinates at its end, and what is told of all steps.

    Args:
      wanted: names of results.
    """
    step = Stepping(asked, timed=True)
    groups = {name: step.groups[name] for name in ("parameters", "input")}
    one, last = traced(step.one, step.groups, asked.dtype), traced(step.end, groups, asked.dtype)
    graph = Graph(asked.dtype)
    values, kept = arguments(graph, groups, asked.runtime)
    reader = Reader(graph, repeats(one.jaxpr))
    names = [f.name for f in groups["input"]]
    q0, t0, Ts = (values["input"][names.index(name)] for name in ("q", "t", "Ts"))
    told = [f for f in step.told if f.name not in ("e", "x")]
    carried = [*told, *step.groups["history"]]

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
        now = dict(zip([f.name for f in step.told], made, strict=False))
        for field, old in zip(told, state, strict=False):
            if field.name in _OVER_TIME:
                both = graph.apply(_OVER_TIME[field.name], old.flat[0], now[field.name].flat[0])
                now[field.name] = array_of([both], ())
        return [cell for value in (*(now[f.name] for f in told), *made[len(step.told) :]) for cell in value.flat]

    first = [*q0.flat]
    for field in carried[1:]:
        first += [graph.const(np.inf if field is told[-2] else 0, field.kind)] * field.size
    ended = apart(graph.loop("steps", first, body, kinds=[f.kind for f in carried for _ in range(f.size)]))
    e, x = reader.run(last.jaxpr, last.consts, at(ended[0], graph.input("steps", 0, INT)))
    found = dict(zip([f.name for f in told], ended, strict=False)) | {"e": e, "x": x}
    by_name = {f.name: f for f in step.told}
    outputs = [(by_name[name], list(found[name].flat)) for name in RESULTS if name in wanted]
    return Program(graph, kept, {"output": outputs})


def trace_growth(asked: Asked) -> Program:
    """Whether a step grew: from the errors `e` at its two ends, at the times `t`."""
    step = Stepping(asked, timed=True)
    groups = {name: step.groups[name] for name in ("parameters", "input")}
    ends = [Field("t", (2,)), Field("e", (2, asked.law.task.m))]
    return read_as(asked, step.grown, groups | {"ends": ends}, {"output": [Field("status", (1,), INT)]})
