"""Swept: the best and the worst loop of a sweep, run anew as motions; a sweep itself keeps no joint paths."""

import json
import pathlib

import jax
import numpy as np

from cnclik import errors
from cnclik.show.viewer.look import factors_of
from cnclik.show.viewer.motion import motion_of
from cnclik.sweeps import store
from cnclik.sweeps.check import parse
from cnclik.sweeps.spec import KEYS, TABLES
from cnclik.sweeps.summary import judged, text


def best_and_worst(folder) -> list:
    """Motions of the best safe loop and of the worst in a folder of `sweep`; what diverged is the worst.

    Robots that are files are looked for from the folder that the command is called in.
    Raises: ArgumentError where no store is there, or no error is in it.
    """
    return loops_of(store.read(pathlib.Path(folder)))


def loops_of(data, spec=None) -> list:
    """The same of a sweep's dataset, and of its spec; None: the one in the dataset."""
    if spec is None:
        written = json.loads(data.attrs["spec"])
        spec = parse({key: written[key] for key in (*KEYS, *TABLES) if key in written}, written["name"])
    if (found := judged(data)) is None:
        raise errors.fail("FILE", "hold an error, such as rms_error", f"holds {', '.join(data.data_vars)}")
    values, safe = (of.values for of in found[:2])
    known = np.where(safe, values, np.inf) if safe.any() else values
    measured = np.where(np.isnan(data[found[0].name].values), -np.inf, values)
    some = dict.fromkeys((int(np.argmin(known)), int(np.argmax(measured))))
    return [_motion(spec, data[found[0].name], np.unravel_index(i, values.shape)) for i in some]


def _motion(spec, values, place):
    at = dict(zip(values.dims, place, strict=True))
    chosen = {d: list(spec.bundles[d])[i] if d in spec.bundles else spec.axes[d].values[i] for d, i in at.items()}
    made = spec.build(**chosen)
    run = jax.tree.map(np.asarray, made.run())
    shown = {d: values[d].values[i] for d, i in at.items()}
    words = ", ".join(f"{d}{' = ' if isinstance(v, float) else ' '}{text(v)}" for d, v in shown.items())
    size = float(values.values[place])
    unit = values.attrs.get("units", "")
    note = f"{values.attrs.get('long_name', values.name)} {size:.4g} {unit}"
    return motion_of(run, made.law, name=words, note=note, radius=factors_of(made, run.q)[1])  # red where it is lost
