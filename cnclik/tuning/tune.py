"""tune: the gains of a loop by gradient, with stability as a constraint.

A loss on the error alone drives the gain to the edge of stability, so the edge is part of the problem: along the path
the spectral radius of the loop stays at or below `margin`, and joint velocities within their limits. While it descends,
the radius is bounded from above by a smooth function; at the end it is measured, and the result says what it found.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.hints import quick_jit
from cnclik.integrate.method import CN
from cnclik.integrate.stage import picard
from cnclik.integrate.trajectory import truncate
from cnclik.law import reference as ref
from cnclik.law.law import Law
from cnclik.record import record, replace, stack
from cnclik.robot.kinematics import as_joint_values
from cnclik.stability.linear import named
from cnclik.stability.spectrum import at_rest, largest_rate, one_step
from cnclik.tuning import parameters as pm
from cnclik.tuning.descent import descend, gradient_mode
from cnclik.tuning.losses import View, terms
from cnclik.tuning.rollout import Scenario, noise_of, perturbed, rollout, scheduled

POSTURES = 8  # along each path, plus its end: where the spectral radius is asked for
_KEPT = 1e-9  # a constraint exceeded by less, relatively, is kept: rounding


# --- spectral radius, smoothly and exactly ------------------------------------------------------------


def radius_bound(matrix, squarings: int = 10):
    """A smooth upper bound of the spectral radius, ‖A^p‖^(1/p) with p = 2^squarings (Gelfand 1941).

    In the Frobenius norm: at most a factor m^(1/2p) above it for normal matrices (0.09 % for m = 6). Eigenvalues
    themselves have no derivative where they coincide, as all do for exact J# and one gain.
    """

    def size(a):
        squared = jnp.sum(a * a)
        zero = squared == 0
        return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))

    def one(carry, share):
        a, log, dead = carry
        s = size(a)
        dead = dead | (s == 0)
        s = jnp.where(s == 0, 1.0, s)
        a = a / s
        return (a @ a, log + share * jnp.log(s), dead), None

    shares = 0.5 ** jnp.arange(squarings, dtype=matrix.dtype)
    start = (matrix, jnp.zeros((), matrix.dtype), jnp.zeros((), bool))
    (a, log, dead), _ = jax.lax.scan(one, start, shares)
    s = size(a)
    dead = dead | (s == 0)
    return jnp.where(dead, 0.0, jnp.exp(log + jnp.log(jnp.where(s == 0, 1.0, s)) * 0.5**squarings))


def _measured(matrix):
    """Spectral radius by eigenvalues; inf where the matrix is not finite. No derivative."""
    finite = jnp.all(jnp.isfinite(matrix))
    values = jnp.linalg.eigvals(jnp.where(finite, matrix, 0.0))
    return jnp.where(finite, jnp.max(jnp.abs(values)), jnp.inf)


def _delayed(a, delay):
    """The step of a loop that acts on the error `delay` samples ago: e[k+1] = e[k] + (A − I) e[k−d], as one matrix."""
    if delay == 0:
        return a
    m = a.shape[0]
    eye = jnp.eye(m, dtype=a.dtype)
    top = [eye, *[jnp.zeros_like(a)] * (delay - 1), a - eye]
    rows = [jnp.concatenate(top, axis=1)]
    for i in range(delay):
        rows.append(jnp.concatenate([eye if j == i else jnp.zeros_like(a) for j in range(delay + 1)], axis=1))
    return jnp.concatenate(rows)


# --- the objective ------------------------------------------------------------------------------------


class Judged(NamedTuple):
    """What values lead to."""

    loss: jax.Array
    radius: jax.Array  # largest spectral radius measured along the runs
    speed: jax.Array  # largest |q̇| over its limit
    postures: jax.Array  # (B·K, n) where the radius was measured
    run: object  # `Trajectory` of the first scenario


@record
class LoopObjective:
    """Loss and constraints of a loop over B scenarios, as a function of its parameters' values."""

    loop: object
    parameters: tuple
    scenarios: object  # `Scenario` with a leading axis B
    postures: object  # (B·K, n) where the spectral radius is asked for
    moments: object  # (B·K,) of the horizon, for a gain schedule
    losses: tuple  # (function, weight) pairs
    margin: object
    limits: object  # (j,) joint velocity limits, and which joints have them
    joints: tuple
    horizon: object
    tolerance: object
    N: int
    delay: int
    method: object
    stage: object

    def _runs(self, loop):
        run = functools.partial(
            rollout, N=self.N, method=self.method, stage=self.stage, delay=self.delay, horizon=self.horizon
        )
        return jax.vmap(lambda scenario: run(loop, scenario))(self.scenarios)

    def _maps(self, loop, postures):
        """One-step maps of the error at rest (B·K, m, m), and what a null-space velocity does (B·K, n, n) or None."""
        moves = callable(loop.law.null_velocity)

        def one(q, moment):
            law = scheduled(loop, moment)
            moved, rows = one_step(law, at_rest(law, None, q), q, loop.Ts, self.method, self.stage)
            m, n = rows.shape
            inverse = jnp.linalg.pinv(rows)
            task = jnp.eye(m, dtype=q.dtype) + rows @ (moved - jnp.eye(n, dtype=q.dtype)) @ inverse
            if not moves:
                return task, None
            across = jnp.eye(n, dtype=q.dtype) - inverse @ rows
            return task, across @ moved @ across

        return jax.vmap(one)(postures, self.moments)

    def _loss(self, loop, runs, maps):
        steps = jnp.arange(self.N, dtype=runs.q.dtype)
        weight = jnp.clip((self.horizon - steps * loop.Ts) / loop.Ts, 0.0, 1.0)
        weight = weight / jnp.sum(weight)
        lanes = runs.q.shape[0]
        maps = maps.reshape(lanes, -1, *maps.shape[1:])

        def one(run, maps):
            view = View(run, weight, loop.Ts, self.horizon, self.tolerance, maps)
            return sum(w * fn(view) for fn, w in self.losses)

        return jnp.mean(jax.vmap(one)(runs, maps))

    def _speed(self, runs):
        """Largest |q̇| over its limit, per joint that has one (j,)."""
        largest = jnp.max(jnp.abs(runs.qdot[..., jnp.array(self.joints, int)]), axis=(0, 1))
        return largest / self.limits

    def __call__(self, values):
        """(loss, constraints (c,)): radius/margin − 1 at each posture, then speed/limit − 1 per joint."""
        loop = pm.put(self.loop, self.parameters, values)
        runs = self._runs(loop)
        maps, across = self._maps(loop, self.postures)
        radius = jax.vmap(lambda a: radius_bound(_delayed(a, self.delay)))(maps)
        constraints = [radius / self.margin - 1.0]
        if across is not None:
            constraints.append(jax.vmap(radius_bound)(across) - 1.0)
        if self.joints:
            constraints.append(self._speed(runs) - 1.0)
        return self._loss(loop, runs, maps), jnp.concatenate(constraints)

    def judge(self, values) -> Judged:
        """What the values lead to, the radius measured by eigenvalues along the runs themselves."""
        loop = pm.put(self.loop, self.parameters, values)
        runs = self._runs(loop)
        k = jnp.clip(jnp.round(jnp.linspace(0, 1, POSTURES + 1) * self.horizon / loop.Ts).astype(int), 0, self.N)
        postures = runs.q[:, k].reshape(-1, runs.q.shape[-1])
        maps, across = self._maps(loop, postures)
        radius = jnp.max(jax.vmap(lambda a: _measured(_delayed(a, self.delay)))(maps))
        if across is not None:
            # Where nothing acts a null-space direction stays as it is, 1; beyond that it drifts apart.
            null = jnp.max(jax.vmap(_measured)(across))
            radius = jnp.maximum(radius, jnp.where(null > 1 + _KEPT, null * self.margin, 0.0))
        speed = jnp.max(self._speed(runs)) if self.joints else jnp.zeros((), runs.q.dtype)
        loss = self._loss(loop, runs, maps)
        finite = jnp.isfinite(loss) & jnp.all(jnp.isfinite(runs.q))
        inf = jnp.asarray(jnp.inf, loss.dtype)
        return Judged(
            jnp.where(finite, loss, inf),
            jnp.where(finite, radius, inf),
            jnp.where(jnp.isfinite(speed), speed, inf),
            postures,
            jax.tree.map(lambda x: x[0], runs),
        )


