"""The runs of `cnclik.paper.readings` as labelled data: what the figures, the claims and the tables are read from."""

import functools
import itertools
import json
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from cnclik.engine.plan import as_here
from cnclik.integrate.method import METHODS
from cnclik.measure.dataset import about, as_json, provenance, to_dataset
from cnclik.measure.files import save_netcdf
from cnclik.paper import claims
from cnclik.paper import readings as paper
from cnclik.paper.readings import ARMS, BESIDE, CASES, DEFAULT, HALVINGS, NUDGES, PAPER, READINGS, Lane
from cnclik.precision import in_float64
from cnclik.show.output import draw
from cnclik.threads import side_by_side
from cnclik.writing import output_folder

_SETTINGS = {"Ts": paper.TS, "N": paper.N, "M": paper.M, "alpha": paper.ALPHA, "link_length": 1.0}
CONFIG = {
    "paper": "D. A. Drexler, Solution of the Closed-Loop Inverse Kinematics Algorithm Using the Crank-Nicolson Method, "
    "SAMI 2016, Section V",
    **_SETTINGS,
    "arms": {name: arm._asdict() for name, arm in ARMS.items()},
    **{"nudge": paper.NUDGE, "nudges": NUDGES},
}

FIGURES = (*(f"fig{k:02d}.png" for k in range(1, 16)), "overview.png")  # what `figures.figures` draws


class Results(NamedTuple):
    """The three datasets that figures, claims and tables are read from."""

    trajectories: xr.Dataset
    methods: xr.Dataset
    passes: xr.Dataset


@in_float64
def everything(progress=None) -> Results:
    """Return all runs, as data, in float64; `progress` is called as progress(done, total, note)."""
    runs: dict = {}
    residuals: dict = {}
    with side_by_side() as pool:  # most of it is compiling, on one core each
        results = pool.map(as_here(lambda run: paper.run_method(*run)), paper.METHOD_RUNS)
        for done, (_, name) in enumerate(paper.METHOD_RUNS):
            if progress is not None:
                progress(done, len(paper.METHOD_RUNS), f"{name}: compiling and running")
            for known, more in zip((runs, residuals), next(results), strict=True):
                known |= more
    return Results(trajectories(runs), methods(runs), passes(residuals))


def reproduce(out, *, progress=None, overwrite=False) -> Results:
    """Run all experiments of Section V under all eight readings of its text, in float64, in about half a minute.

    Args:
      out: folder for data, claims.json, claims.md and, after them, figures.
      progress: called as progress(done, total, note).
      overwrite: write also into a folder of others.

    Returns: datasets `trajectories`, `methods` and `passes`; `judge` makes claims of the first and the last.
    Raises: ArgumentError for an unusable folder; FigureError where figures could not be drawn, with data and claims in
      place.
    """
    files = [*(f"{name}.nc" for name in Results._fields), "claims.json", "claims.md", *FIGURES]
    with output_folder(out, overwrite=overwrite, files=files) as folder:
        results = everything(progress)
        for name, data in results._asdict().items():
            folder.write(f"{name}.nc", functools.partial(save_netcdf, data))
        judged = claims.judge(results.trajectories, results.passes)
        # allow_nan: a claim that rests on a NaN must not pass as JSON.
        folder.write_text("claims.json", json.dumps(judged, indent=1, allow_nan=False) + "\n")
        folder.write_text("claims.md", claims.page(judged, results))
    from cnclik.paper import figures  # here, where a broken installation of matplotlib costs no data

    draw(figures.figures(*results), out, progress=progress, overwrite=overwrite)
    return results


def trajectories(runs: dict) -> xr.Dataset:
    """Return the paper's methods over arm, reading, case and method: what `to_dataset` gives, and errors.

    spread: by how much, relatively, the mean error differs between starts a rounding error apart.
    """
    labels = {"reading": list(READINGS), "case": list(CASES), "method": list(PAPER)}
    shape, arms = [len(v) for v in labels.values()], []
    for arm in ARMS:
        keys = [key(arm, *where) for where in itertools.product(*labels.values())]
        batch = jax.tree.map(lambda *v: np.reshape(v, (*shape, *np.shape(v[0]))), *(runs[k] for k in keys))
        data = to_dataset(batch, paper.law(arm), dims=labels, coords=labels)
        data["spread"] = (tuple(labels), np.reshape([_spread(runs, k) for k in keys], shape))
        arms.append(data.assign_coords(time=paper.TS * np.arange(paper.N + 1)))
    data = xr.concat(arms, xr.IndexVariable("arm", list(ARMS)), join="outer", coords="minimal", compat="override")
    data["joint_unit"] = ("joint", ["rad"] * data.sizes["joint"])
    data["error_norm"] = np.sqrt((data.e**2).sum("axis", skipna=False))
    data["mean_error"] = data.error_norm.mean("time", skipna=False)
    data["final_error"] = data.error_norm.isel(time=-1, drop=True)
    words = {"time": ("time", "s"), "error_norm": ("error norm ‖e‖", "m"), "final_error": ("‖e[N]‖", "m")}
    words["mean_error"] = "mean of ‖e‖ over k = 0 … N", "m"
    words["spread"] = "relative change of mean_error between starts 1e-12 rad apart", "1"
    return _labelled(data, words)


