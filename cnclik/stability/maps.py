"""Maps: outcomes of whole nonlinear loops over alpha, Ts and M, with the linear stability limit."""

import math

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.plan import in_c
from cnclik.integrate.drive import Drive, check_drive, sampled
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import DEFAULT, MethodLike, evaluations_per_step
from cnclik.integrate.solve import answers_soon
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import check_loop
from cnclik.measure.outcome import Ending, Outcome, outcome, stable
from cnclik.precision import in_float64, of_numbers
from cnclik.record import replace
from cnclik.robot.model import as_joint_values, one_off
from cnclik.stability.driven import SLACK, least_limits
from cnclik.stability.linear import checked, stability_limit
from cnclik.stability.loop import loop_at_rest
from cnclik.stability.recommend import largest_stable
from cnclik.stability.spectrum import largest_rate, settle
from cnclik.stability.tasks import bounded_rates, shares_of

CHUNK = 1 << 15  # loops run between two looks at the progress
RAYS = 64  # of a map of gains, to each of two edges, along which its limit is looked for
LEAST = 1e-6  # share of the largest gain, at least, of the smallest at such an edge
HALVINGS = 24  # of the range of such a limit
LOOPS_PER_CALL = 1 << 10  # loops that one core runs at a time: small, as those that diverge may take longer


@in_float64
def outcomes(
    law,
    reference,
    q0,
    *,
    alpha,
    Ts,
    M=None,
    N=100,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive=Drive(),
    tolerance=1e-3,
    scale=None,
    chunk=CHUNK,
    progress=None,
) -> Outcome:
    """Run a loop for every given combination and classify how each ended, see `outcome`. In float64.

    Args:
      law, reference: the loop; a gain that is not a scalar is scaled so that its largest |eigenvalue| is alpha.
      q0: (..., n) start; alpha, Ts, M: (...). All are broadcast against each other, one loop each.
      M: iterations in place of the stage's own, or None.
      drive: model of the drives, see `Drive`; its dead time is in samples, all else in seconds.
      N, tolerance, scale: number of steps, and what counts as converged.
      chunk: loops run between two calls of `progress`, on all cores.
      progress: called as progress(loops done, loops in all), or None.
    Returns: `Outcome` of NumPy arrays (...).
    """
    method, stage = checked(method, stage)
    check_loop(law, reference)
    check_drive(drive, law.chain)
    N = errors.integer("N", N, at_least=4, at_most=errors.MOST)
    errors.number("tolerance", tolerance, positive=True)
    errors.progress(progress)
    q0, alpha, Ts, shape = _alike(law.chain.n, q0=q0, alpha=alpha, Ts=Ts, M=0 if M is None else M)
    count = math.prod(shape)
    chunk = min(errors.integer("chunk", chunk, at_least=1), count)
    pad = -count % chunk

    def flat(values, kind=float, tail=()):
        values = np.broadcast_to(np.asarray(values, kind), shape + tail).reshape((count, *tail))
        return np.concatenate([values, np.broadcast_to(values[-1:], (pad, *tail))])  # one shape, one compilation

    factor, time = flat(alpha) / largest_rate(law.alpha), flat(Ts)
    # Sampled once for each sampling time: the matrix exponential has no place in a program for many loops.
    times, which = np.unique(time, return_inverse=True)
    models = None
    if not drive.prompt:
        models = jax.tree.map(lambda *each: np.stack(each)[which], *(sampled(drive, float(T)) for T in times))
    start = flat(q0, tail=q0.shape[-1:])
    if M is not None:
        M = flat(M, int)
        stage = replace(stage, M=None, maximum=max(stage.maximum, int(np.max(M))))

    def one(q0, factor, Ts, M, model):
        gained = replace(law, alpha=law.alpha * factor)
        own = stage if M is None else replace(stage, M=M)
        through = dict(drive=drive, model=model)
        return outcome(gained, reference, q0, Ts, N, method, own, **through, tolerance=tolerance, scale=scale)

    evaluations = count * N * int(evaluations_per_step(method, replace(stage, M=stage.maximum), law.chain.n))
    soon = not in_c() and answers_soon(evaluations, law)  # C does: 64 loops of G1 take it as long as XLA, 1,600 a tenth
    run = one_off(jax.vmap(one)) if soon else lanes(one, block=LOOPS_PER_CALL)
    done = []
    for i in range(0, count, chunk):
        part = jax.tree.map(lambda v: v[i : i + chunk], (start, factor, time, M, models))  # noqa: B023
        done.append(jax.tree.map(np.asarray, run(*part)))
        if progress is not None:
            progress(min(i + chunk, count), count)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count].reshape(shape), *done)


