"""Parameters of a loop that can be tuned, and the transforms that keep them inside their bounds.

An optimizer moves free numbers u. For any u their values stay within the bounds: numbers by a logistic function,
symmetric positive definite gains by one of their eigenvalues.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.law import inverse as inverses
from cnclik.law.law import Law, metric
from cnclik.law.null import ScaledNullVelocity
from cnclik.record import AnyArray, Float, record, replace
from cnclik.robot.fixed import Offset, scale
from cnclik.robot.mounted import with_tip
from cnclik.stability.spectrum import largest_rate
from cnclik.task.values import Joints

BOX, SPD = "box", "spd"
INSIDE = 1e-6  # fraction of the range by which a start on a bound moves inside, where derivatives are not 0


@record
class Parameter:
    """One thing to tune.

    Attributes:
      name: its name in results.
      kind: "box": every entry lies between `lower` and `upper`; "spd": a symmetric positive definite matrix whose
        eigenvalues do.
      start: where tuning starts; its shape is the parameter's.
      lower, upper: bounds, numbers or arrays of that shape.
      put: function (loop, value) -> loop with the value in it.
      unit: its unit.
    """

    name: str
    kind: str
    start: AnyArray
    lower: AnyArray
    upper: AnyArray
    put: Callable
    unit: str = "1"


def parameter(name, start, lower, upper, put, *, kind=BOX, unit="1") -> Parameter:
    """A checked `Parameter`. Raises: ArgumentError for bounds that leave no room."""
    start = np.asarray(errors.array(name, start, finite=False), float)
    shapes = ((), start.shape) if kind == BOX else ((),)
    lower, upper = (np.asarray(errors.array(f"bounds of {name}", v, *shapes), float) for v in (lower, upper))
    if not np.all(lower < upper):
        raise errors.fail(f"bounds of {name}", "increase", f"are {lower.tolist()} and {upper.tolist()}")
    if kind == BOX:
        lower, upper = np.broadcast_to(lower, start.shape), np.broadcast_to(upper, start.shape)
    return Parameter(name=name, kind=kind, start=start, lower=lower, upper=upper, put=put, unit=unit)


# --- transforms ---------------------------------------------------------------------------------------


def size(p: Parameter) -> int:
    """Number of free numbers of the parameter."""
    m = np.shape(p.start)[-1] if np.ndim(p.start) else 1
    return m * (m + 1) // 2 if p.kind == SPD else int(np.prod(np.shape(p.start), dtype=int))


def bounded(p: Parameter, u):
    """The value for the free numbers u (size,); within its bounds for every finite u.

    box: lower + (upper − lower)/(1 + exp(−u)). spd: lower I + (upper − lower)(I − (I + S)⁻¹) with S = LLᵀ and L lower
    triangular with diagonal exp(u/2): an eigenvalue s of S gives lower + (upper − lower) s/(1 + s).
    """
    if p.kind == BOX:
        value = p.lower + (p.upper - p.lower) * jax.nn.sigmoid(u.reshape(np.shape(p.start)))
        return jnp.clip(value, p.lower, p.upper)
    m = np.shape(p.start)[0]
    rows, columns = np.tril_indices(m)
    entries = jnp.where(rows == columns, jnp.exp(0.5 * jnp.clip(u, -60.0, 60.0)), u)
    factor = jnp.zeros((m, m), u.dtype).at[rows, columns].set(entries)
    left = jnp.linalg.inv(jnp.eye(m, dtype=u.dtype) + factor @ factor.T)
    share = jnp.eye(m, dtype=u.dtype) - 0.5 * (left + left.T)
    return p.lower * jnp.eye(m, dtype=u.dtype) + (p.upper - p.lower) * share


def free(p: Parameter, value):
    """The free numbers of a value, which is moved inside its bounds if necessary; the inverse of `bounded`."""
    value = np.nan_to_num(np.asarray(value, float), nan=1.0)
    if p.kind == BOX:
        share = np.clip((value - p.lower) / (p.upper - p.lower), INSIDE, 1 - INSIDE)
        return np.log(share / (1 - share)).ravel()
    eigenvalues, vectors = np.linalg.eigh(0.5 * (value + value.T))
    share = np.clip((eigenvalues - p.lower) / (p.upper - p.lower), INSIDE, 1 - INSIDE)
    factor = np.linalg.cholesky((vectors * (share / (1 - share))) @ vectors.T)
    m = len(share)
    u = np.where(np.eye(m, dtype=bool), 2 * np.log(np.where(np.eye(m, dtype=bool), factor, 1.0)), factor)
    return u[np.tril_indices(m)]


def values_of(parameters, u):
    """The parameters' values from one vector of all free numbers."""
    ends = np.cumsum([size(p) for p in parameters])
    return tuple(bounded(p, u[end - size(p) : end]) for p, end in zip(parameters, ends, strict=True))


