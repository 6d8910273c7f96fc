"""Spectrum: the one-step map of the whole loop, differentiated, and its largest eigenvalue.

At rest (e = 0, constant target) the loop's own `step` is differentiated, with its iterations, limits and user-written
functions. It holds at one posture; the gains of `cnclik.stability.gain` hold at any, and their tests ask it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.loop import advance
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import Law, check_loop, observe, weighted
from cnclik.law.paths import Reference
from cnclik.law.reference import hold_at
from cnclik.precision import in_float64_if_known
from cnclik.record import ArrayLike, Float, Number, cast, replace
from cnclik.robot import chart
from cnclik.robot.model import as_joint_values, modelled, one_off
from cnclik.robot.posture import arm_length
from cnclik.robot.rotations import safe_norm, safe_sqrt

REST = 1e-5  # of (1 + the arm's length in m): an error above this is not rest [m, rad]; float32 resolves a tenth of it


@in_float64_if_known
def spectral_radius(
    law: Law,
    reference: Reference | None,
    q: Float[ArrayLike, " n"],
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
) -> Number:
    """Return the largest |λ| of the loop's one-step map at rest over the directions of the task; stable below 1.

    With S = ∂q[k+1]/∂q[k] it is that of I + J (S − I) J#. Null-space directions, which an exact J# leaves unchanged
    (λ = 1), are separated by J; a direction that J has lost keeps its error. Pure: jit, vmap and grad go through for
    alpha, Ts, damping and geometry, in the caller's precision (it is not smooth where two eigenvalues have the same
    size). Called with numbers it is computed in float64.

    Args:
      law: the right-hand side, see `Law`. A posture term is taken with its rest at q.
      reference: a constant `Reference` with e = 0 at q, or None: hold the pose at q.
      q: (n,) joint values at rest [rad, m].
      Ts: sampling time [s].
      method, stage: as for `solve`.
    Raises: ArgumentError where q is not at rest on the target, or Ts is not a positive number.
    """
    method, Ts = named(method), 1.0 * errors.number("Ts", Ts, positive=True)
    check_loop(law, *(() if reference is None else (reference,)))
    q = as_joint_values(law.chain, q, finite=True)
    if law.null_velocity is not None:
        law = replace(law, null_velocity=replace(law.null_velocity, rest=q))
    if not all(map(errors.concrete, jax.tree.leaves((law, reference, q, Ts)))):
        return _radius(law, reference, q, Ts, method, stage)[0]
    radius, away = _radius_of_numbers(law, reference, q, Ts, method, stage)
    if not away < REST * (1 + arm_length(law.chain)):
        raise errors.fail("q", "be at rest on the target", f"leaves an error of {float(away):.3g}")
    return np.float64(radius)


def _radius(law, reference, q, Ts, method, stage):
    """Return the radius, and the error that a reference has at t = 0."""
    law, reference, Ts = cast((modelled(law), reference, Ts), q.dtype)
    t = jnp.zeros_like(Ts)
    away = t if reference is None else safe_norm(observe(law, reference, t, q).e)
    held = hold_at(law.chain, law.task, q)

    def move(y):
        return chart.into(law.chain, q, advance(law, held, chart.out(law.chain, q, y), t, Ts, method, stage).q)

    moved, rows = jax.jacfwd(move)(chart.centre(law.chain, q)), weighted(law.task, observe(law, held, t, q).rows)
    eye = jnp.eye(len(rows), dtype=rows.dtype)
    task_map = eye + rows @ (moved - jnp.eye(len(moved), dtype=rows.dtype)) @ jnp.linalg.pinv(rows)
    eigenvalues = jnp.linalg.eigvals(task_map)
    return safe_sqrt(jnp.max(eigenvalues.real**2 + eigenvalues.imag**2)), away


_radius_of_numbers = one_off(_radius, static_argnames=("method",))  # one program, not one for each operation
