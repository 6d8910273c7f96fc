"""Maps: stability regions of methods, and how whole nonlinear loops end beside the linear limit."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.integrate.drive import Drive, check_drive, sampled
from cnclik.integrate.lanes import lanes
from cnclik.integrate.method import DEFAULT, MethodLike, named
from cnclik.integrate.stage import Stage, picard
from cnclik.law.law import check_loop
from cnclik.measure.outcome import Ending, outcome
from cnclik.precision import in_float64
from cnclik.record import replace
from cnclik.stability.advice import mixed
from cnclik.stability.gain import mixed_share
from cnclik.stability.linear import amplification, gain_removing, passes_of, stability_limit

CHUNK = 1 << 15  # loops run between two looks at the progress
AXES = {"alpha": ("1/s", "gain α"), "Ts": ("s", "sampling time"), "M": ("1", "passes M")}
RESULTS = {
    "ending": ("1", "how the loop ended"),
    "rate": ("1", "mean factor of the error per step"),
    "steps": ("1", "steps to the tolerance"),
    "final": ("m or rad", "largest error in the last quarter"),
}


@in_float64
def stability_map(
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
    progress=None,
):
    """Return how simulated loops end over gains, sampling times and passes, and the linear limit. In float64.

    Args:
      law, reference, q0: the loop; the reference must be constant. A gain that is not a number is scaled so that its
        largest entry is alpha.
      alpha: [1/s]. Ts: [s]. M: passes of an implicit method, or None: the stage's own. Each a number, or (k,) and then
        an axis of the map.
      N, tolerance: number of steps, and what counts as converged, see `outcome`.
      method, stage: as for `solve`.
      drive: what lies between command and motion; its dead time is in samples, all else in seconds.
      progress: called as progress(loops done, loops in all), or None.
    Returns: an xarray.Dataset over (M, Ts, alpha), or those that are axes, of the fields of `Outcome`, and `limit` over
      (M, Ts): the largest gain that is stable at any posture, exact for J# without damping, see `gains`; NaN where
      joints differ in their drives and rates in size: then there is none, see `advise`.
    """
    import xarray as xr

    method, largest = named(method), float(np.max(np.asarray(law.alpha)))
    check_loop(law, reference)
    if not reference.still:
        raise errors.fail("reference", "be constant, as hold(...) is", "moves")
    check_drive(drive, law.chain)
    errors.kind("stage", stage, Stage, "be a stage such as picard(5)")
    N = errors.integer("N", N, at_least=4, at_most=errors.MOST)
    errors.number("tolerance", tolerance, positive=True)
    errors.kind("progress", progress, (Callable, type(None)), "be a function or None")
    if M is not None and not method.implicit:
        raise errors.fail("method", "be implicit where M is given, such as CN", f"is {method}")
    bounds: dict = {"M": {"at_least": 0, "most": 1e6}, "Ts": {"positive": True}, "alpha": {"at_least": 0}}
    given = {k: v for k, v in {"M": M, "Ts": Ts, "alpha": alpha}.items() if v is not None}
    values = {k: np.asarray(errors.array(k, v, (), (None,), **bounds[k]), float) for k, v in given.items()}
    q0 = np.asarray(errors.array("q0", q0, (law.chain.n,)), float)
    axes = [name for name, value in values.items() if value.ndim]
    if not axes:
        raise errors.fail("alpha, Ts, M", "hold several values, one of them at least", "do not")
    if np.any(values.get("M", 0) % 1):
        raise errors.fail("M", "be whole", f"is {values['M'].tolist()}")
    if not largest > 0:
        raise errors.fail("law", "have a gain above 0", f"has {largest:g}")

    shape = [values[name].size for name in axes]
    each = dict(zip(axes, np.meshgrid(*(values[name] for name in axes), indexing="ij"), strict=True))
    each = {name: np.broadcast_to(value, shape).ravel() for name, value in (values | each).items()}
    factor, passes = each["alpha"] / largest, None if M is None else each["M"].astype(int)
    # Sampled once for each sampling time: the matrix exponential has no place in a program for many loops.
    times, which = np.unique(each["Ts"], return_inverse=True)
    models = None
    if not drive.prompt:
        models = jax.tree.map(lambda *each: np.stack(each)[which], *(sampled(drive, float(T)) for T in times))

    def ended(factor, Ts, M, model):
        scaled = replace(law, alpha=law.alpha * factor)
        own = stage if M is None else replace(stage, M=M, maximum=int(values["M"].max()))
        through = dict(drive=drive, model=model, tolerance=tolerance)
        return outcome(scaled, reference, jnp.asarray(q0), Ts, N, method, own, **through)

    run, count, endings = lanes(ended), len(factor), []
    size = min(CHUNK, count)
    for i in range(0, count, size):
        ids = np.minimum(np.arange(i, i + size), count - 1)  # one shape, one compilation
        loops = jax.tree.map(lambda v: v[ids], (factor, each["Ts"], passes, models))  # noqa: B023
        endings.append(jax.tree.map(np.asarray, run(*loops)))
        if progress is not None:
            progress(min(i + size, count), count)
    loops = jax.tree.map(lambda *parts: np.concatenate(parts)[:count].reshape(shape), *endings)

    def limit(Ts, M=None):
        if mixed(law, drive):
            return np.nan
        return largest_stable(method, stage if M is None else replace(stage, M=int(M)), drive, Ts=Ts)

    made = xr.Dataset(
        {name: (axes, getattr(loops, name)) for name in RESULTS},
        coords={name: (name if value.ndim else (), value) for name, value in values.items()},
        attrs={
            "method": method.name,
            "stage": type(stage).__name__.lower() if M is not None else str(stage),
            "q0": q0,
            "N": N,
            "tolerance": tolerance,
        },
    )
    of_limit = [made[name] for name in ("Ts", "M") if name in values]
    made = made.assign(limit=xr.apply_ufunc(limit, *of_limit, vectorize=True)).transpose(*axes)
    made.limit.attrs = {"units": "1/s", "long_name": "largest gain stable at any posture"}
    for name, (unit, words) in (RESULTS | {name: AXES[name] for name in values}).items():
        made[name].attrs = {"units": unit, "long_name": words}
    made.ending.attrs |= {"flag_values": [e.value for e in Ending], "flag_meanings": " ".join(e.name for e in Ending)}
    return made


def largest_stable(method, stage, drive, *, Ts: float) -> float:
    """Return the largest gain that is stable at any posture [1/s]; inf: any. Args: stage: or a number M of passes."""
    share = mixed_share(drive.joints, float(Ts))
    return gain_removing(share, method, passes_of(stage)) / float(Ts) if share else 0.0


# --- the plane of z ----------------------------------------------------------------------------------


def plane(methods, passes, *, points=201):
    """Return stability regions |R(z)|, stable up to 1, over (row, im, re), and limits on the real axis over `row`.

    Complex z belong to a law that turns, such as one whose Jacobian is wrong by an angle φ: z exp(iφ).

    Args: methods: names. passes: M of implicit ones, which are solved exactly, too. points: along each axis.
    """
    import xarray as xr

    methods = [named(method, "methods") for method in methods]
    passes = [errors.integer("passes", M, at_least=0) for M in passes]
    points = errors.integer("points", points, at_least=2, at_most=10_000)
    cases = [(method, M) for method in methods for M in ([*passes, None] if method.implicit else [None])]
    if not cases:
        raise errors.fail("methods", "hold a method", "is empty")
    x, y = np.linspace(-2.0, 4.0, points), np.linspace(-4.0, 4.0, points)
    regions = [np.abs(amplification(method, x + 1j * y[:, None], M)).astype(np.float32) for method, M in cases]
    return xr.Dataset(
        {
            "stable": ("row", [stability_limit(*case) for case in cases], {"units": "1"}),
            "monotone": ("row", [gain_removing(1.0, *case) for case in cases], {"units": "1"}),
            "region": (("row", "im", "re"), np.stack(regions), {"units": "1", "long_name": "|R(z)|"}),
        },
        coords={
            "method": ("row", [method.name for method, _ in cases]),
            "stage": ("row", ["" if not m.implicit else "exact" if M is None else f"picard({M})" for m, M in cases]),
            "re": ("re", x, {"units": "1", "long_name": "Re z"}),
            "im": ("im", y, {"units": "1", "long_name": "Im z"}),
        },
    )


def limit_table(data):
    """Return (rows, header) of the limits of a `plane`, as text."""
    columns = (data[name].values for name in ("method", "stage", "stable", "monotone"))
    rows = [
        [str(method), str(stage), *("none" if z == np.inf else f"{z:.4f}" for z in limits)]
        for method, stage, *limits in zip(*columns, strict=True)
    ]
    return rows, ["method", "stage", "stable", "without overshoot"]
