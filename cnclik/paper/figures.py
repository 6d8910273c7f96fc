"""Which figures `reproduce` draws, from which data, under which name: the paper's twelve in its order, then ours."""

import functools
import hashlib

import numpy as np
import xarray as xr

from cnclik.measure.dataset import as_json
from cnclik.paper import claims, plots
from cnclik.paper import readings as paper
from cnclik.paper.choices import DEFAULT

_CASES = {"reach": "Case I, reaching a point", "track": "Case II, tracking a line"}
_KINDS = {
    "joint paths": functools.partial(plots.joints, name="q"),
    "error of the end effector: x, y, and norm": plots.errors,
    "joint velocities": functools.partial(plots.joints, name="qdot"),
}
PICARD_READINGS = ("on-path/once/consistent", "on-path/twice/consistent")


def figures(trajectories: xr.Dataset, methods: xr.Dataset, passes: xr.Dataset, reading: str) -> dict:
    """{file name: (function that draws it, the description in the file)}, as `cnclik.show.output.draw` takes them."""
    found = {}

    def add(name, caption, data, make):
        found[f"{name}.png"] = functools.partial(make, data), about(caption, data)

    for arm, size in paper.ARMS.items():
        for case, what in _CASES.items():
            run = trajectories.sel(arm=arm, case=case, reading=reading).sel(joint=[f"q{i + 1}" for i in range(size.n)])
            for kind, make in _KINDS.items():
                add(f"fig{len(found) + 1:02d}", f"{size} arm, {what}: {kind}", run, make)
    followed = passes[["residual"]].sel(reading=list(PICARD_READINGS)).isel({"pass": slice(0, 31)})
    add("fig13", "Error against evaluations, all methods", methods, plots.work)
    add("fig14", "Observed orders, stages converged", methods, plots.orders)
    drawn = functools.partial(plots.passes, chosen=paper.M, settled=claims.SETTLED)
    picard = "Convergence of the Picard iteration, Ts once and twice"
    add("fig15", picard, followed, lambda data: drawn(data.residual))
    both = _overview_data(trajectories, methods)
    add("overview", "An arm following a line, and the error of each method", both, _overview)
    return found


def about(caption: str, data: xr.Dataset) -> dict:
    """The description in a PNG: its title, the configuration, and the fingerprint of what was drawn."""
    labels = {n: str(v.values) for n, v in data.coords.items() if v.ndim == 0}
    config = data.attrs.get("config", as_json({}))
    return {"Title": caption, "Config": config, "Selection": as_json(labels), "Data": fingerprint(data)}


def fingerprint(data) -> str:
    """SHA-256 of a dataset's numbers and labels: what ties a figure to the data it was drawn from."""
    digest = hashlib.sha256()
    for name in sorted(map(str, data.variables)):
        values = data[name].values
        raw = values.tobytes() if values.dtype.kind in "fiub" else "\n".join(map(str, values.ravel())).encode()
        digest.update(f"{name} {data[name].dims} {values.shape}\n".encode() + raw)
    return digest.hexdigest()


def _overview_data(trajectories, methods):
    where = {"arm": "5dof", "case": "track"}
    run = trajectories[["q", "x"]].sel({**where, "reading": str(DEFAULT), "method": "CN"}, drop=True)
    compared = methods[["rms_error", "evaluations", "error_norm"]].sel(where, drop=True)
    return xr.merge([run, compared], combine_attrs="override", join="exact")


def _overview(data):
    instants = np.linspace(0, paper.N, 7).astype(int)
    return plots.overview(data, data, np.stack([_points(q) for q in data.q.values[instants]]))


def _points(q):
    """Base, joints and tip of a planar arm with links of 1 m that turns clockwise from +y, (n + 1, 2)."""
    angle = np.cumsum(q)
    links = np.stack([np.sin(angle), np.cos(angle)], axis=-1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(links, axis=0)])
