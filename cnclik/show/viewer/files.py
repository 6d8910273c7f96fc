"""Files of runs and of answers, as motions: what `solve` and `reach` wrote, or arrays of one's own."""

import csv
import io
import json
import os
import pathlib

import numpy as np

from cnclik import errors
from cnclik.problem.names import robot_from, robot_name
from cnclik.problem.tables import read_columns
from cnclik.reaching.result import ReachStatus
from cnclik.reading import read_bytes
from cnclik.show.viewer.motion import BAD, GOOD, WARNING, Motion, from_arrays
from cnclik.show.viewer.swept import best_and_worst

ENDINGS = (".nc", ".csv", ".npz")
RUN, STORE = "trajectory.nc", "data.zarr"
MOST_TARGETS = 40  # of a report's moving robot
_UNITS = {"x": "m", "y": "m", "z": "m"}


def is_result(text) -> bool:
    """Whether a text names a file or folder of results, and no robot."""
    inside = (os.path.join(str(text), name) for name in (RUN, STORE))
    return str(text).lower().endswith(ENDINGS) or any(map(os.path.exists, inside))


def read_motions(path, robot=None) -> list:
    """The motions in a file, or in a folder of `solve` or `sweep`.

    Args:
      path: trajectory.nc, trajectory.csv, answers of reach (.nc, .csv, .npz), or .npz with t, q and where they are
        known x, e, status and axes; of a folder of `sweep` the best and the worst loop.
      robot: (chain, name, links), for files that don't say; see `robot_of`.

    Raises: ArgumentError for what is none of these, or says nothing of its robot.
    """
    path = pathlib.Path(path)
    if os.path.exists(path / STORE):  # which no name is too long for
        return best_and_worst(path)
    path = path / RUN if os.path.exists(path / RUN) else path
    ending = errors.ending("FILE", path, *ENDINGS)
    try:
        return [_motion({".nc": _netcdf, ".npz": _arrays, ".csv": _table}[ending](path), path, robot)]
    except errors.ArgumentError:
        raise
    except Exception as error:  # whatever HDF5, xarray, NumPy and arrays that don't go with each other make of damage
        raise errors.fail("FILE", "be a run of `solve` or answers of `reach`", f"{path.name} is not: {error}") from None


def _motion(found, path, robot):
    """What a file holds, by its names, as a motion."""
    config = found.pop("config", None) or _beside(path)
    if "tasks" in config:
        raise errors.fail("FILE", "be a run of one task so far", f"{path.name} is of a stack")
    if robot is None and "robot" in config:
        robot = robot_of(config["robot"], *(config.get(name) for name in ("tip", "base", "lengths")))
    if robot is None:
        raise errors.fail("ROBOT", f"be given before {path.name}, which doesn't name it", "is not")
    chain, name, links = robot
    shape = np.shape(found["q"])
    if len(shape) < 2 or shape[-1] != chain.n or not shape[0]:
        raise errors.fail("FILE", f"hold joint values (N, {chain.n}) of {name}'s joints", f"holds {shape}")
    made = answers_motion if "targets" in found else _run
    return made(chain, found, name=path.stem if name in ("", None) else name, links=links)


def robot_of(robot, tip=None, base=None, lengths=None) -> tuple:
    """(chain, name, links): links are (file, tip, base) of a URDF file, else None."""
    file = str(robot)
    is_file = not hasattr(robot, "joints") and os.path.isfile(file)
    return robot_from(robot, tip, base, lengths), robot_name(robot, tip), (file, tip, base) if is_file else None


def _run(chain, found, **about):
    """A run; what a file lacks of it is left out."""
    q = np.asarray(found["q"], float)
    axes = tuple(map(str, found.get("axes", ())))
    none = np.zeros((len(q), len(axes)))
    status = np.nan_to_num(np.asarray(found.get("status", np.zeros(len(q) - 1)), float))[: len(q) - 1]
    values = (np.asarray(found.get(name, none), float) for name in ("x", "e"))
    t = np.asarray(found.get("t", np.arange(len(q))), float)
    if len(t) != len(q):
        raise errors.fail("FILE", f"hold as many times as joint values, {len(q)}", f"holds {len(t)}")
    units = [_UNITS.get(axis, "rad") for axis in axes]
    return from_arrays(chain, t, q, *values, status, axes=axes, units=units, **about)


