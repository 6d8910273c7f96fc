"""Tune: the gains of a loop by gradient, between bounds that its drives allow.

A loss on the error alone would drive a gain to the edge of stability, where a loop rings. So a gain is at most the one
that `gains` recommends for the drives, which is safe at any posture. Limits of joint speed are constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, drive_in_words
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import Law, check_loop, metric
from cnclik.law.paths import Reference
from cnclik.law.reference import References
from cnclik.precision import in_float64
from cnclik.record import AnyArray, ArrayLike, Float, Number, in_words, record, replace, stack
from cnclik.robot.rotations import safe_sqrt
from cnclik.stability.advice import Advice, advise
from cnclik.stability.gain import gains
from cnclik.tuning.descent import KEPT, Bounds, descend, evaluate
from cnclik.tuning.parameters import Parameter, chosen, ends, postures, put, split

AT_BOUND = 1e-3  # relative distance from a bound that is none
_STATUS = {
    "converged": "Converged: the loss no longer falls.",
    "steps": "Stopped after the given number of steps.",
    "nothing": "Nothing to tune by: there is no error. Give a path, another start, or noise.",
    "non-finite": "The run is not finite: look at the path, the start and the damping.",
    "infeasible": "No values were found that keep the limits of joint speed: make the path slower or smaller.",
}


def tracking(run: Trajectory):
    """Return the RMS of ‖e‖ [m, rad]. The initial error is given, and does not count."""
    return safe_sqrt(jnp.mean(jnp.sum(run.e[1:] ** 2, axis=-1)))


@record
class Tuned:
    """Answer of `tune`: `ck.solve(*tuned.loop, drive=tuned.drive)` runs it. Arrays are NumPy's, float64.

    Attributes:
      law: with the tuned values.
      loop: (law, reference, q0, Ts, N, method, stage) of the first path, as `solve` takes them.
      drive: as given, or as assumed.
      parameters: what was tuned, with bounds and units. values: {name: tuned value}.
      advice: `Advice` on the tuned law: its gains beside those that the drives allow.
      loss: name of the function that was minimized. losses: its values before and after.
      speeds: the largest |q̇| over its limit before and after; 0 without limits.
      before, after: `Trajectory` of the first path with the values as given and as tuned.
      status: "converged", "steps", "nothing" (there is no error), "infeasible" or "non-finite".
      evaluations: runs with their gradient.
    """

    law: Law
    loop: tuple
    drive: Drive
    parameters: tuple[Parameter, ...]
    values: dict[str, np.ndarray]
    advice: Advice
    loss: str
    losses: tuple[float, float]
    speeds: tuple[float, float]
    before: Trajectory
    after: Trajectory
    status: str
    evaluations: int

    @property
    def why(self) -> str:
        """The status in a sentence, with what else decides."""
        bound = [p.name for p in self.parameters if np.any(self.values[p.name] >= p.upper * (1 - AT_BOUND))]
        sentences = [_STATUS[self.status]]
        sentences += [f"At the upper bound: {', '.join(bound)}."] * bool(bound)
        sentences += [f"Above the recommended gain: {', '.join(self.advice.above)}."] * bool(self.advice.above)
        return " ".join(sentences)

    def __str__(self):
        lines, runs = [], (self.before, self.after)
        for p in self.parameters:
            unit = f" {p.unit}".removesuffix(" 1")
            lines.append(f"{p.name} = {in_words(self.values[p.name])}{unit} (from {in_words(p.start)})")
        pairs = {self.loss: self.losses}
        for name, _ in self.law.task.each:
            pairs[f"RMS error of {name}"] = tuple(np.sqrt(np.mean(np.sum(run[name].e[1:] ** 2, -1))) for run in runs)
        lines += [f"{name}: {before:.4g} -> {after:.4g}" for name, (before, after) in pairs.items()]
        if self.speeds[1]:
            lines.append("joint speed: {:.3g} % -> {:.3g} % of the limit".format(*100 * np.array(self.speeds)))
        assumed = ", assumed" * self.advice.gains.assumed
        lines.append(f"drives: {drive_in_words(self.drive, self.loop[3])}{assumed}")
        return "\n".join([*lines, *map(str, self.advice.rates), self.why])


@record
class Objective:
    """Loss, excess of joint speeds (n,) and runs (B, …) of a loop, as a function of the parameters' values."""

    law: Law
    parameters: tuple[Parameter, ...]
    scenarios: tuple  # reference, q0 and noise of each run, stacked
    Ts: Float[AnyArray, ""]
    how: tuple  # N, method, stage
    drive: Drive
    loss: Callable
    counts: Float[AnyArray, " m"] | None  # weight of each coordinate of a stack in the loss
    limits: Float[AnyArray, " n"]

    def __call__(self, values):
        law = put(self.law, self.parameters, values)

        def scenario(reference, q0, noise):
            run = solve(law, reference, q0, self.Ts, *self.how, drive=self.drive, noise=noise)
            counted = run if self.counts is None else replace(run, e=run.e * self.counts)
            return self.loss(counted), run

        loss, runs = jax.vmap(scenario)(*self.scenarios)
        return jnp.mean(loss), jnp.max(jnp.abs(runs.qdot), axis=(0, 1)) / self.limits - 1.0, runs


