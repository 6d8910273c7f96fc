"""Loop: the loop in time as one program for many lanes, and the test for a growing step."""

import functools

import jax
import jax.numpy as jnp

from cnclik.engine.routine import INT, REAL, Field, Routine
from cnclik.export.trace import Request, Stepping, read_as
from cnclik.integrate.loop import loop_of, one, start

RESULTS = ("q", "e", "x", "qdot", "residual", "contraction", "least", "status")
_OVER_TIME = {  # results over all steps: how two values combine, and the initial value
    "residual": (jnp.maximum, 0),
    "contraction": (jnp.maximum, 0),
    "least": (jnp.minimum, jnp.inf),
    "status": (jnp.bitwise_or, 0),
}


def trace_loop(request: Request, wanted=RESULTS) -> Routine:
    """A loop of `steps` steps: joints, error and coordinates at its end, and results over all steps.

    Args: wanted: names of results.
    """
    step = Stepping(request, timed=True)
    # The columns of a batch are real numbers.
    groups = {"parameters": [f._replace(kind=REAL) for f in step.groups["parameters"]], "input": step.groups["input"]}
    kinds = [f.kind for some in (step.groups["parameters"], step.groups["input"]) for f in some]
    outputs = {f.name: f for f in step.outputs if f.name in wanted}

    def whole(*flat):
        *flat, steps = flat
        given = [x.astype(jnp.int32) if kind == INT else x for kind, x in zip(kinds, flat, strict=True)]
        law, stage, reference, inputs, _ = step.apart(given)
        loop = loop_of(law, reference, inputs["q"], inputs["Ts"], steps, request.method, stage, t0=inputs["t"])

        def advance(starting, k, carry):
            state, before = carry
            state, made = one(loop, starting, state, k)
            both = {name: _OVER_TIME[name][0] if name in _OVER_TIME else lambda _, now: now for name in before}
            return state, {name: both[name](before[name], getattr(made, name)) for name in before}

        def zeros(f):
            dtype = request.dtype if f.kind == REAL else jnp.int32
            return jnp.full(f.shape, _OVER_TIME.get(f.name, (None, 0))[1], dtype)

        carry = start(loop, inputs["q"]), {name: zeros(f) for name, f in outputs.items() if name not in ("q", "e", "x")}
        early = jnp.minimum(request.method.steps - 1, steps)
        if request.method.steps > 1:
            carry = jax.lax.fori_loop(0, early, functools.partial(advance, True), carry)
        state, found = jax.lax.fori_loop(early, steps, functools.partial(advance, False), carry)
        end = one(loop, False, state, steps)[1]  # a step of length 0, of which only the observation is used
        found = {"q": state.q, "e": end.e, "x": end.x} | found
        return [found[name] for name in RESULTS if name in wanted]

    steps = [Field("steps", (), INT)]
    return read_as(request, whole, groups | {"steps": steps}, {"output": [outputs[n] for n in RESULTS if n in wanted]})


def trace_growth(request: Request) -> Routine:
    """Whether a step is GROWING, from the errors `e` at its two ends, at the times `t`."""
    step = Stepping(request, timed=True)
    groups = {name: step.groups[name] for name in ("parameters", "input")}
    ends = [Field("t", (2,)), Field("e", (2, request.law.task.m))]
    return read_as(request, step.grown, groups | {"ends": ends}, {"output": [Field("status", (), INT)]})
