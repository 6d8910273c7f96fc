"""Rates: the loop at rest as the linear one that it is there, ė = −J J#K e, and what a step of a method makes of it.

At rest J# stands still for what is small: a step multiplies a motion of the joints by R(Ts·J#KJ), R the method's own
factor, and of an exponential step by I − J#(I − e^{−K·Ts})J. That holds of every method, stage, inverse and limit, as
long as no null-space velocity moves with the joints; `spectrum.step_maps` differentiates the step itself, and the tests
hold one to the other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.law.law import evaluate, weighted_gain
from cnclik.record import AnyArray, Float, cast, replace
from cnclik.robot.model import modelled, one_off
from cnclik.stability.driven import alike, increments
from cnclik.stability.drives import own_drives
from cnclik.stability.spectrum import directions

_TURNED = 1e6  # condition of a gain matrix's eigenvectors, beyond which they are none
_REAL = 1e-6  # share of rates up to which an imaginary part is rounding


class Rates(NamedTuple):
    """A loop at rest, in task coordinates in which its gain is diagonal."""

    rows: AnyArray  # J (m, n), weighted
    columns: AnyArray  # J# (n, m)
    damping: Float[AnyArray, " m"] | None  # λ of each row, where J# = Jᵀ (J Jᵀ + diag(λ²))⁻¹
    alpha: AnyArray  # (m,), complex of a gain that turns
    turned: AnyArray  # (m, m), from these coordinates to the weighted task's
    along: Float[AnyArray, "n r"]  # directions of the joints in which the task moves

    def taken(self, scale, Ts, method):
        """What a step takes of errors (k, m): z, or of an exponential step 1 − e^{−z}. Args: scale: (k, 1) or (k, m)
        of the gains; Ts: (k, 1)."""
        z = scale * self.alpha * Ts
        return -increments(method, None, z)[..., 0] if method.exponential else z

    def matrices(self, taken):
        """What a step takes of motions of the joints, in the directions `along` (k, r, r)."""
        found = (self.along.T @ self.columns) @ (taken[..., None] * (self.rows @ self.along))
        return _real(found)

    def driven(self, taken, method, stage, drive):
        """Modes D (k, r, p) as `cnclik.stability.driven` takes them; where joints differ in their drives, `steps`."""
        if own_drives(drive):
            return self.steps(taken, method, stage)
        return alike(steps_of(_real(np.linalg.eigvals(self.matrices(taken))), method, stage))

    def maps(self, scale, Ts, method, stage):
        """What `spectrum.step_maps` finds for gains scale·alpha and sampling times (k,): (k, p·n, p·n) and (m, n)."""
        steps = self.steps(self.taken(scale[:, None], Ts[:, None], method), method, stage)
        k, p, n, _ = steps.shape
        first = np.moveaxis(steps, 1, 2).reshape(k, n, p * n) + np.eye(n, p * n)
        past = np.broadcast_to(np.eye((p - 1) * n, p * n), (k, (p - 1) * n, p * n))
        return np.concatenate([first, past], 1), (self.turned @ self.rows).real

    def steps(self, taken, method, stage):
        """D (k, p, n, n) of the joints."""
        rates, vectors = np.linalg.eig(self.matrices(taken))
        each = vectors[:, None] * np.moveaxis(steps_of(_real(rates), method, stage), -1, 1)[..., None, :]
        return self.along @ (each @ np.linalg.inv(vectors)[:, None]).real @ self.along.T


def _real(found):
    close = np.abs(np.imag(found)).max(initial=0.0) <= _REAL * np.abs(found).max(initial=0.0)
    return np.real(found) if close else found


def steps_of(taken, method, stage):
    """D (..., p) of modes of which a step takes z, or a share."""
    return -taken[..., None] if method.exponential else increments(method, stage, taken)


def parts_at_rest(law, held, q):
    """J (m, n) weighted, J# (n, m), and the shift of its damping, if it is such an inverse. Pure."""
    law, held = cast((modelled(law), held), q.dtype)
    made = evaluate(law, held, jnp.zeros_like(q[0]), q)
    inverse = replace(law.inverse, e=0.0 * made.e) if getattr(law.inverse, "by_error", False) else law.inverse
    factored = inverse(made.rows)
    return made.rows, jax.vmap(made.apply, out_axes=1)(jnp.eye(len(made.e), dtype=q.dtype)), factored.shift


parts_of_numbers = one_off(parts_at_rest)


def rates_of(law, held, q) -> Rates | None:
    """A law at rest, see `at_rest`; None with a null-space velocity, and where the gain's eigenvectors meet."""
    if law.null_velocity is not None:
        return None
    rows, columns, shift = parts_of_numbers(law, held, q)
    rows, columns = np.asarray(rows, float), np.asarray(columns, float)
    m, alpha, turned = law.task.m, np.asarray(law.alpha, float), np.eye(law.task.m)
    if alpha.ndim == 2:
        blocks = [at for _, at in law.task.each] or [slice(None)]
        alpha, turned = _diagonal(np.asarray(weighted_gain(law), float), blocks)
        if np.linalg.cond(turned) > _TURNED:
            return None
    return Rates(
        rows=np.linalg.solve(turned, rows),
        columns=columns @ turned,
        damping=None if shift is None else np.sqrt(np.broadcast_to(np.asarray(shift, float), (m,))),
        alpha=np.broadcast_to(alpha, (m,)),
        turned=turned,
        along=directions(rows)[2],
    )


def _diagonal(matrix, blocks):
    """Eigenvalues (m,) and eigenvectors (m, m) of a matrix, of each block by itself."""
    kind = float if np.array_equal(matrix, matrix.T) else complex
    values, vectors = np.zeros(len(matrix), kind), np.zeros_like(matrix, kind)
    for at in blocks:
        values[at], vectors[at, at] = (np.linalg.eigh if kind is float else np.linalg.eig)(matrix[at, at])
    return _real(values), _real(vectors)
