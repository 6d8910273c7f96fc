"""Columns: the meaning of the names above a table of poses, in any order and the usual spellings.

x, px, pos_x, position.x, /pose/position/x and x [mm] are one coordinate; qw, q_w, quat_w and orientation.w one of the
quaternion's; t00 … t33 are a transform's entries.
"""

import re
from typing import NamedTuple

from cnclik import errors, quantities

POSITION, QUATERNION, TIME = ("x", "y", "z"), ("qw", "qx", "qy", "qz"), "time"
TRANSFORM = tuple(f"t{i}{j}" for i in range(4) for j in range(4))
_TURN = "q|quat|quaternion|ori|orient|orientation|rot|rotation"
_PLACE = "p|pos|position|t|trans|translation"
_SPELLINGS = (  # the last parts of a name, in small letters, joined by _
    (re.compile(rf"(?:.*_)?(?:{_TURN})_?([wxyz])"), "q"),
    (re.compile(rf"(?:.*_)?(?:{_PLACE})_?([xyz])"), ""),
    (re.compile(r"([xyz])(?:_pos|_position|_m)?"), ""),
    (re.compile(r"(w)"), "q"),
    (re.compile(r"[tm]_?([0-3])_?([0-3])"), "t"),
)
_TIMES = ("time", "timestamp", "stamp", "times", "timestamps", "rosbagtimestamp", "clock")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}  # [s]
_SECONDS = {"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "millis": "ms", "usec": "us", "micros": "us"}
_SECONDS |= dict.fromkeys(("nsec", "nanosec", "nanos", "nsecs", "nanosecs", "nanoseconds"), "ns")
_UNITS = {**dict.fromkeys(POSITION, "m"), TIME: "s"}


def meanings(argument: str, file: str, names) -> list:
    """[(what a column is, factor to its unit)] of a head's names: x, y, z, qw … qz, time, or t00 … t33.

    Raises: ArgumentError for names that are unknown or there twice, and for half a quaternion.
    """
    found = [_meaning(argument, file, name) for name in names]
    is_ = [what for what, _ in found]
    if "qw" in is_ and not {"qx", "qy", "qz"} & set(is_) and is_.count("x") == 1:  # w x y z without qx is a quaternion
        turns = {"x": "qx", "y": "qy", "z": "qz"}
        found = [(turns.get(what, what), factor) for what, factor in found]
        is_ = [what for what, _ in found]
    for what in is_:
        if is_.count(what) > 1:
            both = " and ".join(repr(name) for name, other in zip(names, is_, strict=True) if other == what)
            raise errors.fail(argument, f"name each column once, such as {_listed()}", f"{file} has {both}")
    for some in (QUATERNION, TRANSFORM):
        lacking = [name for name in some if name not in is_]
        if lacking and len(lacking) < len(some):
            raise errors.fail(argument, f"have all of {some[0]} … {some[-1]}", f"{file} lacks {' '.join(lacking)}")
    return found


def of_tip(names, tip) -> dict:
    """{number: name without the tip} of the columns of a tip, such as left_hand.x, and of times; {} if there are none.

    Args: tip: the names that the tip may have.
    """
    own = {}
    for i, name in enumerate(names):
        before = next((one for one in tip if name.startswith((f"{one}.", f"{one}/"))), None)
        if before is not None:
            own[i] = name[len(before) + 1 :]
    return {i: own.get(i, name) for i, name in enumerate(names) if i in own or clock_of(name)} if own else {}


def words_of(name) -> list:
    """The words of a column's name in small letters: /header/stampNs is header, stamp, ns."""
    return [word for word in re.split(r"[^a-z0-9µ]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower()) if word]


class Clock(NamedTuple):
    """The meaning of the name of a column of times."""

    unit: str | None  # a key of SECONDS
    of: tuple  # other words of the name
    part: bool  # whether it may be one of a pair of seconds and nanoseconds


def clock_of(name) -> Clock | None:
    """The meaning of a name of times, or None: t, time, __time, /header/stamp, sec, nanosec, t [ms], time_ns."""
    words = words_of(name)
    unit = next((_SECONDS.get(w, w) for w in words[::-1] if w in SECONDS or w in _SECONDS), None)
    rest = [w for w in words if w not in SECONDS and w not in _SECONDS]
    long = bool(words) and words[-1] in _SECONDS
    if long and not rest:
        rest = ["time"]  # `sec`, `nanosec` alone
    if not rest or not (rest == ["t"] or rest[-1] in _TIMES or (long and any(w in _TIMES for w in rest))):
        return None
    return Clock(unit, tuple(rest), long and unit is not None and SECONDS[unit] in (1.0, 1e-9))


def _meaning(argument, file, name):
    bare, unit = name, ""
    if ends := re.fullmatch(r"(.*?)\s*[\[(]\s*([^\])]*?)\s*[\])]\s*", name):
        bare, unit = ends.groups()
    key = re.sub(r"[^0-9a-z]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", bare).lower()).strip("_")
    times = clock_of(bare)
    what = TIME if times else None
    for pattern, prefix in _SPELLINGS:
        if what is None and (made := pattern.fullmatch(key)):
            what = prefix + "".join(made.groups())
    if what is None:
        raise errors.fail(argument, f"have columns such as {_listed()}", f"{file} has {name!r}")
    units = quantities.units(_UNITS[what]) if what in _UNITS else {}
    if unit and unit not in units and (what in _UNITS or unit != "1"):
        usual = f"be in {', '.join(w for w in units if w.isascii())}" if units else "be without unit"
        raise errors.fail(argument, f"have columns whose units are known: {what} must {usual}", f"{file} has {name!r}")
    if times and times.unit and not unit:
        return what, SECONDS[times.unit]
    return what, units.get(unit, (1.0, ""))[0]


def _listed() -> str:
    return ", ".join((TIME, *POSITION, *QUATERNION))
