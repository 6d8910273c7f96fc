"""Laws, methods and stages by name, and their exported step held against JAX."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik.law.curves import Tangent
from cnclik.law.reference import Reference
from cnclik.task.parts import places
from tests.export.native import native

ROUNDINGS = (4, 4, 4, 32, 32, 32, 256, 256, 256)  # of joint values, by which a step is repeated
CLOSELY = 40  # times as many repeats where those explain too little
NEAR = {"float64": 1e-12, "float32": 1e-5}


def arm(n):
    """A planar arm with position and velocity limits."""
    made = ck.planar_arm([1.0, 0.8, 0.6, 0.5, 0.4][:n])
    return ck.replace(made, lower=(-2.0,) * n, upper=(2.0,) * n, velocity_limit=(1.5,) * n)


INVERSES = {
    "pseudoinverse": ck.pseudoinverse,
    "damped": lambda: ck.damped(0.1),
    "singular-damped": lambda: ck.singular_damped(0.1, 0.2),
}
LIMITS = {
    "none": lambda: None,
    "velocity-scaling": ck.velocity_scaling,
    "bounded": ck.bounded,
}
NULL = {
    "none": lambda chain, task: None,
    "posture": lambda chain, task: ck.posture(np.full(chain.n, 0.3)),
}
STAGES = {"picard": lambda: ck.picard(3), "chord": lambda: ck.chord(2), "newton": lambda: ck.newton(2)}


class Combination(NamedTuple):
    """One law with one method."""

    robot: str
    inverse: str = "damped"
    limits: str = "none"
    null: str = "none"
    method: str = "EE"
    stage: str = "picard"
    dtype: str = "float64"
    Ts: float = 0.01

    def __str__(self):
        return "-".join(map(str, self[:-1]))

    def parts(self):
        """(law, method, stage)."""
        chain, task = arm(int(self.robot[-1])), ck.position("xy")
        law = ck.Law(
            chain,
            task,
            alpha=5.0,
            inverse=INVERSES[self.inverse](),
            limits=LIMITS[self.limits](),
            null_velocity=NULL[self.null](chain, task),
        )
        return law, ck.METHODS[self.method], STAGES[self.stage]()


def inputs(law, count, dtype, seed=0):
    """q, position, rotation, velocity of many lanes: singular postures, some beyond the limits, one NaN among them."""
    random, chain, task = np.random.default_rng(seed), law.chain, law.task
    low, high = np.maximum(chain.lower, -3.0), np.minimum(chain.upper, 3.0)
    q = low + (high - low) * random.uniform(0, 1, (count, chain.n))
    few = max(count // 10, 1)
    q[:few] = 0.0  # stretched: singular
    q[few : 2 * few] *= 1.3  # some beyond their limits
    q[2 * few : 3 * few, 1:] = random.normal(0, 1e-5, (few, chain.n - 1))  # next to a singularity
    there = low + (high - low) * random.uniform(0, 1, (min(count, 500), chain.n))
    targets = [ck.forward(chain, row) for row in there]
    position = np.resize([np.asarray(t.position)[list(task.linear)] for t in targets], (count, len(task.position)))
    rotation = np.resize([np.asarray(t.rotation) for t in targets], (count, 3, 3))
    velocity = random.normal(0, 0.1, (count, task.m))
    q[-1, 0] = np.nan
    return [np.ascontiguousarray(v, dtype) for v in (q, position, rotation, velocity)]


def target(law, position, rotation, velocity):
    """A target at t = 0, moving with a velocity of its own."""
    task, count = law.task, len(law.task.position)
    spin = jnp.zeros(3, velocity.dtype).at[places(task.orientation)]
    curve = Tangent(
        t=jnp.zeros((), velocity.dtype),
        position=position if task.position else None,
        velocity=velocity[:count] if task.position else None,
        rotation=rotation if task.orientation else None,
        spin=spin.set(velocity[count:]) if task.orientation else None,
    )
    return Reference(curve=curve)


def by_jax(combination):
    """Steps of all lanes by JAX alone: a function of the inputs, to q, qdot, e, x, residual and status."""
    law, method, stage = combination.parts()

    def one(q, position, rotation, velocity):
        reference = target(law, position, rotation, velocity)

        made = ck.step(law, reference, q, 0.0, combination.Ts, method, stage)
        return made.q, made.qdot, made.e, made.x, made.residual, made.status

    program = jax.jit(jax.vmap(one))

    def run(given):
        with ck.use_engine("plain"), jax.enable_x64(combination.dtype == "float64"):
            return [np.asarray(v) for v in program(*given)]

    return run


def by_c(combination, given, step=None):
    """The same by the exported step, lane by lane."""
    law, method, stage = combination.parts()
    step = native(law, method=method, stage=stage, dtype=combination.dtype) if step is None else step
    found = []
    for q, position, rotation, velocity in zip(*given, strict=True):
        known = {"position": position, "rotation": rotation, "velocity": velocity, "Ts": combination.Ts}
        made = step(q, *(known[name] for name in step.names[1:]))
        found.append((made.q, made.qdot, made.e, made.x, made.residual, made.status))
    return [np.array(v) for v in zip(*found, strict=True)]


def plainly(combination):
    """The same step, built so that it rounds elsewhere: no product is added before it is rounded."""
    law, method, stage = combination.parts()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CFLAGS", "-O1 -ffp-contract=off")
        return native(law, method=method, stage=stage, dtype=combination.dtype)


def moved(given, by):
    """The inputs with joint values moved by so many roundings, an array."""
    q, *others = given
    return [(q + np.finfo(q.dtype).eps * by).astype(q.dtype), *others]


def spread(values, near):
    """How far results lie from those of the same lanes elsewhere; of the status, whether all are the same."""
    with np.errstate(invalid="ignore"):
        far = [np.fmax.reduce([0.0 * v, *(np.abs(v - n[i]) for n in near)]) for i, v in enumerate(values[:5])]
    return [*far, np.all([n[5] == values[5] for n in near], axis=0)]


def wider(one, other):
    """The larger of two spreads."""
    return [*(np.fmax(a, b) for a, b in zip(one[:5], other, strict=False)), one[5] & other[5]]


def compare(combination, count, seed=0, step=None):
    """(largest difference in units of what is allowed, how many lanes differ in status).

    Next to a singularity, with a large J#, the rounding of q itself is felt: the step is repeated from joint values
    that differ by a few to a few hundred roundings; where a limit takes hold there, so is the status. Rounding inside
    the step is seen by `plainly`. The few lanes that those do not explain are looked at more closely: a choice, such
    as which joint is locked, may turn anywhere within those roundings.
    """
    law, *_ = combination.parts()
    random, run = np.random.default_rng(0), by_jax(combination)
    given = inputs(law, count, combination.dtype, seed)
    wanted, found = run(given), by_c(combination, given, step)
    plain = by_c(combination, given, step or plainly(combination))
    near = [run(moved(given, k * random.choice([-1.0, 1.0], given[0].shape))) for k in ROUNDINGS]
    known = wider(spread(wanted, near), spread(found, [plain]))
    off, others = differences(combination, wanted, known, found)
    few = np.flatnonzero((off > 1) | others)
    if 0 < len(few) <= max(count // 100, 5):
        given, wanted, found, known = ([v[few] for v in values] for values in (given, wanted, found, known))
        near = [run(moved(given, k * random.uniform(-1, 1, given[0].shape))) for k in ROUNDINGS * CLOSELY]
        off[few], others[few] = differences(combination, wanted, wider(known, spread(wanted, near)), found)
    return float(off.max()), int(others.sum())


def differences(combination, wanted, known, found):
    """Of each lane: the difference in units of what is allowed, and whether its status is another."""
    near, worst = NEAR[combination.dtype], []
    for a, b, far in zip(wanted[:5], found, known, strict=False):
        finite = np.isfinite(a)
        assert (finite == np.isfinite(b)).all()
        size = np.max(1.0 + np.abs(np.where(finite, a, 0.0)), axis=tuple(range(1, a.ndim)), keepdims=True)
        allowed = near * size + 10 * np.where(finite, far, 0.0)
        ratio = np.where(finite, np.abs(a - b), 0.0) / allowed
        worst.append(ratio.reshape(len(a), -1).max(axis=1))
    return np.max(worst, axis=0), (wanted[5] != found[5]) & known[5]
