"""`python -m tests.diagnosis.logs 144 SEED`: simulated logs of loops, and how often `diagnose` is right about them.

Loops late by dead time, and by a lag as well, pushed or excited by noise; a wrong sign; frames turned against each
other; paths, sweeps and healthy loops. Each answer is put to the test: the gain, sign or frame that it names goes into
the simulated loop.
"""

import collections
import sys

import numpy as np

from cnclik.diagnosis import diagnose

TS = 0.004
FINE = 20  # parts of a sample in which drives are followed
KINDS = ("late", "lag", "excited", "excited lag", "sign", "turned", "healthy", "path", "sweep")


Log = collections.namedtuple("Log", "signal alpha truth about")  # a recording, and what is true of it


def stable(d):
    """The largest stable z with d samples of dead time."""
    return 2 * np.sin(np.pi / (2 * (2 * d + 1)))


def monotone(d):
    """The largest z without overshoot."""
    return d**d / (d + 1) ** (d + 1)


def loop(z, delay, N, lag=0.0, push=1.0, noise=None, clip=np.inf):
    """(N,) error after a step of its target, of a loop with dead time [samples, whole or not] and a lag [samples]."""
    steps, x, v, y = np.zeros(N), 0.0, 0.0, np.full(N, np.inf)
    keep = np.exp(-1 / (FINE * lag)) if lag else 0.0
    arrives = np.floor((np.arange(N * FINE) + 0.5) / FINE - delay).astype(int)
    for k in range(N):
        y[k] = push - x
        steps[k] = np.clip(z * (y[k] + (0.0 if noise is None else noise[k])), -clip, clip)
        for at in arrives[k * FINE : (k + 1) * FINE]:
            u = steps[at] if at >= 0 else 0.0
            x += u / FINE + (v - u) * lag * (1 - keep)
            v = u + (v - u) * keep
        if abs(x) > 1e12:
            break
    return y


def servo(command, Ts, delay, velocity=False, lag=None, natural_frequency=None, damping_ratio=None, integral=0.0):
    """(N,) motion after commands (N,) that are held: the transfer function, made discrete by SciPy."""
    from scipy.signal import cont2discrete, lfilter

    upper, lower = [1.0], [1.0]
    if integral:  # of the velocity's error
        upper, lower = [1.0, integral], [lag, 1.0, integral]
    elif lag is not None:
        lower = [lag, 1.0]
    elif natural_frequency is not None:
        lower = [natural_frequency**-2, 2 * damping_ratio / natural_frequency, 1.0]
    elif not velocity:  # moves on a line from sample to sample
        return np.interp(np.arange(len(command)) - delay, np.arange(len(command)) + 1.0, command)
    late = np.concatenate([np.full(round(delay * FINE), command[0]), np.repeat(command, FINE)])[: FINE * len(command)]
    over, under, _ = cont2discrete((upper, lower + [0.0] * velocity), Ts / FINE)
    moved = lfilter(over[0], under, late - command[0])[::FINE]
    return moved + command[0] * (Ts * np.arange(len(command)) if velocity else 1.0)


def limits(delay, lag):
    """(largest stable z, largest without overshoot) of a loop, from its step responses."""
    if lag == 0 and delay == round(delay):
        return stable(delay), monotone(delay)
    w = np.linspace(1e-4, np.pi, 100_000)
    phase = -np.pi / 2 - w * (delay + 0.5) - np.arctan(w * lag)
    at = w[np.argmax(phase < -np.pi)]
    most = at * np.hypot(1, at * lag)
    return most, largest(lambda z: over(z, delay, lag) < 0.01, 1e-3 * most, most)


def largest(holds, low, high):
    """The largest number between two of which something holds, by bisection of ratios."""
    for _ in range(8):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def over(z, delay, lag) -> float:
    """Overshoot of a step, as a share of it."""
    return float(-np.min(loop(z, delay, int(12 * (delay + lag + 4)), lag)))


def between(rng, low, high):
    return np.exp(rng.uniform(np.log(low), np.log(high)))