_LANES = 16  # values judged together: one shape, one program


@quick_jit
def _judge(objective, values):
    return jax.vmap(objective.judge)(values)


class _Seen(NamedTuple):
    """`Judged` of several values as NumPy arrays, and by how much each exceeds its constraints."""

    loss: np.ndarray
    radius: np.ndarray
    speed: np.ndarray
    postures: np.ndarray
    run: object
    violation: np.ndarray


def _look(objective, many) -> _Seen:
    """Judge a list of tuples of values."""
    found = []
    for i in range(0, len(many), _LANES):
        part = many[i : i + _LANES]
        padded = [*part, *[part[-1]] * (_LANES - len(part))]
        lanes = tuple(jnp.stack([jnp.asarray(v[j]) for v in padded]) for j in range(len(objective.parameters)))
        made = jax.tree.map(np.asarray, _judge(objective, lanes))
        found.append(jax.tree.map(lambda x, part=part: x[: len(part)], made))
    judged = jax.tree.map(lambda *x: np.concatenate(x), *found)
    violation = np.maximum(judged.radius / float(objective.margin), judged.speed) - 1.0
    violation = np.where(np.isfinite(judged.loss), violation, np.inf)
    return _Seen(*judged, violation)


# --- results ------------------------------------------------------------------------------------------


