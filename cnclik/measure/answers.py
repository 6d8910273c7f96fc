"""Answers of `cnclik.reach` as labelled data and files."""

import pathlib

import numpy as np

from cnclik import errors
from cnclik.measure.dataset import Labelled, about
from cnclik.measure.files import save_csv, save_netcdf
from cnclik.reaching.result import Reached, ReachStatus
from cnclik.task.task import aims

ENDINGS = (".nc", ".csv")


def answers(reached: Reached, transforms) -> Labelled:
    """Answers for targets (B, 4, 4) with dimension `target` (and `solution`); all have units.

    For k tips the targets are (B, k, 4, 4), and there is a dimension `tip`.
    """
    dims = ("target", "solution")[: np.ndim(reached.status)]
    units = " or ".join(dict.fromkeys(reached.chain.units))
    flags = {"flag_values": [int(s) for s in ReachStatus], "flag_meanings": " ".join(s.name for s in ReachStatus)}
    coords, each = {"joint": ("joint", list(reached.chain.joint_names), {})}, ("tip",) * (np.ndim(transforms) > 3)
    variables = {
        "transform": (("target", *each, "row", "column"), transforms, about("target pose", "m, 1")),
        "q": ((*dims, "joint"), reached.q, about("joint value", units)),
        "status": (dims, reached.status, about("status", "1") | flags),
        "position_error": (dims, reached.position_error, about("position error", "m")),
        "orientation_error": (dims, reached.orientation_error, about("orientation error", "rad")),
        "at_limit": ((*dims, "joint"), reached.at_limit, about("joint at a limit", "1")),
        "distance": (dims, reached.distance, about("largest joint's distance from near", units)),
    }
    if each:
        coords["tip"] = ("tip", [aim.label for aim in aims(reached.task)], {})
    return Labelled(variables, coords, {})


def save(data: Labelled, path) -> None:
    """Write answers as .nc, or as .csv with a row per target and solution."""
    if errors.ending("out", pathlib.Path(path), *ENDINGS) == ".nc":
        return save_netcdf(data, path)
    dims, status, _ = data.variables["status"]
    shape, joints = np.shape(status), data.coords["joint"][1]
    tips = [f"{tip}." for tip in data.coords["tip"][1]] if "tip" in data.coords else [""]
    flat = {
        name: np.reshape(v, (np.size(status), -1)) for name, (_, v, _) in data.variables.items() if name != "transform"
    }
    columns: dict = dict(zip(dims, np.indices(shape).reshape(len(shape), -1), strict=True))
    columns["status"] = [ReachStatus(code).name for code in flat["status"][:, 0]]
    columns |= dict(zip(joints, flat["q"].T, strict=True))
    for name in ("position_error", "orientation_error", "distance"):
        columns[name] = flat[name][:, 0]
    columns["at_limit"] = [" ".join(np.array(joints)[hit.astype(bool)]) for hit in flat["at_limit"]]
    transforms = np.asarray(data.variables["transform"][1]).reshape(shape[0], -1)
    entries = [f"{tip}t{i}{j}" for tip in tips for i in range(4) for j in range(4)]
    columns |= dict(zip(entries, np.repeat(transforms, np.prod(shape[1:], dtype=int), axis=0).T, strict=True))
    plain = [(v + 0.0).tolist() if np.asarray(v).dtype.kind == "f" else v for v in columns.values()]  # no −0
    save_csv([list(columns), *zip(*plain, strict=True)], path)