def _alike(n, **given) -> tuple:
    """(q0, alpha, Ts) as arrays, and the shape of all loops. Raises: ArgumentError for values that do not fit."""
    q0, alpha, Ts, M = (np.asarray(errors.array(name, value), float) for name, value in given.items())
    if not np.all(Ts > 0):
        raise errors.fail("Ts", "be positive", f"is {Ts.tolist()}")
    if np.any(M < 0):
        raise errors.fail("M", "be at least 0", f"is {M.tolist()}")
    if np.any((M > 1_000_000) | (np.round(M) != M)):
        raise errors.fail("M", "be whole, and at most a million", f"is {M.tolist()}")
    if q0.shape[-1:] != (n,):
        raise errors.fail("q0", f"have shape (..., {n})", f"has shape {q0.shape}")
    shapes = q0.shape[:-1], alpha.shape, Ts.shape, M.shape
    try:
        shape = np.broadcast_shapes(*shapes)
    except ValueError:
        shape = (0,)
    if not math.prod(shape):
        raise errors.fail("q0, alpha, Ts, M", "go with each other, one loop at least", f"have the shapes {shapes}")
    return q0, alpha, Ts, shape


@in_float64
def stability_map(
    law,
    reference,
    q0,
    *,
    alpha,
    Ts,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive=Drive(),
    N=100,
    rest=None,
    **options,
):
    """Outcomes of simulated loops over the (alpha, Ts) plane, and the linear limit of the loop at rest. In float64.

    Args:
      law, reference, q0: the loop; the reference must be constant.
      alpha: (a,) gains [1/s]. Ts: (b,) sampling times [s].
      method, stage: as for `solve`. drive: as for `outcomes`.
      rest: posture at which the loop rests, if known; otherwise `settle` finds it.
      N, options: as for `outcomes`.
    Returns: an xarray.Dataset over (Ts, alpha), with `limit` (Ts,), the largest stable alpha by `recommend`.
    """
    import xarray as xr

    method, stage = checked(method, stage)
    check_loop(law, reference)
    q0 = as_joint_values(law.chain, q0, "q0")
    alpha, Ts = (np.asarray(errors.array(n, v, (None,)), float) for n, v in (("alpha", alpha), ("Ts", Ts)))
    rest = settle(law, reference, q0) if rest is None else rest
    how = dict(method=method, stage=stage, drive=drive)
    made = outcomes(law, reference, q0, alpha=alpha, Ts=Ts[:, None], N=N, **how, **options)
    limit = boundary(law, reference, rest, Ts=Ts, **how)
    return xr.Dataset(
        _variables(made, ("Ts", "alpha")) | {"limit": ("Ts", limit, {"units": "1/s", "long_name": "linear boundary"})},
        coords={
            "alpha": ("alpha", alpha, {"units": "1/s", "long_name": "gain α"}),
            "Ts": ("Ts", Ts, {"units": "s", "long_name": "sampling time"}),
        },
        attrs=_attributes(law, q0, method, stage, N, options),
    )


