"""Objective: loss and constraints of a loop over its scenarios, as a function of the tuned values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.cache import bounded_jit
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import DEFAULT, Method
from cnclik.integrate.stage import Stage, picard
from cnclik.integrate.trajectory import Trajectory
from cnclik.law.law import check_loop, metric
from cnclik.precision import in_float64
from cnclik.record import AnyArray, Array, ArrayLike, Float, record, replace
from cnclik.stability.driven import delay_margin, increments, noise_gain, radius
from cnclik.stability.drives import each_drive
from cnclik.stability.linear import checked, first_above
from cnclik.stability.settings import MOST_Z
from cnclik.stability.spectrum import at_rest, growing, null_flow, staying
from cnclik.threads import after
from cnclik.tuning import linear
from cnclik.tuning import parameters as pm
from cnclik.tuning.conditions import Conditions, Scenario, rollout, scenarios
from cnclik.tuning.losses import View, terms

INTERVALS = 8  # along each path, at whose ends the spectral radius is computed
AT_ONCE = 16  # values judged at once, so that one program serves all
CONSTRAINT_TOLERANCE = 2**22 * np.finfo(float).eps  # relative excess of a constraint that counts as rounding
CONSTRAINTS = ("spectral radius", "overshoot", "null space", "joint velocity")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Goal:
    """The tuned parameters, the loss, and the constraints.

    Attributes:
      over: what is tuned: names of `parameters.named` (alpha, schedule, damping, posture_rate, feedforward, links,
        tool, Ts), or your own `parameters.Parameter`s. Of a stack, the postures (tasks of joint values that give way
        to others) are tuned, and count in the loss, only if they are named: "rest.alpha".
      bounds: {name: (lower, upper)} in place of the defaults.
      loss: a name of `losses.LOSSES`, {name: weight}, or a function of a `losses.View`.
      delay_margin: further dead time [samples] with which a step still must not overshoot. With A the one-step map of
        the error, |1 − λ(A)| ≤ d^d/(d + 1)^(d + 1) where that makes d samples: z ≤ 1/4 for explicit Euler and drives
        that follow at once.
      noise_gain: bound of the standard deviation of the motion per unit of white measurement noise.
      ringing: True drops both: only the loss is minimized, and the loop rings.
      margin: bound of the spectral radius of the loop at rest, at 9 postures along each path; the error then shrinks
        at least by this factor per step. 1, stable, by default; 0.9 for a loop that may ring.
      velocity_limit: (n,) [rad/s, m/s], one number for all joints, "chain": the robot's own, or None.
      conditions: noise, delay and model error it is judged under, see `Conditions`.
    """

    over: str | pm.Parameter | Sequence[str | pm.Parameter] = ("alpha",)
    bounds: dict[str, tuple[ArrayLike, ArrayLike]] | None = None
    loss: str | dict[str, float] | Callable[[View], Array] = "tracking"
    delay_margin: float = 1.0
    noise_gain: float = 0.5
    ringing: bool = False
    margin: float | None = None
    velocity_limit: ArrayLike | None = "chain"
    conditions: Conditions = dataclasses.field(default_factory=Conditions)

    def __post_init__(self):
        errors.number("delay_margin", self.delay_margin, at_least=0)
        errors.number("noise_gain", self.noise_gain, positive=True)
        object.__setattr__(self, "ringing", errors.truth("ringing", self.ringing))
        if self.margin is None:
            object.__setattr__(self, "margin", 0.9 if self.ringing else 1.0)
        if errors.number("margin", self.margin, positive=True) > 1:
            raise errors.fail("margin", "be at most 1", f"is {self.margin:g}")
        if not isinstance(self.bounds, (dict, type(None))):
            raise errors.fail("bounds", "be a table {name: (lower, upper)}", f"is {self.bounds!r}")
        errors.kind("conditions", self.conditions, Conditions, "be Conditions(...)")


class Judged(NamedTuple):
    """The performance for some values: largest numbers along the runs, as in `Performance`; inf if not finite."""

    loss: Float[np.ndarray, ""]
    radius: Float[np.ndarray, ""]
    null_radius: Float[np.ndarray, ""]
    correction: Float[np.ndarray, ""]
    null_share: Float[np.ndarray, ""]  # largest share of a motion in the null space that a step removes
    speed: Float[np.ndarray, ""]
    excess: Float[np.ndarray, " 4"]  # relative excess of each of CONSTRAINTS; −inf: it is not set
    postures: Float[np.ndarray, "BK n"]  # where the radii were computed
    growths: Float[np.ndarray, "BK n n"]  # projections on null-space motions that grow there by themselves
    errors: Float[np.ndarray, " k"]  # RMS over all runs, of each of `own_errors`
    run: Trajectory  # of the first scenario

    @property
    def violation(self) -> float:
        """Relative excess of the worst constraint; at most 0 if all are kept."""
        return float(np.max(self.excess))

    @property
    def feasible(self) -> bool:
        """Whether all constraints are kept, to rounding."""
        return bool(self.violation <= CONSTRAINT_TOLERANCE)


@record
class LoopObjective:
    """Loss and constraints of a loop over B scenarios, as a function of its parameters' values."""

    loop: pm.Adjustable
    parameters: tuple[pm.Parameter, ...]
    scenarios: Scenario  # with a leading axis B
    postures: Float[AnyArray, "BK n"]  # where the spectral radius is computed
    growths: Float[AnyArray, "BK n n"]  # null-space motions that grow there by themselves, see `growing`
    moments: Float[AnyArray, " BK"]  # shares of the horizon, for a gain schedule
    losses: tuple[tuple[Callable, AnyArray], ...]  # (function, weight) pairs
    margin: Float[AnyArray, ""]
    largest_correction: Float[AnyArray, ""]  # largest share of an error that a step may remove; inf: any
    largest_null_share: Float[AnyArray, ""]  # the same of a motion in the null space, to be stable through the drive
    limits: Float[AnyArray, " j"] | None  # joint velocity limits of the joints that have one
    joints: tuple[int, ...]
    horizon: Float[AnyArray, ""]
    tolerance: Float[AnyArray, ""]
    N: int
    drive: Drive  # if joints differ, each drive counts for all joints
    method: Method
    stage: Stage
    counts: Float[AnyArray, " m"] | None  # weight of each coordinate of a stack in the loss, from the original law; 0
    #                                       of postures that were not named
    contracts: bool  # whether the margin is stricter than the bound on corrections

    @property
    def moves_null_space(self) -> bool:
        return self.loop.law.null_velocity is not None

    @property
    def constraints(self) -> int:
        """The number of constraints, known without tracing."""
        null = self.moves_null_space * (1 + (not self.drive.prompt))
        kinds = 1 + self.contracts * len(each_drive(self.drive)) + null
        return kinds * len(self.postures) + len(self.joints)

    def costs(self, correction: float, null_share: float) -> dict:
        """Noise gain and delay margin of a loop that removes these shares of an error and of a motion in the null
        space, by linear theory."""
        unknown = dict(noise_gain=np.inf, delay_margin=0.0)
        if not 0 < correction < np.inf:
            return unknown
        modes = [np.array([[-share]]) for share in (correction, null_share) if share > 0]
        drives, Ts = each_drive(self.drive), float(self.loop.Ts)
        if max(radius(steps[None], drive, Ts)[0] for steps in modes for drive in drives) >= 1:
            return unknown
        return dict(
            noise_gain=max(noise_gain(modes[0], drive, Ts)[0] for drive in drives),
            delay_margin=min(delay_margin(steps, drive, Ts) for steps in modes for drive in drives),
        )

    def _runs(self, loop):
        def run(scenario):
            return rollout(loop, scenario, self.N, self.method, self.stage, drive=self.drive)

        return jax.vmap(run)(self.scenarios)

    def _along(self, of, loop, postures):
        """of(law, q) at postures (B·K, n), with the gain of the schedule there."""
        return jax.vmap(lambda q, moment: of(pm.scheduled(loop, moment), q))(postures, self.moments)

    def _maps(self, loop, postures):
        """See `maps_at_rest`: (B·K, m, m), (B·K, n, n), (B·K, m, m), (B·K, n, n)."""
        return self._along(lambda law, q: linear.maps_at_rest(law, q, loop.Ts, self.method, self.stage), loop, postures)

    @property
    def own_errors(self) -> dict:
        """{"hand [m]": its coordinates}: of a stack those of each task in each of its units."""
        task, units = self.loop.law.task, np.array(self.loop.law.task.units)
        of = np.arange(task.m)
        every = [(name, unit, of[at][units[at] == unit]) for name, at in task.each for unit in dict.fromkeys(units[at])]
        return {f"{name} [{unit}]": own for name, unit, own in every}

    @property
    def kept(self) -> tuple:
        """Names of the postures of a stack that do not count in the loss."""
        return tuple(name for name, at in self.loop.law.task.each if not np.asarray(self.counts)[at].any())

    def _shares(self, loop, runs):
        """Share of the horizon (N,) of each step."""
        steps = jnp.arange(self.N, dtype=runs.q.dtype)
        weight = jnp.clip((self.horizon - steps * loop.Ts) / loop.Ts, 0.0, 1.0)
        return weight / jnp.sum(weight)

    def _loss(self, loop, runs, maps):
        weight = self._shares(loop, runs)
        if self.counts is not None:
            runs = replace(runs, e=runs.e * self.counts)

        def of_run(run, maps):
            view = View(run, weight, loop.Ts, self.horizon, self.tolerance, maps)
            return sum(w * fn(view) for fn, w in self.losses)

        return jnp.mean(jax.vmap(of_run)(runs, maps.reshape(len(runs.q), -1, *maps.shape[1:])))

    def _speed(self, runs):
        """Largest |q̇| over its limit, for each joint that has one (j,)."""
        largest = jnp.max(jnp.abs(runs.qdot[..., jnp.array(self.joints, int)]), axis=(0, 1))
        return largest / self.limits

    def __call__(self, values):
        """(loss, constraints (c,)), smooth: relative excess of each constraint at each posture, or for each joint."""
        loop = pm.put(self.loop, self.parameters, values)
        runs = self._runs(loop)
        maps, across, taken, null_taken = self._maps(loop, after(jnp.asarray(self.postures), runs.q))
        correction = jax.vmap(linear.radius_estimate)(taken)
        constraints = [correction / self.largest_correction - 1.0]
        if self.contracts:
            for drive in each_drive(self.drive):
                radius = jax.vmap(linear.radius_bound)(linear.driven_map(maps, drive, self.loop.Ts))
                constraints.append(radius / self.margin - 1.0)
        if self.moves_null_space:
            growths = jnp.asarray(self.growths)
            constraints.append(jax.vmap(linear.radius_estimate)(staying(across, growths)) - 1.0)
            if not self.drive.prompt:  # motions that do not oscillate by themselves, to a thousandth; `judged` has all
                removed = jax.vmap(linear.radius_bound)(null_taken - growths @ null_taken @ growths)
                constraints.append(removed / self.largest_null_share - 1.0)
        if self.joints:
            constraints.append(self._speed(runs) - 1.0)
        return self._loss(loop, runs, maps), jnp.concatenate(constraints)

    def observe(self, values) -> dict:
        """The input of `judged`: the runs with these values, along which the maps are taken. Pure."""
        loop = pm.put(self.loop, self.parameters, values)
        runs = self._runs(loop)
        moments = jnp.linspace(0, 1, INTERVALS + 1)
        k = jnp.clip(jnp.round(moments * self.horizon / loop.Ts).astype(int), 0, self.N)
        postures = runs.q[:, k].reshape(-1, runs.q.shape[-1])
        maps, across, taken, _ = self._maps(loop, postures)
        squares = self._shares(loop, runs) @ jnp.mean(runs.e[:, 1:] ** 2, 0)
        return {
            "loss": self._loss(loop, runs, maps),
            "errors": jnp.array([jnp.sqrt(jnp.sum(squares[own])) for own in self.own_errors.values()]),
            "finite": jnp.all(jnp.isfinite(runs.q)),
            "maps": maps,
            "across": across,
            "taken": taken,
            "flows": self._along(_flow, loop, postures) if self.moves_null_space else None,
            "speed": jnp.max(self._speed(runs)) if self.joints else jnp.zeros((), runs.q.dtype),
            "postures": postures,
            "run": jax.tree.map(lambda x: x[0], runs),
        }

    def judged(self, seen: dict) -> Judged:
        """`Judged` for many results of `observe`, NumPy arrays with a leading axis.

        The eigenvalues are computed by NumPy, as LAPACK's threads wait for each other in two batches of one compiled
        program.
        """
        maps = seen["maps"]
        finite = np.isfinite(seen["loss"]) & seen["finite"]

        def known(value):
            return np.where(finite & np.isfinite(value), value, np.inf)

        across, growths = seen["across"], np.zeros_like(seen["across"])
        if seen["flows"] is not None:
            flows, rows = (v.reshape(-1, *v.shape[-2:]) for v in seen["flows"])
            growths = np.reshape([*map(growing, flows, rows)], across.shape)
            across = staying(across, growths)
        driven = [linear.driven_map(maps, drive, float(self.loop.Ts)) for drive in each_drive(self.drive)]
        task_radius = known(np.max([*map(linear.measured_radius, driven)], axis=0))
        null_radius, correction = (known(linear.measured_radius(v)) for v in (across, seen["taken"]))
        null, drives = linear.null_steps(across, maps.shape[-1])[..., None], each_drive(self.drive)
        if self.moves_null_space and not self.drive.prompt:
            through = [radius(null, drive, float(self.loop.Ts)).max(-1) for drive in drives]
            null_radius = known(np.max(through, axis=0))
        null_share = self.moves_null_space * np.max(-null.real, axis=(-3, -2, -1), initial=0.0)
        speed = known(seen["speed"])
        with np.errstate(divide="ignore", invalid="ignore"):  # an unstable loop has no allowed correction
            ratios = (task_radius / self.margin, correction / self.largest_correction, null_radius, speed)
        is_set = [True, float(self.largest_correction) < np.inf, self.moves_null_space, bool(self.joints)]
        excess = np.where(is_set, np.stack(ratios, -1) - 1.0, -np.inf)
        size = known(seen["loss"]), task_radius, null_radius, correction, null_share, speed
        return Judged(*size, excess, seen["postures"], growths, seen["errors"], seen["run"])