@in_float64
def tune(
    law: Law,
    reference: Reference | References | Sequence[Reference | References],
    q0: Float[ArrayLike, "*B n"],
    *,
    Ts: Number,
    N: int,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    over: str | Parameter | Sequence[str | Parameter] = "alpha",
    bounds: dict[str, tuple[ArrayLike, ArrayLike]] | None = None,
    loss: Callable[[Trajectory], Any] = tracking,
    drive: Drive | None = None,
    noise: Float[ArrayLike, "*B N m"] | None = None,
    velocity_limit: ArrayLike | None = None,
    steps: int = 100,
    optimizer: Any = None,
    progress: Callable | None = None,
) -> Tuned:
    """Tune a loop by the gradient of its run, in float64: minimize a loss, with gains that its drives allow anywhere.

    Args:
      law: where tuning starts. Its alpha is tuned in the form that it has: a number, one per axis (m,), or one for
        each task of a stack.
      reference: a path, or a list of B paths. q0: (n,) start [rad, m], or (B, n). The loss is the mean over them.
      Ts: sampling time [s]. N: number of steps. method, stage: as for `solve`.
      over: what is tuned: alpha, posture_rate, damping, feedforward, of a stack also hands.alpha; or your own
        `Parameter`s. Postures of a stack, tasks of joint values that give way, are tuned and count in the loss only if
        they are named.
      bounds: {name: (lower, upper)} in place of the defaults. Those of a gain end at the recommended one of
        `gains(Ts=, drive=, method=, M=)`; they may end at its largest stable one.
      loss: a function of the `Trajectory`; of a stack, its e is scaled by the weight of each coordinate over the
        damping of its level.
      drive: model of the drives, see `Drive`; None: unknown, as for `gains`. `Drive()`: ideal.
      noise: (N, m) added to the measured error at each step [m, rad], or (B, N, m); None: none.
      velocity_limit: joint speed that the run keeps [rad/s, m/s], a number or (n,); None: the robot's own limits,
        np.inf: none.
      steps: evaluations with gradient, at most.
      optimizer: an optax transformation; None: L-BFGS.
      progress: called with (evaluations, evaluations in all, words) as it goes on, or None.

    Returns: `Tuned`, with the runs before and after.
    Raises: ArgumentError for arguments that do not fit, and for drives that differ between joints where several gains
      are tuned: then no gain is safe at every posture.
    """
    references = reference if isinstance(reference, (list, tuple)) else [reference]
    check_loop(law, *references)
    errors.kind("progress", progress, (Callable, type(None)), "be a function or None")
    steps = errors.integer("steps", steps, at_least=3)
    loop: dict[str, Any] = {"Ts": Ts, "method": named(method), "drive": drive}
    allowed = gains(**loop | {"M": stage})
    parameters = chosen(over, law, {} if bounds is None else bounds, allowed)
    lower, upper, start = ends(parameters)
    apart = lower + np.linspace(0.4, 0.6, len(lower)) * (upper - lower)
    advise(put(law, parameters, apart), stage=stage, **loop)  # refuses several gains where joints' drives differ
    how = errors.integer("N", N, at_least=3), loop["method"], stage
    objective = objective_of(law, parameters, references, q0, Ts, how, loss, allowed.drive, noise, velocity_limit)
    within = Bounds(lower, upper)
    before = evaluate(objective, within, within.free(start))
    after, evaluations, status = descend(
        objective, within, within.within(before.u), optimizer=optimizer, steps=steps, progress=progress
    )
    values = np.clip(within.values(after.u), lower, upper)
    tuned = jax.tree.map(np.array, put(law, parameters, values))  # new arrays: these belong to float64, see `precision`
    first, q0 = jax.tree.map(np.array, references[0]), np.array(objective.scenarios[1][0])
    runs = [jax.tree.map(lambda x: np.array(np.asarray(x)[0]), point.seen) for point in (before, after)]
    return Tuned(
        law=tuned,
        loop=(tuned, first, q0, float(Ts), *how),
        drive=objective.drive,
        parameters=parameters,
        values=dict(zip([p.name for p in parameters], split(parameters, values), strict=True)),
        advice=advise(tuned, stage=stage, **loop),
        loss=getattr(loss, "__name__", "loss"),
        losses=(before.loss, after.loss),
        speeds=(before.excess + 1.0, after.excess + 1.0),
        before=runs[0],
        after=runs[1],
        status="infeasible" if KEPT < after.excess < np.inf else status,
        evaluations=evaluations,
    )