@record
class Tuned:
    """What a tuning found. No number in it is NaN, what could not be computed is inf; trajectories are as they were.

    Attributes:
      law, Ts: with the tuned values in them (`schedule` too, where there is one).
      values: {name: value}. start: {name: value} at the start.
      bounds: {name: (lower, upper)}.
      loss_before, loss_after: at the start as given and with the tuned values.
      satisfied: whether all constraints are kept, as measured along the tuned run.
      violation: by how much the worst one is exceeded, relative to its bound; at most 0 where kept.
      radius_before, radius: largest spectral radius measured along the run. margin: its bound.
      speed: largest |q̇| over its limit; 0 where there are no limits.
      z_before, z: alpha·Ts (largest |eigenvalue| of a gain matrix).
      history: {"loss", "violation", "accepted"}: (evaluations,) of the start that won.
      starts: (S,) loss each start ended with, inf where it kept no constraints.
      before, after: `Trajectory` of the first scenario.
      status: "converged", "steps" (stopped at their number), "stuck", "infeasible" or "non-finite".
      why: the same in a sentence.
      gradient: how derivatives were taken, in words.
      evaluations: runs with their gradient, all starts together.
    """

    law: object
    Ts: object
    schedule: object
    values: dict
    start: dict
    bounds: dict
    units: dict
    loss: str
    loss_before: float
    loss_after: float
    satisfied: bool
    violation: float
    radius_before: float
    radius: float
    margin: float
    speed: float
    z_before: float
    z: float
    history: dict
    starts: object
    before: object
    after: object
    status: str
    why: str
    gradient: str
    evaluations: int
    postures: object

    def __str__(self):
        show = lambda v: np.array2string(np.asarray(v), precision=5, separator=", ")  # noqa: E731
        values = "; ".join(f"{n} = {show(v)}" + _of(self.units[n]) for n, v in self.values.items())
        kept = "kept" if self.satisfied else f"exceeded by {100 * self.violation:.3g} %"
        return (
            f"{values}; z = {self.z:.4g}\nloss {self.loss_before:.4g} -> {self.loss_after:.4g}, spectral radius "
            f"{self.radius:.4g} (margin {self.margin:g}), constraints {kept}\n{self.why}"
        )


def _of(unit):
    return "" if unit == "1" else f" {unit}"


@functools.cache
def default_optimizer():
    """L-BFGS directions (Liu & Nocedal 1989), ten pairs remembered; the line search is `descent`'s own."""
    import optax

    return optax.lbfgs(memory_size=10, linesearch=None)


# --- tune ---------------------------------------------------------------------------------------------


