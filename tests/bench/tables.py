"""`python -m tests.bench.tables FOLDER ...`: the tables of the studies' READMEs in results/, from their stores.

FOLDER is where `cnclik sweep` put the data of sweeps/exponential_parts.toml, methods_noise, methods_reach or
methods_spatial, and has its name, such as results/exponential_parts.
"""

import pathlib
import sys

import numpy as np
import xarray

from cnclik.integrate.method import METHODS, evaluations_per_step
from cnclik.integrate.stage import picard
from cnclik.measure.files import markdown

GAIN = 5.0


def number(value) -> str:
    """Two digits."""
    text = f"{float(value):.1e}" if np.isfinite(value) else "unstable"
    return text.replace("e-0", "e-").replace("e+00", "")


def exponential_parts(data):
    """RMS position error by ingredient, target's future and Ts."""
    columns = [(future, Ts) for future in data.future.values for Ts in (0.1, 0.05, 0.01)]
    rows = [
        [name, *(number(data.rms_position_error.sel({"ingredient": name, "future": f}).sel(Ts=T)) for f, T in columns)]
        for name in data.ingredient.values
    ]
    yield "", markdown(["", *(f"{future}, Ts = {Ts:g} s" for future, Ts in columns)], rows)


def methods_noise(data):
    """RMS position error by method, noise and two delays: at a given gain, and at each method's best with that gain."""
    error = np.sqrt((data.rms_position_error**2).mean("seed"))
    columns = [(noise, delay) for noise in data.noise.values for delay in (0, 2)]
    header = ["", *(f"{1e3 * noise:g} mm, {delay} late" for noise, delay in columns)]
    for case in data.case.values:
        given, best = [], []
        for method in data.method.values:
            lanes = error.sel({"case": case, "method": method})
            over = [lanes.sel(noise=noise, measurement_delay=delay) for noise, delay in columns]
            least = [gains.isel(alpha=int(gains.argmin("alpha"))) for gains in over]
            given.append([method, *(number(gains.sel(alpha=GAIN, method="nearest")) for gains in over)])
            best.append([method, *(f"{number(b)} ({float(b.alpha):.2g})" for b in least)])
        yield f"{case}, α = 5 1/s", markdown(header, given)
        yield f"{case}, at the best gain (which)", markdown(header, best)


def methods_reach(data):
    """Steps to the tolerance by method and z, and the least mean error."""
    for case in data.case.values:
        rows = []
        for method in data.method.values:
            lanes = data.sel({"case": case, "method": method})
            steps = [f"{s:.0f}" if np.isfinite(s) else "–" for s in lanes.steps_to_tolerance.values]
            least = lanes.mean_error.isel(z=int(lanes.mean_error.argmin("z")))
            rows.append([method, *steps, f"{number(least)} ({float(least.z):g})"])
        yield f"{case}: steps to 1 mm", markdown(["", *(f"z = {z:g}" for z in data.z.values), "mean error"], rows)


def methods_spatial(data):
    """RMS error along and across the path by method and Ts: at a given gain, and the whole error at the best one."""
    for case in data.case.values:
        rows = []
        for method in data.method.values:
            lanes = data.sel({"case": case, "method": method})
            cost = float(evaluations_per_step(METHODS[method], picard(5), 7))
            cells = []
            for Ts in data.Ts.values:
                at = lanes.sel(Ts=Ts)
                given = at.sel(alpha=GAIN, method="nearest")
                best = at.rms_position_error.isel(alpha=int(at.rms_position_error.argmin("alpha")))
                cells += [number(given.rms_along), number(given.rms_across)]
                cells.append(f"{number(best)} ({float(best.alpha):.2g})")
            rows.append([method, f"{cost:g}", *cells])
        header = [f"{what}, Ts = {Ts:g} s" for Ts in data.Ts.values for what in ("along", "across", "best (at α)")]
        yield f"{case}, α = 5 1/s", markdown(["", "Jacobians a step", *header], rows)


STUDIES = {fn.__name__: fn for fn in (exponential_parts, methods_noise, methods_reach, methods_spatial)}


def main():
    for folder in map(pathlib.Path, sys.argv[1:]):
        data = xarray.open_zarr(folder / "data.zarr").load()
        for title, text in STUDIES[folder.name](data):
            print(f"{title}\n\n{text}")


if __name__ == "__main__":
    main()