def known_values(parameters, u):
    """`values_of` as NumPy arrays."""
    return tuple(map(np.asarray, _values_of(tuple(parameters), np.asarray(u))))


_values_of = bounded_jit(values_of)


def free_of(parameters, values):
    """Inverse of `values_of`."""
    return np.concatenate([free(p, v) for p, v in zip(parameters, values, strict=True)])


# --- a loop and what may be tuned in it ---------------------------------------------------------------


@record
class Adjustable:
    """The part of a loop that contains the parameters.

    Attributes:
      law: the right-hand side.
      Ts: sampling time [s].
      schedule: (K,) gains [1/s] at K instants evenly spread over the horizon, linear between them, to which the law's
        alpha is scaled (its largest rate); None: alpha is constant.
    """

    law: Law
    Ts: Float[AnyArray, ""]
    schedule: Float[AnyArray, " K"] | None = None


def put(loop: Adjustable, parameters, values) -> Adjustable:
    """The loop with all values set."""
    for p, value in zip(parameters, values, strict=True):
        loop = p.put(loop, value)
    return loop


def gain_per_step(loop: Adjustable) -> float:
    """z = alpha·Ts of the loop, for the largest |eigenvalue| of a gain matrix or the largest gain of a schedule."""
    if loop.schedule is not None:
        return float(np.max(loop.schedule)) * float(loop.Ts)
    return largest_rate(loop.law.alpha) * float(loop.Ts) if np.any(loop.law.alpha) else 0.0


def scheduled(loop: Adjustable, share):
    """The law with the schedule's alpha at a share 0 … 1 of the horizon."""
    if loop.schedule is None:
        return loop.law
    schedule = jnp.asarray(loop.schedule)
    rate = jnp.interp(share, jnp.linspace(0.0, 1.0, len(schedule), dtype=schedule.dtype), schedule)
    alpha = jnp.asarray(loop.law.alpha)
    size = jnp.max(jnp.abs(jnp.linalg.eigvalsh(alpha) if alpha.ndim == 2 else alpha))
    return replace(loop.law, alpha=alpha * (rate / size))


def scaled_links(chain, factors):
    """The chain with its links' offsets scaled by factors (n + 1,), before each joint and at the tip."""

    def stretch(offset, factor):
        return Offset(position=scale(factor, offset.position), rotation=offset.rotation)

    joints = tuple(replace(j, origin=stretch(j.origin, factors[i])) for i, j in enumerate(chain.joints))
    return with_tip(replace(chain, joints=joints), stretch(chain.tip, factors[len(joints)]))


# Start and default bounds of each name, as functions of (law, Ts, task); what a value changes of the law, as functions
# of (law, task, value); and its unit. The task is None, or one of a stack, as in "hands.alpha".


def even(values):
    """A task's values as one number if they are equal."""
    first = values.flat[0]
    return first if np.all(values == first * (np.eye(len(values)) if values.ndim == 2 else 1.0)) else values


def gain_of(law, task):
    alpha = np.asarray(law.alpha, float)
    return alpha if alpha.ndim == 0 or task is None else even(alpha[(law.task.of(task),) * alpha.ndim])


def _alpha(law, Ts, task=None):
    alpha = np.asarray(law.alpha, float)
    if alpha.ndim == 2 and not np.allclose(alpha, alpha.T):
        raise errors.fail("alpha", "be a symmetric matrix to be tuned", "is not symmetric")
    return gain_of(law, task), 1e-3 / Ts, 10.0 / Ts


