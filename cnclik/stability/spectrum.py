"""Spectrum: the one-step map of the whole loop, differentiated, and its eigenvalues.

At rest (e = 0, constant target) the loop's own `step` is differentiated, including its iterations. With exact J# every
task direction is multiplied by R(z) and every null-space direction by 1; damping, weights, gain matrices and null-space
velocities need no special treatment.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.plan import unless_chosen
from cnclik.hints import LIGHT_COMPILE
from cnclik.integrate.history import blank, primed
from cnclik.integrate.loop import advance
from cnclik.integrate.method import DEFAULT, IE, MethodLike
from cnclik.integrate.solve import solve
from cnclik.integrate.stage import Stage, chord, picard
from cnclik.law import reference as ref
from cnclik.law.inverse import Pseudoinverse
from cnclik.law.law import Law, check_loop, evaluate
from cnclik.law.paths import hold_at
from cnclik.precision import in_float64, in_float64_if_known, of_numbers
from cnclik.record import ArrayLike, Float, Number, cast, record, replace
from cnclik.robot import chart
from cnclik.robot.model import as_joint_values, modelled, one_off, standing
from cnclik.robot.posture import arm_length
from cnclik.robot.rotations import safe_sqrt
from cnclik.stability.linear import checked

REST = 1e-5  # of (1 + the arm's length in m): an error above this is not rest [m, rad]; float32 resolves a tenth of it
LEAVING = 1e-6  # [1/s]: a motion of the null space that grows faster leaves the posture
MEETING = 1e-6  # of a factor of the null space above 1 that is none: where two meet, rounding parts them
ALONE_FROM = 6  # rows from which on lanes are looked at one after the other: batches of LAPACK may wait for each other
LANES = 128  # gains and sampling times looked at together: one shape for every question, compiled once for a loop


# --- the map ------------------------------------------------------------------------------------------


def one_step(law, reference, q, Ts, method, stage):
    """∂q[k+1]/∂q[k] of the step from t = 0 in the chart at q (n, n), and the rows of the weighted task Jacobian (m, n).

    Of a multistep method of p instants it is the map of all that they were, (q[k], …, q[k−p+1]), at rest at q:
    (p·n, p·n), the newest first.
    """
    law, reference, Ts = cast((modelled(law), reference, Ts), q.dtype)
    if law.null_velocity is None:  # with one an arm that is on its way to another posture has stages elsewhere
        law = replace(law, chain=standing(law.chain, q))
    t, n, p, chain = jnp.zeros_like(Ts), len(q), method.steps, law.chain

    def move(instants):
        now, *past = (chart.out(chain, q, y) for y in instants.reshape(p, n))
        history = blank(law, now, method)
        if past:
            history = primed(law, reference, past, t, Ts, method, history)
        made = advance(law, reference, now, t, Ts, method, stage, history)
        return chart.into(chain, q, made.q)

    rows = evaluate(law, reference, t, q).rows
    moved = jax.jacfwd(move)(jnp.tile(chart.centre(chain, q), p))
    if p > 1:
        moved = jnp.concatenate([moved, jnp.eye((p - 1) * n, p * n, dtype=q.dtype)])
    return moved, rows


def step_maps(law, reference, q, scale, Ts, method, stage, often=False):
    """`one_step` for many gains scale·alpha and sampling times (k,): (k, p·n, p·n) and (m, n), NumPy arrays.

    Args: often: whether many more of this loop are asked for.
    """
    count, lanes = len(scale), 1 if law.task.m > ALONE_FROM else LANES
    pad = (0, -count % lanes)
    scale, Ts = (np.pad(np.asarray(v, float), pad, mode="edge") for v in (scale, Ts))
    tile = _tiles_run_often if often and method.implicit else _tiles
    parts = [
        tile(law, reference, q, scale[i : i + lanes], Ts[i : i + lanes], method, stage)
        for i in range(0, len(scale), lanes)
    ]
    return np.concatenate([np.asarray(moved) for moved, _ in parts])[:count], np.asarray(parts[0][1])


def _tile(law, reference, q, scale, Ts, method, stage):
    def one(scale, Ts):
        return one_step(replace(law, alpha=law.alpha * scale), reference, q, Ts, method, stage)

    if law.task.m > ALONE_FROM:
        moved, rows = jax.lax.map(lambda each: one(*each), (scale, Ts))
    else:
        moved, rows = jax.vmap(one)(scale, Ts)
    return moved, rows[0]


_tiles = one_off(_tile, static_argnames=("method",))
# Of passes 2.5 ms each, where QUICK_COMPILE's take 15, and 0.5 s more to compile: an advice asks for 70.
_tiles_run_often = one_off(_tile, compiler=LIGHT_COMPILE, static_argnames=("method",))


def of_error(moved, rows, xp=jnp, inverse=None):
    """What maps S of q (..., n, n) do to the error at rest where the task's rows are J (m, n): I + J (S − I) J#.

    Of p instants, (..., p·n, p·n), it is what they do to as many errors. Args: inverse: J# (n, m), if it is known.
    """
    p = moved.shape[-1] // rows.shape[1]
    down, up = (at_instants(v, p, xp) for v in (rows, xp.linalg.pinv(rows) if inverse is None else inverse))
    eye = xp.eye(moved.shape[-1], dtype=rows.dtype)
    return xp.eye(len(down), dtype=rows.dtype) + down @ (moved - eye) @ up


def at_instants(matrix, p: int, xp=np):
    """A matrix that acts on each of p instants."""
    return matrix if p == 1 else xp.kron(xp.eye(p, dtype=matrix.dtype), matrix)


def task_map(law, reference, q, Ts, method=DEFAULT, stage=picard(5)):
    """The (m, m) matrix by which one step multiplies the (weighted) error at rest, see `of_error`: (p·m, p·m) of p
    instants.

    Pure, for jit, vmap and grad; nothing is checked. A direction that J has lost keeps its error.
    """
    return of_error(*one_step(law, reference, q, Ts, method, stage))


@in_float64_if_known
def spectral_radius(
    law: Law,
    reference: ref.Reference | None,
    q: Float[ArrayLike, " n"],
    Ts: Number,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
) -> Number:
    """Largest |λ| of the loop's one-step map at rest over the directions of the task; stable below 1.

    Null-space directions, which an exact J# leaves unchanged (λ = 1), are separated by J. Pure: jit, vmap and grad go
    through for alpha, Ts, damping and geometry, in the caller's precision (it is not smooth where two eigenvalues have
    the same size). Called with numbers it is computed in float64. See `spectrum` for the eigenvalues themselves.

    Args:
      law: the right-hand side, see `Law`.
      reference: a constant `Reference` with e = 0 at q, or None: hold the pose at q.
      q: (n,) joint values at rest [rad, m].
      Ts: sampling time [s].
      method, stage: as for `solve`.
    Raises: ArgumentError where q is not at rest on the target, or Ts is not a positive number.
    """
    method, stage = checked(method, stage)
    Ts = 1.0 * errors.number("Ts", Ts, positive=True)
    given = *at_rest(law, reference, q), as_joint_values(law.chain, q), Ts
    if all(map(errors.concrete, jax.tree.leaves(given))):
        return np.float64(_radius_of_numbers(*given, method, stage))
    return _radius(*given, method, stage)


def _radius(law, reference, q, Ts, method, stage):
    found = jnp.linalg.eigvals(task_map(law, reference, q, Ts, method, stage))
    return safe_sqrt(jnp.max(found.real**2 + found.imag**2))


_radius_of_numbers = one_off(_radius, static_argnames=("method",))  # one program, not one for each operation


# --- eigenvalues --------------------------------------------------------------------------------------


@record
class Spectrum:
    """Eigenvalues of the one-step map; a multistep method of p instants has p times as many.

    Attributes:
      task: (r,) complex, over the r = rank J directions in which the task moves, largest first.
      null: (n − r,) complex, over the null space of J.
      lost: number of task directions that J cannot move at q; their error remains.
      radius: largest |task|.
      null_radius: largest |null|; exactly 1 where nothing acts in the null space, 0 without a null space.
      direction: (m,) unit vector of task coordinates of the largest task eigenvalue (real part).
      coupling: how much motion in the null space disturbs the task in one step; 0 for exact J#.
    """

    task: np.ndarray
    null: np.ndarray
    lost: int
    radius: float
    null_radius: float
    direction: np.ndarray
    coupling: float


@in_float64
def spectrum(law, reference, q, Ts, method=DEFAULT, stage=picard(5)) -> Spectrum:
    """Eigenvalues of the loop's one-step map at rest, separated into task and null-space directions. In float64.

    Args: as for `spectral_radius`.
    Raises: as `spectral_radius`.
    """
    method, stage = checked(method, stage)
    errors.number("Ts", Ts, positive=True)
    law, held = at_rest(law, reference, q)
    return spectrum_of(*step_map(law, held, as_joint_values(law.chain, q), Ts, method, stage))


def step_map(law, reference, q, Ts, method, stage, often=False):
    """`step_maps` for the law's own gain at one sampling time: (n, n) and (m, n)."""
    moved, rows = step_maps(law, reference, q, np.ones(1), np.full(1, Ts, float), method, stage, often)
    return moved[0], rows


