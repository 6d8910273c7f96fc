"""Answers of `cnclik.reach` as labelled data and files."""

import pathlib
from typing import TYPE_CHECKING

import numpy as np

from cnclik import errors
from cnclik.measure.dataset import about
from cnclik.measure.files import save_csv, save_netcdf
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
        save_netcdf(data, path)
    else:
        save_csv(_rows(data), path)


def _rows(data):
    several = "solution" in data.sizes
    shape = data.sizes["target"], data.sizes.get("solution", 1)
    joints, tips = data.joint.values.astype(str), [f"{tip}." for tip in data.tip.values] if "tip" in data.sizes else []
    numbers = ["position_error", "orientation_error", "least_singular_value", "evaluations", "distance"]
    of_tips = [f"tip_{name}" for name in numbers[:2] if tips]
    entries = [f"{tip}t{i}{j}" for tip in tips or [""] for i in range(4) for j in range(4)]
    names = [
        "status",
        *joints,
        *numbers,
        "at_limit",
        *(f"{tip}{name[4:]}" for name in of_tips for tip in tips),
        *entries,
    ]
    yield ["target", *["solution"] * several, *names]
    before, after = ([data[name].values.reshape(*shape, -1) for name in some] for some in (["q", *numbers], of_tips))
    status, at_limit = (data[name].values.reshape(*shape, -1) for name in ("status", "at_limit"))
    poses = data.transform.values.reshape(shape[0], -1)
    for b, k in np.ndindex(shape):
        limits = " ".join(joints[at_limit[b, k].astype(bool)])
        answer = [ReachStatus(int(status[b, k, 0])).name, *_cells(before, b, k), limits, *_cells(after, b, k)]
        yield [b, *[k] * several, *answer, *(poses[b] + 0.0).tolist()]


def _cells(arrays, b, k) -> list:
    return [v + 0.0 if isinstance(v, float) else v for of in arrays for v in of[b, k].tolist()]  # no −0.0
