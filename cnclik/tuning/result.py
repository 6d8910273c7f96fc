"""Result of a tuning: a record, plain numbers for a file, and words."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import numpy as np

from cnclik.integrate.method import Method
from cnclik.integrate.stage import Stage
from cnclik.integrate.trajectory import Trajectory, truncate
from cnclik.law.law import Law
from cnclik.law.reference import Reference
from cnclik.measure.files import plain
from cnclik.record import Float, in_words, record
from cnclik.stability import rebased
from cnclik.tuning import parameters as pm
from cnclik.tuning.conditions import Conditions
from cnclik.tuning.controller import controller_lines
from cnclik.tuning.descent import gradient_mode
from cnclik.tuning.losses import in_words as loss_in_words
from cnclik.tuning.objective import CONSTRAINT_TOLERANCE, CONSTRAINTS, steps_to

_WHY = {
    "converged": "Converged: the loss no longer changes and every constraint is kept.",
    "steps": "Stopped after the given number of steps; every constraint is kept.",
    "stuck": "Stopped where no step descends; every constraint is kept.",
    "nothing": "Nothing to tune by: the loop begins at its targets and stays there. The values are those given, or the "
    "nearest that keep every constraint. Give a path, another target or start, or noise.",
    "infeasible": "No values were found that keep every constraint: none of them is for a robot.",
    "non-finite": "No gain within the bounds gives a finite run: look at the path, the start and the damping.",
}

MORE, LEAST = 0.01, 1e-6  # growth of a task's own error that is told: relative, and above rounding [m, rad]
AT_LIMIT = 0.01  # of a joint's velocity limit; a run this close to it is limited by it
_NEARLY_NO_GAIN = (
    "The gain is nearly zero: an error would not be removed within the whole path. Here the loss grows with it, as it "
    "does where a drive lags a fast target. Send the target ahead by the drive's lag, or bound alpha."
)
_TOO_FAST = (
    " The path itself takes {share:.3g} % of a joint's velocity limit, with nearly no gain. Make it slower or smaller. "
    "This run lasts {horizon:.3g} s; a path without a period of its own (--period) passes once in that time."
)
_HELD_BACK = (
    "The gain is nearly zero: an error would not be removed within the whole path. More would break the bound on "
    "joint velocities: give more steps or a slower path, begin nearer to it, or use limits=velocity_scaling()."
)
_LITTLE_GAIN = (
    "The gain, which was not tuned, is nearly zero: an error would not be removed within the whole path. Raise alpha, "
    "tune it too, or give more steps."
)


@record
class Performance:
    """Performance of a loop: the largest numbers along its runs. A value that could not be computed is inf.

    Attributes:
      loss: the minimized loss.
      radius: spectral radius in the task's directions at rest, delay included: the factor of a small error per step.
      null_radius: spectral radius in the null space of J; 1 if nothing acts there or if the null-space velocity
        leaves one posture for another, 0 without a null space.
      correction: share of a small error that one step removes, |1 − λ|: z for explicit Euler and exact J#.
      noise_gain: standard deviation of the motion per unit of white measurement noise, by linear theory.
      delay_margin: additional dead time that the loop tolerates, its null space included [samples]; inf for any.
      speed: |q̇| over its limit; 0 without limits.
      violation: relative amount by which the worst constraint is exceeded; at most 0 if all are kept.
      worst: name of this constraint.
      z: alpha·Ts, of the largest gain.
      errors: {"hand [m]": RMS error of this task of a stack in this unit}; {} of one task.
      run: `Trajectory` of the first scenario.
    """

    loss: float
    radius: float
    null_radius: float
    correction: float
    noise_gain: float
    delay_margin: float
    speed: float
    violation: float
    worst: str
    z: float
    errors: dict
    run: Trajectory


@record
class Tuned:
    """What a tuning found, and the loop it belongs to: `ck.solve(*found.loop)` runs it. Arrays are NumPy's, float64.

    Attributes:
      law, Ts: with the tuned values in them. schedule: gains over the horizon [1/s] where they were tuned, else None.
      reference, q0, N, method, stage: the rest of the loop; paths and starts as they were given. N: steps of the
        tuned Ts to the horizon.
      conditions: under which it was judged.
      parameters: what was tuned: `Parameter`s with name, start, lower, upper, unit. values: {name: tuned value}.
      kept: names of the postures of a stack, which were not named and do not count in the loss.
      loss: what was made small, in words.
      margin: bound of the spectral radius. ringing: whether the error was allowed to change its sign.
      front: {"z", "loss", "noise_gain", "delay_margin", "violation"}: (K,) what other gains
        cost, all else as tuned.
      path_speed: |q̇| over its limit with nearly no gain (z = 0.01), as the path alone requires.
      before, after: `Performance` as given and as tuned.
      status: "converged", "steps" (stopped at their number), "stuck", "nothing" (no loss), "infeasible" or
        "non-finite".
      history: {"loss", "violation", "accepted"}: (evaluations,) of the start that won.
      starts: (S,) loss each start ended with, inf where it kept no constraints.
      gradient: how derivatives were computed, in words.
      evaluations: runs with their gradient, all starts together.
    """

    law: Law
    reference: Reference | Sequence[Reference]
    q0: Float[np.ndarray, "*B n"]
    Ts: float
    N: int
    method: Method
    stage: Stage
    schedule: Float[np.ndarray, " K"] | None
    conditions: Conditions
    parameters: tuple[pm.Parameter, ...]
    values: dict[str, np.ndarray]
    kept: tuple[str, ...]
    loss: str
    margin: float
    ringing: bool
    front: dict[str, np.ndarray]
    path_speed: float
    before: Performance
    after: Performance
    status: str
    history: dict[str, np.ndarray]
    starts: Float[np.ndarray, " S"]
    gradient: str
    evaluations: int

    @property
    def loop(self) -> tuple:
        """(law, reference, q0, Ts, N, method, stage) of the first path, as `solve` takes them; no schedule in it."""
        reference = self.reference[0] if isinstance(self.reference, (list, tuple)) else self.reference
        return self.law, reference, np.atleast_2d(self.q0)[0], self.Ts, self.N, self.method, self.stage

    @property
    def satisfied(self) -> bool:
        """Whether all constraints are kept along the tuned run."""
        return bool(self.after.violation <= CONSTRAINT_TOLERANCE)

    @property
    def why(self) -> str:
        """The status in a sentence, with remarks if the result is hardly a loop or may run away, or a task pays."""
        astray, paid = rebased.astray(self.conditions.drive, self.Ts), ", ".join(self.paid)
        said = [self._how_it_ended, f"But {astray}." * bool(astray)]
        if paid:
            cause = f" (as given, {self.before.worst} is beyond its bound)" if self.before.violation > 0 else ""
            said.append(f"But there are larger errors than before{cause}: RMS of {paid}.")
        return " ".join(filter(None, said))

    @property
    def paid(self) -> list:
        """In words, the errors of a stack's tasks that are larger than before, but for kept postures."""
        return [
            f"{name} {before:.3g} -> {self.after.errors[name]:.3g}"
            for name, before in self.before.errors.items()
            if not self.after.errors[name] <= (1 + MORE) * before + LEAST and name.rpartition(" ")[0] not in self.kept
        ]

    @property
    def _how_it_ended(self) -> str:
        if self.status != "infeasible":
            tuned, at_limit = {"alpha", "schedule"} & {*map(pm.kind_of, self.values)}, self.after.speed > 1 - AT_LIMIT
            little = _LITTLE_GAIN if not tuned else _HELD_BACK if at_limit else _NEARLY_NO_GAIN
            return _WHY[self.status] + (f" {little}" if self.N * self.after.correction < 1 else "")
        worst = f"{self.after.worst} is exceeded by {100 * self.after.violation:.3g} %"
        cause = ""
        if self.after.worst == "joint velocity" and self.path_speed > 1:
            cause = _TOO_FAST.format(share=100 * self.path_speed, horizon=self.N * self.Ts)
        return f"{_WHY[self.status]} Worst, the bound on {worst}.{cause}"

    def of_tasks(self) -> list:
        """[(name, RMS error before and after)] of a stack's tasks, in words."""
        own = "; does not count in the loss unless {0}.alpha is named"
        return [
            (name, f"{before:.4g} -> {self.after.errors[name]:.4g}" + own.format(task) * (task in self.kept))
            for name, before in self.before.errors.items()
            for task in [name.rpartition(" ")[0]]
        ]

    def __str__(self):
        values = "; ".join(f"{p.name} = {in_words(self.values[p.name])}" + with_unit(p) for p in self.parameters)
        own = "".join(f"RMS of {name}: {said}\n" for name, said in self.of_tasks())
        return (
            f"{values}; z = {self.after.z:.4g}\n{own}"
            f"loss {self.before.loss:.4g} -> {self.after.loss:.4g}, spectral radius {self.after.radius:.4g} "
            f"(margin {self.margin:g}), constraints {kept_in_words(self)}\n{self.why}"
        )


