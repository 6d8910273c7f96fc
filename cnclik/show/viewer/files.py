"""Files of runs and of answers, as motions: what `solve` and `reach` wrote, or arrays of your own."""

import csv
import dataclasses
import io
import json
import os
import pathlib

import numpy as np

from cnclik import errors
from cnclik.measure.dataset import Axes, axes_of
from cnclik.problem.names import robot_and_tip, robot_name
from cnclik.problem.stack import Written, stack_from, tables_from, tips_of
from cnclik.problem.tables import read_columns
from cnclik.reaching.result import ReachStatus
from cnclik.reading import read_bytes
from cnclik.show.viewer.motion import BAD, GOOD, WARNING, Motion, from_arrays, in_base
from cnclik.show.viewer.swept import best_and_worst

ENDINGS = (".nc", ".csv", ".npz")
RUN, STORE = "trajectory.nc", "data.zarr"
MOST_TARGETS = 40  # targets in a report's animation
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

    Raises: ArgumentError for what is none of these, or does not name its robot.
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
    except Exception as error:  # damaged files raise all kinds of errors in HDF5, xarray and NumPy
        raise errors.fail("FILE", "be a run of `solve` or answers of `reach`", f"{path.name} is not: {error}") from None


def _motion(found, path, robot):
    """A motion from the named arrays of a file."""
    config = found.pop("config", None) or _beside(path)
    written = Written(config["tasks"], config.get("walls", {})) if "tasks" in config else None
    tables = None if written is None else tables_from(written, {}).tasks
    if robot is None and "robot" in config:
        named = [config.get(name) for name in ("tip", "base", "lengths")]
        robot = robot_of(config["robot"], *named, None if written is None else tips_of(written))
    if robot is None:
        raise errors.fail("ROBOT", f"be given before {path.name}, which doesn't name it", "is not")
    chain, name, links = robot
    if tables is not None:
        found["axes"] = axes_of(stack_from(tables, chain), chain)
    shape = np.shape(found["q"])
    if len(shape) < 2 or shape[-1] != chain.n or not shape[0]:
        raise errors.fail("FILE", f"hold joint values (N, {chain.n}) of {name}'s joints", f"holds {shape}")
    made = answers_motion if "targets" in found else _run
    return made(chain, found, name=path.stem if name in ("", None) else name, links=links)


def robot_of(robot, tip=None, base=None, lengths=None, tips=None) -> tuple:
    """(chain, name, links) of a robot with one tip, or with several, see `cnclik.problem.names.robot_and_tip`."""
    chain = robot_and_tip(robot, tip, base, lengths, tips)[0]
    return chain, robot_name(robot, tip), links_of(robot, base, chain)


def links_of(robot, base, chain) -> tuple | None:
    """(file, names of the tips, base) of a robot in a URDF file, else None."""
    is_file = not hasattr(robot, "joints") and os.path.isfile(str(robot))
    return (str(robot), [tip.name for tip in chain.tips], base) if is_file else None


def _run(chain, found, **about):
    """A run; quantities that the file lacks are left out."""
    q = np.asarray(found["q"], float)
    axes = found.get("axes", ())
    if not isinstance(axes, Axes):
        axes = tuple(map(str, axes))
        axes = Axes(axes, [_UNITS.get(axis, "rad") for axis in axes], [chain.tips[0].name] * len(axes))
    none = np.zeros((len(q), len(axes.names)))
    status = np.nan_to_num(np.asarray(found.get("status", np.zeros(len(q) - 1)), float))[: len(q) - 1]
    values = (np.asarray(found.get(name, none), float) for name in ("x", "e"))
    t = np.asarray(found.get("t", np.arange(len(q))), float)
    if len(t) != len(q):
        raise errors.fail("FILE", f"hold as many times as joint values, {len(q)}", f"holds {len(t)}")
    return from_arrays(chain, t, q, *values, status, axes=axes, **about)


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
    made = Motion(
        chain=chain,
        t=np.arange(len(q), dtype=float),
        q=q,
        targets=(),
        error=_missed(found, len(q)),
        level=np.where(solved, GOOD, np.where(nearest, WARNING, BAD)),
        words=tuple(ReachStatus(s).name for s in status),
        note=f"{int(solved.sum()):,} of {len(q):,} targets reached",
        unit="target",
        **about,
    )
    names, wanted = [tip.name for tip in chain.tips], {}
    places = np.nan_to_num(np.asarray(found["targets"], float)[..., :3, 3].reshape(len(q), -1, 3))
    for k, label in enumerate(map(str, found.get("tip", names[:1]))):
        own, of, other = label.partition(" in ")
        tip = max((n for n in names if own == n or own.endswith(f".{n}")), key=len, default=own)
        wanted[f"{tip}{of}{other}"] = dict(zip("xyz", places[:, k].T, strict=True))
    return dataclasses.replace(made, targets=in_base(made, wanted))