def _flow(law, q):
    return null_flow(*at_rest(law, None, q), q)


@bounded_jit
def _observed(objective, values):
    return jax.vmap(objective.observe)(values)


@in_float64
def judge(objective, many, *, together: int = AT_ONCE) -> list:
    """`Judged` for each of many values (tuples, one entry per parameter), with NumPy arrays. In float64.

    Args: together: how many are judged at once; fewer are padded, so that one program serves all.
    """
    found = []
    for i in range(0, len(many), together):
        part = many[i : i + together]
        padded = [*part, *[part[-1]] * (together - len(part))]
        lanes = tuple(np.stack([v[j] for v in padded]) for j in range(len(objective.parameters)))
        made = objective.judged(jax.tree.map(np.asarray, _observed(objective, lanes)))
        found += [jax.tree.map(lambda x, j=j: x[j], made) for j in range(len(part))]
    return found


def goal_of(given: dict) -> Goal:
    """The goal of these arguments. Raises: ArgumentError for a name that is none."""
    for name in given:
        errors.one_of("goal", name, [field.name for field in dataclasses.fields(Goal)])
    return Goal(**given)


@in_float64
def loop_objective(law, reference, q0, *, Ts, N, method=DEFAULT, stage=picard(5), **goal) -> LoopObjective:
    """The objective of `tune`, to judge values found in other ways. In float64. Args: as for `tune`."""
    check_loop(law)
    goal = goal_of(goal)
    assert goal.margin is not None  # `Goal` has set it
    method, stage = checked(method, stage)
    errors.number("Ts", Ts, positive=True)
    N = errors.integer("N", N, at_least=2)
    loop = pm.Adjustable(law=law, Ts=np.asarray(float(Ts)))
    drive = check_drive(goal.conditions.drive, law.chain)
    most = np.inf if goal.ringing else linear.largest_share(drive, float(Ts), goal.delay_margin, goal.noise_gain)
    parameters = pm.chosen(goal.over, loop, goal.bounds or {})
    tuned = {p.name.partition(".")[0] for p in parameters}
    kept, counts = [name for name in pm.postures(law) if name not in tuned], np.array(metric(law))
    for name in kept:
        counts[law.task.of(name)] = 0.0
    parameters += tuple(_moved(loop, kept, 0.0 if goal.margin < 1 else most, method, stage))
    shortest = next((float(p.lower) for p in parameters if p.name == "Ts"), float(Ts))
    horizon = N * float(Ts)
    longest = steps_to(horizon, shortest)
    runs = scenarios(law, reference, q0, longest, goal.conditions)
    joints, limits = _limits(law.chain, goal.velocity_limit)
    if drive.order and any(p.name == "Ts" for p in parameters):
        raise errors.fail("over", "not hold Ts where the drive has a lag", "holds it")
    return LoopObjective(
        loop=loop,
        parameters=parameters,
        scenarios=runs,
        postures=np.repeat(runs.q0, INTERVALS + 1, axis=0),
        growths=np.zeros((len(runs.q0) * (INTERVALS + 1), law.chain.n, law.chain.n)),
        moments=np.tile(np.linspace(0, 1, INTERVALS + 1), len(runs.q0)),
        losses=tuple((fn, np.asarray(w)) for fn, w in terms(goal.loss)),
        margin=np.asarray(float(goal.margin)),
        largest_correction=np.asarray(most),
        largest_null_share=np.asarray(max(linear.largest_null_share(drive, float(Ts)), 1e-9)),
        limits=limits,
        joints=joints,
        horizon=np.asarray(horizon),
        tolerance=np.asarray(float(goal.conditions.tolerance)),
        N=longest,
        drive=drive,
        method=method,
        stage=stage,
        counts=counts if law.task.tasks else None,
        contracts=goal.ringing or goal.margin < 1,
    )