def tune(
    law,
    reference,
    q0,
    *,
    Ts,
    N,
    method=CN,
    stage=picard(5),
    over=("alpha",),
    bounds=None,
    loss="tracking",
    margin=0.9,
    velocity_limit="chain",
    noise=0.0,
    delay=0,
    model_error=0.0,
    draws=1,
    tolerance=1e-3,
    optimizer=None,
    steps=100,
    rounds=5,
    starts=1,
    seed=0,
    gradient="auto",
    progress=None,
) -> Tuned:
    """Tune a loop's gains by gradient: loss → min, spectral radius ≤ margin, |q̇| ≤ limit.

    Args:
      law: where tuning starts. The shape of its alpha is what is tuned: a number, one per axis (m,), or a symmetric
        positive definite (m, m).
      reference: a path, or a list of B paths. q0: (n,) start [rad, m], or (B, n); the loss is the mean over them.
      Ts: sampling time [s]. N: steps; N·Ts is the horizon, also where Ts is tuned.
      method, stage: as for `solve`.
      over: what is tuned: names of `parameters.named` (alpha, schedule, damping, null_gain, feedforward, links, tool,
        Ts), or `parameters.Parameter`s of one's own.
      bounds: {name: (lower, upper)} in place of the defaults.
      loss: a name of `losses.LOSSES`, {name: weight}, or a function of a `losses.View`.
      margin: bound of the spectral radius of the loop at rest, at 9 postures along each path; the error then shrinks
        at least by this factor per step.
      velocity_limit: (n,) [rad/s, m/s], one number for all joints, "chain": the robot's own, or None.
      noise: standard deviation of the measured error, a number or (m,) [m, rad]. delay: samples by which it is late.
      model_error: relative error of the model's link lengths.
      draws: scenarios drawn of noise and model error for each path.
      tolerance: what counts as arrived, for the loss "settling" [m, rad].
      optimizer: an optax transformation; L-BFGS by default.
      steps: evaluations with gradient per start. rounds: how often the multipliers are updated in that time.
      starts: descents side by side: the law's own values, and random ones within the bounds.
      seed: of everything drawn. gradient: "forward", "reverse", or "auto" by the number of parameters.
      progress: called with (evaluations, loss, violation) after each round, or None.

    Returns: `Tuned`; it keeps every constraint, or says by how much not.
    Raises: ArgumentError for arguments that do not fit.
    """
    objective = make_objective(
        law,
        reference,
        q0,
        Ts=Ts,
        N=N,
        method=method,
        stage=stage,
        over=over,
        bounds=bounds,
        loss=loss,
        margin=margin,
        velocity_limit=velocity_limit,
        noise=noise,
        delay=delay,
        model_error=model_error,
        draws=draws,
        tolerance=tolerance,
        seed=seed,
    )
    errors.integer("steps", steps, at_least=2)
    errors.integer("rounds", rounds, at_least=1)
    errors.integer("starts", starts, at_least=1)
    errors.one_of("gradient", gradient, ("auto", "forward", "reverse"))
    optimizer = default_optimizer() if optimizer is None else optimizer
    parameters = objective.parameters
    count = pm.total(parameters)
    mode = gradient_mode(count, gradient)
    own = tuple(p.start for p in parameters)

    # Safe values: the gain, of those spread over z, that keeps the constraints best.
    options = _spread(objective)
    first = _look(objective, [own, *options])
    safe = int(np.argmin(first.violation[1:]))
    rng = np.random.default_rng(seed)
    frees = [pm.free_of(parameters, own), *rng.uniform(-4, 4, (starts - 1, count))]
    common = dict(objective=objective, own=own, first=first, mode=mode, loss=_words(loss))
    if not np.isfinite(first.loss[1 + safe]):
        return _hopeless(frees[0], **common)
    anchor = pm.free_of(parameters, options[safe])
    objective = replace(objective, postures=jnp.asarray(first.postures[1 + safe]))
    begun = [_nearest_kept(objective, u, anchor) for u in frees]
    scale = 1.0 / np.array([_positive(size) for _, size in begun])

    sizes = jax.eval_shape(objective, tuple(jnp.asarray(v) for v in own))[1].shape[0]
    done = descend(
        objective,
        np.stack([u for u, _ in begun]),
        scale,
        constraints=sizes,
        optimizer=optimizer,
        mode=mode,
        steps=steps,
        rounds=rounds,
        tolerance=1e-6,
        progress=progress,
    )
    return _conclude(done, anchor, **(common | {"objective": objective}))


