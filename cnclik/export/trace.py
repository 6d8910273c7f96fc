"""Trace: a step of the loop, or a robot's kinematics, as a graph with named arguments and results."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik.engine.routine import INT, Field, Routine, read
from cnclik.engine.tracing import of_the_model
from cnclik.export import fields
from cnclik.integrate.method import Method
from cnclik.integrate.solve import one_step
from cnclik.integrate.stage import Stage
from cnclik.law.law import Law
from cnclik.law.paths import Reference, Tangent
from cnclik.law.reference import References, of_each
from cnclik.record import cast
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, jacobian_at, modelled
from cnclik.task.parts import places


class Request(NamedTuple):
    """What is exported."""

    of: Law | Chain  # a law is exported as a step, a chain as its kinematics
    reference: Reference | References | None  # None: the target is an argument of the function
    method: Method
    stage: Stage
    dtype: np.dtype


def trace(request: Request) -> Routine:
    """Return the routine of a request. Raises: `UnsupportedError`, which names what has no C form."""
    return _kinematics(request) if isinstance(request.of, Chain) else _step(request)


# --- the step -----------------------------------------------------------------------------------------


def _step(request) -> Routine:
    law, dtype = request.of, request.dtype
    n, m = law.chain.n, law.task.m
    tree = (law, request.stage) if request.reference is None else (law, request.stage, request.reference)
    parameters, put = fields.parameters(tree)
    units = ", ".join(dict.fromkeys(law.chain.units))
    given = [Field("q", (n,), about=f"joint values [{units}]")]
    if request.reference is None:
        given += [field for before, parts in targets(law.task) for field in _of_target(before, parts)]
    else:
        given += [Field("t", (), about="time [s]", value=0.0)]
    given += [Field("Ts", (), about="sampling time [s]")]
    outputs = [
        Field("q", (n,), about=f"joint values after the step [{units}]"),
        Field("qdot", (n,), about="joint velocities to send to the robot [rad/s, m/s]"),
        Field("e", (m,), about="error before the step [m, rad]"),
        Field("x", (m,), about="task coordinates before the step [m, rad]"),
        Field("residual", (), about="last change of an implicit stage [rad, m]"),
        Field("contraction", (), about="ratio of its last two changes"),
        Field("least", (), about="least singular value of the task Jacobian, an estimate from below [m or 1]"),
        Field("status", (), INT, "bits of the step's status"),
    ]

    def step(*flat):
        values = iter(flat)
        law, stage, *others = put([next(values) for _ in parameters])
        inputs = {f.name: next(values) for f in given}
        reference = others[0] if others else _target(law, inputs)
        made = one_step(
            law, reference, stage, request.method, inputs["q"], inputs.get("t", _start(dtype)), inputs["Ts"]
        )
        return [getattr(made, f.name) for f in outputs]

    return read(step, {"parameters": parameters, "input": given}, {"output": outputs}, dtype=dtype)


def _start(dtype):
    """Return the time 0, at which no target has moved, whatever its velocity."""
    return of_the_model(jnp.zeros((), dtype))


def targets(task) -> list:
    """Return [(prefix of a target's arguments, its parts)]; the prefix is hands_ for a task named hands."""
    every = task.targets
    if len(every) == 1 and not task.tasks:
        return [("", every[0][1])]
    words = ["_".join(path) for path in task.target_names]
    return [(f"{word}_", parts) for word, (_, parts) in zip(fields.identifiers(words), every, strict=True)]


def _of_target(before, parts):
    """Yield the arguments of a target: its place and its velocity."""
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
            yield Field(before + place(part), (part.m,), about=about)
    unit = ", ".join(f"{unit}/s" for unit in dict.fromkeys(parts.units))
    about = f"desired task velocity{of if before else frame} [{unit}]"
    yield Field(f"{before}velocity", (parts.m,), about=about, value=np.zeros(parts.m))


def place(part) -> str:
    return "rotation" if part.turns else "position" if hasattr(part, "axes") else "values"


def _target(law, inputs):
    """Return the targets from the arguments: their places and velocities."""
    named, t = iter(targets(law.task)), _start(inputs["q"].dtype)

    def one(_, parts):
        before, _ = next(named)
        position = velocity = rotation = spin = None
        for part, where in zip(parts.parts, parts.slices, strict=True):
            aim, rate = inputs[before + place(part)], inputs[f"{before}velocity"][where]
            if part.turns:
                rotation, spin = aim, jnp.zeros(3, rate.dtype).at[places(part.axes)].set(rate)
            else:
                position, velocity = aim, rate
        return Reference(curve=Tangent(t=t, position=position, velocity=velocity, rotation=rotation, spin=spin))

    return of_each(one, None, law.task)


# --- kinematics ---------------------------------------------------------------------------------------


def _kinematics(request) -> Routine:
    """The pose and the Jacobian of each tip."""
    chain = request.of
    parameters, put = fields.parameters(chain)
    names = [tip.name for tip in chain.tips]
    before = [f"{word}_" for word in fields.identifiers(names, "tip")] if len(names) > 1 else [""]

    def kinematics(*flat):
        *values, q = flat
        chain, made = cast(modelled(put(values)), request.dtype), []
        for i in range(len(names)):
            at = frames(chain, q, i)
            made += [at.position, at.rotation, jacobian_at(chain, at)]
        return made

    outputs = []
    for name, prefix in zip(names, before, strict=True):
        of = f"of {name}" if prefix else "of the tip"
        rows = f"(v, w) = J qdot {of} in the base frame, row by row [m/s, rad/s]"
        outputs += [
            Field(f"{prefix}position", (3,), about=f"{of} in the base frame [m]"),
            Field(f"{prefix}rotation", (3, 3), about=f"{of}, row by row"),
            Field(f"{prefix}jacobian", (6, chain.n), about=rows),
        ]
    given = [Field("q", (chain.n,), about=f"joint values [{', '.join(dict.fromkeys(chain.units))}]")]
    return read(kinematics, {"parameters": parameters, "input": given}, {"output": outputs}, dtype=request.dtype)
