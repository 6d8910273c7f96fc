"""Reach, traced: a look at a posture with the damped step from it, and the tables that a search needs."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.routine import INT, Field, Routine
from cnclik.export.trace import Asked, read_as
from cnclik.reaching.seeds import SETS, SIZE, seeds
from cnclik.reaching.step import Search, iterate
from cnclik.reaching.units import in_units, of_joints
from cnclik.record import cast, replace
from cnclik.robot.chain import REVOLUTE
from cnclik.robot.model import modelled
from cnclik.robot.posture import arm_length

SEEDS = 64  # postures that are written into the source, by default
TOLERANCE = (1e-6, 1e-6)  # [m], [rad]
LEAST = 64.0  # roundings, that a tolerance is at least


class Reaching(NamedTuple):
    """What the C is written from."""

    look: Routine  # of the state of a search: look, and step on
    call: Routine  # what the exported function takes and gives, without a graph
    unit: float  # [m] of all lengths in the tables, and of the look
    own: tuple  # (n,) what a joint value there is multiplied with: the unit of joints that slide, 1 of others
    lower: np.ndarray  # (n,)
    upper: np.ndarray
    postures: np.ndarray  # (K, n) to start from
    tips: np.ndarray  # (K, p + 9) where they lead: what targets are compared with
    scale: float  # of a target's position, in `tips`
    turns: tuple  # joints that may go round, without a limit
    center: tuple  # what a target can be too far from: the first joint's place, in the task's coordinates; or none
    length: float  # of the stretched arm [m], and what rounding may add


def trace_reach(asked: Asked, count: int) -> Reaching:
    """The look and the tables. Raises: ArgumentError, `UnsupportedError` naming what has no C form."""
    errors.integer("seeds", count, at_least=1, at_most=SETS * SIZE)
    (chain, unit), task = in_units(asked.law.chain), replace(asked.law.task, weights=None)
    n, p, turned = chain.n, len(task.position), bool(task.orientation)
    found, rounds = seeds(chain), [joint.kind == REVOLUTE for joint in chain.joints]
    columns = [*task.linear, *(range(3, 12) if turned else ())]
    units, own = ", ".join(dict.fromkeys(chain.units)), of_joints(chain, unit)
    least = LEAST * np.finfo(asked.dtype).eps
    parameters = [
        Field("tolerance", (2,), about="of position [m] and orientation [rad]", value=np.maximum(TOLERANCE, least)),
        Field("tries", (), INT, about=f"postures to start from, at most, up to {count + 1}", value=count + 1),
    ]
    given = [Field("q", (n,), about=f"joint values to search from first, such as where the arm is [{units}]")]
    given += [Field("position", (p,), about="the target's, in the task's coordinates [m]")] * bool(p)
    given += [Field("rotation", (3, 3), about="the target's, row by row", value=np.eye(3))] * turned
    told = [
        Field("q", (n,), about=f"joint values of the answer, else of the nearest pose found [{units}]"),
        Field("position_error", (), about="[m]"),
        Field("orientation_error", (), about="[rad]"),
        Field("evaluations", (), INT, "looks at a posture that it took"),
        Field("status", (), INT, "how it went"),
    ]
    return Reaching(
        look=_look(asked, chain, task, parameters[:1], given[1:]),
        call=Routine({"parameters": parameters, "input": given, "history": []}, {"output": told}),
        unit=unit,
        own=own,
        lower=np.array(chain.lower, float),
        upper=np.array(chain.upper, float),
        postures=np.asarray(found.postures)[:count],
        tips=np.asarray(found.tips)[:count, columns],
        scale=found.scale,
        center=tuple(float(chain.joints[0].origin.position[i]) for i in task.linear if all(rounds)),
        length=(1 + least) * float(arm_length(chain)),
        turns=tuple(np.flatnonzero(np.array(chain.periodic) & np.isinf(chain.lower) & np.isinf(chain.upper)).tolist()),
    )


def _look(asked, chain, task, parameters, target) -> Routine:
    n = chain.n
    bounds = [Field("low", (n,)), Field("high", (n,))]
    state = [Field("q", (n,)), Field("best", (n,)), Field("squares", (2,))]
    state += [Field(name, ()) for name in ("cost", "steep", "trust", "looks")] + [Field("arrived", (), INT)]
    groups = {"parameters": parameters, "input": target, "bounds": bounds, "search": state}

    def one(tolerance, *flat):
        values = iter(flat)
        wanted = {f.name: next(values) for f in target}
        low, high = (next(values) for _ in bounds)
        *state, arrived = values
        position = jnp.zeros(3, asked.dtype)
        if task.position:
            position = position.at[np.array(task.linear)].set(wanted["position"])
        pose = position, wanted["rotation"] if task.orientation else jnp.eye(3, dtype=asked.dtype)
        of, at = cast(modelled(chain), asked.dtype), Search(*state, arrived != 0)
        made = iterate(of, task, at, pose, (low, high), tolerance, jnp.ones((), bool))
        return [*made[:-1], made.arrived.astype(jnp.int32)]

    return read_as(asked, one, groups, {"search": state})
