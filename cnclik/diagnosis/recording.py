"""Recording: columns of numbers, their sampling time from stamps of any unit, and which columns are not motion."""

import numpy as np

from cnclik import errors
from cnclik.problem.columns import SECONDS, clock_of, words_of

LEAST = 16  # rows
LARGEST = 1e30  # value of a recording, at most; squares of far larger ones overflow
MISSING = 0.6  # of a step; where a row is missing, stamps fall behind permanently by at least this
ROWS_BESIDE = 12  # rows compared on either side
APART = 0.02  # difference between a given Ts and that of the stamps that needs no note
_STATUS = ("status", "state", "mode", "flag", "flags", "code", "id", "seq", "sequence", "counter", "index")
_STATUS += ("enabled", "fault", "valid", "running", "row", "iteration", "safety")
_EPOCHS = ((1e18, "ns"), (1e15, "us"), (1e12, "ms"))  # size of present-day stamps since 1970
_STEPS = ((2e5, "ns"), (500.0, "us"), (0.5, "ms"))  # smallest step in each unit, as no loop takes more than 0.5 s


def columns(name, values):
    """A recording (N,) or (N, k) as columns (N, k). Raises: ArgumentError for values not finite or beyond LARGEST."""
    values = np.asarray(errors.array(name, values, (None,), (None, None), most=LARGEST), float)
    return values[:, None] if values.ndim == 1 else values


def sampling_time(t, Ts) -> float:
    """Ts [s] as given or from times (N,) with jitter.

    Raises: ArgumentError if rows are missing, or if neither is given.
    """
    if Ts is not None or t is None:
        return float(errors.number("Ts", Ts, positive=True))
    t = np.asarray(errors.array("t", t, (None,), most=LARGEST), float)
    step = np.diff(t)
    usual = float(np.median(step)) if len(step) else 0.0
    if usual <= 0:
        raise errors.fail("t", "increase", f"the median step is {usual:g} s")
    mean = float(t[-1] - t[0]) / len(step)
    if np.unique(step).size < 4 and abs(usual / mean - 1) > APART:
        found = f"are {usual:.6g} s apart in the median and {mean:.6g} s in the mean (digits are missing, or rows)"
        raise errors.fail("t", "be times that are equally far apart", found)
    usual = spacing(t)
    gap = _gap(t, step, usual)
    if gap is not None:
        found = f"row {gap + 2} comes {step[gap]:.4g} s after the one before"
        raise errors.fail("t", f"have a row every {usual:g} s", found)
    return mean


def spacing(t) -> float:
    """The usual step of times (N,), which may jitter; a few rows may be missing. Raises: ArgumentError."""
    apart = max(len(t) // 4, 1)
    usual = float(np.median(t[apart:] - t[:-apart])) / apart  # long intervals reduce the effect of jitter
    if usual <= 0:
        raise errors.fail("t", "increase", f"the median step is {usual:g} s")
    return usual


def _gap(t, step, usual):
    """The step after which stamps are permanently delayed; None if there is none: a single late stamp is jitter."""
    late = t - t[0] - usual * np.arange(len(t))
    found = {}
    for k in np.flatnonzero(step > (1 + MISSING) * usual):
        before, after = late[max(k + 1 - ROWS_BESIDE, 0) : k + 1], late[k + 1 : k + 1 + ROWS_BESIDE]
        found[int(k)] = float(np.median(after) - np.median(before)) / usual
    worst = max(found, key=found.get, default=None)
    return worst if worst is not None and found[worst] > MISSING else None


# --- which column is what -----------------------------------------------------------------------------


def clock(names, table):
    """(times [s] (N,) or None; indices of all columns of times; the unit they were read in, or None).

    A pair of seconds and nanoseconds is one time. If the name does not state a unit, the size of the stamps does.
    """
    places, found, unit = [], None, None
    parts = {}
    for i, name in enumerate(names):
        named = clock_of(name)
        if named is None:
            continue
        places.append(i)
        if named.part:
            parts.setdefault(named.of, {})[named.unit] = i
        if found is None and not np.isnan(table[:, i]).all():
            found, unit = table[:, i] - table[0, i], named.unit or _unit_of(table[:, i])
            found = found * SECONDS[unit]
    for pair in parts.values():
        if {"s", "ns"} <= set(pair):
            whole, part = table[:, pair["s"]], table[:, pair["ns"]]
            return whole - whole[0] + 1e-9 * (part - part[0]), places, "s"
    return found, places, unit


def _unit_of(t) -> str:
    """The unit of stamps, from their size since 1970 or their steps: a loop takes 0.1 ms to 0.5 s."""
    with np.errstate(invalid="ignore"):
        size, step = np.nanmax(np.abs(t)), np.abs(np.nanmedian(np.diff(t))) if len(t) > 1 else 0.0
    since = [unit for least, unit in _EPOCHS if least <= size < 4 * least and 1e-5 <= step * SECONDS[unit] <= 1.0]
    return next(iter(since), None) or next((unit for least, unit in _STEPS if step >= least), "s")


def no_motion(names, table) -> list:
    """Indices of columns that are not motion: non-numeric ones, and whole numbers named like a status or a count."""
    found = []
    for i, name in enumerate(names):
        values = table[:, i][~np.isnan(table[:, i])]
        whole = bool(np.all(values == np.round(values)))
        if not len(values) or (whole and any(word in _STATUS for word in words_of(name))):
            found.append(i)
    return found