def spectrum_of(moved, rows) -> Spectrum:
    """The spectrum of a one-step map S (n, n), or (p·n, p·n), where the task's rows are J (m, n)."""
    u, sigma, along, across = directions(rows)
    rank, p = along.shape[1], moved.shape[-1] // rows.shape[1]
    along, across = at_instants(along, p), at_instants(across, p)
    task, vectors = np.linalg.eig(along.T @ moved @ along)
    order = np.argsort(-np.abs(task))
    null = np.linalg.eigvals(across.T @ moved @ across)
    direction = np.zeros(len(rows))
    if rank:
        found = (u[:, :rank] * sigma[:rank]) @ vectors[:rank, order[0]]
        found = (found * np.exp(-1j * np.angle(found[np.argmax(np.abs(found))]))).real
        direction = found / np.linalg.norm(found)
    return Spectrum(
        task=task[order].astype(complex),
        null=null[np.argsort(-np.abs(null))].astype(complex),
        lost=rows.shape[0] - rank,
        radius=float(np.abs(task).max(initial=0.0)),
        null_radius=float(np.abs(null).max(initial=0.0)),
        direction=direction,
        coupling=float(np.linalg.norm(along.T @ moved @ across, 2)) if across.size and rank else 0.0,
    )


def directions(rows):
    """Left singular vectors and singular values of J, and bases of joint directions along the task and across it."""
    u, sigma, vt = np.linalg.svd(rows)
    rank = int(np.sum(sigma > max(rows.shape) * np.finfo(rows.dtype).eps * 10 * sigma[0]))
    return u, sigma, vt[:rank].T, vt[rank:].T


