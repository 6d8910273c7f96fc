"""Judge: which modes of a recording belong to the loop and which to a path, and what kind of motion they are."""

import enum

import numpy as np

from cnclik.diagnosis.blocks import orthogonal, within
from cnclik.diagnosis.late import phase_delay
from cnclik.diagnosis.modes import Modes, find_modes, polynomials, roughness

MOST = 2000  # rows to be judged, at most: those that move most
LEAST = 16  # rows
TURNS = 3  # periods needed of an oscillation that does not decay
SHRUNK = 0.7  # share left at the end of one that decays; for these one period is enough
BEGUN = 0.05  # share of the range that counts as the beginning of motion
BACK = 0.04  # back-and-forth motion, as a share of the range, that counts as ringing
SEEN = 0.01  # share left after half a period below which it is not ringing
HELD = 1.5  # change in size over all rows, at most, of a sustained oscillation
GREW = 2.0  # factor over all rows above which growth without oscillation is not a path's
LOST = 0.05  # share left at the end of a motion that has decayed
WINDOW = 1.5  # periods in a window in which an oscillation must be visible
BENT = 2.0  # residual over its roughness, at most, if no bends of a path are left in it
CLEAN = 1e-3  # or the residual as a share of the waves
HARDLY = 2e-3  # share of the range that is negligible
WAVES = 0.04  # waves left by such bends, at most, as a share of the range
ABOVE = 1.5  # or as a multiple of the residual,
OFTEN = 10  # if there are fewer periods than this
BETTER = 10.0  # margin in the criterion by which growth must beat a polynomial
THERE = 0.5  # share of an oscillation that must remain beside the best cubic
UNFINISHED = 0.3  # motion of a short recording's path and of lasting modes, as a share of the decay
ABOVE_NOISE = 8.0  # or as a multiple of the noise, if there is no decay
SAME = 0.25  # samples by which dead times of modes of one loop may differ
SMALL = 0.01  # share of the dominant mode's energy below which a mode does not count beside it


class Kind(enum.StrEnum):
    """What a recording shows."""

    RINGING = "ringing"
    SUSTAINED = "sustained oscillation"
    GROWING = "growing oscillation"
    DIVERGING = "growth without oscillation"
    MONOTONE = "monotone decay"
    QUIET = "quiet"
    NOISE = "noise"
    UNDECIDED = "undecided"


OSCILLATING = (Kind.RINGING, Kind.SUSTAINED, Kind.GROWING)


def spans(parts):
    """(k,) range of the sum of parts (g, N, k)."""
    return np.ptp(parts.sum(0), axis=0)


