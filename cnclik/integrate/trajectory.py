"""Trajectory: what a loop did, instant by instant; put together, cut short, joined."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.law.law import task_coordinates
from cnclik.record import record, replace

INSTANTS = ("t", "q", "x", "e")  # N + 1 entries
STEPS = ("qdot", "residual", "contraction", "status")  # N entries


@record
class Trajectory:
    """A loop in time: N steps between N + 1 instants t[k] = t0 + k·Ts.

    Attributes:
      t: (N + 1,) [s].
      q: (N + 1, n) joint values [rad, m].
      x: (N + 1, m) task coordinates of the tip [m, rad].
      e: (N + 1, m) error, x_d − x (rotations: vector of the turn that is left) [m, rad].
      qdot: (N, n) joint velocity held during step k, (q[k+1] − q[k])/Ts [rad/s, m/s].
      residual: (N,) last change of the implicit stage, as a joint displacement; 0 for explicit methods.
      contraction: (N,) ratio of its last two changes; at 1 or more it diverges.
      status: (N,) bits of `Status`.
      evaluations: evaluations of f(q, t) in the whole run, each one a Jacobian and an inverse.
    """

    t: jax.Array
    q: jax.Array
    x: jax.Array
    e: jax.Array
    qdot: jax.Array
    residual: jax.Array
    contraction: jax.Array
    status: jax.Array
    evaluations: jax.Array


def assemble(law, t, steps, q, e, evaluations) -> Trajectory:
    """A trajectory from what a scan over its steps stacked up, in component form, and how it ended. Pure.

    Args:
      t: (N + 1,) [s].
      steps: (q, e, qdot, residual, contraction, status) of every step, q and e at its start.
      q, e: at the last instant, tuples of scalars.
    """
    qs, es, qdot, residual, contraction, status = steps
    qs, es = (tuple(jnp.append(a, b) for a, b in zip(u, v, strict=True)) for u, v in ((qs, q), (es, e)))
    # A coordinate that no joint moves is a literal, hence the asarray.
    x = jax.vmap(lambda q: tuple(jnp.asarray(v, t.dtype) for v in task_coordinates(law, q)))(qs)
    columns = functools.partial(jnp.stack, axis=-1)
    return Trajectory(
        t=t,
        q=columns(qs),
        x=columns(x),
        e=columns(es),
        qdot=columns(qdot),
        residual=residual,
        contraction=contraction,
        status=status,
        evaluations=jnp.asarray(evaluations),
    )


def truncate(run: Trajectory, N: int) -> Trajectory:
    """The first N steps of a run, one lane; every step costs the same number of evaluations."""
    made = run.status.shape[0]
    points = {name: getattr(run, name)[: N + 1] for name in INSTANTS}
    steps = {name: getattr(run, name)[:N] for name in STEPS}
    return replace(run, **points, **steps, evaluations=run.evaluations * min(N, made) // max(made, 1))


def join(parts) -> Trajectory:
    """Runs end to end, as NumPy arrays: where one ends the next begins, and that instant is kept once."""

    def steps(name):
        return np.concatenate([np.asarray(getattr(p, name)) for p in parts])

    def instants(name):
        values = [np.asarray(getattr(p, name)) for p in parts]
        return np.concatenate([*(v[:-1] for v in values), values[-1][-1:]])

    return Trajectory(
        **{name: instants(name) for name in INSTANTS},
        **{name: steps(name) for name in STEPS},
        evaluations=sum(np.asarray(p.evaluations) for p in parts),
    )
