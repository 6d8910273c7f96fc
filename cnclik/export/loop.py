"""Loop: the loop in time as one program, for many lanes; and what marks a step that grew."""

import jax
import jax.numpy as jnp

from cnclik.engine.routine import INT, REAL, Field, Routine
from cnclik.export.trace import Request, Stepping, read_as

RESULTS = ("q", "e", "x", "qdot", "residual", "contraction", "least", "status")
_OVER_TIME = {  # of all steps together: how two are put together, and what is before the first
    "residual": (jnp.maximum, 0),
    "contraction": (jnp.maximum, 0),
    "least": (jnp.minimum, jnp.inf),
    "status": (jnp.bitwise_or, 0),
}


def trace_loop(request: Request, wanted=RESULTS) -> Routine:
    """A loop of `steps` steps: joints, error and coordinates at its end, and what is known of all steps.

    Args: wanted: names of results.
    """
    step = Stepping(request, timed=True)
    parameters, names = step.groups["parameters"], [f.name for f in step.groups["input"]]
    # A column of a batch holds real numbers.
    groups = {"parameters": [f._replace(kind=REAL) for f in parameters], "input": step.groups["input"]}
    carried = [f for f in step.outputs if f.name == "q" or (f.name in wanted and f.name not in ("e", "x"))]

    def zeros(f):
        return jnp.full(f.shape, _OVER_TIME.get(f.name, (None, 0))[1], request.dtype if f.kind == REAL else jnp.int32)

    def loop(*flat):
        known = [x.astype(jnp.int32) if f.kind == INT else x for f, x in zip(parameters, flat, strict=False)]
        *given, steps = flat[len(known) :]
        given = dict(zip(names, given, strict=True))

        def at(q, k):
            now = {"q": q, "t": given["t"] + k.astype(request.dtype) * given["Ts"]}
            return [*known, *(given | now).values()]

        def advance(k, carry):
            before, past = carry
            made, past = step.advance(*at(before["q"], k), *past)
            now = {f.name: jnp.asarray(x, zeros(f).dtype) for f, x in zip(step.outputs, made, strict=True)}
            now |= {name: both(before[name], now[name]) for name, (both, _) in _OVER_TIME.items() if name in before}
            return {name: now[name] for name in before}, past

        first = {f.name: zeros(f) for f in carried} | {"q": given["q"]}
        last, _ = jax.lax.fori_loop(0, steps, advance, (first, [zeros(f) for f in step.groups["history"]]))
        found = last | dict(zip(("e", "x"), step.end(*at(last["q"], steps)), strict=True))
        return [found[name] for name in RESULTS if name in wanted]

    by_name = {f.name: f for f in step.outputs}
    outputs = {"output": [by_name[name] for name in RESULTS if name in wanted]}
    return read_as(request, loop, groups | {"steps": [Field("steps", (), INT)]}, outputs)


def trace_growth(request: Request) -> Routine:
    """Whether a step grew: from the errors `e` at its two ends, at the times `t`."""
    step = Stepping(request, timed=True)
    groups = {name: step.groups[name] for name in ("parameters", "input")}
    ends = [Field("t", (2,)), Field("e", (2, request.law.task.m))]
    return read_as(request, step.grown, groups | {"ends": ends}, {"output": [Field("status", (), INT)]})