@in_float64
def boundary(law, reference, rest, *, Ts, method=DEFAULT, stage=picard(5), drive=Drive()):
    """Largest stable alpha [1/s] by linear theory for each Ts (b,).

    A hyperbola, unless a null-space velocity acts or drives have a time of their own.
    """
    Ts = np.asarray(Ts, float)
    some = Ts if callable(law.null_velocity) or drive.order else Ts[:1]
    loop = loop_at_rest(law, reference, rest, method, stage, drive)
    return np.asarray([largest_stable(loop, float(T)) for T in some]) / Ts


@in_float64
def gains_map(law, q, *, alpha, Ts, method: MethodLike = DEFAULT, stage: Stage = picard(5), drive=Drive()):
    """Spectral radius of a stack at rest over the gains of two of its tasks, all else as it is. In float64.

    Args:
      law: with a stack of tasks, whose gains are scaled. q: (n,) where it rests [rad, m].
      alpha: {name: (a,)} of the two tasks, their largest gains [1/s]. Ts: [s].
      method, stage: as for `solve`. drive: as for `outcomes`.
    Returns: an xarray.Dataset over the two gains, by their tasks' names, with `radius`, and "limit of NAME" of either
      (ray,) [1/s]: where the loop becomes unstable as both grow in one ratio, NaN where it does not within the map; in
      its attributes `stable` and `recommended` [1/s]: what every gain may be whatever the posture and the others are,
      see `TaskAdvice`.
    """
    import xarray as xr

    if not isinstance(alpha, dict) or len(alpha) != 2:
        raise errors.fail("alpha", "be {name: gains} of two tasks", f"is {alpha!r}")
    if "radius" in alpha:
        raise errors.fail("alpha", "name tasks by other names than that of the map's own values", "names one radius")
    loop = loop_at_rest(law, None, q, method, stage, drive)
    if not bounded_rates(loop.law):
        raise errors.fail("law", "be of a stack, without transpose and null_velocity, for a map of two gains", "is not")
    Ts, here = float(errors.number("Ts", Ts, positive=True)), shares_of(loop, Ts)
    first, second = ((loop.law.task.of(n), np.asarray(errors.array(n, v, (None,)), float)) for n, v in alpha.items())
    own = [float(np.max(here.rates.alpha[at])) for at, _ in (first, second)]
    if not min(own) > 0:
        raise errors.fail("law", f"have gains of {' and '.join(alpha)} to be scaled", f"has {own}")

    def radius(gains):
        scale = np.ones((len(gains), loop.law.task.m))
        scale[:, first[0]], scale[:, second[0]] = (gains / own).T[..., None]
        return here.radius(scale, loop.drive)

    cells = np.stack(np.meshgrid(first[1], second[1]), -1)
    found = _limit(radius, cells)
    limits = least_limits(loop.method, loop.stage, Ts, loop.drive)
    names, about = list(alpha), {"units": "1", "long_name": "spectral radius"}
    return xr.Dataset(
        {"radius": (names[::-1], np.array([radius(row) for row in cells]), about)}
        | {f"limit of {n}": ("ray of limit", v, {"units": "1/s"}) for n, v in zip(names, found.T, strict=True)},
        coords={
            n: (n, v, {"units": "1/s", "long_name": f"α of {n}"})
            for n, (_, v) in zip(alpha, (first, second), strict=True)
        },
        attrs={"stable": limits.stable / Ts, "recommended": limits.recommended / Ts}
        | {"Ts": Ts, "method": loop.method.name, "stage": str(loop.stage), "q": np.asarray(loop.q)},
    )


def _limit(radius, cells):
    """Pairs of gains (r, 2) up to which a loop is stable in their ratio, NaN where that is beyond a map (b, a, 2)."""
    least, most = cells.min((0, 1)), cells.max((0, 1))
    shares = np.geomspace(np.maximum(least / most, LEAST), 1.0, RAYS)
    edge = most * np.vstack([np.insert(shares[:, :1], 1, 1.0, 1), np.insert(shares[::-1, 1:], 0, 1.0, 1)])
    low, high = np.zeros((len(edge), 1)), np.ones((len(edge), 1))
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        stable = radius(middle * edge)[:, None] <= 1 + SLACK
        low, high = np.where(stable, middle, low), np.where(stable, high, middle)
    return np.where(high < 1, high, np.nan) * edge


