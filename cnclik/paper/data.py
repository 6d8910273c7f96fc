"""The runs of `cnclik.paper.readings` as labelled data: what the figures, the claims and the tables are read from."""

import functools
import itertools
import json
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from cnclik import errors
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

CONFIG = {
    "paper": "D. A. Drexler, Solution of the Closed-Loop Inverse Kinematics Algorithm Using the Crank-Nicolson Method, "
    "SAMI 2016, Section V",
    "Ts": paper.TS,
    "N": paper.N,
    "M": paper.M,
    "alpha": paper.ALPHA,
    "link_length": 1.0,
    "arms": {name: {"n": a.n, "target": a.target, "start": a.start} for name, a in ARMS.items()},
    "nudge": paper.NUDGE,
    "nudges": NUDGES,
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


def reproduce(out=None, *, reading=str(DEFAULT), progress=None, overwrite=False):
    """Run all experiments of Section V under all eight readings of its text, in float64, in about half a minute.

    Args:
      out: folder for data, claims.json, claims.md and, after them, figures; None: nothing is written.
      reading: what figures 1 to 12 show.
      progress: called as progress(done, total, note).
      overwrite: write also into a folder of others.

    Returns: datasets `trajectories`, `methods` and `passes`; `judge` makes claims of the first and the last.
    Raises: ArgumentError for an unknown reading or an unusable folder; FigureError where figures could not be drawn,
      with data and claims in place.
    """
    shown = errors.one_of("reading", str(reading), READINGS)
    if out is None:
        return everything(progress)
    files = [*(f"{name}.nc" for name in Results._fields), "claims.json", "claims.md", *FIGURES]
    with output_folder(out, overwrite=overwrite, files=files) as folder:
        results = everything(progress)
        for name, data in results._asdict().items():
            folder.write(f"{name}.nc", functools.partial(save_netcdf, data))
        judged = claims.judge(results.trajectories, results.passes)
        # allow_nan: a claim that rests on a NaN must not pass as JSON.
        folder.write_text("claims.json", json.dumps(judged, indent=1, allow_nan=False) + "\n")
        from cnclik.paper import figures  # here, where a broken installation of matplotlib costs no data

        pictures = figures.figures(*results, shown)
        captions = {name: words.get("Title", "") for name, (_, words) in pictures.items()}
        folder.write_text("claims.md", claims.page(judged, results, shown, captions))
    draw(pictures, out, progress=progress, overwrite=overwrite)
    return results


def trajectories(runs: dict) -> xr.Dataset:
    """Return the paper's methods on both arms and cases under all readings.

    Dims arm, reading, case, method, time, joint. Beside what `to_dataset` gives: error_norm ‖e[k]‖, mean_error (over k
    = 0 … N), final_error ‖e[N]‖, and spread: by how much, relatively, the mean error differs between starts a rounding
    error apart.
    """
    labels = {"reading": list(READINGS), "case": list(CASES), "method": list(PAPER)}
    shape, arms = [len(v) for v in labels.values()], []
    for arm in ARMS:
        keys = [key(arm, *where) for where in itertools.product(*labels.values())]
        stacked = [
            np.reshape(v, (*shape, *np.shape(v[0])))
            for v in zip(*(jax.tree.leaves(runs[k]) for k in keys), strict=True)
        ]
        batch = jax.tree.unflatten(jax.tree.structure(runs[keys[0]]), stacked)
        data = to_dataset(batch, paper.law(arm), dims=labels, coords=labels)
        data["spread"] = (tuple(labels), np.reshape([_spread(runs, k) for k in keys], shape))
        arms.append(data.assign_coords(time=paper.TS * np.arange(paper.N + 1)))
    data = xr.concat(arms, xr.IndexVariable("arm", list(ARMS)), join="outer", coords="minimal", compat="override")
    data["joint_unit"] = ("joint", ["rad"] * data.sizes["joint"])
    data["error_norm"] = np.sqrt((data.e**2).sum("axis", skipna=False))
    data["mean_error"] = data.error_norm.mean("time", skipna=False)
    data["final_error"] = data.error_norm.isel(time=-1, drop=True)
    words = {
        "time": about("time", "s"),
        "error_norm": about("error norm ‖e‖", "m"),
        "mean_error": about("mean of ‖e‖ over k = 0 … N", "m"),
        "final_error": about("‖e[N]‖", "m"),
        "spread": about("relative change of mean_error between starts 1e-12 rad apart", "1"),
    }
    return _labelled(data, words)


def _spread(runs, where):
    """Return (max − min)/mean of the mean error over the displaced starts."""
    *rest, lane = where
    nudged = [runs[(*rest, lane._replace(nudge=i))].e for i in range(1, NUDGES + 1)]
    means = np.linalg.norm(nudged, axis=-1).mean(-1)
    return float(np.ptp(means) / means.mean())


def key(arm: str, reading: str, case: str, method: str) -> tuple:
    """Return the key of a run: readings that do the same share one."""
    r = READINGS[reading]
    feedforward = "consistent" if case == "reach" else r.feedforward
    return arm, "once" if not METHODS[method].implicit else r.Ts, method, Lane(r.rotation, case, feedforward)


def methods(runs: dict) -> xr.Dataset:
    """Return all methods under the reading on-path/once/consistent: error against evaluations, and observed orders.

    Dims arm, case, method, Ts. Errors are taken at the instants the paper samples, 0.1 s apart, whatever Ts:
    mean_error over t = 0 … 3 s, rms_error over t = 0.1 … 3 s. `rms_converged` is that of tracking with
    implicit stages solved to convergence, `order` its rate under halving of Ts.
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
        "mean_error": about("mean of ‖e‖ over t = 0 … 3 s", "m"),
        "rms_error": about("RMS of ‖e‖ over t = 0.1 … 3 s", "m"),
        "evaluations": about("evaluations of f(q, t)", "1"),
        "rms_converged": about("RMS tracking error, implicit stages converged", "m"),
        "order": about("observed order, from 2 Ts to Ts", "1"),
        "error_norm": about("error norm ‖e‖ at Ts = 0.1 s", "m"),
        "Ts": about("sampling time", "s"),
        "time": about("time", "s"),
    }
    return _labelled(data, words, reading=str(DEFAULT), M_converged=paper.CONVERGED)


def passes(residuals: dict) -> xr.Dataset:
    """Return the Picard iteration followed from the states of the runs of IE and CN.

    Dims arm, reading, case, method, pass, step. `residual` is the change of the joint increment in the last
    pass (pass 0: the increment it starts from).
    """
    labels: dict = {"arm": list(ARMS), "reading": list(READINGS), "case": list(CASES), "method": list(paper.FOLLOWED)}
    labels |= {"pass": np.arange(paper.PASSES + 1), "step": np.arange(paper.N)}
    values = [residuals[key(*where)] for where in itertools.product(*list(labels.values())[:4])]
    data = xr.Dataset({"residual": ([*labels], np.reshape(values, [len(v) for v in labels.values()]))}, labels)
    return _labelled(data, {"residual": about("change of the joint increment in the last pass", "rad")})


def _labelled(data, words, **config):
    """Return data with long names and units, default ones where `words` has none, and the configuration."""
    for name in data.variables:
        data[name].attrs = about(name, "1") | data[name].attrs | words.get(name, {})
    data.attrs = provenance(float) | {"config": as_json(CONFIG | config)}
    return data
