"""Answers of `cnclik.reach` as labelled data and files."""

import pathlib
from typing import TYPE_CHECKING

import numpy as np

from cnclik import errors
from cnclik.measure.dataset import about
from cnclik.measure.files import save_netcdf
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.task.aims import aims

if TYPE_CHECKING:
    import xarray as xr

ENDINGS = (".nc", ".csv")


def answers(reached: Reached, transforms) -> "xr.Dataset":
    """Answers for targets (B, 4, 4) as an `xarray.Dataset` with dimension `target` (and `solution`); all have units.

    For k tips the targets are (B, k, 4, 4), and there is a dimension `tip`.
    """
    import xarray as xr

    dims = ("target", "solution")[: np.ndim(reached.status)]
    units = " or ".join(dict.fromkeys(reached.chain.units))
    flags = {"flag_values": [int(s) for s in ReachStatus], "flag_meanings": " ".join(s.name for s in ReachStatus)}
    labels, each = [aim.label for aim in aims(reached.task)], ("tip",) if np.ndim(transforms) > 3 else ()
    variables = {
        "transform": (("target", *each, "row", "column"), transforms, about("target pose", "m, 1")),
        "q": ((*dims, "joint"), reached.q, about("joint value", units)),
        "status": (dims, reached.status, about("status", "1") | flags),
        "position_error": (dims, reached.position_error, about("position error", "m")),
        "orientation_error": (dims, reached.orientation_error, about("orientation error", "rad")),
        "least_singular_value": (dims, reached.least_singular_value, about("least singular value", "m or 1")),
        "at_limit": ((*dims, "joint"), reached.at_limit, about("joint at a limit", "1")),
        "evaluations": (dims, reached.evaluations, about("evaluations", "1")),
        "distance": (dims, reached.distance, about("largest joint's distance from near", units)),
    }
    if each:
        places, turns = (np.stack(v, -1) for v in zip(*reached.each, strict=True))
        variables["tip_position_error"] = ((*dims, "tip"), places, about("position error of a tip", "m"))
        variables["tip_orientation_error"] = ((*dims, "tip"), turns, about("orientation error of a tip", "rad"))
    coords = {"joint": list(reached.chain.joint_names)} | ({"tip": labels} if each else {})
    return xr.Dataset(variables, coords=coords)


def save(data: "xr.Dataset", path) -> None:
    """Write answers as .nc, or as .csv with a row per target and solution."""
    if errors.ending("out", pathlib.Path(path), *ENDINGS) == ".nc":
        return save_netcdf(data, path)
    import pandas

    over = [name for name in ("target", "solution") if name in data.sizes]
    rows = data.assign_coords({name: np.arange(data.sizes[name]) for name in over}).stack(answer=over)
    rows = rows.transpose("answer", ...)
    joints = rows.joint.values.astype(str)
    columns: dict = {name: rows[name].values for name in over}
    columns["status"] = [ReachStatus(status).name for status in rows.status.values]
    columns |= dict(zip(joints, rows.q.values.T, strict=True))
    numbers = ("position_error", "orientation_error", "least_singular_value", "evaluations", "distance")
    columns |= {name: rows[name].values for name in numbers}
    columns["at_limit"] = [" ".join(joints[hit.astype(bool)]) for hit in rows.at_limit.values]
    tips = [f"{tip}." for tip in rows.tip.values] if "tip" in data.sizes else [""]
    for name in numbers[:2] if len(tips) > 1 else ():
        columns |= dict(zip([tip + name for tip in tips], rows[f"tip_{name}"].values.T, strict=True))
    entries = [f"{tip}t{i}{j}" for tip in tips for i in range(4) for j in range(4)]
    columns |= dict(zip(entries, rows.transform.values.reshape(len(rows.answer), -1).T, strict=True))
    table = pandas.DataFrame(columns)
    numeric = table.select_dtypes("float").columns
    table[numeric] += 0.0  # no −0
    table.to_csv(path, index=False, na_rep="nan")
