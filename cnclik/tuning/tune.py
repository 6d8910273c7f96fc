"""Tune: the gains of a loop by gradient, with what a robot tolerates as constraints.

A loss on the error alone would drive the gain to the edge of the allowed range, so the edge is part of the problem.
Along the path a step does not overshoot, even with one more sample of dead time; noise is not amplified beyond a bound;
and joint velocities keep their limits. During the descent eigenvalues are bounded by smooth functions; at the end they
are computed exactly, and the result contains them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.method import DEFAULT, MethodLike
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law
from cnclik.law.reference import Reference
from cnclik.precision import in_float64
from cnclik.record import Array, ArrayLike, Float, Number, record, replace
from cnclik.robot.chain import Chain
from cnclik.robot.model import frames, modelled
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import Descent, History, descend
from cnclik.tuning.objective import AT_ONCE, Judged, goal_of, judge, loop_objective
from cnclik.tuning.result import Tuned, result

FRONT = 5.0  # largest factor between the gains of the front and the tuned gain
NOTHING = 1e-13  # loss that is rounding
FALLBACK_Z = (0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)  # gains to fall back on


class Candidate(NamedTuple):
    """A point of the free numbers, and its performance."""

    u: np.ndarray  # (p,)
    judged: Judged


@in_float64
def tune(
    law: Law,
    reference: Reference | Sequence[Reference],
    q0: Float[ArrayLike, "*B n"],
    *,
    Ts: Number,
    N: int,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    descent: Descent = Descent(),
    progress: Callable | None = None,
    **goal: Any,
) -> Tuned:
    """Tune the gains of a loop by gradient: minimize a loss, without overshoot for one more sample of dead time.

    Joint velocities keep their limits. Computed in float64, whatever JAX's setting is.

    Args:
      law: where tuning starts. Its alpha is tuned in the shape that it has: a number, or one per axis (m,).
      reference: a path, or a list of B paths. q0: (n,) start [rad, m], or (B, n); the loss is the mean over them.
      Ts: sampling time [s]. N: number of steps; N·Ts is the horizon, even where Ts is tuned.
      method, stage: as for `solve`.
      descent: settings of the descent, see `Descent`.
      progress: called with (evaluations, evaluations in all, loss in words) after each round, or None.
      goal: over, bounds, loss, delay_margin, noise_gain, ringing, margin, velocity_limit, conditions, see `Goal`.
        Default: alpha, for the RMS error, without overshoot for one more sample of dead time, with a noise gain of at
        most 0.5, the robot's own velocity limits, and drives without delay.

    Returns: `Tuned`; it keeps every constraint, or states by how much it does not.
    Raises: ArgumentError for arguments that do not fit.
    """
    errors.kind("descent", descent, Descent, "be Descent(...)")
    objective = loop_objective(law, reference, q0, Ts=Ts, N=N, method=method, stage=stage, **goal)
    goal, parameters = goal_of(goal), objective.parameters
    given = dict(goal=goal, reference=reference, q0=q0, gradient=descent.gradient)
    own = tuple(p.start for p in parameters)
    fallbacks = _gains_over_z(objective)
    before, *judged = judge(objective, [own, *fallbacks])
    safe = min(range(len(judged)), key=lambda i: (judged[i].violation, i))  # keeps the constraints best
    if not np.isfinite(judged[safe].loss):
        values = _values(objective, pm.free_of(parameters, own))
        return _without_descent(objective, values, before, judge(objective, [values])[0], "non-finite", given)
    anchor, run = pm.free_of(parameters, fallbacks[safe]), judged[safe]
    objective = replace(objective, postures=run.postures, growths=run.growths)  # constrain along that run
    others = np.random.default_rng(int(goal.conditions.seed)).uniform(-4, 4, (descent.starts - 1, len(anchor)))
    begun = [_nearest_feasible(objective, u, anchor) for u in (pm.free_of(parameters, own), *others)]
    sizes = np.array([float(c.judged.loss) for c in begun])
    if sizes.max() < NOTHING and begun[0].judged.feasible:  # roundings prefer no gain: keep those given
        values, speed = _values(objective, begun[0].u), float(judged[0].speed)
        more = dict(front=_front(objective, values), path_speed=speed, starts=sizes)
        return _without_descent(objective, values, before, begun[0].judged, "nothing", given, **more)
    done = descend(
        objective,
        np.stack([c.u for c in begun]),
        1.0 / np.where(sizes > 0, sizes, 1.0),
        constraints=objective.constraints,
        descent=descent,
        progress=progress,
    )
    ends = _judged(objective, [*done.u, *done.best, anchor])
    chosen = _restored(objective, [*ends, *begun])
    losses = [float(c.judged.loss) if c.judged.feasible else np.inf for c in ends[:-1]]
    starts = np.reshape(losses, (2, descent.starts)).min(0)
    winner = int(np.argmin(starts)) if np.isfinite(starts).any() else 0
    values = _values(objective, chosen.u)
    return result(
        objective,
        values,
        before,
        chosen.judged,
        _front(objective, values),
        path_speed=float(judged[0].speed),
        status=done.why if chosen.judged.feasible else "infeasible",
        history={name: history[winner] for name, history in done.history._asdict().items()},
        starts=starts,
        evaluations=done.history.loss.size,
        **given,
    )


def _without_descent(objective, values, before, now, status, given, *, front=(), path_speed=np.inf, starts=(np.inf,)):
    """The result where no descent is of use: no gain has a finite run, or none has an error."""
    ended = dict(history={name: np.zeros(0) for name in History._fields}, starts=np.array(starts), evaluations=0)
    return result(objective, values, before, now, front, path_speed=path_speed, status=status, **ended, **given)


def _values(objective, u):
    return pm.known_values(objective.parameters, u)


def _bounded(p, value):
    return pm.known_values((p,), pm.free(p, value))[0]


def _judged(objective, points) -> list:
    return [*map(Candidate, points, judge(objective, [_values(objective, u) for u in points]))]


def _gains(objective) -> list:
    return [p for p in objective.parameters if pm.kind_of(p.name) in ("alpha", "schedule")]


def _gains_over_z(objective):
    """Values to fall back on: gains spread over z = alpha·Ts, all else unchanged (inside its bounds)."""
    start = {p.name: _bounded(p, p.start) for p in objective.parameters}
    even = {p.name: np.ones(np.shape(p.start)) for p in _gains(objective)}
    Ts = float(start.get("Ts", objective.loop.Ts))
    made = [
        start | {p.name: _bounded(p, z / Ts * even[p.name]) for p in _gains(objective)}
        for z in (FALLBACK_Z if even else (0.0,))
    ]
    return [tuple(values.values()) for values in made]


def _front(objective, values) -> list:
    """(values, `Judged`) of smaller and larger gains than the tuned one."""
    gains, tuned = _gains(objective), {p.name: v for p, v in zip(objective.parameters, values, strict=True)}
    sizes = np.geomspace(1 / FRONT, FRONT, AT_ONCE) if gains else ()
    made = [tuple((tuned | {p.name: _bounded(p, s * tuned[p.name]) for p in gains}).values()) for s in sizes]
    return list(zip(made, judge(objective, made), strict=True))


# --- candidates ---------------------------------------------------------------------------------------


def _between(objective, far, near, shares):
    """Candidates on the straight line from far (share 0) to near (1) in the free numbers."""
    return _judged(objective, [far + s * (near - far) for s in shares])


def _least_bad(candidates):
    return min(candidates, key=lambda c: c.judged.violation)


def _nearest_feasible(objective, u, anchor) -> Candidate:
    """The point nearest to u on the line to the anchor that keeps the constraints, or the least bad one."""
    line = _between(objective, u, anchor, np.linspace(0, 1, AT_ONCE))
    return next((c for c in line if c.judged.feasible), _least_bad(line))


def _restored(objective, candidates) -> Candidate:
    """The best of the candidates; one that ended just outside is first moved back to the boundary.

    It may then be better than all others.
    """
    feasible = [c for c in candidates if c.judged.feasible]
    if not feasible:
        return _least_bad(candidates)
    near = min(feasible, key=lambda c: c.judged.loss)
    beyond = [c for c in candidates if not c.judged.feasible and c.judged.loss < near.judged.loss]
    if not beyond:
        return near
    back = _boundary(objective, min(beyond, key=lambda c: c.judged.loss), near)
    return min(near, back, key=lambda c: c.judged.loss)


def _boundary(objective, far, near) -> Candidate:
    """The last point on the line from `near` (which keeps the constraints) towards `far` that keeps them."""
    low, high, last = 0.0, 1.0, near  # shares towards `near`
    for _ in range(3):
        shares = np.linspace(low, high, AT_ONCE)
        line = _between(objective, far.u, near.u, shares)
        i = next((i for i, c in enumerate(line) if c.judged.feasible), None)
        last = last if i is None else line[i]
        if not i:  # none keeps them, or the farthest one
            break
        low, high = shares[i - 1], shares[i]
    return last


# --- geometry from measured positions, with the same descent ------------------------------------------


@record
class PositionObjective:
    """Mean squared distance between measured positions and those of a chain built from the parameters' values."""

    parameters: tuple[pm.Parameter, ...]
    build: Callable[..., Chain]  # function of the values
    q: Float[Array, "K n"]
    measured: Float[Array, "K 3"]

    def __call__(self, values):
        chain = self.build(*values)
        found = jax.vmap(lambda q: frames(modelled(chain), q).position)(self.q)
        return jnp.mean(jnp.sum((found - self.measured) ** 2, axis=-1)), jnp.zeros((0,), found.dtype)