def make_objective(
    law,
    reference,
    q0,
    *,
    Ts,
    N,
    method=CN,
    stage=picard(5),
    over=("alpha",),
    bounds=None,
    loss="tracking",
    margin=0.9,
    velocity_limit="chain",
    noise=0.0,
    delay=0,
    model_error=0.0,
    draws=1,
    tolerance=1e-3,
    seed=0,
) -> LoopObjective:
    """The objective that `tune` descends, for judging values found in other ways. Args: as for `tune`."""
    if not isinstance(law, Law):
        raise errors.fail("law", "be a Law", f"is {type(law).__name__}")
    method, stage = named(method, stage)
    errors.number("Ts", Ts, positive=True)
    N = errors.integer("N", N, at_least=2)
    errors.number("margin", margin, positive=True)
    if errors.concrete(margin) and margin > 1:
        raise errors.fail("margin", "be at most 1", f"is {margin:g}")
    errors.integer("delay", delay, at_least=0)
    errors.number("model_error", model_error, at_least=0)
    errors.integer("draws", draws, at_least=1)
    errors.number("tolerance", tolerance, positive=True)
    loop = pm.Loop(law=law, Ts=jnp.asarray(float(Ts)))
    parameters = _parameters(over, loop, bounds or {})
    shortest = next((float(p.lower) for p in parameters if p.name == "Ts"), float(Ts))
    horizon = N * float(Ts)
    longest = int(np.ceil(horizon / shortest - 1e-9))
    scenarios = _scenarios(law, reference, q0, longest, noise, model_error, draws, seed)
    lanes = scenarios.q0.shape[0]
    joints, limits = _limits(law.chain, velocity_limit)
    moments = np.tile(np.linspace(0, 1, POSTURES + 1), lanes)
    return LoopObjective(
        loop=loop,
        parameters=parameters,
        scenarios=scenarios,
        postures=jnp.repeat(scenarios.q0, POSTURES + 1, axis=0),
        moments=jnp.asarray(moments),
        losses=tuple((fn, jnp.asarray(w)) for fn, w in terms(loss)),
        margin=jnp.asarray(float(margin)),
        limits=limits,
        joints=joints,
        horizon=jnp.asarray(horizon),
        tolerance=jnp.asarray(float(tolerance)),
        N=longest,
        delay=delay,
        method=method,
        stage=stage,
    )


def _parameters(over, loop, bounds):
    over = (over,) if isinstance(over, (str, pm.Parameter)) else tuple(over)
    if not over:
        raise errors.fail("over", "name something to tune", "is empty")
    made = tuple(p if isinstance(p, pm.Parameter) else pm.named(p, loop, bounds.get(p)) for p in over)
    names = [p.name for p in made]
    if len(set(names)) != len(names):
        raise errors.fail("over", "name each parameter once", f"is {names}")
    if {"links", "tool"} <= set(names):
        raise errors.fail("over", "name links (the tip's offset among them) or tool", "names both")
    for name in bounds:
        errors.one_of("bounds", name, names)
    return made


def _scenarios(law, reference, q0, N, noise, model_error, draws, seed):
    """All runs a loss is the mean of, stacked."""
    references = list(reference) if isinstance(reference, (list, tuple)) else [reference]
    for one in references:
        if not isinstance(one, ref.Reference):
            raise errors.fail("reference", "be a Reference such as hold(...)", f"is {type(one).__name__}")
        ref.check(one, law.task)
    q0 = np.asarray(errors.array("q0", q0, (law.chain.n,), (None, law.chain.n)), float)
    q0 = np.atleast_2d(q0)
    count = max(len(references), len(q0))
    if len(references) not in (1, count) or len(q0) not in (1, count):
        raise errors.fail("q0", f"hold one start, or one for each of {len(references)} paths", f"holds {len(q0)}")
    sigma = np.asarray(errors.array("noise", noise, (), (law.task.m,)), float)
    if np.any(sigma < 0):
        raise errors.fail("noise", "be at least 0", f"is {sigma.tolist()}")
    rng = np.random.default_rng(seed)
    made = []
    for i in range(count):
        for _ in range(draws):
            made.append(
                Scenario(
                    reference=references[i % len(references)],
                    q0=as_joint_values(law.chain, q0[i % len(q0)]),
                    noise=noise_of(sigma, N, law.task.m, rng) if np.any(sigma > 0) else None,
                    plant=perturbed(law.chain, model_error, rng) if model_error > 0 else None,
                )
            )
    return stack(made)