def task_radius(moved, rows):
    """Largest |λ| (k,) of maps (k, n, n) over the task directions that J (m, n) moves; inf where not finite."""
    return largest(moved, directions(rows)[2])


def null_flow(law, held, q):
    """How the velocity at rest at q changes with q, ∂q̇/∂q (n, n), and the rows of the weighted J (m, n). Pure."""
    law, held = cast((modelled(law), held), q.dtype)

    def flow(y):
        found = evaluate(law, held, jnp.zeros_like(q[0]), chart.out(law.chain, q, y))
        return found.qdot, found.rows

    return jax.jacfwd(flow, has_aux=True)(chart.centre(law.chain, q))


null_flow_of_numbers = one_off(null_flow)


def growing(flow, rows):
    """Projection (n, n) on the motions of the null space of J that leave a posture for another by the flow ∂q̇/∂q.

    It is the null-space velocity itself that carries them away: no gain or sampling time is to blame.
    """
    if not (np.isfinite(flow).all() and np.isfinite(rows).all()):
        return np.zeros_like(flow)
    across = directions(rows)[3]
    inner = across.T @ flow @ across
    rates, vectors = np.linalg.eig(inner)
    return across @ ((vectors * (rates.real > LEAVING)) @ np.linalg.pinv(vectors)).real @ across.T


def staying(moved, growth):
    """Maps (..., p·n, p·n) that leave motions of a projection `growing` (..., n, n) as they are."""
    n = growth.shape[-1]
    p = moved.shape[-1] // n
    if p == 1:
        return moved - growth @ moved @ growth + growth
    all_of_it = at_instants(growth, p)
    found = all_of_it @ moved @ all_of_it
    still = np.concatenate([np.broadcast_to(np.kron(np.eye(1, p), growth), found[:, :n].shape), found[:, n:]], 1)
    return moved - found + still