def _with_alpha(law, task, value):
    if task is None:
        return {"alpha": value}
    alpha, at = jnp.asarray(law.alpha), law.task.of(task)
    alpha = alpha if alpha.ndim else jnp.full(law.task.m, alpha)
    own = value * jnp.eye(at.stop - at.start) if value.ndim < alpha.ndim == 2 else value
    return {"alpha": alpha.at[(at,) * alpha.ndim].set(own)}


def _level(law, task):
    if not isinstance(law.inverse, inverses.Levels):
        raise errors.fail("over", "name the damping of a task for a law with levels(...)", "names it for another")
    return next(i for i, names in enumerate(law.inverse.names) if task in names)


def _damping(law, Ts, task):
    """Of a level up to halfway (as a ratio) to the next level's: dampings define the order of levels."""
    if task is None:
        if not isinstance(law.inverse, inverses.Damped):
            must = "name damping for a law that has damped(...) alone"
            raise errors.fail("over", must, "names it for another inverse")
        return _around(float(law.inverse.damping))
    i, each = _level(law, task), [float(one.damping) for one in law.inverse.damping]
    start = each[i]
    below, above = (d for d in each if d < start), (d for d in each if d > start)
    return start, np.sqrt(start * max(below, default=start / 1e6)), np.sqrt(start * min(above, default=start * 1e6))


def _around(start):
    return start, start / 1e3, start * 1e3


def _with_damping(law, task, value):
    if task is None:
        return {"inverse": inverses.Damped(damping=value)}
    each, i = list(law.inverse.damping), _level(law, task)
    each[i] = replace(each[i], damping=value)
    return {"inverse": replace(law.inverse, damping=tuple(each))}


def _null_gain(law, Ts, task):
    if law.null_velocity is None:
        raise errors.fail("over", "name null_gain for a law with a null_velocity", "names it for one without")
    return 1.0, 0.0, 10.0


def _tool(law, Ts, task):
    start = np.array([float(v) for v in law.chain.tip.position])
    return start, start - 0.5, start + 0.5


def _with_tool(law, task, value):
    chain = law.chain
    return {"chain": with_tip(chain, Offset(position=tuple(value[i] for i in range(3)), rotation=chain.tip.rotation))}


def _weights(law, Ts, task):
    return _around(even(np.asarray(law.task.weight_of_each, float)[law.task.of(task)]))


def _with_weights(law, task, value):
    return {"task": replace(law.task, weights=jnp.asarray(law.task.weight_of_each).at[law.task.of(task)].set(value))}


_OF_TASK = {
    "alpha": (_alpha, _with_alpha, "1/s"),
    "damping": (_damping, _with_damping, "m or 1"),
    "weights": (_weights, _with_weights, "1"),
}
_KNOWN = {
    "alpha": _OF_TASK["alpha"],
    "damping": _OF_TASK["damping"],
    "null_gain": (_null_gain, lambda law, _, v: {"null_velocity": ScaledNullVelocity(law.null_velocity, v)}, "1"),
    "feedforward": (lambda law, *_: (float(law.feedforward), 0.0, 2.0), lambda law, _, v: {"feedforward": v}, "1"),
    "links": (
        lambda law, *_: (np.ones(len(law.chain.joints) + 1), 0.5, 2.0),
        lambda law, _, v: {"chain": scaled_links(law.chain, v)},
        "1",
    ),
    "tool": (_tool, _with_tool, "m"),
    "Ts": (lambda law, Ts, _: (Ts, Ts / 4, Ts * 4), None, "s"),
}
NAMES = tuple(_KNOWN)
_POSITIVE = ("alpha", "damping", "weights", "Ts")


@functools.cache  # the same function for the same name, as it is a key of programs
def _putting(what, task):
    change = (_OF_TASK if task else _KNOWN)[what][1]

    def put(loop, value):
        if change is None:
            return replace(loop, **{what: value})
        return replace(loop, law=replace(loop.law, **change(loop.law, task, value)))

    return put


def postures(law) -> list:
    """Names of a stack's tasks of joint values that count less than another task, beside tasks of other kinds.

    They give way, so an error remains, which in a loss would be made small at the cost of the tasks they give way to.
    """
    task, counts = law.task, np.asarray(metric(law))
    joints = {name for name, _ in task.each if all(isinstance(part, Joints) for part in task.alone(name).parts)}
    alone = len(joints) == len(task.each)
    return [] if alone else [name for name, at in task.each if name in joints and counts[at].max() < counts.max()]