def looked_at(y, longest):
    """(first, begun, last): the at most MOST rows that move most; before `begun` they hardly move."""
    first, last = 0, len(y)
    if last > MOST:
        width = int(min(longest, last // 8))
        kernel = np.ones(width) / width
        fast = [c - np.convolve(np.pad(c, width, mode="edge"), kernel, "same")[width:-width] for c in y.T]
        size = sum((c / (np.std(c) + np.finfo(float).tiny)) ** 2 for c in fast)
        total = np.concatenate([[0.0], np.cumsum(size)])
        first = int(np.argmax(total[MOST:] - total[:-MOST]))
        last = first + MOST
    away = np.abs(y[first:last] - y[first]) > BEGUN * np.ptp(y[first:last], axis=0)
    begun = int(np.argmax(away.any(1)))
    return first, first + begun if last - first - begun >= LEAST else first, last


def growing(y, longest):
    """The modes of rows that grow from a small start; None if they do not."""
    found = find_modes(y, longest)
    grown = np.any(np.abs(found.factors) ** len(y) > 1 / BEGUN)
    return found if grown and explained(y, found) and found.score < polynomials(y) else None


def judged(y, found: Modes, longest):
    """(kind, indices of the modes that show it with the dominant first, whether each mode is the loop's).

    Args:
      y: (N, k) what the modes were found in. longest: longest period of a loop's oscillation [samples].
    """
    N, f, size = len(y), found.factors, np.abs(found.factors)
    angle = np.abs(np.angle(f))
    energy = np.sum(found.parts**2, axis=(1, 2))
    turns = N * angle / (2 * np.pi)
    dies = N * np.log(size) < np.log(LOST)
    changes = N * np.abs(np.log(size)) > -np.log(SHRUNK)
    fast = (angle * longest >= 2 * np.pi) & ((turns >= TURNS) | (changes & (turns >= 1)))
    visible = np.abs(np.log(size)) * np.pi < -np.log(SEEN) * angle
    fast &= visible
    own = fast | dies
    chosen = _hardest(f, energy, np.flatnonzero(fast)[np.argsort(-energy[fast])])
    up = np.flatnonzero((f.real > 0) & ((f.imag == 0) | ~visible) & (N * np.log(size) > np.log(GREW)))
    up = up[np.argsort(-energy[up])]
    if len(up) and _grows(y, found, up[0], chosen):
        return Kind.DIVERGING, up[:1], own
    back = len(chosen) and _turns_back(found.parts[own].sum(0))
    if back and _is_there(y, found, found.parts[chosen].sum(0), angle[chosen[0]]):
        change = np.log(size[chosen[0]])
        if abs(change) < np.log(HELD) / N:
            return Kind.SUSTAINED, chosen, own
        return (Kind.GROWING if change > 0 else Kind.RINGING), chosen, own
    real = np.flatnonzero(dies & (f.real > 0) & ((f.imag == 0) | ~visible))
    if len(real):
        rest = np.ptp(found.path + found.parts[~dies].sum(0), axis=0)
        unfinished = longest > N and np.any(rest > UNFINISHED * spans(found.parts[real]) + ABOVE_NOISE * found.noise)
        decay = explained(y, found) and not unfinished
        return (Kind.MONOTONE if decay else Kind.UNDECIDED), real[np.argsort(-energy[real])], own
    largest = np.abs(found.path).max(0) + np.abs(found.parts).sum(0).max(0)
    least = 1e-9 * largest
    if longest > N and (
        not explained(y, found) or np.any(spans(found.parts[~dies]) > ABOVE_NOISE * found.noise + least)
    ):
        return Kind.UNDECIDED, chosen[:0], own
    return (Kind.QUIET if np.all(found.noise <= least) else Kind.NOISE), chosen[:0], own


def _hardest(factors, energy, chosen):
    """`chosen`, but first the mode of the largest gain among those that share the dead time of the dominant one.

    Directions of a task, and tasks, may get different shares of one gain: the gain must suit the largest.
    """
    if not len(chosen):
        return chosen
    late, size = np.array([phase_delay(factor) for factor in factors[chosen]]), np.abs(factors[chosen])
    alike = (np.abs(late - late[0]) < SAME) & (energy[chosen] > SMALL * energy[chosen[0]])
    first = int(np.argmax(np.where(alike, size, 0.0)))
    return np.array([chosen[first], *np.delete(chosen, first)])


def _grows(y, found, i, swinging) -> bool:
    """Whether growth is the main motion: larger than the oscillation, explained, and not a path's bend."""
    span = np.ptp(found.parts[i], axis=0)
    most = np.max(span / np.ptp(y, axis=0))
    other = np.max(spans(found.parts[swinging]) / np.ptp(y, axis=0)) if len(swinging) else 0.0
    tenths = np.stack([part.mean(0) for part in np.array_split(y, 10)])
    step = np.abs(np.diff(tenths, axis=0))
    if np.all(step[-1] < step[:-1].max(0)):  # growth is fastest at its end
        return False
    return bool(most > max(other, WAVES) and explained(y, found) and likelier(y, found))


def likelier(y, found: Modes) -> bool:
    """Whether growing modes explain y (N, k) better than a path, or than the start of a motion that ends."""
    return found.score < polynomials(y) - BETTER


def explained(y, found: Modes) -> bool:
    """Whether path and modes leave only noise of y (N, k), or a negligible part."""
    left = y - found.path - found.parts.sum(0)
    return bool(np.all(found.noise <= np.maximum(BENT * roughness(left), HARDLY * np.ptp(y, axis=0))))


def _is_there(y, found, part, angle) -> bool:
    """Whether an oscillation (N, k) is visible in y in every window, and is not a sum of waves that fits a path's
    bends.
    """
    left = y - found.path - found.parts.sum(0)
    rough = roughness(left)
    many = len(y) * angle > 2 * np.pi * OFTEN
    large = (np.ptp(part, axis=0) > WAVES * np.ptp(y, axis=0)) & (many | (np.std(part, axis=0) > ABOVE * found.noise))
    clean = found.noise <= np.maximum(BENT * rough, CLEAN * np.std(part, axis=0))
    if not np.any(large | clean):
        return False
    width = min(max(int(WINDOW * 2 * np.pi / angle), 8), len(y))
    smooth, _ = orthogonal(np.linspace(-1, 1, width)[:, None] ** np.arange(4))
    both = power = 0.0
    for first in range(0, len(y) - width + 1, width):
        there, wave = y[first : first + width], part[first : first + width]
        wave = wave - within(smooth, wave)
        both, power = both + np.sum(there * wave), power + np.sum(wave**2)
    return bool(both > THERE * power)


def _turns_back(part) -> bool:
    """Whether (N, k) goes back and forth, not only one way."""
    way, span = np.abs(np.diff(part, axis=0)).sum(0), np.ptp(part, axis=0)
    main = span > 0.1 * span.max()
    return bool(np.any(way[main] > (1 + BACK) * span[main]))
