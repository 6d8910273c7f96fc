"""Recording: columns of numbers, and their sampling time from stamps that jitter."""

import numpy as np

from cnclik import errors

LARGEST = 1e30  # value of a recording, at most; squares of far larger ones overflow
TURN = 0.1  # [rad] from a whole turn, within which a jump is a wrap: no joint moves a turn in a sample
MISSING, BESIDE = 0.6, 12  # of a step, by which the rows after a gap come late; rows on either side that tell


def columns(name, values, door, *, least=16, like=None):
    """Return a log as columns (N, k), as many as `like` has. Raises: ArgumentError, also of what `door` can't trace."""
    values = errors.array(name, values, (None,), (None, None), most=LARGEST)
    if not errors.concrete(values):
        raise errors.fail(name, "hold numbers", f"is traced by JAX: call {door} outside of jit, vmap and grad")
    values = np.asarray(values, float)
    values = values[:, None] if values.ndim == 1 else values
    if like is not None and values.shape != like.shape:
        raise errors.fail(name, f"have shape {like.shape}", f"has shape {values.shape}")
    if len(values) < least or values.shape[1] == 0:
        raise errors.fail(name, f"have at least {least} rows", f"has {len(values) if values.shape[1] else 0}")
    return values


def sampling_time(t, Ts, N=None) -> float:
    """Return Ts [s] as given, or from times (N,) that jitter. Raises: ArgumentError if rows are missing."""
    if Ts is not None or t is None:
        Ts = errors.number("Ts", Ts, positive=True)
        return float(errors.array("Ts", Ts, (), at_least=1 / LARGEST, most=LARGEST))
    t = np.asarray(errors.array("t", t, (N,), most=LARGEST), float)
    usual, step = spacing(t), np.diff(t)
    if (late := step * missing(t, usual)).any():
        row = int(np.argmax(late))
        found = f"row {row + 2} comes {step[row]:.4g} s after the one before"
        raise errors.fail("t", f"have a row every {usual:g} s", found)
    return usual


def spacing(t) -> float:
    """Return the step of times (N,) beside gaps: over long intervals jitter counts little. Raises: ArgumentError."""
    apart, k, usual = max(len(t) // 4, 1), np.arange(float(len(t))), 0.0
    for _ in range(4):  # a better step shows more of the gaps
        usual = float(np.median((t[apart:] - t[:-apart]) / (k[apart:] - k[:-apart]))) if len(t) > 1 else 0.0
        if not usual > 0:
            raise errors.fail("t", "increase", f"the median step is {usual:g} s")
        k[1:] = np.cumsum(np.where(missing(t, usual), np.round(np.diff(t) / usual), 1.0))
    return usual


def missing(t, Ts):
    """Return whether rows are missing after each of the first N − 1 times: a late stamp alone is jitter."""
    late, gaps = t - Ts * np.arange(len(t)), np.diff(t) > (1 + MISSING) * Ts
    for k in np.flatnonzero(gaps):
        before, after = late[max(k + 1 - BESIDE, 0) : k + 1], late[k + 1 : k + 1 + BESIDE]
        gaps[k] = np.median(after) - np.median(before) > MISSING * Ts
    return gaps


def unwrapped(q, gaps=False) -> tuple:
    """(Joint values (N,) or (N, k) that go on where they wrap by 2π, whether each step does)."""
    step = np.diff(q, axis=0, prepend=q[:1])
    wraps = np.abs(np.abs(step) - 2 * np.pi) < TURN
    wraps[1:] &= np.logical_not(gaps)
    return q - 2 * np.pi * np.cumsum(np.sign(step) * wraps, axis=0), wraps[1:]
