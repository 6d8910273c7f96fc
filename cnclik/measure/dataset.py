"""Trajectories as labelled data: named dimensions, units on every variable, the configuration in the attributes."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.status import Status
from cnclik.integrate.trajectory import Trajectory, check_run
from cnclik.law.law import Law
from cnclik.measure.files import plain
from cnclik.precision import of_numbers
from cnclik.record import ArrayLike
from cnclik.version import __version__

if TYPE_CHECKING:
    import xarray as xr


@of_numbers
def to_dataset(
    run: Trajectory,
    law: Law,
    *,
    dims: Iterable[str] = (),
    coords: Mapping[str, ArrayLike] | None = None,
    config: Any = None,
) -> xr.Dataset:
    """Return a trajectory, or a batch of them, as an `xarray.Dataset`.

    Dimensions: those of the batch, then `time` (N + 1 instants) or `step` (N steps, step k leading from
    instant k to k + 1), then `joint` or `axis`. Every variable has `long_name` and `units`.

    Args:
      run: `Trajectory` from `solve`; those of a batch have leading axes.
      law: the law of the run. Its chain names the joints, its task the axes.
      dims: names of the leading axes, outermost first.
      coords: labels along them, {dim: values}.
      config: the options that made the data; they become one JSON string in the attributes.

    Raises: ArgumentError if `dims` does not fit the trajectory's leading axes.
    """
    import xarray as xr

    return xr.Dataset(*labelled(run, law, dims, coords, config))


def labelled(run: Trajectory, law: Law, dims=(), coords=None, config=None) -> tuple:
    """Return variables, coordinates and attributes of `to_dataset`, without xarray, which takes long to load."""
    check_run(run, errors.kind("law", law, Law))
    dims, t = tuple(dims), np.asarray(run.t)
    *lanes, N = np.shape(run.residual)
    if len(lanes) != len(dims):
        raise errors.fail("dims", f"name the {len(lanes)} leading axes of the trajectory", f"is {dims}")
    chain, task, instant, step = law.chain, law.task, (*dims, "time"), (*dims, "step")
    each = (chain.units, [f"{unit}/s" for unit in chain.units], task.units)
    q_unit, qdot_unit, x_unit = (" or ".join(dict.fromkeys(units)) for units in each)
    table = {
        "q": ((*instant, "joint"), "joint value", q_unit),
        "x": ((*instant, "axis"), "task coordinate", x_unit),
        "e": ((*instant, "axis"), "error x_d − x", x_unit),
        "qdot": ((*step, "joint"), "joint velocity", qdot_unit),
        "residual": (step, "last change of the implicit stage", q_unit),
        "contraction": (step, "ratio of its last two changes", "1"),
        "status": (step, "status bits", "1"),
        "walls": ((*step, "wall"), "margin of the approach velocity at a wall", "m/s or rad/s"),
    }
    arrays = {name: getattr(run, name) for name in table}
    variables = {k: (table[k][0], np.asarray(v), about(*table[k][1:])) for k, v in arrays.items() if v is not None}
    evaluations = np.broadcast_to(np.asarray(run.evaluations), lanes)
    variables["evaluations"] = (dims, evaluations, about("evaluations of f(q, t)", "1"))
    flags = {"flag_masks": [s.value for s in Status if s], "flag_meanings": " ".join(str(s.name) for s in Status if s)}
    variables["status"][2].update(flags)
    labels = {
        "joint": ("joint", list(chain.joint_names), about("joint", "1")),
        "joint_unit": ("joint", list(chain.units), about("unit of the joint's value", "1")),
        "axis": ("axis", list(task.names), about("task coordinate", "1")),
        "axis_unit": ("axis", list(task.units), about("unit of the task coordinate", "1")),
        "step": ("step", np.arange(N), about("step", "1")),
    }
    if run.walls is not None:
        labels["wall"] = ("wall", [wall.name for wall in getattr(law.limits, "walls", ())], about("wall", "1"))
    if not task.of_one_tip or len(chain.tips) > 1:
        labels["axis_tip"] = ("axis", _tips(task, chain), about("the tip whose coordinate it is", "1"))
    if task.each:
        labels["task"] = ("task", [name for name, _ in task.tasks], about("task", "1"))
        axis_task = [name for name, at in task.each for _ in range(at.start, at.stop)]
        labels["axis_task"] = ("axis", axis_task, about("its task", "1"))
    first = t.reshape(-1, t.shape[-1])[0]
    if np.all(t == first):
        labels["time"] = ("time", first, about("time", "s"))
    else:  # each lane has its own times, as in a sweep over Ts
        variables["t"] = (instant, t, about("time", "s"))
    attrs = provenance(run.q.dtype) | ({} if config is None else {"config": as_json(config)})
    return variables, labels | dict(coords or {}), attrs


def _tips(task, chain) -> list:
    """Return the tip of each coordinate: "left"; "left in right" for a pose relative to another tip."""
    tips = []
    for _, target in task.targets:
        part = target.parts[0]
        tip = chain.tips[0].name if part.tip is None else part.tip
        tips += [tip if part.to is None else f"{tip} in {part.to}"] * target.m
    return tips


def as_json(config) -> str:
    """Return a configuration as one line of JSON for the attributes, with sorted keys and arrays as lists."""
    return json.dumps(plain(config), sort_keys=True, ensure_ascii=False, default=str)


def provenance(dtype) -> dict:
    """Return what the numbers may depend on besides the configuration: versions, device and `dtype`."""
    return {
        "cnclik": __version__,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "dtype": str(np.dtype(dtype)),
        "device": jax.default_backend(),
    }


def about(name, units) -> dict:
    return {"long_name": name, "units": units}
