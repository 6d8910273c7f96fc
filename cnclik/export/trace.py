"""Trace: an export as a graph with named arguments and results: a step, a loop for many lanes, or geometry alone."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.engine.constants import of_the_model
from cnclik.engine.routine import INT, REAL, Field, Routine, read
from cnclik.export import fields
from cnclik.integrate.loop import loop_of, one, start
from cnclik.integrate.method import Method
from cnclik.integrate.solve import one_step
from cnclik.integrate.stage import Stage
from cnclik.integrate.status import growing
from cnclik.law.curves import Hold
from cnclik.law.law import Law
from cnclik.law.reference import Reference, References, of_each, tangent
from cnclik.record import cast, replace
from cnclik.robot.model import frames, jacobian_rows, modelled

WHAT = ("step", "solve", "reach", "fk", "jacobian")
RESULTS = ("q", "e", "x", "qdot", "residual", "contraction", "least", "status")
_OVER_TIME = {  # results over all steps: how two values combine, and the initial value
    "residual": (jnp.maximum, 0),
    "contraction": (jnp.maximum, 0),
    "least": (jnp.minimum, jnp.inf),
    "status": (jnp.bitwise_or, 0),
}


class Request(NamedTuple):
    law: Law
    reference: Reference | References | None  # None: the target is an argument of the function
    method: Method
    stage: Stage
    dtype: np.dtype
    what: str
    runtime: tuple[str, ...] | None  # names of the parameters set at run time; None: all


def trace(request: Request) -> Routine:
    """The routine of a request. Raises: `UnsupportedError`, which names what has no C form."""
    if request.what in ("fk", "jacobian"):
        return _of_chain(request)
    step = Stepping(request, timed=request.what == "solve")
    return read_as(request, step.advance, step.groups, {"output": step.outputs})


def read_as(request: Request, fn, groups, outputs) -> Routine:
    """The routine of a function, with the requested dtype and parameters at run time."""
    runtime = request.runtime
    fixed = [f.name for f in groups.get("parameters", ()) if runtime is not None and f.name not in runtime]
    return read(fn, groups, outputs, dtype=request.dtype, fixed=fixed)


# --- the step -----------------------------------------------------------------------------------------


class Stepping:
    """A step's arguments and results, and the functions of flat arguments that make it."""

    def __init__(self, request: Request, *, timed):
        """timed: whether the time is an argument even if the target is one, which then moves with its velocity."""
        self.request, law = request, request.law
        n, m = law.chain.n, law.task.m
        tree = (law, request.stage) if request.reference is None else (law, request.stage, request.reference)
        parameters, self.put = fields.parameters(tree, request.runtime)
        units = ", ".join(dict.fromkeys(law.chain.units))
        given = [Field("q", (n,), about=f"joint values [{units}]")]
        if request.reference is None:
            given += [field for before, parts in targets(law.task) for field in _of_target(before, parts)]
        if timed or request.reference is not None:
            given += [Field("t", (), about="time [s]", value=0.0)]
        given += [Field("Ts", (), about="sampling time [s]")]
        self.groups = {"parameters": parameters, "input": given}
        self.outputs = [
            Field("q", (n,), about=f"joint values after the step [{units}]"),
            Field("qdot", (n,), about="joint velocities to send to the robot [rad/s, m/s]"),
            Field("e", (m,), about="error before the step [m, rad]"),
            Field("x", (m,), about="task coordinates before the step [m, rad]"),
            Field("residual", (), about="last change of an implicit stage [rad, m]"),
            Field("contraction", (), about="ratio of its last two changes"),
            Field("least", (), about="least singular value of the task Jacobian, an estimate from below [m or 1]"),
            Field("status", (), INT, "bits of the step's status"),
        ]

    def apart(self, flat):
        """(law, stage, reference, inputs by name, the rest) of flat arguments."""
        values = iter(flat)
        law, stage, *others = self.put([next(values) for _ in self.groups["parameters"]])
        inputs = {f.name: next(values) for f in self.groups["input"]}
        return law, stage, others[0] if others else _target(law, inputs), inputs, list(values)

    def advance(self, *flat):
        """Return the results of a step in the order of `outputs`."""
        law, stage, reference, inputs, _ = self.apart(flat)
        t = inputs.get("t", _start(self.request.dtype))
        made = one_step(law, reference, stage, self.request.method, inputs["q"], t, inputs["Ts"])
        return [getattr(made, f.name) for f in self.outputs]

    def grown(self, *flat):
        """The GROWING bit of a step from its errors at both ends, (2, m), at two times (2,)."""
        law, _, reference, _, (times, errors) = self.apart(flat)
        law, reference = cast((law, reference), self.request.dtype)
        return growing(law, reference, times, errors)[0]