def _of_stack(law) -> dict:
    """{name: the names of tasks' parameters it stands for}, one per task, or the first of each level; no `postures`,
    and no gains that are 0."""
    kept = postures(law)
    tasks = [name for name, _ in law.task.tasks if name not in kept]
    levels = isinstance(law.inverse, inverses.Levels)
    acts = [task for task in tasks if np.any(gain_of(law, task))] or tasks
    found = {what: [f"{task}.{what}" for task in some] for what, some in (("alpha", acts), ("weights", tasks)) if some}
    first = ([n for n in names if n not in kept][:1] for names in law.inverse.names) if levels else ()
    each = [f"{name}.damping" for found in first for name in found]
    return found | ({"damping": each} if levels else {})


def kind_of(name: str) -> str:
    """The kind of a parameter, whichever task it belongs to."""
    return name.rpartition(".")[2]


def named(name: str, loop: Adjustable, bounds=None) -> Parameter:
    """A parameter by name, starting at the loop's own value.

    alpha: the gain in the shape the law has it: a number, one per axis, or a symmetric positive definite matrix
    [1/s]. damping: λ of damped(λ).
    null_gain: factor of the null-space velocity. feedforward: factor of ẋ_d. links: factors (n + 1,) of the links'
    offsets, the tip's last. tool: offset (3,) of the tip in the last frame [m]. Ts: sampling time [s]. Of a task of a
    stack: hands.alpha; hands.damping, λ of its level; hands.weights, one number if they are equal.

    Args:
      bounds: (lower, upper), or None: z = alpha·Ts from 0.001 to 10, damping and Ts up to a factor 1000 and 4 around
        their start, factors from 0 to 2 (null_gain 10, links 0.5 to 2), the tool within 0.5 m.
    """
    task, what = str(name).rpartition(".")[0], kind_of(str(name))
    if task and loop.law.task.tasks:
        errors.one_of("over", task, [known for known, _ in loop.law.task.tasks])
        of, _, unit = _OF_TASK[errors.one_of("over", what, _OF_TASK)]
    else:
        (of, _, unit), what, task = _KNOWN[errors.one_of("over", name, NAMES)], name, None
    start, lower, upper = of(loop.law, float(loop.Ts), task)
    if bounds is not None:
        if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
            raise errors.fail(f"bounds of {name}", "be (lower, upper)", f"are {bounds!r}")
        lower, upper = bounds
    kind = SPD if what == "alpha" and np.ndim(start) == 2 else BOX
    made = parameter(name, start, lower, upper, _putting(what, task), kind=kind, unit=unit)
    if what in _POSITIVE and not np.all(made.lower > 0):
        raise errors.fail(f"bounds of {name}", "be positive", f"start at {lower}")
    return made


def chosen(over, loop: Adjustable, bounds) -> tuple:
    """The tuned parameters, given as names and `Parameter`s with bounds {name: (lower, upper)}.

    For a stack, "alpha", "damping" and "weights" stand for those of all its tasks but `postures`; a gain of 0 stays.
    """
    over = tuple(over) if isinstance(over, (tuple, list)) else (over,)
    if not over:
        raise errors.fail("over", "name something to tune", "is empty")
    every = _of_stack(loop.law)
    over = [one for p in over for one in (every.get(p, [p]) if isinstance(p, str) else [p])]
    made = tuple(
        p if isinstance(p, Parameter) else named(p, loop, bounds.get(p, bounds.get(kind_of(str(p))))) for p in over
    )
    names = [p.name for p in made]
    if len(set(names)) != len(names):
        raise errors.fail("over", "name each parameter once", f"is {names}")
    at = [_level(loop.law, name.partition(".")[0]) for name in names if name.endswith(".damping")]
    if len(set(at)) < len(at):
        raise errors.fail("over", "name the damping of a level once, by one of its tasks", f"is {names}")
    if {"links", "tool"} <= set(names):
        raise errors.fail("over", "name links (the tip's offset among them) or tool", "names both")
    for name in bounds:
        errors.one_of("bounds", name, [*names, *map(kind_of, names)])
    return made