def with_unit(parameter) -> str:
    """The unit as a suffix of a value."""
    return "" if parameter.unit == "1" else f" {parameter.unit}"


def kept_in_words(tuned) -> str:
    if tuned.satisfied:
        return "kept"
    return f"NOT kept, that on {tuned.after.worst} exceeded by {100 * tuned.after.violation:.3g} %"


def gradient_in_words(count, mode, method, stage) -> str:
    """The derivative of a tuning: its mode, the number of free numbers, and how implicit stages enter it.

    Args: count: free numbers. mode: "auto", "forward" or "reverse". method, stage: as for `solve`.
    """
    numbers = f"{count} free number{'' if count == 1 else 's'}"
    if not method.implicit:
        stages = "no implicit stages"
    elif getattr(stage, "implicit", False):
        stages = "stages by the implicit function theorem"
    else:
        stages = "stages pass by pass"
    return f"{gradient_mode(count, mode)} mode, {numbers}, {stages}"


FRONT = ("z", "loss", "noise_gain", "delay_margin", "violation")


def result(objective, values, before, after, others, *, goal, reference, q0, gradient, **ended) -> Tuned:
    """`Tuned` from the chosen values, one per parameter, and the judgements.

    Args: others: (values, `Judged`) for other gains. reference, q0, gradient: as given to `tune`. ended: path_speed,
      status, history, starts, evaluations of `Tuned`.
    """
    parameters = objective.parameters
    loop, own = (
        _copied(pm.put(objective.loop, parameters, [np.asarray(v) for v in some]))
        for some in (values, [p.start for p in parameters])
    )
    front = [_performance(objective, pm.put(objective.loop, parameters, some), judged) for some, judged in others]
    return Tuned(
        law=loop.law,
        reference=_copied(reference),
        q0=np.array(q0, float),
        Ts=float(loop.Ts),
        N=min(objective.N, steps_to(objective.horizon, loop.Ts)),
        method=objective.method,
        stage=objective.stage,
        schedule=loop.schedule,
        conditions=goal.conditions,
        parameters=parameters,
        values={p.name: v for p, v in zip(parameters, values, strict=True)},
        kept=objective.kept,
        loss=loss_in_words(goal.loss),
        margin=float(objective.margin),
        ringing=bool(goal.ringing),
        front={name: np.array([getattr(p, name) for p in front]) for name in FRONT},
        before=_performance(objective, own, before),
        after=_performance(objective, loop, after),
        gradient=gradient_in_words(sum(map(pm.size, parameters)), gradient, objective.method, objective.stage),
        **ended,
    )