def _start(dtype):
    """The time 0, at which no target has moved, whatever its velocity."""
    return of_the_model(jnp.zeros((), dtype))


def targets(task) -> list:
    """[(prefix of a target's arguments, its parts)]; the prefix is hands_ for a task named hands."""
    every = task.targets
    if len(every) == 1 and not task.tasks:
        return [("", every[0][1])]
    words = ["_".join(path) for path in task.target_names]
    return [(f"{word}_", parts) for word, (_, parts) in zip(fields.identifiers(words), every, strict=True)]


def _of_target(before, parts):
    """The arguments of a target: its place and its velocity."""
    to = getattr(parts.parts[0], "to", None)
    frame = f" in the frame of {to}" if to else ""
    of = (f" of {before[:-1]}" if before else " in the task's coordinates") + frame
    for part in parts.parts:
        if part.turns:
            about = f"desired rotation{of if before else frame}, row by row"
            yield Field(f"{before}rotation", (3, 3), about=about, value=np.eye(3))
        else:
            unit = ", ".join(dict.fromkeys(part.units))
            about = f"desired {place(part)}{of} [{unit}]"
            yield Field(before + place(part), part.shape, about=about)
    unit = ", ".join(f"{unit}/s" for unit in dict.fromkeys(parts.units))
    about = f"desired task velocity{of if before else frame} [{unit}]"
    yield Field(f"{before}velocity", (parts.width,), about=about, value=np.zeros(parts.width))


def place(part) -> str:
    return "rotation" if part.turns else "position" if hasattr(part, "axes") else "values"


def _target(law, inputs):
    """The targets from the arguments: their places and velocities."""
    named, t = iter(targets(law.task)), _start(inputs["q"].dtype)

    def one(_, parts):
        before, _ = next(named)
        given: dict = {"position": None, "rotation": None}
        for part in parts.parts:
            given["rotation" if part.turns else "position"] = inputs[before + place(part)]
        moving = tangent(Reference(curve=Hold(**given), feedforward=inputs[f"{before}velocity"]), parts, t)
        return replace(moving, feedforward=None)

    return of_each(one, None, law.task)


# --- the loop in time ---------------------------------------------------------------------------------


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

        def advance(k, carry):
            state, before = carry
            state, made = one(loop, state, k)
            both = {name: _OVER_TIME[name][0] if name in _OVER_TIME else lambda _, now: now for name in before}
            return state, {name: both[name](before[name], getattr(made, name)) for name in before}

        def zeros(f):
            dtype = request.dtype if f.kind == REAL else jnp.int32
            return jnp.full(f.shape, _OVER_TIME.get(f.name, (None, 0))[1], dtype)

        carry = start(loop, inputs["q"]), {name: zeros(f) for name, f in outputs.items() if name not in ("q", "e", "x")}
        state, found = jax.lax.fori_loop(0, steps, advance, carry)
        end = one(loop, state, steps)[1]  # a step of length 0, of which only the observation is used
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


# --- geometry alone -----------------------------------------------------------------------------------


def _of_chain(request) -> Routine:
    """Forward kinematics, or the Jacobian, of each tip."""
    chain, poses = request.law.chain, request.what == "fk"
    parameters, put = fields.parameters(chain, request.runtime)
    names = [tip.name for tip in chain.tips]
    before = [f"{word}_" for word in fields.identifiers(names, "tip")] if len(names) > 1 else [""]

    def fn(*flat):
        *values, q = flat
        chain = cast(modelled(put(values)), request.dtype)
        made = []
        for i in range(len(names)):
            at = frames(chain, q, i)
            made += [at.position, at.rotation] if poses else [jacobian_rows(chain, at, (0, 1, 2), (0, 1, 2))]
        return made

    outputs = []
    for name, own in zip(names, before, strict=True):
        of = f"of {name}" if own else "of the tip"
        rows = f"(v, w) = J qdot {of} in the base frame, row by row [m/s, rad/s]"
        place = Field(f"{own}position", (3,), about=f"{of} in the base frame [m]")
        turn = Field(f"{own}rotation", (3, 3), about=f"{of}, row by row")
        outputs += [place, turn] if poses else [Field(f"{own}jacobian", (6, chain.n), about=rows)]
    given = [Field("q", (chain.n,), about=f"joint values [{', '.join(dict.fromkeys(chain.units))}]")]
    groups = {"parameters": parameters, "input": given}
    return read_as(request, fn, groups, {"output": outputs})
