"""Methods compared on real robots: error of spatial pose tracking against evaluations, over the sampling time."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr

from cnclik.integrate.method import METHODS
from cnclik.integrate.solve import evaluations_per_step, solve
from cnclik.integrate.stage import picard
from cnclik.law.inverse import damped
from cnclik.law.law import Law
from cnclik.law.reference import circle
from cnclik.law.task import pose as pose_task
from cnclik.robot.builtin import panda, ur5
from cnclik.robot.kinematics import pose
from cnclik.study.dataset import as_json, provenance
from cnclik.study.problem import length, start_from

ROBOTS = {"Panda": panda, "UR5": ur5}
COMPARED = ("EE", "IE", "CN", "TRAPEZOID", "MIDPOINT", "RK4")
ALPHA, M, PERIOD = 5.0, 5, 4.0
TS = tuple(PERIOD / n for n in (1600, 800, 400, 200, 100, 50, 25))
LAMBDA = 1e-6  # exact to 1e-10: no path comes near a singularity


def run(track=lambda tasks: tasks) -> xr.Dataset:
    """RMS position and orientation error over one turn of a circle, orientation kept, for every method and Ts.

    All sampling times run side by side for as many steps as the smallest needs; the error is taken over the
    steps of one turn.
    """
    found = {}
    longest = round(PERIOD / min(TS))
    for robot, method in track([(r, m) for r in ROBOTS for m in COMPARED]):
        chain = ROBOTS[robot]()
        q0 = start_from(chain, pose_task())
        at = pose(chain, q0)
        radius = length(chain) / 10
        reference = circle(
            np.asarray(at.position) - [radius, 0, 0], radius, period=PERIOD, rotation=np.asarray(at.rotation)
        )
        law = Law(chain, pose_task(), alpha=ALPHA, inverse=damped(LAMBDA))
        many = jax.vmap(functools.partial(_errors, law, reference, q0, method, longest))
        found[robot, method] = [np.asarray(v) for v in many(jnp.array(TS))]
    robots, methods = list(ROBOTS), list(COMPARED)
    dims = ("robot", "method", "Ts")
    pick = lambda i: [[found[r, m][i] for m in methods] for r in robots]  # noqa: E731
    cost = {m: float(evaluations_per_step(METHODS[m], picard(M), 7)) for m in methods}
    rms = "RMS {} error over one turn"
    config = {"verb": "compare", "alpha": ALPHA, "M": M, "stage": "picard", "period": PERIOD, "damping": LAMBDA}
    return xr.Dataset(
        {
            "position_error": (dims, pick(0), {"units": "m", "long_name": rms.format("position")}),
            "orientation_error": (dims, pick(1), {"units": "rad", "long_name": rms.format("orientation")}),
            "evaluations": ("method", list(cost.values()), {"units": "1", "long_name": "evaluations per step"}),
        },
        {
            "robot": robots,
            "method": methods,
            "Ts": ("Ts", list(TS), {"units": "s", "long_name": "sampling time"}),
        },
        attrs=provenance(np.float64) | {"config": as_json(config)},
    )


def _errors(law, reference, q0, method, N, Ts):
    made = solve(law, reference, q0, Ts, N, method, picard(M))
    k = jnp.arange(N + 1)
    turn = ((k >= 1) & (k * Ts <= PERIOD * (1 + 1e-9)))[:, None]
    mean = lambda e: jnp.sqrt(jnp.sum(jnp.where(turn, e, 0.0) ** 2) / jnp.sum(turn))  # noqa: E731
    return mean(made.e[:, :3]), mean(made.e[:, 3:])


def order(data) -> xr.DataArray:
    """Observed order of each method: slope of log error against log Ts over the three smallest Ts."""
    few = data.position_error.sortby("Ts").isel(Ts=slice(0, 3))
    return xr.apply_ufunc(
        lambda e: np.polyfit(np.log(few.Ts.values), np.log(e), 1)[0], few, input_core_dims=[["Ts"]], vectorize=True
    )


def table(data) -> str:
    """Markdown: errors at every Ts, evaluations per step, observed order."""
    slopes = order(data)
    lines = [
        "# Methods on real robots",
        "",
        f"Written by `cnclik compare`. One turn of a circle in {PERIOD:g} s, orientation kept, spatial pose task,"
        f" alpha = {ALPHA:g} 1/s, implicit stages by picard({M}). RMS position error [m].",
    ]
    for robot in data.robot.values:
        steps = [f"Ts = {1e3 * Ts:.4g} ms" for Ts in data.Ts.values]
        lines += ["", f"## {robot}", "", "| method | evaluations per step | " + " | ".join(steps) + " | order |"]
        lines.append("| --- " + "| ---: " * (len(steps) + 2) + "|")
        for method in data.method.values:
            at = data.sel({"robot": robot, "method": method})
            values = [f"{v:.2e}" for v in at.position_error.values]
            slope = float(slopes.sel({"robot": robot, "method": method}))
            lines.append(f"| {method} | {at.evaluations.item():.0f} | {' | '.join(values)} | {slope:.2f} |")
    return "\n".join(lines) + "\n"