def _limits(chain, velocity_limit):
    """Which joints have a velocity limit, and how large it is."""
    if velocity_limit is None:
        return (), None
    if isinstance(velocity_limit, str):
        errors.one_of("velocity_limit", velocity_limit, ("chain",))
        limits = np.array(chain.velocity_limit)
    else:
        limits = errors.array("velocity_limit", velocity_limit, (), (chain.n,), finite=False)
        limits = np.broadcast_to(np.asarray(limits, float), (chain.n,))
        if not np.all(limits > 0):
            raise errors.fail("velocity_limit", "be positive", f"is {limits.tolist()}")
    joints = tuple(int(i) for i in np.flatnonzero(np.isfinite(limits)))
    return joints, (jnp.asarray(limits[list(joints)]) if joints else None)


_SPREAD = (0.05, 0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.5, 2.0, 3.0)


def _spread(objective):
    """Values to fall back on: gains spread over z = alpha·Ts, everything else as it is (inside its bounds)."""
    start = {p.name: np.asarray(pm.bounded(p, pm.free(p, p.start))) for p in objective.parameters}
    Ts = float(start.get("Ts", objective.loop.Ts))
    made = []
    for z in _SPREAD:
        values = dict(start)
        for p in objective.parameters:
            if p.name in ("alpha", "schedule"):
                value = z / Ts * (np.eye(len(p.start)) if p.kind == pm.SPD else np.ones(np.shape(p.start)))
                values[p.name] = np.asarray(pm.bounded(p, pm.free(p, value)))
        made.append(tuple(values[p.name] for p in objective.parameters))
    if not {"alpha", "schedule"} & set(start):
        return made[:1]
    return made


def _positive(value):
    return value if value > 0 else 1.0


def _between(objective, far, near, points):
    """Values on the straight line from `far` to `near` in the free numbers."""
    return [_values(objective, far + s * (near - far)) for s in points]


def _values(objective, u):
    return tuple(np.asarray(v) for v in pm.values_of(objective.parameters, jnp.asarray(u)))


def _nearest_kept(objective, u, anchor):
    """The point nearest to u on the way to the anchor that keeps the constraints, or the least bad; and its loss."""
    shares = np.linspace(0, 1, _LANES)
    seen = _look(objective, _between(objective, u, anchor, shares))
    kept = np.flatnonzero(seen.violation <= _KEPT)
    i = int(kept[0]) if kept.size else int(np.argmin(seen.violation))
    return u + shares[i] * (anchor - u), float(seen.loss[i])


def _restored(objective, u, anchor):
    """The last point on the way from the anchor (which keeps the constraints) towards u that keeps them."""
    low, high = 0.0, 1.0  # shares towards the anchor
    for _ in range(3):
        shares = np.linspace(low, high, _LANES)
        seen = _look(objective, _between(objective, u, anchor, shares))
        kept = np.flatnonzero(seen.violation <= _KEPT)
        if not kept.size:
            return anchor
        i = int(kept[0])
        if i == 0:
            return u + shares[0] * (anchor - u)
        low, high = shares[i - 1], shares[i]
    return u + high * (anchor - u)


def _conclude(done, anchor, *, objective, own, first, mode, loss) -> Tuned:
    """Judge where the descents ended, mend what exceeds its bounds, and choose."""
    count = len(done.u)
    points = [*done.u, *done.best, anchor]
    seen = _look(objective, [_values(objective, u) for u in points])
    kept = seen.violation <= _KEPT
    final = np.full(count, np.inf)
    for i in range(count):
        final[i] = np.min(np.where(kept[[i, count + i]], seen.loss[[i, count + i]], np.inf))
    if kept.any():
        near = points[int(np.argmin(np.where(kept, seen.loss, np.inf)))]
        # A descent that ended just outside is brought back to the boundary: it may be better than what was kept.
        lower = np.where(~kept[:count] & (seen.loss[:count] < np.min(seen.loss[kept])), seen.loss[:count], np.inf)
        tried = [near]
        if np.isfinite(lower).any():
            tried.append(_restored(objective, points[int(np.argmin(lower))], near))
        again = _look(objective, [_values(objective, u) for u in tried])
        best = int(np.argmin(np.where(again.violation <= _KEPT, again.loss, np.inf)))
        u, judged = tried[best], jax.tree.map(lambda x: x[best], again)
    else:
        best = int(np.argmin(seen.violation))
        u, judged = points[best], jax.tree.map(lambda x: x[best], seen)
    lane = int(np.argmin(final)) if np.isfinite(final).any() else 0
    status = done.why if judged.violation <= _KEPT else "infeasible"
    history = {name: getattr(done.history, name)[lane] for name in done.history._fields}
    return _result(
        objective, _values(objective, u), judged, status, history, final, own, first, mode, loss, done.history.loss.size
    )


