"""The runs of `cnclik.paper.readings` as labelled data: what the figures, the claims and the tables are read from."""

import itertools
from typing import NamedTuple

import jax
import numpy as np
import xarray as xr

from cnclik.integrate.method import METHODS
from cnclik.measure.dataset import as_json, provenance, to_dataset
from cnclik.paper import readings as paper
from cnclik.paper.readings import ARMS, BESIDE, CASES, HALVINGS, NUDGES, PAPER, READINGS, Found, Lane
from cnclik.precision import in_float64

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


class Results(NamedTuple):
    """The three datasets that figures, claims and tables are read from."""

    trajectories: xr.Dataset
    methods: xr.Dataset
    passes: xr.Dataset


@in_float64
def everything(progress=None) -> Results:
    """All runs, as data, in float64 whatever JAX's setting; `progress` is called as progress(done, total, note)."""
    runs, residuals = {}, {}
    for done, (arm, size) in enumerate(ARMS.items()):
        if progress is not None:
            progress(done, len(ARMS), f"the {size} arm: compiling and running")
        one = paper.run_arm(arm)
        runs |= one.runs
        residuals |= one.residuals
    found = Found(runs, residuals)
    return Results(trajectories(found), methods(found), passes(found))


def trajectories(found: Found) -> xr.Dataset:
    """The paper's methods on both arms and cases under all readings: dims arm, reading, case, method, time, joint.

    Beside what `to_dataset` gives: error_norm ‖e[k]‖, mean_error (over k = 0 … N), final_error ‖e[N]‖, and
    spread: by how much, relatively, the mean error differs between starts a rounding error apart.
    """
    labels = {"reading": list(READINGS), "case": list(CASES), "method": list(PAPER)}
    shape = [len(v) for v in labels.values()]
    arms = []
    for arm in ARMS:
        keys = [key(arm, *where) for where in itertools.product(*labels.values())]
        runs = [found.runs[k] for k in keys]
        batch = jax.tree.map(lambda *leaves: np.reshape(leaves, (*shape, *np.shape(leaves[0]))), *runs)
        one = to_dataset(batch, paper.law(arm), dims=labels, coords=labels)
        one["spread"] = (tuple(labels), np.reshape([_spread(found, k) for k in keys], shape))
        arms.append(one.assign_coords(time=paper.TS * np.arange(paper.N + 1)))
    data = xr.concat(arms, xr.IndexVariable("arm", list(ARMS)), join="outer", coords="minimal", compat="override")
    data.time.attrs = {"long_name": "time", "units": "s"}
    data["joint_unit"] = ("joint", ["rad"] * data.sizes["joint"])
    data["error_norm"] = np.sqrt((data.e**2).sum("axis")).assign_attrs(long_name="error norm ‖e‖", units="m")
    data["mean_error"] = data.error_norm.mean("time").assign_attrs(long_name="mean of ‖e‖ over k = 0 … N", units="m")
    data["final_error"] = data.error_norm.isel(time=-1, drop=True).assign_attrs(long_name="‖e[N]‖", units="m")
    data.spread.attrs = {"long_name": "relative change of mean_error between starts 1e-12 rad apart", "units": "1"}
    return _labelled(data, data.q.dtype)


def key(arm: str, reading: str, case: str, method: str) -> tuple:
    """Where `Found` keeps a run: readings that do the same share one."""
    r = READINGS[reading]
    feedforward = "consistent" if case == "reach" else r.feedforward
    return arm, "once" if not METHODS[method].implicit else r.Ts, method, Lane(r.rotation, case, feedforward)


