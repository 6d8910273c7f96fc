"""Loop: a law at rest with its method and its drive, and what its steps do to small errors."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive
from cnclik.integrate.method import EE, Method, Multistep
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage
from cnclik.law.curves import Hold
from cnclik.law.law import Law, check_loop, evaluate
from cnclik.law.reference import Reference, of_each
from cnclik.precision import of_numbers
from cnclik.record import AnyArray, Float, cast, replace
from cnclik.robot.model import as_joint_values, modelled, one_off
from cnclik.stability.driven import alike, increments, looked_at, modes_of, radius
from cnclik.stability.drives import own_drives
from cnclik.stability.linear import FEW, checked
from cnclik.stability.spectrum import (
    Spectrum,
    at_rest,
    directions,
    error_of_numbers,
    growing,
    largest,
    largest_rate,
    null_flow_of_numbers,
    rest_tolerance,
    spectrum_of,
    staying,
    step_map,
    step_maps,
)

GAINS = 256  # looked at together
LEAST = 1e-15  # share of the gain down to which a stable one is looked for
UNSTABLE = 1 + 1e-6  # spectral radius at rest beyond which a loop is unstable: smaller excess is rounding


class LoopAtRest(NamedTuple):
    """A loop at rest, checked, with the number behind its gain, see `at_rest`."""

    law: Law
    held: Reference
    q: Float[AnyArray, " n"]
    method: Method | Multistep
    stage: Stage
    rate: float
    drive: Drive
    known: dict  # what was asked for: limits of one loop look at the same gains

    def _once(self, key, make):
        if key not in self.known:
            self.known[key] = make()
        return self.known[key]

    @property
    def prompt(self) -> LoopAtRest:
        return self._replace(drive=Drive())

    @property
    def points(self) -> int:
        """How many gains are looked at together."""
        n, late = self.law.chain.n, self.drive.lumped.delay
        found = looked_at(self.drive, n * (3 + late) - late if own_drives(self.drive) else 3)
        return found if self.rates else max(found, FEW + 1)  # maps come many at a time

    @property
    def rates(self) -> Rates | None:
        """See `rates_of`."""
        return self._once("rates", lambda: rates_of(self.law, self.held, self.q))

    def maps(self, scale, Ts):
        """See `step_maps`, `staying`."""
        scale, Ts = np.asarray(scale, float), np.asarray(Ts, float)
        return self._once((self.method, scale.tobytes(), Ts.tobytes()), lambda: self._maps(scale, Ts))

    def _maps(self, scale, Ts):
        if self.rates is None:
            moved, rows = step_maps(self.law, self.held, self.q, scale, Ts, self.method, self.stage, often=True)
            return moved if self.law.null_velocity is None else staying(moved, self.growing()), rows
        return self.rates.maps(scale, Ts, self.method, self.stage)

    def growing(self):
        """See `spectrum.growing`."""
        return self._once("growing", lambda: growing(*self.flow()))

    def flow(self):
        """See `spectrum.null_flow`."""
        made = self._once("flow", lambda: null_flow_of_numbers(self.law, self.held, self.q))
        return [*map(np.asarray, made)]

    def now(self, Ts) -> Spectrum:
        """Its eigenvalues with the gain it has."""
        if self.rates is None:
            return spectrum_of(*step_map(self.law, self.held, self.q, Ts, self.method, self.stage, often=True))
        moved, rows = self.maps(np.ones(1), np.full(1, Ts))
        return spectrum_of(moved[0], rows)

    def _at(self, z, Ts):
        """Scales of the gain, and sampling times, of z; with Ts None of sampling times."""
        z = np.asarray(z, float)
        return (np.ones_like(z), z / self.rate) if Ts is None else (z / (self.rate * Ts), np.full_like(z, Ts))

    def along(self, z, Ts=None):
        """`maps` at gains of z; with Ts None at sampling times of z."""
        return self.maps(*self._at(z, Ts))

    def radii(self, z, Ts=None):
        """Spectral radii (k,) over the task's directions, and over the null space's where it moves; see `along`."""
        if self.drive.prompt and self.rates is None:
            moved, rows = self.along(z, Ts)
            return tuple(largest(moved, basis) for basis in directions(rows)[2:])
        task, null = self.modes(z, Ts)
        Ts = 1.0 if Ts is None else Ts  # of prompt drives, which know none
        moves = self.law.null_velocity is not None
        return radius(task, self.drive, Ts), radius(null, self.drive, Ts) if moves else np.zeros(len(task))

    def modes(self, z, Ts=None):
        """What a step does in the directions of the task, and of the null space, at gains of z; see `modes_of`."""
        if self.rates is None:
            moved, rows = self.along(z, Ts)
            _, _, along, across = directions(rows)
            return modes_of(moved, along, self.drive), modes_of(moved, across, self.drive)
        scale, times = self._at(z, Ts)
        taken = self.rates.taken(scale[:, None], times[:, None], self.method)
        task = self.rates.driven(taken, self.method, self.stage, self.drive)
        return task, np.zeros((len(scale), 0, self.method.steps))

    def share_radii(self, share, Ts):
        """Spectral radii (k,) over the task's directions with shares (k,) of the gain."""
        return self.radii(np.asarray(share) * self.rate * Ts, Ts)[0]

    def stable_share(self, Ts) -> float:
        """Share of the gain up to which it is stable, to 1 %: 1 if all of it is, 0 below LEAST.

        All of it counts, too, where only smaller gains are not: those that don't outweigh what else moves the task.
        """
        count = GAINS if self.drive.prompt else looked_at(self.drive, 3)

        def bad(share):
            return ~(self.share_radii(share, Ts) <= UNSTABLE)

        least, whole = bad(np.array([LEAST, 1.0]))
        if least and not whole:
            return 1.0
        for top in np.geomspace(1, LEAST, 6)[:-1]:  # three decades at a time
            grid = np.geomspace(top * 1e-3, top, count)
            unstable = bad(grid)
            first = int(np.argmax(unstable))
            if not unstable.any():
                return float(top)
            if first > 0:
                grid = np.linspace(grid[first - 1], grid[first], count)
                return float(grid[max(int(np.argmax(bad(grid))) - 1, 0)])
        return 0.0

    def fastest_share(self, Ts, most=1.0) -> float:
        """Share of the gain, at most `most`, with which it settles soonest."""
        count = GAINS if self.drive.prompt else 2 * (looked_at(self.drive, 3) // 2)
        grid = np.linspace(0, 1, count + 1)[1:]
        for _ in range(2):
            best = grid[np.argmin(self.share_radii(most * grid, Ts))]
            grid = np.clip(best + (np.arange(count) - count // 2) / (count // 2) / count, 1e-9, 1.0)
        return most * float(best)


FINE = 0.2  # of an error that a step removes, on the way to where a stack rests
LONG = 2000  # steps of it


@of_numbers
def rest_of_stack(law: Law, reference, q0) -> Float[np.ndarray, " n"]:
    """Where a stack rests with its targets held where they are at t = 0: (n,) joint values, after a long run.

    Its errors need not vanish there, as tasks may ask for what they can't all have. One that begins on its targets
    stays where it begins.
    """
    check_loop(law, reference)
    q0 = as_joint_values(law.chain, q0, "q0")
    held = of_each(lambda one, _: _held_at_start(one), reference, law.task)
    at = np.asarray(error_of_numbers(law, held, q0))
    if np.linalg.norm(at) < rest_tolerance(law.chain):
        return np.asarray(q0)
    run = solve(law, held, q0, FINE / largest_rate(law.alpha), LONG, EE)
    if not np.isfinite(np.asarray(run.q)[-1]).all():
        raise errors.fail("target", "be one the loop comes to rest on", "makes joint values that are not finite")
    return np.asarray(run.q)[-1]


def _held_at_start(one):
    position, rotation = one.curve(0.0)
    return Reference(curve=Hold(position=position, rotation=rotation))


def loop_at_rest(law, reference, q, method, stage, drive=Drive()) -> LoopAtRest:
    """Args: as for `recommend`."""
    method, stage = checked(method, stage)
    (law, held), drive = at_rest(law, reference, q), check_drive(drive, law.chain)
    return LoopAtRest(law, held, as_joint_values(law.chain, q), method, stage, largest_rate(law.alpha), drive, {})


def resting(law, q, method, stage, drive) -> LoopAtRest:
    """The same of a checked loop at any instant of a run, the error being what it is there; a gain of 0 is one, too."""
    rate, q = largest_rate(law.alpha) if np.any(law.alpha) else 1.0, as_joint_values(law.chain, q)
    leads = law.null_velocity is not None  # to another posture
    known = {} if leads else {"growing": np.zeros((len(q), len(q)))}
    return LoopAtRest(*at_rest(law, None, q), q, method, stage, rate, drive, known)


# --- rates: the linear loop at rest, ė = −J J#K e, and what a step of a method makes of it ------------
# At rest J# stands still for what is small: a step multiplies a motion of the joints by R(Ts·J#KJ), R the method's own
# factor, and of an exponential step by I − J#(I − e^{−K·Ts})J. That holds of every method, stage, inverse and limit,
# as long as no null-space velocity moves with the joints; `spectrum.step_maps` differentiates the step itself, and the
# tests hold one to the other.


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
    return Rates(
        rows=np.linalg.solve(turned, rows),
        columns=columns @ turned,
        damping=None if shift is None else np.sqrt(np.broadcast_to(np.asarray(shift, float), (m,))),
        alpha=np.broadcast_to(alpha, (m,)),
        turned=turned,
        along=directions(rows)[2],
    )
