"""`python -m tests.diagnosis.logs 500`: simulated logs of loops, and how often `diagnose` is right about them.

Loops late by dead time, and by a lag as well, pushed or excited by noise; a wrong sign; frames turned against each
other; ramps, sweeps and healthy loops. Each answer is put to the test: the gain, sign or frame that it names goes into
the simulated loop. What is said with a confidence of 0.9 must be right nine times of ten.
"""

import argparse
import collections
from typing import NamedTuple

import numpy as np

from cnclik.diagnosis import diagnose
from tests.diagnosis.recordings import monotone, stable

TS = 0.004
FINE = 20  # parts of a sample in which a lag is followed
OVER = 0.05  # of a step, by which a loop may overshoot with a gain that is right
SLOW = 0.25  # share of the largest gain without overshoot that such a gain has at least
NEXT = 0.9  # or of the largest one with a sample more of dead time, where there is none
KINDS = ("late", "lag", "excited", "excited lag", "sign", "turned", "healthy", "path", "sweep")


class Log(NamedTuple):
    """A recording and what is true of it."""

    signal: np.ndarray
    alpha: float | None
    truth: str
    about: dict


def late_loop(z, delay, lag, N, push=1.0, noise=None):
    """(N,) error after a step of its target, of a loop with dead time [samples, whole or not] and a lag [samples]."""
    steps, x, v, y = np.zeros(N), 0.0, 0.0, np.zeros(N)
    keep = 0.0 if lag == 0 else np.exp(-1 / (FINE * lag))
    arrives = np.floor((np.arange(N * FINE) + 0.5) / FINE - delay).astype(int)
    for k in range(N):
        y[k] = push - x
        steps[k] = z * (y[k] + (0.0 if noise is None else noise[k]))
        for at in arrives[k * FINE : (k + 1) * FINE]:
            u = steps[at] if at >= 0 else 0.0
            x += (u + (v - u) * (lag * FINE * (1 - keep))) / FINE if lag else u / FINE
            v = u + (v - u) * keep
        if abs(x) > 1e12:
            y[k + 1 :] = np.inf
            break
    return y


def limits(delay, lag):
    """(largest stable z, largest without overshoot) of a loop, from its step responses."""
    if lag == 0 and delay == round(delay):
        return stable(delay), monotone(delay)
    w = np.linspace(1e-4, np.pi, 100_000)
    phase = -np.pi / 2 - w * (delay + 0.5) - np.arctan(w * lag)
    at = w[np.argmax(phase < -np.pi)]
    most = at * np.hypot(1, at * lag)
    low, high = 0.0, most
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if over(middle, delay, lag) < 0.01 else (low, middle)
    return most, low


def over(z, delay, lag) -> float:
    """Overshoot of a step, as a share of it."""
    return float(-np.min(late_loop(z, delay, lag, int(12 * (delay + lag + 4)))))


