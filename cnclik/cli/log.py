"""A log that a verb reads: its columns, its sampling time, and which of them are commands and which motion."""

import contextlib
import dataclasses
import math
import pathlib
import re
from typing import Any

from cnclik import errors, quantities

SENT = {"command", "commands", "commanded", "cmd", "target", "desired", "reference", "ref", "setpoint", "sent"}
MOVED = {"position", "positions", "pos", "motion", "actual", "measured", "feedback"}
OTHER = {"velocity", "velocities", "vel", "effort", "efforts", "torque", "torques", "acceleration", "acc", "current"}
STATUS = {"status", "state", "mode", "flag", "flags", "code", "id", "seq", "sequence", "counter", "index", "enabled"}
STATUS |= {"fault", "valid", "running", "row", "iteration", "safety"}
TIMES = {"time", "timestamp", "stamp", "times", "timestamps", "rosbagtimestamp", "clock"}
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # [s]
SIZES = {word: factor for word, (factor, _) in quantities.units("q").items()}  # in rad or m, of a word in a name
SIZES |= dict.fromkeys(("degree", "degrees"), SIZES["deg"])
LENGTHS = {*quantities.units("x")}
PARTS = {"": "s", "m": "ms", "milli": "ms", "u": "us", "µ": "us", "micro": "us", "n": "ns", "nano": "ns"}
UNITS = {f"{part}{word}": unit for part, unit in PARTS.items() for word in ("s", "sec", "secs", "seconds")}
FASTEST, SLOWEST = 2e-4, 0.5  # [s] of a sample, where neither a name nor a Ts gives the unit of stamps
YEARS = 1e9, 1e10  # [s] of stamps since 1970, up to 2286
APART = 0.02  # difference between a given Ts and that of the stamps that needs no note


@dataclasses.dataclass
class Log:
    """A log as read: names and numbers (N, columns) of its columns; its times (N,) or None, and where they are from."""

    names: list
    table: Any  # NumPy's arrays, which help does not need
    t: Any
    Ts: float | None  # as given
    stamps: str
    motion: list  # indices of the columns that are no times, status, velocities or efforts
    chosen: list  # indices of the columns that were named
    lengths: list  # whether the name of each column has a unit of length

    def columns(self, places):
        """(N, k) of some columns, up to the last complete row: the last instant of a run has no step."""
        import numpy as np

        table = self.table[:, places]
        empty = np.isnan(table).any(1)
        table = table[: len(table) - int(np.argmin(empty[::-1]))]
        if (rows := np.flatnonzero(~np.isfinite(table).all(1))).size:
            found = f"has none in row {rows[0] + 1}"
            raise errors.fail("LOG", "hold a finite number in every row of its columns", found)
        return table

    def moved(self) -> list:
        """Indices of the columns that were named, else of the motion of joints with commands, else of all motion."""
        if found := self.chosen or self.pairs()[1] or self.motion:
            return found
        raise errors.fail("LOG", "have a column besides the times", "has none")

    def pairs(self) -> tuple[list, list]:
        """Indices of commands and of motions: joint_1_cmd belongs to joint_1_pos, or to joint_1; ([], []) for none."""
        words = {i: words_of(self.names[i]) for i in self.motion}
        of = {i: tuple(word for word in some if word not in SENT | MOVED) for i, some in words.items()}
        sent = {of[i]: i for i, some in words.items() if SENT & {*some}}
        rest = [i for i in words if i not in sent.values()]
        marked = {of[i]: i for i in rest if MOVED & {*words[i]}}
        moved = {of[i]: i for i in rest} | marked
        if sent.keys() <= moved.keys():
            return list(sent.values()), [moved[joint] for joint in sent]
        return (list(sent.values()), list(marked.values())) if len(sent) == len(marked) else ([], [])