def _moved(loop, kept, most, method, stage):
    """Gains of kept postures that break the constraints, each from just below the largest that one step tolerates to
    its own; where the margin forbids slow ones (most = 0) all, within the usual bounds."""
    z = first_above(lambda z: np.abs(increments(method, stage, z).sum(-1)), min(most, 2.0), 4 * MOST_Z, 512)
    for name in kept:
        own = pm.gain_of(loop.law, name)
        if z == 0:
            yield pm.named(f"{name}.alpha", loop)
        elif np.ndim(own) < 2 and np.all(own > 0) and np.max(own) > z / loop.Ts:
            yield pm.named(f"{name}.alpha", loop, (np.minimum(own, 0.99 * z / loop.Ts) * (1 - 1e-6), own))


def steps_to(horizon, Ts) -> int:
    """Steps of Ts that reach the horizon, the last one perhaps beyond it."""
    return int(np.ceil(float(horizon) / float(Ts) - 1e-9))


def _limits(chain, velocity_limit):
    if velocity_limit is None:
        return (), None
    if isinstance(velocity_limit, str):
        errors.one_of("velocity_limit", velocity_limit, ("chain",))
        velocity_limit = chain.velocity_limit
    limits = errors.array("velocity_limit", velocity_limit, (), (chain.n,), finite=False)
    limits = np.broadcast_to(np.asarray(limits, float), (chain.n,))
    if not np.all(limits > 0):
        raise errors.fail("velocity_limit", "be positive", f"is {limits.tolist()}")
    joints = tuple(int(i) for i in np.flatnonzero(np.isfinite(limits)))
    return joints, (limits[list(joints)] if joints else None)