def noisy(rng, e, share=None):
    share = rng.choice([0.0, 1e-4, 1e-3, 5e-3, 1e-2]) if share is None else share
    return e + share * np.ptp(e[: max(len(e) // 4, 40)]) * rng.standard_normal(e.shape)


def columns(rng, e):
    """Several joints that share a loop: each a part of it, from somewhere, perhaps drifting."""
    k = int(rng.integers(1, 4))
    y = np.outer(e, rng.choice([-1, 1], k) * rng.uniform(0.1, 1, k)) + rng.uniform(-2, 2, k)
    return y + 1e-3 * rng.choice([0, 1]) * np.arange(len(e))[:, None] * rng.uniform(-1, 1, k)


def drawn(rng, kind) -> Log:
    """A log of a kind."""
    N = int(rng.integers(120, 500))
    alpha = bool(rng.integers(2))
    if kind in ("late", "lag", "excited", "excited lag"):
        lag = float(rng.uniform(1, 8)) if kind.endswith("lag") else 0.0
        delay = int(rng.integers(kind == "late", 9 if not lag else 5)) + float(lag > 0) * rng.uniform()
        most, calm = limits(delay, lag)
        high = 0.93 if kind.startswith("excited") else 1.08
        z = rng.uniform(min(1.8 * calm, 0.6 * most) if kind[0] != "e" else 0.45 * most, high * most)
        if kind.startswith("excited"):
            noise = rng.standard_normal(4 * N)
            e = late_loop(z, delay, lag, 4 * N, 0.0, noise)
            e = e + rng.integers(2) * noise
        else:
            e = noisy(rng, late_loop(z, delay, lag, N))
            e = np.concatenate([np.full(int(rng.integers(0, 60)), e[0]), e])
        return Log(columns(rng, e), z / TS if alpha else None, "late", dict(z=z, delay=delay, lag=lag, calm=calm))
    if kind == "sign":
        delay, z = int(rng.integers(0, 5)), np.exp(rng.uniform(np.log(5e-3), np.log(0.3)))
        e = late_loop(-z, delay, 0.0, N)
        e = noisy(rng, e[: max(int(np.argmax(e > 1e6)) or N, 60)])
        other = late_loop(z, delay, 0.0, len(e)) if rng.integers(2) and z < monotone(delay) else e
        y = np.stack([e, other], 1) * rng.uniform(0.2, 1, 2)
        return Log(y, z / TS if alpha else None, "sign", dict(z=z))
    if kind == "turned":
        theta = np.radians(rng.choice([-1, 1]) * rng.uniform(35, 170))
        factor = 1 - np.exp(rng.uniform(np.log(0.02), np.log(0.4))) * np.exp(1j * theta)
        turn = abs(np.angle(factor))
        N = int(rng.uniform(1.3, 5) * 2 * np.pi / turn) + 40
        N = min(N, int(12 / abs(np.log(abs(factor))) + 30))
        w = factor ** np.arange(N) * np.exp(1j * rng.uniform(0, 6))
        y = np.stack([w.real, w.imag], 1)
        if rng.integers(2):
            y = np.concatenate([y, 0.5 * abs(1 - abs(1 - factor)) ** np.arange(N)[:, None]], 1)
        y = y + rng.choice([0, 1e-4, 3e-3]) * np.ptp(y) * rng.standard_normal(y.shape)
        return Log(y, abs(1 - factor) / TS if alpha else None, "turned", dict(theta=np.degrees(theta)))
    t = np.arange(N) / N
    if kind == "healthy":
        delay = int(rng.integers(0, 6))
        e = late_loop(rng.uniform(0.2, 0.95) * monotone(delay), delay, 0.0, N)
        e = e if rng.integers(3) else 0 * e + 1e-3 * rng.standard_normal(N)
        return Log(columns(rng, noisy(rng, e)), None, "calm", {})
    if kind == "path":
        s = np.clip(t * rng.uniform(0.8, 2), 0, 1)
        shapes = (s, 10 * s**3 - 15 * s**4 + 6 * s**5, np.sin(2 * np.pi * t * rng.uniform(0.2, 1.2)), s**2, s**3)
        e = sum(rng.uniform(-1, 1) * one for one in shapes if rng.integers(2)) + s
        return Log(columns(rng, noisy(rng, e)), None, "calm", {})
    low, high = np.exp(rng.uniform(np.log(2), np.log(6))), np.exp(rng.uniform(np.log(8), np.log(30)))
    e = np.sin(2 * np.pi * (low * t + 0.5 * (high - low) * t**2))
    return Log(columns(rng, noisy(rng, e)), None, "calm", {})


def is_right(log: Log, found) -> bool | None:
    """Whether an answer is right; None where nothing is said with a confidence."""
    if found.confidence is None:
        return None
    if found.cause == "wrong sign":
        return log.truth == "sign"
    if found.cause == "turned frames":
        return log.truth == "turned" and abs(found.angle - log.about["theta"]) < 5
    if log.truth != "late":
        return False
    if found.factor is None:
        return None
    z, delay, lag, calm = (log.about[name] for name in ("z", "delay", "lag", "calm"))
    new, least = found.factor * z, SLOW * calm
    if not delay + lag:  # then a gain that suits a sample more is a quarter of the largest, and rounding would decide
        least = NEXT * monotone(1)
    return bool(over(new, delay, lag) < OVER and new > least)


def answers(count, seed=0, kinds=KINDS):
    """(kind, log, answer, whether it is right) of logs, every kind in turn."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        kind = kinds[i % len(kinds)]
        log = drawn(rng, kind)
        found = diagnose(log.signal, TS, alpha=log.alpha)
        yield kind, log, found, is_right(log, found)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.diagnosis.logs", description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=KINDS)
    parser.add_argument("--wrong", action="store_true", help="print wrong answers that are said with 0.9")
    args = parser.parse_args()
    rows, told = collections.defaultdict(collections.Counter), collections.defaultdict(list)
    for kind, log, found, right in answers(args.count, args.seed, args.kinds):
        sure = found.confidence is not None and found.confidence >= 0.9
        rows[kind][f"{found.cause or found.kind}{' sure' * sure}"] += 1
        if right is not None:
            told[min(int(found.confidence * 10), 9)].append(right)
            rows[kind][f"right{' sure' * sure}"] += right
            if args.wrong and not right and found.confidence > 0.6:
                print(kind, log.alpha, log.about, found.confidence, found, "\n")
    for kind, row in rows.items():
        print(f"{kind}: {dict(sorted(row.items()))}")
    for tenth, rights in sorted(told.items()):
        print(f"confidence {tenth / 10:.1f} to {tenth / 10 + 0.1:.1f}: {sum(rights)} of {len(rights)} right")


if __name__ == "__main__":
    main()
