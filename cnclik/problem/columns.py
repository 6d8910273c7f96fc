"""Columns: the names of times above a table, in the usual spellings: t, time_ns, /header/stamp, sec, t [ms]."""

import re
from typing import NamedTuple

_TIMES = ("time", "timestamp", "stamp", "times", "timestamps", "rosbagtimestamp", "clock")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}  # [s]
_SECONDS = {"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "millis": "ms", "usec": "us", "micros": "us"}
_SECONDS |= dict.fromkeys(("nsec", "nanosec", "nanos", "nsecs", "nanosecs", "nanoseconds"), "ns")


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
