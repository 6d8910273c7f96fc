"""A log that a verb reads: its columns, its sampling time, and which of them are commands and which motion."""

import dataclasses
import pathlib
import re
from typing import Any

from cnclik import errors
from cnclik.cli.arguments import option
from cnclik.problem.columns import SECONDS, clock_of, words_of

SENT = {"command", "commands", "commanded", "cmd", "target", "desired", "reference", "ref", "setpoint", "sent"}
MOVED = {"position", "positions", "pos", "motion", "actual", "measured", "feedback"}
OTHER = {"velocity", "velocities", "vel", "effort", "efforts", "torque", "torques", "acceleration", "acc", "current"}
STATUS = {"status", "state", "mode", "flag", "flags", "code", "id", "seq", "sequence", "counter", "index", "enabled"}
STATUS |= {"fault", "valid", "running", "row", "iteration", "safety"}
EPOCHS = ((1e18, "ns"), (1e15, "us"), (1e12, "ms"))  # size of present-day stamps since 1970
STEPS = ((2e5, "ns"), (500.0, "us"), (0.5, "ms"))  # smallest step in each unit, as no loop takes more than 0.5 s


@dataclasses.dataclass(kw_only=True)
class LogOptions:
    """For verbs that read a log."""

    log: pathlib.Path = option(metavar="LOG.csv", positional=True)
    """The log: one row per sample, one column per joint, error or command."""
    Ts: float | None = option(None, unit="s")
    """Sampling time of loop and log [s]; default: from a column of times (time, timestamp, header.stamp, ...)."""
    columns: tuple[str, ...] | None = None
    """Columns to read, by name or number; default: all but times, status, velocities and efforts. Of commands and
    motion: all commands, then all motions."""
    json: bool = False
    """Print the result as JSON."""


@dataclasses.dataclass
class Log:
    """A log as read: names and numbers (N, columns) of its columns; its times (N,) or None, and where they are from."""

    names: list
    table: Any  # NumPy's arrays, which help does not need
    t: Any
    stamps: str
    left_out: set

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

    def chosen(self, given) -> list:
        """Indices of columns that are given by name or number."""
        return [self.names.index(errors.one_of("columns", column, self.names)) for column in given or ()]

    def errors(self) -> list:
        """The errors in a file of `cnclik solve --csv`."""
        return [i for i, name in enumerate(self.names) if name.startswith("e_")]

    def joints(self) -> list:
        """The joints in a file of `cnclik solve --csv`; of other files all columns of motion."""
        if found := [i for i, name in enumerate(self.names) if name.startswith("q_")]:
            return found
        if found := self.motions():
            return found
        raise errors.fail("LOG", "have a column besides the times", "has none")

    def motions(self) -> list:
        """Columns that are no times, status, velocities or efforts."""
        each = enumerate(self.names)
        return [i for i, name in each if i not in self.left_out and not OTHER & {*words_of(name)}]

    def pairs(self, given=None) -> tuple[list, list]:
        """Indices of commands and of motions: joint_1_cmd belongs to joint_1_pos, or to joint_1; ([], []) for none."""
        usual = self.motions()
        words = {i: [w for word in words_of(self.names[i]) for w in re.findall(r"[^0-9]+|[0-9]+", word)] for i in usual}
        of = {i: tuple(w for w in some if w not in SENT | MOVED) for i, some in words.items()}
        sent = {of[i]: i for i in usual if SENT & {*words[i]}}
        marked = {of[i]: i for i in usual if MOVED & {*words[i]} and not SENT & {*words[i]}}
        moved = {of[i]: i for i in usual if not SENT & {*words[i]}} | marked
        if given:
            places = self.chosen(given)
            if len(places) % 2:
                raise errors.fail("columns", "name as many motions as commands", f"names {len(places)} columns")
            return places[: len(places) // 2], places[len(places) // 2 :]
        if sent and sent.keys() <= moved.keys():
            return list(sent.values()), [moved[joint] for joint in sent]
        return (list(sent.values()), list(marked.values())) if sent and len(sent) == len(marked) else ([], [])


def read(args) -> Log:
    """The log of a verb's options."""
    from cnclik.problem.tables import read_columns

    names, table = read_columns("LOG", args.log)
    if table.size == 0:
        raise errors.fail("LOG", "hold numbers", f"{args.log.name} holds none")
    t, times, unit = clock(names, table)
    if t is None and args.Ts is None:
        raise errors.fail("Ts", "be given where no column is called t, time or stamp", "is not")
    name = names[times[0]] if times else "--Ts"
    stamps = f"{name}, read in {unit}" if args.Ts is None else "--Ts"
    return Log(list(names), table, t, stamps, {*times, *no_motion(names, table)})


def sampled(log: Log, Ts) -> float:
    """Ts [s] of a log without gaps: as given, or from its stamps, which a given one may contradict."""
    from cnclik.diagnosis.recording import APART, sampling_time

    name = log.stamps.partition(",")[0]
    if Ts is not None:
        Ts, log.stamps = sampling_time(None, Ts), "--Ts"
        if log.t is not None:
            try:
                own = sampling_time(log.t, None)
                log.stamps += f", though the stamps are {1e3 * own:.4g} ms apart" * (abs(own / Ts - 1) > APART)
            except errors.ArgumentError as error:
                log.stamps += f", though of the stamps {str(error).partition(', but ')[2].rstrip('.')}"
        return Ts
    with errors.called("t", name):
        return sampling_time(log.t, None)


# --- which column is what -----------------------------------------------------------------------------


def clock(names, table):
    """(times [s] (N,) or None; indices of all columns of times; the unit they were read in, or None).

    A pair of seconds and nanoseconds is one time. If the name does not state a unit, the size of the stamps does.
    """
    import numpy as np

    places, t, unit, parts = [], None, None, {}
    for i, name in enumerate(names):
        named = clock_of(name)
        if named is None:
            continue
        places.append(i)
        if named.part:
            parts.setdefault(named.of, {})[named.unit] = table[:, i]
        if t is None and not np.isnan(table[:, i]).all():
            unit = named.unit or _unit_of(table[:, i])
            t = (table[:, i] - table[0, i]) * SECONDS[unit]
    for pair in parts.values():
        if {"s", "ns"} <= set(pair):
            return pair["s"] - pair["s"][0] + 1e-9 * (pair["ns"] - pair["ns"][0]), places, "s"
    return t, places, unit


def _unit_of(t) -> str:
    """The unit of stamps, from their size since 1970 or their steps: a loop takes 0.1 ms to 0.5 s."""
    import numpy as np

    with np.errstate(invalid="ignore"):
        size, step = np.nanmax(np.abs(t)), np.abs(np.nanmedian(np.diff(t))) if len(t) > 1 else 0.0
    since = [unit for least, unit in EPOCHS if least <= size < 4 * least and 1e-5 <= step * SECONDS[unit] <= 1.0]
    return next(iter(since), None) or next((unit for least, unit in STEPS if step >= least), "s")


def no_motion(names, table) -> list:
    """Indices of columns that are not motion: non-numeric ones, and whole numbers named like a status or a count."""
    import numpy as np

    places = []
    for i, name in enumerate(names):
        values = table[:, i][~np.isnan(table[:, i])]
        if not len(values) or (np.all(values == np.round(values)) and STATUS & {*words_of(name)}):
            places.append(i)
    return places
