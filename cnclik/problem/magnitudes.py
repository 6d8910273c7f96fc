"""Magnitudes: units that fit the joints and the task, and remarks on numbers that are probably in another unit."""

import math

import numpy as np

from cnclik import errors, quantities
from cnclik.problem.options import SWEPT
from cnclik.robot.posture import arm_length, beyond_arm

_TURN = 2 * math.pi
_INSIDE = 1e-6  # rounding of a joint value at its limit
_FAR = 2  # times the length of the arm; a point that far, if in millimetres, is within reach
_JOINTS = ("q0", "posture", "near")  # options that are joint values
_POINTS = ("target", "from", "to", "center")
_LENGTHS = ("radius", "amplitude")


def check_units(chain, task, written: dict) -> None:
    """Raise ArgumentError if a unit does not fit its option: degrees for a prismatic joint or a position.

    Args: written: {option: the given unit of each number, or None}; see `cnclik.quantities.read`.
    """
    parts, axes = ["m"] * bool(task.lengths) + ["rad"] * bool(task.angles), list(task.units)
    wanted: dict = {} if hasattr(task.parts[0], "axes") else {"target": axes}
    wanted |= dict.fromkeys(("above", "below", "margin"), axes[:1])
    wanted |= {"error_clamp": parts, "noise": axes, "tolerance": ["m", "rad"], "accept": ["m", "rad"]}
    for name, units in written.items():
        option = SWEPT.get(name)
        of_joints = name in ("near", "jump", "velocity_limit") or (option is not None and option.unit.startswith("q"))
        each = list(chain.units) if of_joints else wanted.get(name)
        if each is None or not any(units):
            continue
        for k, unit in enumerate(each):
            given = units[k if len(units) == len(each) else 0]
            if given and given.partition("/")[0] != unit and len(units) in (1, len(each)):
                what = f"joint {chain.joint_names[k]!r} is in {unit}" if of_joints else f"number {k + 1} is in {unit}"
                raise errors.fail(name, "have the units of what it is for", f"{what}, and {given} is given")


def remark_on(given: dict, chain, task, Ts, written: dict) -> None:
    """Check the units of options, see `check_units`, and remark on those without one that are plausible in another.

    Args: given: {option: value}. written: as for `check_units`.
    """
    check_units(chain, task, written)
    bare = {name: value for name, value in given.items() if not any(written.get(name, ()))}
    remark_on_times(bare, Ts)
    if bare.get("speed", 0) > 10:
        errors.remark(f"`speed` is {bare['speed']:g} m/s. Millimetres are written --speed {bare['speed']:g}mm/s.")
    if "phase" in bare and np.max(np.abs(bare["phase"])) > _TURN:
        errors.remark(f"`phase` is {_text(bare['phase'])} rad. Degrees are written --phase {_text(bare['phase'])} deg.")
    for name in _JOINTS:
        if isinstance(bare.get(name), (tuple, list)) and len(bare[name]) == chain.n:
            _remark_on_joints(name, bare[name], chain)
    remark_on_lengths(bare, chain, task)


def remark_on_times(bare: dict, Ts) -> None:
    """Remarks on a sampling time, a dead time and a lag without a unit that are probably in another one."""
    late = bare.get("delay", 0)
    if 0 < late < 0.5:
        errors.remark(
            f"`delay` is in samples: {quantities.in_samples(late, Ts)} of dead time. A time is written with its unit: "
            f"--delay {1e3 * late:g}ms."
        )
    if "Ts" in bare and bare["Ts"] > 1:
        errors.remark(f"`Ts` is {bare['Ts']:g} s, a controller slower than once a second. Milliseconds are written "
                      f"--Ts {bare['Ts']:g}ms.")  # fmt: skip
    if "lag" in bare and np.max(bare["lag"]) > 1:
        errors.remark(f"`lag` is {np.max(bare['lag']):g} s. Milliseconds are written --lag {np.max(bare['lag']):g}ms.")


def _remark_on_joints(name, values, chain):
    limits = zip(values, chain.units, chain.lower, chain.upper, strict=True)
    far = [
        value
        for value, unit, low, high in limits
        if unit == "rad" and abs(value) > _TURN and not -math.inf < low <= value <= high < math.inf
    ]
    if far:
        each = (f"{v:g}{'m' if u == 'm' else 'deg'}" for v, u in zip(values, chain.units, strict=True))
        where = " ".join(each) if "m" in chain.units else f"{_text(values)} deg"
        errors.remark(
            f"`{name}` has a joint at {far[0]:g} rad, more than a turn. Degrees are written --{name} {where}."
        )


def remark_on_limits(name: str, values, chain) -> None:
    """A remark on the joint that is farthest beyond its limits."""
    beyond = np.maximum(np.subtract(values, chain.upper), np.subtract(chain.lower, values))
    far = int(np.argmax(beyond))
    if beyond[far] > _INSIDE:
        errors.remark(f"`{name}` has {chain.joint_names[far]} {beyond[far]:.3g} {chain.units[far]} beyond its limit.")


def remark_on_lengths(bare: dict, chain, task, where="") -> None:
    """Remarks on points and lengths without a unit that are probably in another one.

    Args: where: the table that they are in, if they are no options of the command line.
    """
    named = [name for name in (*_POINTS, *_LENGTHS) if name in bare]
    length = _length_of(chain, task) if named else None
    if length is None:
        return
    for name in named:
        values = np.atleast_1d(np.asarray(bare[name], float))
        if name in _POINTS:
            values = values[:-4] if task.orientation and len(values) > 4 else values
            axes = (0, 1, 2) if len(values) == 3 else task.linear
            number = chain.tip_number(task.parts[0].tip)
            far = len(values) == len(axes) and beyond_arm(chain, values, axes, number=number) > (_FAR - 1) * length
        else:
            far = np.abs(values).max() > _FAR * length
        if far:
            write = f'{name} = "{_text(values)} mm"' if where else f"--{name} {_text(values)} mm"
            errors.remark(
                f"`{where}{name}` has {np.abs(values).max():g} m, and the arm is {length:.3g} m long. Millimetres are "
                f"written with their unit: {write}."
            )


def remark_on_places(file: str, places, chain, task, tip=None) -> None:
    """A remark on the positions (N, axes) of a file if most are so far out of reach that millimetres must be meant.

    Args: tip: the name of their tip; None: the only one.
    """
    places, length = np.asarray(places, float), _length_of(chain, task)
    if length is None or not places.size:
        return
    axes = (0, 1, 2) if places.shape[-1] == 3 else task.linear
    away = beyond_arm(chain, places, axes, number=chain.tip_number(tip))
    far = int(np.sum(away > (_FAR - 1) * length))
    if far > 0.5 * len(places):
        errors.remark(
            f"{far} of {len(places)} positions in {file} are far out of reach: up to {np.nanmax(np.abs(places)):g} m, "
            f"and the arm is {length:.3g} m long. Millimetres are named in the header: x [mm], y [mm], z [mm]."
        )


def _length_of(chain, task):
    """The arm's length [m]; None if it is unknown, as for a slide, or if the task has no position."""
    length = arm_length(chain)
    return length if errors.concrete(length) and task.position and "m" not in chain.units else None


def _text(values) -> str:
    return " ".join(f"{v:g}" for v in np.atleast_1d(values))