def _missed(found, count) -> dict:
    """Position errors of answers, of each tip where there are several; those of the first solution."""
    if "tip_position_error" not in found:
        each, labels = [found["position_error"]], [""]
    else:
        every = np.asarray(found["tip_position_error"], float)
        each, labels = np.moveaxis(every, -1, 0), [f"{label} " for label in found["tip"]]
    return {
        f"{label}position error [m]": np.nan_to_num(np.asarray(own, float).reshape(count, -1)[:, 0])
        for label, own in zip(labels, each, strict=True)
    }


# --- the three kinds of files ---------------------------------------------------------------------------


def _netcdf(path) -> dict:
    import xarray as xr

    with xr.open_dataset(io.BytesIO(read_bytes("FILE", path, "a netCDF file")), engine="h5netcdf") as data:
        found = {name: data[name].values for name in ("q", "x", "e", "status") if name in data}
        if "transform" in data:
            found |= of_answers(data)
        else:
            found |= {"t": data["time"].values, "axes": data["axis"].values}
        return found | {"config": json.loads(data.attrs.get("config", "{}"))}


def of_answers(data) -> dict:
    """What a dataset of answers holds, by the names that it has in an .npz file."""
    names = ("q", "status", "position_error", "tip_position_error", "tip")
    return {name: data[name].values for name in names if name in data} | {"targets": data["transform"].values}


def _arrays(path) -> dict:
    with np.load(io.BytesIO(read_bytes("FILE", path, "an .npz file")), allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def _table(path) -> dict:
    """trajectory.csv: q_…, x_…, e_…, status; or answers of reach, whose status is a word."""
    text = read_bytes("FILE", path, "a table").decode("utf-8-sig", errors="replace")
    header, *rest = csv.reader(io.StringIO(text, newline="")) if text.startswith("target,") else ([],)
    if header:
        return _table_of_answers(header, rest)
    names, rows = read_columns("FILE", path)
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
    rows = [row for row in rows if "solution" not in header or row[1] == "0"]
    before = [name.removesuffix("t00") for name in header if name.endswith("t00")]  # of several tips each one's name
    entries = [header.index(f"{tip}t00") for tip in before]
    targets = np.array([[row[i : i + 16] for i in entries] for row in rows], float).reshape(len(rows), -1, 4, 4)
    found = {
        "q": np.array([row[first:last] for row in rows], float),
        "status": np.array([ReachStatus[row[first - 1]] for row in rows], int),
        "position_error": np.array([row[last] for row in rows], float),
        "targets": targets,
    }
    if before != [""]:
        missed = [header.index(f"{tip}position_error") for tip in before]
        found["tip"] = [tip.removesuffix(".") for tip in before]
        found["tip_position_error"] = np.array([[row[i] for i in missed] for row in rows], float)
    return found


def _beside(path) -> dict:
    """The loop's configuration in trajectory.nc of the same folder."""
    if path.name != RUN and path.stem == "trajectory" and os.path.exists(path.parent / RUN):
        return _netcdf(path.parent / RUN)["config"]
    return {}