@in_float64
def passes_map(law, reference, q0, *, z, M, Ts=0.1, method="CN", stage=picard(0), N=100, **options):
    """Outcomes of simulated loops over z = alpha·Ts and the number of iterations M, and the linear limit for each M.

    In float64.

    Args: as for `stability_map`, with z (a,) and M (b,) in place of alpha and Ts, and an implicit method.
    Returns: an xarray.Dataset over (M, z), with `limit` (M,) in z.
    """
    import xarray as xr

    method, stage = checked(method, stage)
    if not method.implicit:
        raise errors.fail("method", "be implicit, such as CN", f"is {method}")
    z, Ts = np.asarray(errors.array("z", z, (None,)), float), float(errors.number("Ts", Ts, positive=True))
    if not np.iterable(M) or isinstance(M, str):
        raise errors.fail("M", "be numbers of passes", f"is {M!r}")
    M = np.array([errors.integer("M", m, at_least=0, at_most=1_000_000) for m in M], int)
    made = outcomes(law, reference, q0, alpha=z / Ts, Ts=Ts, M=M[:, None], method=method, stage=stage, N=N, **options)
    masked = [replace(stage, M=jnp.asarray(int(m)), maximum=int(M.max())) for m in M]
    return xr.Dataset(
        _variables(made, ("M", "z")) | {"limit": ("M", [stability_limit(method, s) for s in masked], {"units": "1"})},
        coords={
            "z": ("z", z, {"units": "1", "long_name": "z = α·Ts"}),
            "M": ("M", M, {"units": "1", "long_name": "passes M"}),
        },
        attrs=_attributes(law, q0, method, stage, N, options) | {"Ts": Ts, "stage": type(stage).__name__.lower()},
    )


def endings_about():
    """Attributes of a variable of endings: what its numbers mean."""
    return {
        "units": "1",
        "long_name": "how the loop ended",
        "flag_values": [e.value for e in Ending],
        "flag_meanings": " ".join(e.name for e in Ending),
    }


def _variables(made: Outcome, dims):
    return {
        "ending": (dims, made.ending, endings_about()),
        "rate": (dims, made.rate, {"units": "1", "long_name": "mean factor of the error per step"}),
        "steps": (dims, made.steps, {"units": "1", "long_name": "steps to the tolerance"}),
        "final": (dims, made.final, {"units": "m or rad", "long_name": "largest error in the last quarter"}),
        "near_singular": (dims, made.near_singular, {"units": "1"}),
        "stage_not_converged": (dims, made.stage_not_converged, {"units": "1", "long_name": "a stage not converged"}),
    }


def _attributes(law, q0, method, stage, N, options):
    return {
        "method": method.name,
        "stage": str(stage),
        "q0": np.asarray(q0).ravel(),
        "evaluations_per_step": int(evaluations_per_step(method, stage, law.chain.n)),
        "N": N,
        "tolerance": options.get("tolerance", 1e-3),
    } | ({} if options.get("scale") is None else {"scale": options["scale"]})


# --- agreement with linear theory ----------------------------------------------------------------------


@of_numbers
def agreement(ending, z, limit, *, band=0.03):
    """Fraction of loops that end as z and the linear limit predict, outside a band around the limit.

    Args:
      ending, z, limit: `Ending`s, z (or alpha) and that of the boundary (inf: all stable), broadcast together.
    """
    ending, z, limit = np.broadcast_arrays(ending, z, limit)
    finite = np.isfinite(limit)
    outside = ~finite | (np.abs(z - np.where(finite, limit, 0)) > band * np.where(finite, limit, 0))
    agree = stable(ending) == (z < limit)
    return float(agree[outside].mean())
