"""Maps: how whole nonlinear loops end over gains, sampling times and numbers of passes, beside the linear limit."""

from __future__ import annotations

import math

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, sampled
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import DEFAULT, MethodLike, evaluations_per_step, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import check_loop
from cnclik.measure.files import markdown
from cnclik.measure.outcome import Ending, Outcome, outcome
from cnclik.precision import in_float64
from cnclik.record import replace
from cnclik.stability.gain import mixed_share
from cnclik.stability.linear import gain_removing, passes_of, stability_limit, stability_region

CHUNK = 1 << 15  # loops run between two looks at the progress
LOOPS_PER_CALL = 1 << 10  # loops that one core runs at a time: small, as those that diverge may take longer
AXES = {"alpha": ("1/s", "gain α"), "Ts": ("s", "sampling time"), "M": ("1", "passes M")}


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
      law, reference: the loop; a gain that is not a number is scaled so that its largest entry is alpha.
      q0: (..., n) start; alpha, Ts, M: (...). All are broadcast against each other, one loop each.
      M: passes in place of the stage's own, or None.
      drive: what lies between command and motion; its dead time is in samples, all else in seconds.
      N, tolerance, scale: number of steps, and what counts as converged.
      chunk: loops run between two calls of `progress`, on all cores.
      progress: called as progress(loops done, loops in all), or None.
    Returns: `Outcome` of NumPy arrays (...).
    """
    method = named(method)
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

    largest = float(np.max(np.asarray(law.alpha)))
    if not largest > 0:
        raise errors.fail("alpha", "not be 0", f"is {largest:g}")
    factor, time = flat(alpha) / largest, flat(Ts)
    # Sampled once for each sampling time: the matrix exponential has no place in a program for many loops.
    times, which = np.unique(time, return_inverse=True)
    models = None
    if not drive.prompt:
        models = jax.tree.map(lambda *each: np.stack(each)[which], *(sampled(drive, float(T)) for T in times))
    start = flat(q0, tail=q0.shape[-1:])
    if M is not None:
        M = flat(M, int)
        stage = replace(stage, M=None, maximum=max(stage.maximum, int(np.max(M))))  # type: ignore[attr-defined]

    def ended(q0, factor, Ts, M, model):
        scaled = replace(law, alpha=law.alpha * factor)
        passes = stage if M is None else replace(stage, M=M)
        through = dict(drive=drive, model=model)
        return outcome(scaled, reference, q0, Ts, N, method, passes, **through, tolerance=tolerance, scale=scale)

    run, endings = lanes(ended, block=LOOPS_PER_CALL), []
    for i in range(0, count, chunk):
        part = jax.tree.map(lambda v: v[i : i + chunk], (start, factor, time, M, models))  # noqa: B023
        endings.append(jax.tree.map(np.asarray, run(*part)))
        if progress is not None:
            progress(min(i + chunk, count), count)
    return jax.tree.map(lambda *parts: np.concatenate(parts)[:count].reshape(shape), *endings)


def _alike(n, **given) -> tuple:
    """(q0, alpha, Ts) as arrays, and the shape of all loops. Raises: ArgumentError for values that do not fit."""
    q0, alpha, Ts, M = (np.asarray(errors.array(name, value), float) for name, value in given.items())
    if not np.all(Ts > 0):
        raise errors.fail("Ts", "be positive", f"is {Ts.tolist()}")
    if np.any((M < 0) | (M > 1_000_000) | (np.round(M) != M)):
        raise errors.fail("M", "be whole, at least 0 and at most a million", f"is {M.tolist()}")
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
    M=None,
    method: MethodLike = DEFAULT,
    stage: Stage = picard(5),
    drive=Drive(),
    N=100,
    **options,
):
    """Return how simulated loops end over gains, sampling times and passes, and the linear limit. In float64.

    Args:
      law, reference, q0: the loop; the reference must be constant.
      alpha: [1/s]. Ts: [s]. M: passes of an implicit method, or None: the stage's own. Each a number, or (k,) and then
        an axis of the map.
      method, stage: as for `solve`. drive: as for `outcomes`.
      N, options: as for `outcomes`.
    Returns: an xarray.Dataset over (M, Ts, alpha), or those that are axes, with `limit` over (M, Ts): the largest gain
      that is stable at any posture, exact for J# without damping, see `gains`.
    """
    import xarray as xr

    method = named(method)
    check_loop(law, reference)
    if M is not None and not method.implicit:
        raise errors.fail("method", "be implicit where M is given, such as CN", f"is {method}")
    given = {"M": M, "Ts": Ts, "alpha": alpha}
    values = {k: np.asarray(errors.array(k, v, (), (None,)), float) for k, v in given.items() if v is not None}
    axes = [name for name, value in values.items() if value.ndim]
    if not axes:
        raise errors.fail("alpha, Ts, M", "hold several values, one of them at least", "are numbers")
    grid = dict(zip(axes, np.meshgrid(*(values[name] for name in axes), indexing="ij"), strict=True))
    loops = outcomes(law, reference, q0, **(values | grid), method=method, stage=stage, drive=drive, N=N, **options)
    of_limit = [name for name in axes if name != "alpha"]
    limit = np.vectorize(
        lambda M, Ts: largest_stable(method, stage if M is None else replace(stage, M=int(M)), drive, Ts=Ts),
        otypes=[float],
    )
    each = [values[name] for name in of_limit]
    at = dict(zip(of_limit, np.meshgrid(*each, indexing="ij"), strict=True))
    limits = limit(at.get("M", values.get("M")), at.get("Ts", values["Ts"]))
    data = _variables(loops, axes)
    data["limit"] = (of_limit, limits, {"units": "1/s", "long_name": "largest gain stable at any posture"})
    units = {name: {"units": AXES[name][0], "long_name": AXES[name][1]} for name in values}
    attrs = {
        "method": method.name,
        "stage": type(stage).__name__.lower() if M is not None else str(stage),
        "q0": np.asarray(q0, float).ravel(),
        "evaluations_per_step": int(evaluations_per_step(method, stage, law.chain.n)),
        "N": N,
        "tolerance": options.get("tolerance", 1e-3),
    } | ({} if options.get("scale") is None else {"scale": options["scale"]})
    return xr.Dataset(
        data,
        coords={name: (name if value.ndim else (), value, units[name]) for name, value in values.items()},
        attrs=attrs,
    )


def largest_stable(method, stage, drive=Drive(), *, Ts: float) -> float:
    """Return the largest gain that is stable at any posture [1/s]; inf: any."""
    share = mixed_share(drive.joints, float(Ts))
    return gain_removing(share, method, passes_of(stage)) / float(Ts) if share else 0.0


# --- the plane of z ----------------------------------------------------------------------------------


def plane(methods, passes, *, points=201):
    """Return stability regions |R(z)| over (region, im, re), and the limits of z on the real axis over `row`.

    Args: methods: names. passes: M of implicit ones, which are solved exactly, too.
    """
    import xarray as xr

    methods = [named(method, "methods") for method in methods]
    passes = [errors.integer("passes", M, at_least=0) for M in passes]
    cases = [(method, M) for method in methods for M in ([*passes, None] if method.implicit else [None])]
    regions = [stability_region(method, M, points=points) for method, M in cases]
    stages = ["" if not method.implicit else "exact" if M is None else f"picard({M})" for method, M in cases]
    limits = {
        "stable": [stability_limit(*case) for case in cases],
        "monotone": [gain_removing(1.0, *case) for case in cases],
    }
    return xr.Dataset(
        {name: ("row", values, {"units": "1"}) for name, values in limits.items()}
        | {"region": (("row", "im", "re"), np.stack([r.values.astype(np.float32) for r in regions]))},
        coords={
            "method": ("row", [method.name for method, _ in cases]),
            "stage": ("row", stages),
            "re": regions[0].re,
            "im": regions[0].im,
        },
    )


def limit_table(data):
    """Return (rows, header) of the limits of a `plane`, as text."""
    names = ("stable", "monotone")
    columns = (data.method.values, data.stage.values, *(data[name].values for name in names))
    rows = [
        [str(method), str(stage), *("none" if v == np.inf else f"{v:.4f}" for v in values)]
        for method, stage, *values in zip(*columns, strict=True)
    ]
    return rows, ["method", "stage", "stable", "without overshoot"]


def plane_page(data) -> str:
    """Return the limits of a `plane` as a Markdown page."""
    rows, header = limit_table(data)
    head = ("# Limits of z = alpha·Ts on the real axis", "", "`exact` is what chord(M) and newton(M) do.", "")
    return "\n".join([*head, markdown(header, rows, left=2)])


def _variables(loops: Outcome, dims):
    flags = {"flag_values": [e.value for e in Ending], "flag_meanings": " ".join(e.name for e in Ending)}
    return {
        "ending": (dims, loops.ending, {"units": "1", "long_name": "how the loop ended"} | flags),
        "rate": (dims, loops.rate, {"units": "1", "long_name": "mean factor of the error per step"}),
        "steps": (dims, loops.steps, {"units": "1", "long_name": "steps to the tolerance"}),
        "final": (dims, loops.final, {"units": "m or rad", "long_name": "largest error in the last quarter"}),
        "near_singular": (dims, loops.near_singular, {"units": "1"}),
        "stage_not_converged": (dims, loops.stage_not_converged, {"units": "1", "long_name": "a stage not converged"}),
    }