def objective_of(law, parameters, references, q0, Ts, how, loss, drive, noise=None, limit=None) -> Objective:
    """Return the objective of a loop. Args: how: (N, method, stage). limit: of joint speed. Others: as for `tune`."""
    (N, *_), n, m = how, law.chain.n, law.task.m
    q0 = np.atleast_2d(np.asarray(errors.array("q0", q0, (n,), (None, n)), float))
    if noise is not None:
        noise = np.asarray(errors.array("noise", noise, (N, m), (None, N, m)), float).reshape(-1, N, m)
    every = {"reference": references, "q0": q0, "noise": [None] if noise is None else noise}
    count = max(map(len, every.values()))
    for name, some in every.items():
        if len(some) not in (1, count):
            raise errors.fail(name, f"be one, or one for each of {count} runs", f"holds {len(some)}")
    try:
        scenarios = stack(tuple(some[i % len(some)] for some in every.values()) for i in range(count))
        jax.tree.map(jnp.asarray, scenarios)  # functions are none
    except (AttributeError, TypeError, ValueError):
        raise errors.fail("reference", "be paths of one kind, such as lines", "is of several") from None
    limit = law.chain.velocity_limit if limit is None else limit
    limits = np.asarray(errors.array("velocity_limit", limit, (), (n,), finite=False), float)
    if not np.all(limits > 0):
        raise errors.fail("velocity_limit", "be positive", f"is {limits.tolist()}")
    return Objective(
        law=law,
        parameters=parameters,
        scenarios=scenarios,
        Ts=np.asarray(float(Ts)),
        how=how,
        drive=check_drive(drive, law.chain),
        loss=errors.kind("loss", loss, Callable, "be a function of a Trajectory"),
        counts=_counts(law, parameters) if law.task.tasks else None,
        limits=np.broadcast_to(limits, (n,)),
    )


def _counts(law, parameters):
    counts, tuned = np.array(metric(law)), {p.name.partition(".")[0] for p in parameters}
    for name in set(postures(law)) - tuned:
        counts[law.task.of(name)] = 0.0
    return counts