def answers_motion(chain, found, **about):
    """Answers of reach: an instant for each target; where there is none the robot stays as it was."""
    q, status = np.array(found["q"], float), np.asarray(found["status"], int)
    q, status = (
        v.reshape(len(found["targets"]), -1, *v.shape[1 + (v.ndim > k) :])[:, 0] for v, k in ((q, 2), (status, 1))
    )
    for k in np.flatnonzero(~np.isfinite(q).all(1)):
        q[k] = q[k - 1] if k else np.zeros(chain.n)
    solved = status <= ReachStatus.ACCEPTED
    nearest = (status == ReachStatus.AT_LIMIT) | (status == ReachStatus.OUT_OF_REACH)
    targets = np.asarray(found["targets"], float)
    made = Motion(
        chain=chain,
        t=np.arange(len(q), dtype=float),
        q=q,
        target=np.nan_to_num(targets[:, :3, 3]),
        error={
            "position error [m]": np.nan_to_num(np.asarray(found["position_error"], float).reshape(len(q), -1)[:, 0])
        },
        level=np.where(solved, GOOD, np.where(nearest, WARNING, BAD)),
        words=tuple(ReachStatus(s).name for s in status),
        note=f"{int(solved.sum()):,} of {len(q):,} targets reached",
        unit="target",
        **about,
    )
    return made


# --- the three kinds of files ---------------------------------------------------------------------------


def _netcdf(path) -> dict:
    import xarray as xr

    with xr.open_dataset(io.BytesIO(read_bytes("FILE", path, "a netCDF file")), engine="h5netcdf") as data:
        found = {name: data[name].values for name in ("q", "x", "e", "status") if name in data}
        if "transform" in data:
            found |= {"targets": data["transform"].values, "position_error": data["position_error"].values}
        else:
            found |= {"t": data["time"].values, "axes": data["axis"].values}
        return found | {"config": json.loads(data.attrs.get("config", "{}"))}


def _arrays(path) -> dict:
    with np.load(io.BytesIO(read_bytes("FILE", path, "an .npz file")), allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def _table(path) -> dict:
    """trajectory.csv: q_…, x_…, e_…, status; or answers of reach, whose status is a word."""
    text = read_bytes("FILE", path, "a table").decode("utf-8-sig", errors="replace")
    header, *rest = csv.reader(io.StringIO(text, newline="")) if text.startswith("target,") else ([],)
    if header:
        return _table_of_answers(header, rest)
    names, rows = read_columns("FILE", path, gaps=True)
    columns = {kind: [i for i, n in enumerate(names) if n.startswith(f"{kind}_")] for kind in ("q", "x", "e")}
    if not columns["q"] or not len(rows):
        raise errors.fail("FILE", "have columns q_JOINT and rows, as `solve --csv` writes", f"{path.name} has none")
    found = {kind: rows[:, some] for kind, some in columns.items() if some}
    found["axes"] = [names[i].removeprefix("e_") for i in columns["e"]]
    for name, key in (("time", "t"), ("status", "status")):
        if name in names:
            found[key] = rows[:, names.index(name)]
    return found


def _table_of_answers(header, rows):
    first, last = header.index("status") + 1, header.index("position_error")
    entry = header.index("t00")
    rows = [row for row in rows if "solution" not in header or row[1] == "0"]
    return {
        "q": np.array([row[first:last] for row in rows], float),
        "status": np.array([ReachStatus[row[first - 1]] for row in rows], int),
        "position_error": np.array([row[last] for row in rows], float),
        "targets": np.array([row[entry : entry + 16] for row in rows], float).reshape(-1, 4, 4),
    }


def _beside(path) -> dict:
    """What trajectory.nc in the same folder says of the loop."""
    if path.name != RUN and path.stem == "trajectory" and os.path.exists(path.parent / RUN):
        return _netcdf(path.parent / RUN)["config"]
    return {}