def methods(found: Found) -> xr.Dataset:
    """All methods under the reading on-path/once/consistent: error against evaluations, and observed orders.

    Dims arm, case, method, Ts. Errors are taken at the instants the paper samples, 0.1 s apart, whatever Ts:
    mean_error over t = 0 … 3 s, rms_error over t = 0.1 … 3 s. `rms_converged` is that of tracking with
    implicit stages solved to convergence, `order` its rate under halving of Ts.
    """
    labels = {"arm": list(ARMS), "case": list(CASES), "method": [*PAPER, *BESIDE]}
    halvings = range(HALVINGS + 1)
    Ts = [paper.TS / 2**h for h in halvings]

    def each(measure, labels, **lane):
        lanes = [
            (Lane("on-path", where.get("case", "track"), "consistent", halving=h, **lane), where)
            for where in (dict(zip(labels, v, strict=True)) for v in itertools.product(*labels.values()))
            for h in halvings
        ]
        values = [measure(found.runs[w["arm"], "once", w["method"], la], la.halving) for la, w in lanes]
        return (*labels, "Ts"), np.reshape(values, [*(len(v) for v in labels.values()), len(Ts)])

    def norms(run, halving):
        return np.linalg.norm(run.e, axis=-1)[:: 2**halving]

    def rms(run, halving):
        return np.sqrt(np.mean(norms(run, halving)[1:] ** 2))

    tracking = {k: labels[k] for k in ("arm", "method")}
    data = xr.Dataset(
        {
            "mean_error": each(lambda r, h: norms(r, h).mean(), labels),
            "rms_error": each(rms, labels),
            "evaluations": each(lambda r, h: int(r.evaluations), labels),
            "rms_converged": each(rms, tracking, M=paper.CONVERGED),
        },
        labels | {"Ts": Ts, "time": paper.TS * np.arange(paper.N + 1)},
    )
    first = itertools.product(*labels.values())
    norm = [norms(found.runs[arm, "once", m, Lane("on-path", case, "consistent")], 0) for arm, case, m in first]
    data["error_norm"] = ((*labels, "time"), np.reshape(norm, [*(len(v) for v in labels.values()), -1]))
    finer = data.rms_converged.isel(Ts=slice(1, None))
    coarser = data.rms_converged.isel(Ts=slice(None, -1)).assign_coords(Ts=finer.Ts)
    data["order"] = np.log2(coarser / finer)
    about = {
        "mean_error": ("mean of ‖e‖ over t = 0 … 3 s", "m"),
        "rms_error": ("RMS of ‖e‖ over t = 0.1 … 3 s", "m"),
        "evaluations": ("evaluations of f(q, t)", "1"),
        "rms_converged": ("RMS tracking error, implicit stages converged", "m"),
        "order": ("observed order, from 2 Ts to Ts", "1"),
        "error_norm": ("error norm ‖e‖ at Ts = 0.1 s", "m"),
        "Ts": ("sampling time", "s"),
        "time": ("time", "s"),
    }
    for name, (long_name, units) in about.items():
        data[name].attrs = {"long_name": long_name, "units": units}
    return _labelled(data, data.rms_error.dtype, reading=str(paper.DEFAULT), M_converged=paper.CONVERGED)


def passes(found: Found) -> xr.Dataset:
    """The Picard iteration followed from the states of the runs of IE and CN.

    Dims arm, reading, case, method, pass, step. `residual` is the change of the joint increment in the last
    pass (pass 0: the increment it starts from).
    """
    labels = {"arm": list(ARMS), "reading": list(READINGS), "case": list(CASES), "method": ["IE", "CN"]}
    values = [found.residuals[key(*where)] for where in itertools.product(*labels.values())]
    shape = [*(len(v) for v in labels.values()), paper.PASSES + 1, paper.N]
    data = xr.Dataset(
        {"residual": ((*labels, "pass", "step"), np.reshape(values, shape))},
        labels | {"pass": np.arange(paper.PASSES + 1), "step": np.arange(paper.N)},
    )
    data.residual.attrs = {"long_name": "change of the joint increment in the last pass", "units": "rad"}
    return _labelled(data, data.residual.dtype)


def _labelled(data, dtype, **config):
    """With units on every variable, labels included, and the configuration in the attributes."""
    for name in data.variables:
        data[name].attrs.setdefault("long_name", name)
        data[name].attrs.setdefault("units", "1")
    data.attrs = provenance(dtype) | {"config": as_json(CONFIG | config)}
    return data


def _spread(found, where):
    """(max − min)/mean of the mean error over the displaced starts."""
    *rest, lane = where
    nudged = [found.runs[(*rest, lane._replace(nudge=i))].e for i in range(1, NUDGES + 1)]
    means = np.linalg.norm(nudged, axis=-1).mean(-1)
    return float(np.ptp(means) / means.mean())
