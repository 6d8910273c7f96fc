"""The loop at rest as matrices: the effect of one step on a small error, delayed or not, and smooth bounds of it."""

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.integrate.drive import Drive
from cnclik.law.law import gains_of
from cnclik.record import replace
from cnclik.robot.rotations import safe_sqrt
from cnclik.stability.driven import driven_limits, looked_at_drive, loop_matrix, noise_limit
from cnclik.stability.drives import each_drive
from cnclik.stability.linear import stepped
from cnclik.stability.loop import loop_at_rest, parts_at_rest
from cnclik.stability.spectrum import at_rest, of_error, one_step
from cnclik.stability.tasks import bounded_rates
from cnclik.threads import after

SQUARINGS = 10  # of a matrix to bound its radius: the power p = 1024


# --- maps ---------------------------------------------------------------------------------------------


def maps_at_rest(law, q, Ts, method, stage):
    """How one step multiplies a small error (m, m) and a small motion in the null space of J (n, n); and the shares it
    removes of an error (m, m) and of such a motion (n, n). Pure.

    With S = ∂q[k+1]/∂q[k]: `of_error`, and (I − J# J) S (I − J# J), whose eigenvalues along the task are 0; those of
    the share removed are 0 there, too. A stack
    removes most where all its tasks are fulfilled; errors that no joint can affect count as removed in the same way.
    """
    law, held = at_rest(law, None, q)
    if law.null_velocity is not None:
        moved, rows = one_step(law, held, q, Ts, method, stage)
        inverse = jnp.linalg.pinv(rows)  # computed once: LAPACK's threads may deadlock in two simultaneous batches
        across = jnp.eye(len(q), dtype=q.dtype) - inverse @ rows
        found = of_error(moved, rows, inverse=inverse)
        return found, across @ moved @ across, _taken(found), across @ _taken(moved) @ across
    rows, columns, _ = parts_at_rest(law, held, q)
    gain = jnp.diag(jnp.asarray(gains_of(law), q.dtype))
    found = stepped(method, stage, rows @ columns, gain, Ts)
    inverse = jnp.linalg.pinv(after(rows, found))
    across = jnp.eye(len(q), dtype=q.dtype) - inverse @ rows
    still = jnp.zeros_like(across)
    if not bounded_rates(law):
        return found, across, _taken(found), still
    eye, moved = jnp.eye(len(gain), dtype=q.dtype), rows @ inverse
    most = stepped(method, stage, eye, gain, Ts)
    return found @ moved + (eye - moved) @ most @ (eye - moved), across, _taken(most), still


def _taken(found):
    return jnp.eye(len(found), dtype=found.dtype) - found


def driven_map(a, drive, Ts):
    """The step of a loop through its drives as one matrix, from the map A (..., m, m) of the error at rest."""
    if drive.prompt:
        return a
    steps = a - np.eye(a.shape[-1], dtype=a.dtype)
    return loop_matrix(steps[..., None, :, :], looked_at_drive(drive), 1.0 if drive.order == 0 else Ts)


def largest_share(drive, Ts, delay_margin: float, noise_gain: float) -> float:
    """Largest share of an error that a step may remove: d^d/(d + 1)^(d + 1) for a dead time d.

    It does not overshoot even with `delay_margin` more samples, and has at most this noise gain. See `driven_limits`.
    """
    found = []
    for joints in each_drive(looked_at_drive(drive)):
        late = replace(joints, delay=joints.delay + delay_margin)
        found += [driven_limits("EE", Ts=Ts, drive=late).monotone, noise_limit(noise_gain, joints, Ts)]
    return min(found)


def largest_null_share(drive, Ts: float) -> float:
    """Largest share of a motion in the null space that a step may remove and be stable, through each joint's drive."""
    return min(driven_limits("EE", Ts=Ts, drive=joints).stable for joints in each_drive(looked_at_drive(drive)))


# --- size ---------------------------------------------------------------------------------------------


def radius_bound(matrix):
    """A smooth upper bound of the spectral radius, ‖A^p‖^(1/p) with p = 1024 (Gelfand 1941).

    In the Frobenius norm it exceeds the radius of normal matrices by at most a factor m^(1/2p) (0.09 % for m = 6).
    Eigenvalues themselves have no derivative where they coincide, as all do for exact J# and one gain.
    """

    def square(carry, share):
        a, log, dead = carry
        s = safe_sqrt(jnp.sum(a * a))
        dead = dead | (s == 0)
        s = jnp.where(s == 0, 1.0, s)
        a = a / s
        return (a @ a, log + share * jnp.log(s), dead), None

    shares = 0.5 ** jnp.arange(SQUARINGS + 1, dtype=matrix.dtype)
    start = (matrix, jnp.zeros((), matrix.dtype), jnp.zeros((), bool))
    (_, log, dead), _ = jax.lax.scan(square, start, shares)
    return jnp.where(dead, 0.0, jnp.exp(log))


def radius_estimate(matrix):
    """`radius_bound` divided by its value for the identity, m^(1/2p).

    It is exact if all eigenvalues have equal size, and otherwise at most that factor too small: for bounds that are to
    be reached, such as 1 for a direction that nothing acts on.
    """
    return radius_bound(matrix) / matrix.shape[0] ** (0.5 ** (SQUARINGS + 1))


def measured_radius(matrices):
    """Largest spectral radius of matrices (..., K, m, m), NumPy arrays, by eigenvalues; inf if one is not finite."""
    finite = np.isfinite(matrices).all((-1, -2, -3))
    values = np.linalg.eigvals(np.where(finite[..., None, None, None], matrices, 0.0))
    return np.where(finite, np.abs(values).max((-1, -2)), np.inf)


def null_steps(across, m):
    """Eigenvalues (..., n − m) of S − I over the null space, of maps S (..., n, n) there that are 0 along m others."""
    values = np.linalg.eigvals(np.where(np.isfinite(across), across, 0.0))
    order = np.argsort(np.abs(values), axis=-1)[..., min(m, values.shape[-1]) :]
    return np.take_along_axis(values, order, -1) - 1.0


def radius_over(law, q, alpha, Ts, method, stage, *, drive=Drive()):
    """Spectral radius (a, b) of the loop at rest at q for many gains and sampling times.

    Args:
      law: its alpha, of any shape, is scaled. q: (n,).
      alpha, Ts: (b,) largest |eigenvalue| of the gain [1/s], (a,) sampling times [s].
      method, stage: as for `solve`. drive: between command and motion.
    """
    loop = loop_at_rest(law, None, q, method, stage, drive)
    return np.stack([loop.radii(np.asarray(alpha) * T, T)[0] for T in Ts])
