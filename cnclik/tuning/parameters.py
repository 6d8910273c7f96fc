"""Parameters: what of a law can be tuned, within which bounds, and where its value goes."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.law.law import Law, metric
from cnclik.record import record, replace
from cnclik.stability.gain import Gains
from cnclik.task.parts import Joints

RANGE = 1e3  # of the largest gain to the least, and of a damping to either side


@record
class Parameter:
    """A quantity of a loop that `tune` may change.

    Attributes:
      name: its name in results.
      start: where tuning starts, a number or an array.
      lower, upper: bounds of its entries.
      put: function (law, value) -> law with the value in it.
      unit: its unit.

    Raises: ArgumentError for bounds that leave no room.
    """

    name: str
    start: Any  # arrays, after the constructor
    lower: Any
    upper: Any
    put: Callable
    unit: str = "1"

    def __post_init__(self):
        start = np.asarray(errors.array(self.name, self.start), float)
        given = (errors.array(f"bounds of {self.name}", v, (), start.shape) for v in (self.lower, self.upper))
        lower, upper = (np.broadcast_to(np.asarray(v, float), start.shape) for v in given)
        if not np.all(lower < upper):
            raise errors.fail(f"bounds of {self.name}", "increase", f"are {lower.tolist()} and {upper.tolist()}")
        for name, value in (("start", start), ("lower", lower), ("upper", upper)):
            object.__setattr__(self, name, value)


def ends(parameters) -> list:
    """Return the lower bounds, the upper bounds and the starts of all parameters, each as one vector."""
    return [np.concatenate([getattr(p, name).ravel() for p in parameters]) for name in ("lower", "upper", "start")]


def split(parameters, values) -> list:
    """Return the value of each parameter from one vector of all."""
    ends = np.cumsum([p.start.size for p in parameters])
    return [values[end - p.start.size : end].reshape(p.start.shape) for p, end in zip(parameters, ends, strict=True)]


def put(law: Law, parameters, values) -> Law:
    """Return the law with the values of all parameters in it, which come as one vector."""
    for p, value in zip(parameters, split(parameters, values), strict=True):
        law = p.put(law, value)
    return law


def postures(law) -> list[str]:
    """Return the names of a stack's tasks of joint values that give way to tasks of other kinds.

    An error of theirs remains. In a loss it would be made small at the cost of the tasks that they give way to.
    """
    task, counts = law.task, np.asarray(metric(law))
    joints = [name for name, _ in task.each if all(isinstance(part, Joints) for part in task.alone(name).parts)]
    alone = len(joints) == len(task.each)
    return [name for name in joints if not alone and counts[task.of(name)].max() < counts.max()]


def chosen(over, law: Law, bounds: dict, gains: Gains) -> tuple[Parameter, ...]:
    """Return what is tuned. Args: over, bounds: as for `tune`. gains: bounds of alpha and posture_rate."""
    over = over if isinstance(over, (tuple, list)) else (over,)
    if not isinstance(bounds, dict):
        raise errors.fail("bounds", "be a table {name: (lower, upper)}", f"is {bounds!r}")
    each = [one for p in over for one in (_each(p, law) if isinstance(p, str) else (p,))]
    parameters = tuple(p if isinstance(p, Parameter) else named(p, law, bounds, gains) for p in each)
    names = [p.name for p in parameters]
    if not names or len(set(names)) < len(names):
        raise errors.fail("over", "name something to tune, each once", f"is {names}")
    free = dict.fromkeys(name for p in each if isinstance(p, str) for name in (p, p.rpartition(".")[2]))
    for name in bounds:
        if name in names and name not in free:
            raise errors.fail("bounds", "leave out a Parameter, which has its own", f"hold {name!r}")
        errors.one_of("bounds", name, free)
    return parameters


def named(name, law: Law, bounds: dict, gains: Gains) -> Parameter:
    """Return a parameter by name, which starts at the law's own value."""
    task, _, what = str(name).rpartition(".")
    if task and law.task.tasks:
        errors.one_of("over", task, [known for known, _ in law.task.tasks])
        errors.one_of("over", what, ("alpha",))
    else:
        task, what = None, errors.one_of("over", name, KNOWN)
    of, _, unit = KNOWN[what]
    start, *default = of(law, task) or (None,)
    if start is None:
        raise errors.fail("over", f"name {what} for a law that has it", "names it for another")
    pair = bounds.get(name, bounds.get(what, default or (gains.recommended / RANGE, gains.recommended)))
    if not isinstance(pair, (tuple, list)) or len(pair) != 2:
        raise errors.fail(f"bounds of {name}", "be (lower, upper)", f"are {pair!r}")
    if unit == "1/s" and not gains.recommended:
        raise errors.fail("drive", "allow a gain", gains.reason.removeprefix("no gain: "))
    parameter = Parameter(name=name, start=start, lower=pair[0], upper=pair[1], put=_putting(what, task), unit=unit)
    if unit == "1/s" and not (np.all(parameter.lower > 0) and np.all(parameter.upper <= gains.largest_stable)):
        must = f"be above 0, and at most the largest stable gain, {gains.largest_stable:.4g} 1/s"
        raise errors.fail(f"bounds of {name}", must, f"are {pair[0]} and {pair[1]}")
    return parameter


def _each(name, law) -> list[str]:
    """Return the names that a name stands for: where a stack has a gain for each task, those of all tasks but
    postures, and those of a gain of 0."""
    if name != "alpha" or not law.task.tasks or not np.ndim(law.alpha):
        return [name]
    acting = [task for task, _ in law.task.tasks if task not in postures(law)]
    return [f"{task}.alpha" for task in acting if np.any(_alpha(law, task)[0])] or [name]


def _alpha(law, task):
    alpha = np.asarray(law.alpha, float)
    alpha = alpha if task is None else np.broadcast_to(alpha, law.task.m)[law.task.of(task)]
    return (alpha.flat[0] if task and np.ptp(alpha) == 0 else alpha,)


def _with_alpha(law, task, value):
    if task is None:
        return {"alpha": value}
    return {"alpha": jnp.broadcast_to(jnp.asarray(law.alpha), law.task.m).at[law.task.of(task)].set(value)}


def _damping(law, _):
    size = getattr(law.inverse, "damping", None)
    return None if np.ndim(size) or size is None else (size, size / RANGE, size * RANGE)


KNOWN = {  # start and bounds (of a gain: start alone), what a value changes of the law, unit
    "alpha": (_alpha, _with_alpha, "1/s"),
    "posture_rate": (
        lambda law, _: law.null_velocity and (law.null_velocity.rate,),
        lambda law, _, v: {"null_velocity": replace(law.null_velocity, rate=v)},
        "1/s",
    ),
    "damping": (_damping, lambda law, _, v: {"inverse": replace(law.inverse, damping=v)}, "m or 1"),
    "feedforward": (lambda law, _: (law.feedforward, 0.0, 2.0), lambda law, _, v: {"feedforward": v}, "1"),
}


@functools.cache  # the same function for the same name: it is a key of programs
def _putting(what, task):
    return lambda law, value: replace(law, **KNOWN[what][1](law, task, value))
