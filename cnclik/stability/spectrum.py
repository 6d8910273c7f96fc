"""Spectrum: the one-step map of the whole loop at rest, its eigenvalues, and what gain they allow.

At rest (e = 0, target held) the loop's own `step` is differentiated as it is, passes unrolled. With exact J# every
task direction is then amplified by R(z) and every null-space direction by 1; damping, weights, gain matrices and
null-space velocities come out by themselves.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.method import EE, IE, Method
from cnclik.integrate.solve import advance, cast, evaluations_per_step, solve
from cnclik.integrate.stage import chord, picard
from cnclik.law import reference as ref
from cnclik.law.law import Law, evaluate
from cnclik.record import record, replace
from cnclik.robot.kinematics import as_joint_values, pose
from cnclik.stability.linear import first_above, least_on, named

_SLACK = 1e-9
_AT_REST = 1e-6  # an error above this is not rest [m, rad]


def _one_step(law, reference, q, Ts, method, stage):
    """The map q[k] -> q[k+1] and, for telling directions apart, the rows of the weighted task Jacobian."""
    law, reference, Ts = cast((law, reference, Ts), q.dtype)
    zero = jnp.zeros_like(Ts)
    move = lambda q: jnp.stack(advance(law, reference, tuple(q), zero, Ts, method, stage).q)  # noqa: E731
    at = evaluate(law, reference, zero, tuple(q))
    rows = jnp.stack([jnp.stack([jnp.asarray(x, q.dtype) for x in row]) for row in at.rows])
    return jax.jacfwd(move)(q), rows


def task_map(law, reference, q, Ts, method: Method = EE, stage=picard(5)):
    """The (m, m) matrix by which one step multiplies the (weighted) error at rest: I + J (S − I) J#.

    S = ∂q[k+1]/∂q[k]. Pure, for jit, vmap and grad; nothing is checked. A direction that J has lost keeps its error.
    """
    moved, rows = _one_step(law, reference, q, Ts, method, stage)
    m, n = rows.shape
    return jnp.eye(m, dtype=q.dtype) + rows @ (moved - jnp.eye(n, dtype=q.dtype)) @ jnp.linalg.pinv(rows)


def spectral_radius(law, target, q, Ts, method: Method = EE, stage=picard(5)):
    """Largest |λ| of the loop's one-step map at rest over the directions of the task; stable below 1.

    Null-space directions, which an exact J# leaves alone (λ = 1), are told apart by J. Pure: jit, vmap and grad go
    through for alpha, Ts, damping and geometry (it is not smooth where two eigenvalues meet in size). See
    `spectrum` for the eigenvalues themselves.

    Args:
      law: the right-hand side, see `Law`.
      target: a held `Reference` with e = 0 at q, or None: hold where q is.
      q: (n,) joint values at rest [rad, m].
      Ts: sampling time [s].
      method, stage: as for `solve`.
    """
    method, stage = named(method, stage)
    reference = at_rest(law, target, q)
    return _radius(task_map(law, reference, as_joint_values(law.chain, q), Ts, method, stage))


def _radius(matrix):
    eigenvalues = jnp.linalg.eigvals(matrix)
    squared = jnp.max(eigenvalues.real**2 + eigenvalues.imag**2)
    zero = squared == 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, squared)))


@record
class Spectrum:
    """Eigenvalues of the one-step map at rest.

    Attributes:
      task: (r,) complex, over the r = rank J directions in which the task moves, largest first.
      null: (n − r,) complex, over the null space of J.
      lost: number of task directions J can't move at q; their error stays.
      radius: largest |task|.
      null_radius: largest |null|; exactly 1 where nothing acts in the null space. 0 where there is none.
      direction: (m,) unit vector of task coordinates that belongs to the largest task eigenvalue (real part).
      coupling: how much motion in the null space disturbs the task in one step; 0 for exact J#.
    """

    task: np.ndarray
    null: np.ndarray
    lost: int
    radius: float
    null_radius: float
    direction: np.ndarray
    coupling: float


_LANES = 1024  # one shape for every question, so that a loop is compiled once


def _maps(law, reference, q, scale, Ts, method, stage):
    """S for many gains scale·alpha and sampling times (k,), and J, as NumPy arrays."""
    count = len(scale)
    pad = (0, -count % _LANES)
    scale, Ts = (np.pad(np.asarray(v, float), pad, mode="edge") for v in (scale, Ts))
    parts = [
        _tile(law, reference, q, scale[i : i + _LANES], Ts[i : i + _LANES], method, stage)
        for i in range(0, len(scale), _LANES)
    ]
    return np.concatenate([np.asarray(moved) for moved, _ in parts])[:count], np.asarray(parts[0][1])


@functools.partial(jax.jit, static_argnames=("method",))
def _tile(law, reference, q, scale, Ts, method, stage):
    def one(scale, Ts):
        return _one_step(replace(law, alpha=law.alpha * scale), reference, q, Ts, method, stage)

    moved, rows = jax.vmap(one)(scale, Ts)
    return moved, rows[0]


def spectrum(law, target, q, Ts, method=EE, stage=picard(5)) -> Spectrum:
    """Eigenvalues of the loop's one-step map at rest, task and null-space directions told apart.

    Args: as for `spectral_radius`.
    Raises: ArgumentError where the loop is not at rest at q.
    """
    method, stage = named(method, stage)
    q = as_joint_values(law.chain, q)
    reference = at_rest(law, target, q)
    moved, rows = _maps(law, reference, q, np.ones(1), np.full(1, Ts, float), method, stage)
    moved = moved[0]
    u, sigma, vt = np.linalg.svd(rows)
    rank = int(np.sum(sigma > max(rows.shape) * np.finfo(rows.dtype).eps * 10 * sigma[0]))
    along, across = vt[:rank].T, vt[rank:].T
    task, vectors = np.linalg.eig(along.T @ moved @ along)
    order = np.argsort(-np.abs(task))
    null = np.linalg.eigvals(across.T @ moved @ across) if across.size else np.zeros(0)
    direction = (u[:, :rank] * sigma[:rank]) @ vectors[:, order[0]]
    direction = (direction * np.exp(-1j * np.angle(direction[np.argmax(np.abs(direction))]))).real
    return Spectrum(
        task=task[order].astype(complex),
        null=null[np.argsort(-np.abs(null))].astype(complex),
        lost=rows.shape[0] - rank,
        radius=float(np.abs(task).max()),
        null_radius=float(np.abs(null).max()) if null.size else 0.0,
        direction=direction / np.linalg.norm(direction),
        coupling=float(np.linalg.norm(along.T @ moved @ across, 2)) if across.size else 0.0,
    )


def at_rest(law, target, q):
    """The held reference of a loop at rest at q: `target`, checked, or where q is."""
    if not isinstance(law, Law):
        raise errors.fail("law", "be a Law", f"is {type(law).__name__}")
    q = as_joint_values(law.chain, q)
    if target is None:
        at = pose(law.chain, q)
        position = at.position[jnp.array(law.task.linear)] if law.task.position else None
        return ref.hold(position, at.rotation if law.task.orientation else None)
    ref.check(target, law.task)
    if errors.concrete(q):
        try:
            size = float(_error(law, target, q))
        except jax.errors.ConcretizationTypeError:
            return target  # traced geometry: taken at the caller's word
        if not size < _AT_REST:
            raise errors.fail("q", "be at rest on the target (see `settle`)", f"leaves an error of {size:.3g}")
    return target


@jax.jit
def _error(law, reference, q):
    return jnp.linalg.norm(jnp.stack(evaluate(law, reference, jnp.zeros((), q.dtype), tuple(q)).e))


def settle(law, target, q0, *, N=200):
    """Where the loop comes to rest on a held target: (n,) joint values, found by chord-solved implicit steps.

    Which of a redundant arm's resting places that is depends on the path there, slightly; its stability does not.

    Raises: ArgumentError where the error doesn't vanish, as for a target out of reach.
    """
    q0 = as_joint_values(law.chain, q0, "q0")
    Ts = 1.0 / largest_rate(law.alpha)
    run = solve(law, target, q0, Ts, N, IE, chord(4))
    size = float(jnp.linalg.norm(run.e[-1]))
    if not size < _AT_REST:
        raise errors.fail(
            "target", "be one the loop comes to rest on", f"leaves an error of {size:.3g} after {N} steps"
        )
    return run.q[-1]


def largest_rate(alpha) -> float:
    """The number behind z = alpha·Ts of any gain: its largest |eigenvalue| [1/s]."""
    alpha = np.asarray(alpha)
    size = float(np.max(np.abs(np.linalg.eigvals(alpha) if alpha.ndim == 2 else alpha)))
    if not size > 0:
        raise errors.fail("alpha", "not be 0", f"is {alpha}")
    return size


# --- what gain, what sampling time ---------------------------------------------------------------------


@record
class Recommendation:
    """Safe values of one quantity, alpha or Ts, the other one given.

    Attributes:
      name: "alpha" or "Ts".
      largest: the largest stable value, of the law's alpha's shape; inf where every one is stable.
      fastest: the value with the smallest spectral radius.
      z_largest, z_fastest: alpha·Ts there (largest |eigenvalue| of a gain matrix).
      radius: spectral radius at `fastest`: the factor by which a step then multiplies the error.
      limit: what gives way first beyond `largest`, in words.
      direction: (m,) the task direction in which it does.
      evaluations: evaluations of f that a step costs.
    """

    name: str
    largest: object
    fastest: object
    z_largest: float
    z_fastest: float
    radius: float
    limit: str
    direction: np.ndarray
    evaluations: int

    def __str__(self):
        show = lambda v: np.array2string(np.asarray(v), precision=5, separator=", ")  # noqa: E731
        return (
            f"{self.name}: stable to {show(self.largest)} (z = {self.z_largest:.4g}), fastest at "
            f"{show(self.fastest)} (z = {self.z_fastest:.4g}, error × {self.radius:.3g} per step); {self.limit}"
        )


def recommend(law, q, *, Ts=None, method=EE, stage=picard(5), target=None, reach=1e4) -> Recommendation:
    """Which gain is safe at this sampling time; or, with Ts None, which sampling time at the law's gain.

    The spectral radius of the whole loop at rest (task directions, and null-space directions where a null-space
    velocity moves them) is followed from small gains up to the first one above 1. It is a statement about small
    errors; `certified_radius` and the measured maps say how far it carries.

    Args:
      law: its alpha, of any shape, is what is scaled.
      q: (n,) joint values at rest [rad, m], see `settle`.
      Ts: sampling time [s], or None.
      method, stage: as for `solve`.
      target: the held reference, or None: where q is.
      reach: z up to which is looked.
    """
    method, stage = named(method, stage)
    q = as_joint_values(law.chain, q)
    reference = at_rest(law, target, q)
    rate = largest_rate(law.alpha)
    if Ts is not None:
        errors.number("Ts", Ts, positive=True)

    def loops(z):
        z = np.asarray(z, float)
        scale, times = (np.ones_like(z), z / rate) if Ts is None else (z / (rate * Ts), np.full_like(z, Ts))
        return _maps(law, reference, q, scale, times, method, stage)

    def radius(z):
        return _task_radius(*loops(z))

    def worst(z):
        moved, rows = loops(z)
        return np.maximum(_task_radius(moved, rows), _null_radius(moved, rows))

    z_largest = first_above(worst, 1 + _SLACK, reach)
    z_fastest, least = least_on(radius, min(z_largest, reach))
    if z_fastest >= reach:
        z_fastest = np.inf
    limit, direction = _what_limits(law, reference, q, z_largest, rate, Ts, method, stage)
    value = lambda z: z / rate if Ts is None else np.asarray(law.alpha) * (z / (rate * Ts))  # noqa: E731
    return Recommendation(
        name="Ts" if Ts is None else "alpha",
        largest=value(z_largest),
        fastest=value(z_fastest),
        z_largest=z_largest,
        z_fastest=z_fastest,
        radius=least,
        limit=limit,
        direction=direction,
        evaluations=int(evaluations_per_step(method, stage, law.chain.n)),
    )


def _task_radius(moved, rows):
    m, n = rows.shape
    return _largest(np.eye(m) + rows @ (moved - np.eye(n)) @ np.linalg.pinv(rows))


def _null_radius(moved, rows):
    across = np.linalg.svd(rows)[2][np.linalg.matrix_rank(rows) :]
    if not across.size:
        return 0.0
    return _largest(across @ moved @ across.T)


def _largest(matrices):
    finite = np.isfinite(matrices).all((-2, -1))
    values = np.abs(np.linalg.eigvals(np.where(finite[..., None, None], matrices, 0.0))).max(-1)
    return np.where(finite, values, np.inf)


def _what_limits(law, reference, q, z, rate, Ts, method, stage):
    """The first thing to give way just beyond z, in words, and its direction in the task."""
    name = str(method) + (f" with {stage}" if method.implicit else "")
    if not np.isfinite(z):
        z = 1.0  # only for the direction
        limit = f"no limit from stability: {name} solves the stiff part"
    else:
        limit = None
    beyond = z * (1 + 1e-6)
    scaled, time = (law, beyond / rate) if Ts is None else (replace(law, alpha=law.alpha * (beyond / (rate * Ts))), Ts)
    found = spectrum(scaled, reference, q, time, method, stage)
    if limit is None and found.null_radius > max(found.radius, 1.0):
        limit = "limited by the null-space velocity"
    if limit is None:
        worst = found.task[0]
        if abs(worst.imag) > 1e-6:
            how = f"the error turns by {abs(np.degrees(np.angle(worst))):.3g}° per step and grows"
        else:
            how = "the error changes sign every step and grows" if worst.real < 0 else "the error grows"
        parts = zip(law.task.names, found.direction, strict=True)
        along = ", ".join(f"{axis} {x:+.2f}" for axis, x in parts if abs(x) > 0.005)
        limit = f"limited by {name}: beyond, {how}, along {along}"
    return limit, found.direction


@record
class Margin:
    """How far a loop is from instability.

    Attributes:
      z: alpha·Ts (largest |eigenvalue| of a gain matrix).
      z_largest: where it becomes unstable.
      margin: z_largest/z, the factor by which alpha may still grow; below 1 the loop is unstable.
      radius: spectral radius now.
      limit: what gives way first, in words.
    """

    z: float
    z_largest: float
    margin: float
    radius: float
    limit: str


def margin(law, q, Ts, method=EE, stage=picard(5), *, target=None, reach=1e4) -> Margin:
    """The gain margin of a loop at rest: by which factor alpha may grow before it is unstable.

    Args: as for `recommend`.
    """
    method, stage = named(method, stage)
    found = recommend(law, q, Ts=Ts, method=method, stage=stage, target=target, reach=reach)
    z = largest_rate(law.alpha) * float(Ts)
    radius = spectrum(law, target, q, Ts, method, stage).radius
    return Margin(z=z, z_largest=found.z_largest, margin=found.z_largest / z, radius=radius, limit=found.limit)
