"""The figures of `cnclik reproduce`: what is drawn, from which data, under which name."""

import functools
from pathlib import Path

import numpy as np
import xarray as xr

from cnclik.measure.dataset import as_json
from cnclik.paper import claims, plots
from cnclik.paper import readings as paper
from cnclik.show import style

_CASES = {"reach": "Case I, reaching a point", "track": "Case II, tracking a line"}
_KINDS = {
    "joint paths": plots.joint_paths,
    "error of the end effector: x, y, and norm": plots.errors,
    "joint velocities": plots.joint_velocities,
}
PICARD_READINGS = ("on-path/once/consistent", "on-path/twice/consistent")


def figures(trajectories: xr.Dataset, methods: xr.Dataset, passes: xr.Dataset, reading: str) -> dict:
    """{file name: (caption, data, function that draws it)}, the paper's twelve in its order, then ours."""
    found = {}
    for arm in paper.ARMS:
        for case, what in _CASES.items():
            run = trajectories.sel(arm=arm, case=case, reading=reading).sel(joint=_joints(arm))
            for kind, draw in _KINDS.items():
                name = f"fig{len(found) + 1:02d}.png"
                found[name] = (f"{arm.replace('dof', '-dof')} arm, {what}: {kind}", run, draw)
    followed = passes[["residual"]].sel(reading=list(PICARD_READINGS)).isel({"pass": slice(0, 31)})
    draw_passes = functools.partial(plots.passes, chosen=paper.M, settled=claims.SETTLED)
    return found | {
        "fig13.png": ("Error against evaluations, all methods", methods, plots.work),
        "fig14.png": ("Observed orders, stages converged", methods, plots.orders),
        "fig15.png": (
            "Convergence of the Picard iteration, Ts once and twice",
            followed,
            lambda data: draw_passes(data.residual),
        ),
        "overview.png": (
            "An arm following a line, and the error of each method",
            _overview_data(trajectories, methods),
            _overview,
        ),
    }


def metadata(caption: str, data: xr.Dataset) -> dict:
    """What a PNG says of itself: its title, the configuration, and the fingerprint of what was drawn."""
    config = data.attrs["config"] if "config" in data.attrs else as_json({})
    labels = {n: str(v.values) for n, v in data.coords.items() if v.ndim == 0}
    return {"Title": caption, "Config": config, "Selection": as_json(labels), "Data": plots.fingerprint(data)}


def draw(found: dict, folder: Path, track=iter) -> None:
    """Draw every figure into the folder; `track` wraps the iteration, to show progress."""
    with style.style():
        for name in track(list(found)):
            caption, data, make = found[name]
            style.save(make(data), Path(folder) / name, metadata(caption, data))


def _joints(arm):
    return [f"q{i + 1}" for i in range(paper.ARMS[arm].n)]


def _overview_data(trajectories, methods):
    where = {"arm": "5dof", "case": "track"}
    run = trajectories[["q", "x"]].sel({**where, "reading": str(paper.DEFAULT), "method": "CN"}, drop=True)
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