def largest(moved, basis):
    """Largest |λ| (k,) of maps (k, n, n) over the directions of a basis, 0 of none; inf where not finite."""
    basis = at_instants(basis, moved.shape[-1] // len(basis))
    parts = basis.T @ moved @ basis
    finite = np.isfinite(moved).all((-2, -1))
    values = np.abs(np.linalg.eigvals(np.where(finite[..., None, None], parts, 0.0))).max(-1, initial=0.0)
    return np.where(finite, values, np.inf)


# --- rest ---------------------------------------------------------------------------------------------


def at_rest(law, reference, q) -> tuple[Law, ref.Reference]:
    """The law and a constant reference of a loop at rest at q, after a check that `reference` is there, too.

    The reference is where q is. A null-space velocity that moves the arm there is taken less that motion: on its way
    to another posture the arm passes through rests of this loop, and the motion is no error of any of them.

    Raises: ArgumentError where `reference` (None: any) is elsewhere at t = 0 by more than REST.
    """
    check_loop(law, *(() if reference is None else (reference,)))
    q = as_joint_values(law.chain, q, finite=True)
    if reference is not None and errors.concrete(q):
        _require_rest(law, reference, q)
    held = held_at(law, q)
    if law.null_velocity is None:
        return law, held
    known = all(map(errors.concrete, jax.tree.leaves((law, q))))
    drift = (drift_of_numbers if known else _drift)(law, held, q)
    if known and not np.isfinite(drift).all():
        raise errors.fail("null_velocity", "give a finite velocity at q", f"is {np.asarray(drift).tolist()}")
    return _without(law, q, drift), held


def _without(law, q, drift):
    """The law with a posture whose pull at q is less by a constant part (n,)."""
    null, chain = law.null_velocity, law.chain
    rest = chart.moved(chain, q, chart.between(chain, q, null.rest) - drift / null.rate)
    return replace(law, null_velocity=replace(null, rest=rest))


def _drift(law, held, q):
    """The part (n,) of q̇₀ that moves the arm at rest at q."""
    (law, held), drift = cast((modelled(law), held), q.dtype), jnp.zeros_like(q)
    for limits in (None, law.limits):  # without them first: they may shorten what they are given
        now = replace(_without(law, q, drift), limits=limits)
        drift = drift + evaluate(now, held, jnp.zeros_like(q[0]), q).qdot
    return drift


drift_of_numbers = one_off(_drift)


def held_at(law, q):
    """The held reference of a loop at rest at q, told that it moves no more."""
    held, dtype = hold_at(law.chain, law.task, q), q.dtype
    return ref.of_each(lambda one, parts: replace(one, feedforward=np.zeros(parts.width, dtype)), held, law.task)


def leaky(law) -> bool:
    """Whether a null-space velocity may pull at the task: I − J# J is a projector of the pseudoinverse alone."""
    return law.null_velocity is not None and not isinstance(law.inverse, Pseudoinverse)


def _require_rest(law, reference, q):
    try:
        size = float(jnp.linalg.norm(error_of_numbers(law, reference, q)))
        near = size < rest_tolerance(law.chain)
    except jax.errors.ConcretizationTypeError:
        return  # traced geometry: taken at the caller's word
    if not near:
        raise errors.fail("q", "be at rest on the target (see `settle`)", f"leaves an error of {size:.3g}")


def rest_tolerance(chain):
    """The error up to which a loop counts as at rest [m, rad]."""
    return REST * (1 + arm_length(chain))


@one_off
def error_of_numbers(law, reference, q):
    """e (m,) at t = 0."""
    return evaluate(modelled(law), reference, jnp.zeros_like(q[0]), q).e


@in_float64
def settle(law: Law, reference: ref.Reference, q0: Float[ArrayLike, " n"], *, N: int = 200) -> Float[np.ndarray, " n"]:
    """Joint values (n,) at which the loop rests on a constant target, found by implicit steps with the chord stage.

    Computed in float64 and returned as a NumPy array. The resting posture of a redundant arm depends slightly on the
    path to it; its stability does not.

    Raises: ArgumentError where the error does not vanish, as for a target out of reach.
    """
    check_loop(law, reference)
    q0 = as_joint_values(law.chain, q0, "q0")
    with unless_chosen("plain"):  # once, so XLA's few passes over it are done in half of C's time
        run = solve(law, reference, q0, 1.0 / largest_rate(law.alpha), N, IE, chord(4))
    size = float(np.linalg.norm(np.asarray(run.e)[-1]))
    if not size < rest_tolerance(law.chain):
        why = ", as the null-space velocity pulls at it" * leaky(law)
        found = f"leaves an error of {size:.3g} after {N} steps{why}"
        raise errors.fail("target", "be one the loop comes to rest on", found)
    return np.asarray(run.q)[-1]


@of_numbers
def largest_rate(alpha) -> float:
    """The rate of any gain, for z = alpha·Ts: the largest of its numbers [1/s]."""
    alpha = np.asarray(alpha)
    size = float(np.max(np.abs(alpha)))
    if not size > 0:
        raise errors.fail("alpha", "not be 0", f"is {alpha}")
    return size