def _hopeless(u, *, objective, own, first, mode, loss) -> Tuned:
    """The result where no gain gives a finite run."""
    values = _values(objective, u)
    judged = jax.tree.map(lambda x: x[0], _look(objective, [values]))
    history = {name: np.zeros(0) for name in ("loss", "violation", "accepted")}
    return _result(objective, values, judged, "non-finite", history, np.full(1, np.inf), own, first, mode, loss, 0)


_WHY = {
    "converged": "Converged: the loss no longer changes and every constraint is kept.",
    "steps": "Stopped after the given number of steps; every constraint is kept.",
    "stuck": "Stopped where no step descends; every constraint is kept.",
    "infeasible": "No values were found that keep every constraint; these exceed them least.",
    "non-finite": "No gain within the bounds gives a finite run: look at the path, the start and the damping.",
}


def _result(objective, values, judged, status, history, final, own, first, mode, loss, evaluations) -> Tuned:
    loop = pm.put(objective.loop, objective.parameters, tuple(jnp.asarray(v) for v in values))
    before = pm.put(objective.loop, objective.parameters, tuple(jnp.asarray(v) for v in own))
    names = [p.name for p in objective.parameters]
    by_name = lambda items: dict(zip(names, items, strict=True))  # noqa: E731
    finite = lambda v: float(np.nan_to_num(v, nan=np.inf))  # noqa: E731
    why = _WHY[status]
    if status == "infeasible":
        why += f" Exceeded by {100 * finite(judged.violation):.3g} %."
    return Tuned(
        law=loop.law,
        Ts=float(loop.Ts),
        schedule=None if loop.schedule is None else np.asarray(loop.schedule),
        values=by_name(values),
        start=by_name(own),
        bounds=by_name([(np.asarray(p.lower), np.asarray(p.upper)) for p in objective.parameters]),
        units=by_name([p.unit for p in objective.parameters]),
        loss=loss,
        loss_before=finite(first.loss[0]),
        loss_after=finite(judged.loss),
        satisfied=bool(judged.violation <= _KEPT),
        violation=finite(judged.violation),
        radius_before=finite(first.radius[0]),
        radius=finite(judged.radius),
        margin=float(objective.margin),
        speed=finite(judged.speed),
        z_before=_z(before),
        z=_z(loop),
        history=history,
        starts=final,
        before=_cut(jax.tree.map(lambda x: x[0], first.run), before, objective),
        after=_cut(judged.run, loop, objective),
        status=status,
        why=why,
        gradient=gradient_in_words(pm.total(objective.parameters), mode, objective.method, objective.stage),
        evaluations=int(evaluations),
        postures=np.asarray(judged.postures),
    )


def gradient_in_words(count, mode, method, stage) -> str:
    """Which derivative a tuning takes: its mode, how many free numbers, and how implicit stages enter it.

    Args: count: free numbers. mode: "auto", "forward" or "reverse". method, stage: as for `solve`.
    """
    numbers = f"{count} free number{'' if count == 1 else 's'}"
    if not method.implicit:
        stages = "no implicit stages"
    elif getattr(stage, "implicit", False):
        stages = "stages by the implicit function theorem"
    else:
        stages = "stages unrolled, pass by pass"
    return f"{gradient_mode(count, mode)} mode, {numbers}, {stages}"


def _cut(run, loop, objective):
    """The run up to the horizon: with a tuned Ts the program runs as many steps as the smallest one needs."""
    N = min(objective.N, int(np.ceil(float(objective.horizon) / float(loop.Ts) - 1e-9)))
    return truncate(run, N)


def _z(loop):
    rate = largest_rate(loop.law.alpha) if loop.schedule is None else float(np.max(loop.schedule))
    return rate * float(loop.Ts)


def _words(loss):
    if isinstance(loss, str):
        return loss
    if isinstance(loss, dict):
        return " + ".join(f"{w:g} {name}" for name, w in loss.items())
    return getattr(loss, "__name__", "own function")


# --- calibration --------------------------------------------------------------------------------------