class Calibrated(NamedTuple):
    """Calibrated values, and RMS distances to the measured positions before and after [m]."""

    values: tuple[np.ndarray, ...]
    rms_before: float
    rms_after: float
    status: str
    history: np.ndarray


@in_float64
def calibrate(
    build: Callable[[Array], Chain],
    start: ArrayLike,
    q: Float[ArrayLike, "K n"],
    measured: Float[ArrayLike, "K 3"],
    *,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    descent: Descent = Descent(steps=200, rounds=4),
    progress: Callable | None = None,
) -> Calibrated:
    """Estimate geometry from measured positions of the tip; computed in float64, whatever JAX's setting is.

    Args:
      build: function (value) -> Chain, such as `planar_arm` of link lengths; must take traced arrays.
      start: nominal value, an array, such as link lengths [m].
      q: (K, n) joint values [rad, m]. measured: (K, 3) positions of the tip there [m].
      lower, upper: bounds; default: 0.5 below and above the start.
      descent, progress: as for `tune`; one start.
    Returns: `Calibrated`.
    Raises: ArgumentError for shapes that do not fit.
    """
    if errors.kind("descent", descent, Descent, "be Descent(...)").starts != 1:
        raise errors.fail("descent", "have one start, as what is nominal is one", f"has {descent.starts}")
    start = np.asarray(errors.array("start", start), float)
    if not start.size:
        raise errors.fail("start", "hold numbers", "is empty")
    if not callable(build):
        raise errors.fail("build", "be a function of the value", f"is {build!r}")
    n = errors.kind("build", build(jnp.asarray(start)), Chain, "return a Chain").n
    q = jnp.asarray(errors.array("q", q, (None, n)))
    measured = jnp.asarray(errors.array("measured", measured, (q.shape[0], 3)))
    lower, upper = (start + d if b is None else b for b, d in ((lower, -0.5), (upper, 0.5)))
    p = pm.parameter("geometry", start, lower, upper, build)
    objective = PositionObjective(parameters=(p,), build=build, q=q, measured=measured)
    before = float(jax.jit(objective)((jnp.asarray(start),))[0])
    if not np.isfinite(before):
        raise errors.fail("start", "give finite positions", "does not")
    scale = np.array([1.0 / before if before > 0 else 1.0])
    done = descend(
        objective, pm.free(p, start)[None], scale, constraints=0, descent=descent, tolerance=1e-9, progress=progress
    )
    values = tuple(np.asarray(v) for v in pm.values_of((p,), jnp.asarray(done.best[0])))
    rms = (before**0.5, float(done.best_loss[0]) ** 0.5)
    return Calibrated(values, *rms, done.why, np.sqrt(done.history.loss[0]))
