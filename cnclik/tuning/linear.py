"""The loop at rest as matrices: what one step does to a small error, late or not, and how large that is, smoothly."""

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.record import replace
from cnclik.robot.kinematics import as_joint_values
from cnclik.robot.spatial import safe_sqrt
from cnclik.stability.linear import at_rest_as, late_factors
from cnclik.stability.spectrum import at_rest, largest_rate, of_error, one_step, step_maps

SQUARINGS = 10  # of a matrix whose radius is bounded: its power p = 1024


# --- maps ---------------------------------------------------------------------------------------------


def maps_at_rest(law, q, Ts, method, stage):
    """How one step multiplies a small error (m, m), and a small motion in the null space of J (n, n). Pure.

    With S = ∂q[k+1]/∂q[k]: `of_error`, and (I − J# J) S (I − J# J). Its eigenvalues along the task are 0.
    """
    moved, rows = one_step(law, at_rest(law, None, q), q, Ts, _forgetful(method), stage)
    across = jnp.eye(len(q), dtype=q.dtype) - jnp.linalg.pinv(rows) @ rows
    return of_error(moved, rows), across @ moved @ across


def _forgetful(method):
    """A one-step method that does to a small error at rest what the method does."""
    same = at_rest_as(method)
    if same.steps > 1:
        raise errors.fail("method", "be a one-step or an exponential method to be tuned", f"is {method}")
    return same


def delayed(a, delay: int):
    """The step of a loop that acts on the error `delay` samples ago: e[k+1] = e[k] + (A − I) e[k−d], as one matrix."""
    if delay == 0:
        return a
    m = len(a)
    eye = jnp.eye(m, dtype=a.dtype)
    older = jnp.eye(m * (delay + 1), k=-m, dtype=a.dtype)  # each error moves on by one place
    return older.at[:m, :m].set(eye).at[:m, -m:].set(a - eye)


def monotone_limit(delay: int) -> float:
    """Largest share of an error that a step may take back without the error ever changing its sign: d^d/(d+1)^(d+1).

    e[k+1] = e[k] − z e[k−d] has a solution that never changes sign up to this z, and beyond it none (Ladas, Philos &
    Sficas 1989): 1, 1/4, 4/27, … for d = 0, 1, 2, …
    """
    return float(delay) ** delay / float(delay + 1) ** (delay + 1)


# --- size ---------------------------------------------------------------------------------------------


def radius_bound(matrix):
    """A smooth upper bound of the spectral radius, ‖A^p‖^(1/p) with p = 1024 (Gelfand 1941).

    In the Frobenius norm: at most a factor m^(1/2p) above it for normal matrices (0.09 % for m = 6). Eigenvalues
    themselves have no derivative where they coincide, as all do for exact J# and one gain.
    """

    def one(carry, share):
        a, log, dead = carry
        s = safe_sqrt(jnp.sum(a * a))
        dead = dead | (s == 0)
        s = jnp.where(s == 0, 1.0, s)
        a = a / s
        return (a @ a, log + share * jnp.log(s), dead), None

    shares = 0.5 ** jnp.arange(SQUARINGS + 1, dtype=matrix.dtype)
    start = (matrix, jnp.zeros((), matrix.dtype), jnp.zeros((), bool))
    (_, log, dead), _ = jax.lax.scan(one, start, shares)
    return jnp.where(dead, 0.0, jnp.exp(log))


def radius_estimate(matrix):
    """`radius_bound` divided by what it is for the identity, m^(1/2p).

    Right where all eigenvalues are equal in size, and at most that factor too small elsewhere: for bounds that are
    to be reached, such as 1 for a direction that nothing acts on.
    """
    return radius_bound(matrix) / matrix.shape[0] ** (0.5 ** (SQUARINGS + 1))


def measured_radius(matrix):
    """Spectral radius by eigenvalues; inf where the matrix is not finite. No derivative."""
    finite = jnp.all(jnp.isfinite(matrix))
    values = jnp.linalg.eigvals(jnp.where(finite, matrix, 0.0))
    return jnp.where(finite, jnp.max(jnp.abs(values)), jnp.inf)


def radius_over(law, q, alpha, Ts, method, stage, *, delay=0):
    """Spectral radius of the loop at rest at q for many gains and sampling times.

    Args:
      law: its alpha, of any shape, is scaled. q: (n,).
      alpha, Ts: (k,) largest |eigenvalue| of the gain [1/s], sampling time [s].
      method, stage: as for `solve`. delay: samples by which the error is late.
    Returns: (k,).
    """
    q = as_joint_values(law.chain, q)
    law = replace(law, alpha=jnp.asarray(law.alpha))
    scale = np.asarray(alpha) / largest_rate(law.alpha)
    moved, rows = step_maps(law, at_rest(law, None, q), q, scale, Ts, _forgetful(method), stage)
    maps = of_error(moved, rows, np)
    finite = np.isfinite(maps).all((-2, -1))
    factors = np.linalg.eigvals(np.where(finite[:, None, None], maps, 0.0))
    return np.where(finite, np.abs(late_factors(factors, delay)).max((-2, -1)), np.inf)
