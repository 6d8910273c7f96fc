"""Recording: columns of numbers, and their sampling time from stamps that jitter."""

import numpy as np

from cnclik import errors

LEAST = 16  # rows
LARGEST = 1e30  # value of a recording, at most; squares of far larger ones overflow
MISSING, BESIDE = 0.6, 12  # of a step, by which stamps of the rows on either side are late where one is missing
APART = 0.02  # difference between a given Ts and that of the stamps that needs no note


def columns(name, values, door):
    """Return a log as columns (N, k). Raises: ArgumentError for values that are not finite, too large or traced."""
    values = errors.array(name, values, (None,), (None, None), most=LARGEST)
    if not errors.concrete(values):
        raise errors.fail(name, "hold numbers", f"is traced by JAX: call {door} outside of jit, vmap and grad")
    values = np.asarray(values, float)
    return values[:, None] if values.ndim == 1 else values


def line(N):
    """Return an offset and a drift as columns (N, 2)."""
    return np.linspace(-1, 1, N)[:, None] ** np.arange(2)


def sampling_time(t, Ts) -> float:
    """Ts [s] as given or from times (N,) with jitter.

    Raises: ArgumentError if rows are missing, or if neither is given.
    """
    if Ts is not None or t is None:
        return float(errors.number("Ts", Ts, positive=True))
    t = np.asarray(errors.array("t", t, (None,), most=LARGEST), float)
    usual, step = spacing(t), np.diff(t)
    mean, middle = float(step.mean()), float(np.median(step))
    if np.unique(step).size < 4 and abs(middle / mean - 1) > APART:
        found = f"are {middle:.6g} s apart in the median and {mean:.6g} s in the mean (digits are missing, or rows)"
        raise errors.fail("t", "be times that are equally far apart", found)
    late = t - t[0] - usual * np.arange(len(t))
    gaps = {}
    for k in np.flatnonzero(
        step > (1 + MISSING) * usual
    ):  # a single late stamp is jitter, and those after it are not late
        after, before = late[k + 1 : k + 1 + BESIDE], late[max(k + 1 - BESIDE, 0) : k + 1]
        gaps[int(k)] = float(np.median(after) - np.median(before))
    worst = max(gaps, key=lambda k: gaps[k], default=None)
    if worst is not None and gaps[worst] > MISSING * usual:
        found = f"row {worst + 2} comes {step[worst]:.4g} s after the one before"
        raise errors.fail("t", f"have a row every {usual:g} s", found)
    return mean


def spacing(t) -> float:
    """The usual step of times (N,), which may jitter; a few rows may be missing. Raises: ArgumentError."""
    apart = max(len(t) // 4, 1)
    usual = (
        float(np.median(t[apart:] - t[:-apart])) / apart if len(t) > 1 else 0.0
    )  # long intervals reduce the effect of jitter
    if not usual > 0:
        raise errors.fail("t", "increase", f"the median step is {usual:g} s")
    return usual