def _copied(tree):
    """A copy with new arrays, as arrays used in a float64 computation must not be used in float32, see `precision`."""
    return jax.tree.map(np.array, tree)


def _performance(objective, loop, judged) -> Performance:
    return Performance(
        **{name: float(getattr(judged, name)) for name in ("loss", "radius", "null_radius", "correction", "speed")},
        **objective.costs(float(judged.correction), float(judged.null_share)),
        violation=judged.violation,
        worst=CONSTRAINTS[int(np.argmax(judged.excess))],
        z=pm.gain_per_step(loop),
        errors=dict(zip(objective.own_errors, judged.errors.tolist(), strict=True)),
        # With a tuned Ts the program runs as many steps as the smallest Ts needs: cut at the horizon.
        run=truncate(judged.run, min(objective.N, steps_to(objective.horizon, loop.Ts))),
    )


# --- files --------------------------------------------------------------------------------------------


_AS_THEY_ARE = (
    *("Ts", "N", "values", "kept", "loss", "margin", "ringing", "front", "conditions", "before", "after"),
    *("satisfied", "status", "why", "gradient", "evaluations", "starts"),
)


def to_json(tuned: Tuned, **about) -> dict:
    """The result as nested tables of plain numbers, lists and texts for `json`; infinite numbers become null.

    Args: about: more entries, such as config={...}.
    """
    made = {
        "alpha": tuned.law.alpha,
        "method": str(tuned.method),
        "stage": str(tuned.stage) if tuned.method.implicit else None,
        "start": {p.name: p.start for p in tuned.parameters},
        "bounds": {p.name: (p.lower, p.upper) for p in tuned.parameters},
        "units": {p.name: p.unit for p in tuned.parameters},
        **{name: getattr(tuned, name) for name in _AS_THEY_ARE},
        "lines": controller_lines(tuned),
        "history": {k: np.asarray(v).astype(float) for k, v in tuned.history.items()},
    }
    return plain(made | about)
