"""Answers of `cnclik.reach` as labelled data and files."""

import pathlib
from typing import TYPE_CHECKING, Any

import numpy as np

from cnclik import errors
from cnclik.measure.dataset import about
from cnclik.measure.files import save_csv, save_netcdf
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.task.aims import aims

if TYPE_CHECKING:
    import xarray as xr

ENDINGS = (".npz", ".nc", ".csv")


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
    """Write answers as .npz (`targets`, and a name for each variable), .nc, or .csv (a row per target and solution)."""
    path = pathlib.Path(path)
    ending = errors.ending("out", path, *ENDINGS)
    if ending == ".nc":
        save_netcdf(data, path)
    elif ending == ".npz":
        arrays: dict[str, Any] = {str(name): variable.values for name, variable in data.data_vars.items()}
        arrays |= {str(name): np.array(values, str) for name, values in data.coords.items()}
        np.savez_compressed(path, targets=arrays.pop("transform"), **arrays)
    else:
        save_csv(_rows(data), path)


def _rows(data):
    several = "solution" in data.sizes
    shape = data.sizes["target"], data.sizes.get("solution", 1)
    joints = [str(name) for name in data.joint.values]
    numbers = ("position_error", "orientation_error", "least_singular_value", "evaluations", "distance")
    columns = [data[name].values.reshape(shape).tolist() for name in numbers]
    status, q, at_limit = (data[name].values.reshape(*shape, -1) for name in ("status", "q", "at_limit"))
    poses = data.transform.values.reshape(shape[0], -1).tolist()
    tips = [f"{tip}." for tip in data.tip.values] if "tip" in data.sizes else []
    each = [f"{tip}{name}" for name in ("position_error", "orientation_error") for tip in tips]
    missed = [
        data[f"tip_{name}"].values.reshape(*shape, -1) for name in ("position_error", "orientation_error") if tips
    ]
    entries = [f"{tip}t{i}{j}" for tip in tips or [""] for i in range(4) for j in range(4)]
    yield ["target", *["solution"] * several, "status", *joints, *numbers, "at_limit", *each, *entries]
    for b, k in np.ndindex(shape):
        name = ReachStatus(int(status[b, k, 0])).name
        limits = " ".join(np.array(joints)[at_limit[b, k].astype(bool)])
        own = [value for error in missed for value in error[b, k].tolist()]
        found = [*q[b, k].tolist(), *(column[b][k] for column in columns), limits, *own, *poses[b]]
        yield [b, *[k] * several, name, *(v + 0.0 if isinstance(v, float) else v for v in found)]  # no −0.0