@record
class PoseObjective:
    """Mean squared distance between measured positions and those of a chain built from the parameters' values."""

    parameters: tuple
    build: object  # (*values) -> Chain
    q: object  # (K, n)
    measured: object  # (K, 3)

    def __call__(self, values):
        from cnclik.robot.kinematics import frames, stack

        chain = self.build(*values)
        found = jax.vmap(lambda q: stack(frames(chain, tuple(q)).position, q))(self.q)
        return jnp.mean(jnp.sum((found - self.measured) ** 2, axis=-1)), jnp.zeros((0,), found.dtype)


class Calibrated(NamedTuple):
    """Values of a calibration, and RMS distances to what was measured before and after [m]."""

    values: tuple
    rms_before: float
    rms_after: float
    status: str
    history: np.ndarray


def calibrate(
    build, start, q, measured, *, lower=None, upper=None, optimizer=None, steps=200, rounds=4, gradient="auto"
):
    """Geometry from measured positions of the tip, by the descent that `tune` uses.

    Args:
      build: function (value) -> Chain, such as `planar_arm` of link lengths; must take traced arrays.
      start: nominal value, an array, such as link lengths [m].
      q: (K, n) joint values [rad, m]. measured: (K, 3) positions of the tip there [m].
      lower, upper: bounds, by default 0.5 below and above the start.
      optimizer, steps, rounds, gradient: as for `tune`.
    Returns: `Calibrated`.
    Raises: ArgumentError for shapes that do not fit.
    """
    start = np.asarray(errors.array("start", start), float)
    q = jnp.asarray(errors.array("q", q, (None, None)))
    measured = jnp.asarray(errors.array("measured", measured, (q.shape[0], 3)))
    p = pm.parameter(
        "geometry", start, start - 0.5 if lower is None else lower, start + 0.5 if upper is None else upper, build
    )
    objective = PoseObjective(parameters=(p,), build=build, q=q, measured=measured)
    before = float(jax.jit(objective)((jnp.asarray(start),))[0])
    if not np.isfinite(before):
        raise errors.fail("start", "give finite positions", "does not")
    done = descend(
        objective,
        pm.free(p, start)[None],
        np.array([1.0 / _positive(before)]),
        constraints=0,
        optimizer=default_optimizer() if optimizer is None else optimizer,
        mode=gradient_mode(pm.size(p), gradient),
        steps=steps,
        rounds=rounds,
        tolerance=1e-9,
    )
    loss = done.history.loss[0]
    values = tuple(np.asarray(v) for v in pm.values_of((p,), jnp.asarray(done.best[0])))
    return Calibrated(values, before**0.5, float(done.best_loss[0]) ** 0.5, done.why, np.sqrt(loss))


# --- the map around a tuned loop ----------------------------------------------------------------------


def radius_field(tuned, made, q):
    """Spectral radius of the linear loop at rest at q over gains and sampling times around a tuned one.

    Args:
      tuned: `Tuned`. made: the problem it came from (method, stage, Ts). q: (n,).
    Returns: an xarray.Dataset over (Ts, alpha), alpha being the gain's largest |eigenvalue| [1/s].
    """
    import xarray as xr

    from cnclik.stability.spectrum import step_maps, task_radius

    rate = largest_rate(tuned.law.alpha)
    centre = tuned.z / tuned.Ts
    alpha = np.geomspace(centre / 20, centre * 8, 40)
    Ts = np.geomspace(tuned.Ts / 8, tuned.Ts * 8, 25)
    grid_Ts, grid_alpha = (v.ravel() for v in np.meshgrid(Ts, alpha, indexing="ij"))
    q = as_joint_values(tuned.law.chain, q)
    law = replace(tuned.law, alpha=jnp.asarray(tuned.law.alpha))
    moved, rows = step_maps(law, at_rest(law, None, q), q, grid_alpha / rate, grid_Ts, made.method, made.stage)
    radius = task_radius(moved, rows).reshape(len(Ts), len(alpha))
    gain = "gain α" if np.ndim(tuned.law.alpha) == 0 else "largest gain of α"
    return xr.Dataset(
        {"radius": (("Ts", "alpha"), radius, {"units": "1", "long_name": "spectral radius"})},
        coords={"alpha": ("alpha", alpha, {"units": "1/s"}), "Ts": ("Ts", Ts, {"units": "s"})},
        attrs={"Ts_before": float(made.Ts), "gain": gain},
    )