def noisy(rng, e):
    share = rng.choice([0.0, 1e-4, 1e-3, 5e-3, 1e-2])
    return e + share * np.ptp(e[: max(len(e) // 4, 40)]) * rng.standard_normal(e.shape)


def columns(rng, e):
    """Several joints that share a loop: each a part of it, from somewhere, perhaps drifting."""
    k = int(rng.integers(1, 4))
    y = np.outer(e, rng.choice([-1, 1], k) * rng.uniform(0.1, 1, k)) + rng.uniform(-2, 2, k)
    return y + 1e-3 * rng.choice([0, 1]) * np.arange(len(e))[:, None] * rng.uniform(-1, 1, k)


def drawn(rng, kind) -> Log:
    """A log of a kind."""
    N = int(rng.integers(120, 500))
    known, t = bool(rng.integers(2)), np.arange(N) / N
    if kind in ("late", "lag", "excited", "excited lag"):
        lag = float(rng.uniform(1, 8)) if kind.endswith("lag") else 0.0
        delay = int(rng.integers(kind == "late", 9 if not lag else 5)) + float(lag > 0) * rng.uniform()
        most, calm = limits(delay, lag)
        if kind.startswith("excited"):
            z, noise = rng.uniform(0.45 * most, 0.93 * most), rng.standard_normal(4 * N)
            e = loop(z, delay, 4 * N, lag, 0.0, noise)
            e = e + rng.integers(2) * noise
        else:
            z = rng.uniform(min(1.8 * calm, 0.6 * most), 1.08 * most)
            e = noisy(rng, loop(z, delay, N, lag))
            e = np.concatenate([np.full(int(rng.integers(0, 60)), e[0]), e])
        return Log(columns(rng, e), z / TS if known else None, "late", dict(z=z, delay=delay, lag=lag, calm=calm))
    if kind == "sign":
        delay, z = int(rng.integers(0, 5)), between(rng, 5e-3, 0.3)
        e = loop(-z, delay, N)
        e = noisy(rng, e[: max(np.argmax(e > 1e6) or N, 60)])
        other = loop(z, delay, len(e)) if rng.integers(2) and z < monotone(delay) else e
        return Log(np.stack([e, other], 1) * rng.uniform(0.2, 1, 2), z / TS if known else None, "sign", {})
    if kind == "turned":
        theta = np.radians(rng.choice([-1, 1]) * rng.uniform(35, 170))
        factor = 1 - between(rng, 0.02, 0.4) * np.exp(1j * theta)
        turns = rng.uniform(1.3, 5)
        k = np.arange(min(turns * 2 * np.pi / abs(np.angle(factor)) + 40, 12 / abs(np.log(abs(factor))) + 30) // 1)
        w = factor**k * np.exp(1j * rng.uniform(0, 6))
        y = np.stack([w.real, w.imag] + [0.5 * abs(1 - abs(1 - factor)) ** k] * rng.integers(2), 1)
        y = y + rng.choice([0, 1e-4, 3e-3]) * np.ptp(y) * rng.standard_normal(y.shape)
        return Log(y, abs(1 - factor) / TS if known else None, "turned", dict(theta=np.degrees(theta)))
    if kind == "healthy":
        delay = int(rng.integers(0, 6))
        e = loop(rng.uniform(0.2, 0.95) * monotone(delay), delay, N)
        e = e if rng.integers(3) else 0 * e + 1e-3 * rng.standard_normal(N)
    elif kind == "path":
        s = np.clip(t * rng.uniform(0.8, 2), 0, 1)
        shapes = (s, 10 * s**3 - 15 * s**4 + 6 * s**5, np.sin(2 * np.pi * t * rng.uniform(0.2, 1.2)), s**2, s**3)
        e = sum(rng.uniform(-1, 1) * shape for shape in shapes if rng.integers(2)) + s
    else:
        low, high = between(rng, 2, 6), between(rng, 8, 30)
        e = np.sin(2 * np.pi * (low * t + 0.5 * (high - low) * t**2))
    return Log(columns(rng, noisy(rng, e)), None, "calm", {})


def ends(found, z, delay, lag=0.0) -> bool:
    """Whether the gain that is named for a loop of z overshoots by less than 5 %, and is a quarter of the largest."""
    z = (found.factor or 0.0) * z
    least = 0.25 * limits(delay, lag)[1] if delay + lag else 0.9 * monotone(1)  # one that suits a sample more will do
    return z > least and over(z, delay, lag) < 0.05


def is_right(log: Log, found) -> bool | None:
    """Whether an answer is right; None where no cause is named."""
    if found.cause is None:
        return None
    if found.cause == "wrong sign":
        return log.truth == "sign"
    if found.cause == "turned frames":
        return log.truth == "turned" and abs(found.angle - log.about["theta"]) < 5
    return log.truth == "late" and ends(found, *(log.about[name] for name in ("z", "delay", "lag")))


def answers(count, seed=0):
    """(kind, log, answer, whether it is right) of logs, every kind in turn."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        log = drawn(rng, KINDS[i % len(KINDS)])
        found = diagnose(log.signal, TS, alpha=log.alpha)
        yield KINDS[i % len(KINDS)], log, found, is_right(log, found)


def report(told) -> None:
    """Print how often what was said is right: (group, whether alpha is known, answer, what it is worth)."""
    rows = collections.defaultdict(collections.Counter)
    for group, alpha, found, worth in told:
        rows[group][worth] += 1
        if found.confidence is not None:
            rows[f"confidence {found.confidence}, {'alpha' if alpha else 'no alpha'}"][worth] += 1
    for group, row in sorted(rows.items()):
        print(f"{group}: {dict(row)}")


if __name__ == "__main__":
    words = {None: "no cause", True: "right", False: "wrong"}
    report((kind, log.alpha, found, words[right]) for kind, log, found, right in answers(*map(int, sys.argv[1:])))