def read(log: str, *, Ts: float | None = None, columns: tuple[str, ...] | None = None) -> Log:
    """Read a log.

    Args:
      log: the log, a CSV file: one row per sample, one column per joint, error or command.
      Ts: sampling time of loop and log [s]; default: from a column of times (time, timestamp, header.stamp, ...).
      columns: columns to read, by name or number; default: all but times, status, velocities and efforts. Of commands
        and motion: all commands, then all motions.
    """
    import numpy as np

    from cnclik.diagnosis.recording import LARGEST, sampling_time, spacing
    from cnclik.problem.tables import read_columns

    names, table = read_columns("LOG", log)
    if not np.isfinite(table).any():
        raise errors.fail("LOG", "hold numbers", f"{pathlib.Path(log).name} holds none")
    sizes = [math.prod(SIZES.get(word, 1.0) for word in words_of(name)) for name in names]
    table *= sizes
    if Ts is not None:
        sampling_time(None, Ts)
    with np.errstate(all="ignore"):
        t, times, unit = clock(names, table, Ts)
    if t is not None and (rows := np.flatnonzero(np.abs(t) > LARGEST)).size:
        raise errors.fail("LOG", f"hold times up to {LARGEST:g}", f"has a larger one in row {rows[0] + 1}")
    if t is None and Ts is None:
        raise errors.fail("Ts", "be given where no column is called t, time or stamp", "is not")
    stamps = f"{names[times[0]] if times else '--Ts'}, read in {unit}" if Ts is None else "--Ts"
    if Ts is not None and t is not None and len(t) > 1:
        apart = float(np.mean(np.diff(t)))
        with contextlib.suppress(errors.ArgumentError):  # of times that do not increase
            apart = spacing(t)
        stamps += f", though the stamps are {1e3 * apart:.4g} ms apart" * (abs(apart / Ts - 1) > APART)
    at = {str(i + 1): i for i in range(len(names))} | {name: i for i, name in enumerate(names)}
    chosen = [at[errors.one_of("columns", column, at if column in at else names)] for column in columns or ()]
    left_out = {*times, *no_motion(names, table)}
    motion = [i for i, name in enumerate(names) if i not in left_out and not OTHER & {*words_of(name)}]
    own = [name if sizes[i] == 1 else name.partition("[")[0].strip() or name for i, name in enumerate(names)]
    return Log(own, table, t, Ts, stamps, motion, chosen, [bool(LENGTHS & {*words_of(name)}) for name in names])


def sampled(log: Log) -> float:
    """Ts [s] of a log without gaps: as given, or from its stamps."""
    from cnclik.diagnosis.recording import sampling_time

    with errors.called("t", log.stamps.partition(",")[0]):
        return sampling_time(log.t, log.Ts)


# --- which column is what -----------------------------------------------------------------------------


def words_of(name) -> list:
    """The words and numbers of a column's name in small letters: /header/stampNs1 is header, stamp, ns, 1."""
    name = re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower().replace("μ", "µ")  # the letter, and the sign for micro
    return re.findall("[a-zµ]+|[0-9]+|°", name)


def clock(names, table, Ts=None):
    """(times [s] (N,) or None; indices of all columns of times; the unit they were read in, or None).

    A pair of seconds and nanoseconds is one time. If the name does not state a unit, Ts does, or the stamps.
    """
    import numpy as np

    units, parts = {}, {}  # of each column of times; {other words: {unit: column}} of pairs
    for i, words in enumerate(map(words_of, names)):
        unit = next((UNITS[w] for w in words[::-1] if w in UNITS), None)
        rest = tuple(w for w in words if w not in UNITS)
        long = bool(words) and words[-1] in UNITS and len(words[-1]) > 2
        if rest == ("t",) or TIMES & {*rest[-1:]} or (long and (not rest or TIMES & {*rest})):
            units[i] = unit
            if long:
                parts.setdefault(rest, {})[unit] = table[:, i]
    for pair in parts.values():
        if {"s", "ns"} <= set(pair):
            return pair["s"] - pair["s"][0] + 1e-9 * (pair["ns"] - pair["ns"][0]), [*units], "s"
    for i, unit in units.items():
        if not np.isnan(t := table[:, i]).all():
            unit = unit or _unit_of(t, Ts)
            return (t - t[0]) * SECONDS[unit], [*units], unit
    return None, [*units], None


def _unit_of(t, Ts) -> str:
    """The unit of stamps: in which their steps are nearest to Ts; without Ts in which they are some, and since 1970."""
    import numpy as np

    step = abs(np.nanmedian(np.diff(t))) if len(t) > 1 else 0.0
    if Ts is not None and step > 0:
        return min(SECONDS, key=lambda unit: abs(np.log(step * SECONDS[unit] / Ts)))
    some = [unit for unit, size in SECONDS.items() if FASTEST <= step * size <= SLOWEST]
    years = [unit for unit in some if YEARS[0] <= np.nanmedian(t) * SECONDS[unit] < YEARS[1]]
    if len(some) > 1 and not years:
        found = f"is not: steps of {step:g} may be {' or '.join(some)}"
        raise errors.fail("Ts", "be given, or the unit in the name of the times, as in time_ms", found)
    return (years or some or ["s"])[0]


def no_motion(names, table) -> list:
    """Indices of columns that are not motion: non-numeric ones, and whole numbers named like a status or a count."""
    import numpy as np

    places = []
    for i, name in enumerate(names):
        values = table[:, i][~np.isnan(table[:, i])]
        if not len(values) or (np.all(values == np.round(values)) and STATUS & {*words_of(name)}):
            places.append(i)
    return places