def _spread(runs, where):
    """Return (max − min)/mean of the mean error over the displaced starts."""
    *rest, lane = where
    nudged = [runs[(*rest, lane._replace(nudge=i))].e for i in range(1, NUDGES + 1)]
    means = np.linalg.norm(nudged, axis=-1).mean(-1)
    return float(np.ptp(means) / means.mean())


def key(arm: str, reading: str, case: str, method: str) -> tuple:
    """Return the key of a run: readings that do the same share one."""
    rotation, Ts, feedforward = READINGS[reading]
    lane = Lane(rotation, case, "consistent" if case == "reach" else feedforward)
    return arm, Ts if METHODS[method].implicit else "once", method, lane


def methods(runs: dict) -> xr.Dataset:
    """Return all methods under the default reading over arm, case, method, Ts: errors, evaluations, observed orders.

    Errors are taken at the instants that the paper samples, 0.1 s apart, whatever Ts.
    """
    labels = {"arm": list(ARMS), "case": list(CASES), "method": [*PAPER, *BESIDE]}
    labels["Ts"] = [paper.TS / 2**halving for halving in range(HALVINGS + 1)]

    def each(labels, **lane):
        for arm, case, method, Ts in itertools.product(*labels.values()):
            halving = labels["Ts"].index(Ts)
            yield runs[arm, "once", method, Lane("on-path", case, "consistent", halving=halving, **lane)], 2**halving

    def norms(labels, **lane):
        rows = [np.linalg.norm(run.e, axis=-1)[::step] for run, step in each(labels, **lane)]
        time = {"time": paper.TS * np.arange(paper.N + 1)}
        return xr.DataArray(np.reshape(rows, [*map(len, labels.values()), -1]), labels | time, [*labels, "time"])

    def rms(norm):
        return np.sqrt((norm.isel(time=slice(1, None)) ** 2).mean("time", skipna=False))

    norm, converged = norms(labels), norms(labels | {"case": ["track"]}, M=paper.CONVERGED)
    data = norm.isel(Ts=0, drop=True).to_dataset(name="error_norm")
    data["mean_error"], data["rms_error"] = norm.mean("time", skipna=False), rms(norm)
    counts = [int(run.evaluations) for run, _ in each(labels)]
    data["evaluations"] = (norm.dims[:-1], np.reshape(counts, norm.shape[:-1]))
    data["rms_converged"] = rms(converged).isel(case=0, drop=True)
    finer = data.rms_converged.isel(Ts=slice(1, None))
    data["order"] = np.log2(data.rms_converged.isel(Ts=slice(None, -1)).assign_coords(Ts=finer.Ts) / finer)
    words = {
        "mean_error": ("mean of ‖e‖ over t = 0 … 3 s", "m"),
        "rms_error": ("RMS of ‖e‖ over t = 0.1 … 3 s", "m"),
        "evaluations": ("evaluations of f(q, t)", "1"),
        "rms_converged": ("RMS tracking error, implicit stages converged", "m"),
        "order": ("observed order, from 2 Ts to Ts", "1"),
        "error_norm": ("error norm ‖e‖ at Ts = 0.1 s", "m"),
        **{"Ts": ("sampling time", "s"), "time": ("time", "s")},
    }
    return _labelled(data, words, reading=str(DEFAULT), M_converged=paper.CONVERGED)


def passes(residuals: dict) -> xr.Dataset:
    """Return the Picard iteration followed from the states of the runs of IE and CN, over arm, reading, case, method.

    residual (…, pass, step) is the change of the joint increment in the last pass; pass 0: where it starts from.
    """
    labels: dict = {"arm": list(ARMS), "reading": list(READINGS), "case": list(CASES), "method": list(paper.FOLLOWED)}
    labels |= {"pass": np.arange(paper.PASSES + 1), "step": np.arange(paper.N)}
    values = [residuals[key(*where)] for where in itertools.product(*list(labels.values())[:4])]
    data = xr.Dataset({"residual": ([*labels], np.reshape(values, [len(v) for v in labels.values()]))}, labels)
    return _labelled(data, {"residual": ("change of the joint increment in the last pass", "rad")})


def _labelled(data, words, **config):
    """Return data with long names and units, default ones where `words` has none, and the configuration."""
    for name in data.variables:
        data[name].attrs = about(name, "1") | data[name].attrs | (about(*words[name]) if name in words else {})
    data.attrs = provenance(float) | {"config": as_json(CONFIG | config)}
    return data
