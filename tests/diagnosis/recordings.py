"""Recordings made in plain NumPy: loops with dead time, and servos after a step, integrated in small steps."""

import itertools

import numpy as np


def stable(d):
    return 2 * np.sin(np.pi / (2 * (2 * d + 1)))


def monotone(d):
    return d**d / (d + 1) ** (d + 1)


def loop(z, d, N, clip=np.inf):
    """(N,) of e[k+1] = e[k] − z e[k−d], at 1 until what was seen first arrives."""
    e = [1.0] * (d + 1)
    while len(e) < N + d:
        e.append(e[-1] - np.clip(z * e[-1 - d], -clip, clip))
    return np.array(e[d:])


def servo(command, Ts, delay, lag=None, omega=None, zeta=None, velocity=False):
    """(N,) motion after commands (N,) that are held, by Runge-Kutta steps of the drive's own equation."""
    from scipy.integrate import solve_ivp

    t = Ts * np.arange(len(command))

    def sent(at):
        return (
            command[int(np.clip(np.floor(at / Ts - delay + 1e-9), 0, len(command) - 1))]
            if at / Ts >= delay
            else command[0]
        )

    def rate(at, x):
        u = sent(at)
        if lag is not None:
            return [x[1], (u - x[1]) / lag] if velocity else [(u - x[0]) / lag]
        if velocity:
            return [x[1], x[2], omega**2 * (u - x[1]) - 2 * zeta * omega * x[2]]
        return [x[1], omega**2 * (u - x[0]) - 2 * zeta * omega * x[1]]

    first = [0.0, command[0], 0.0] if velocity else [command[0], 0.0]
    x = np.array(first[: (2 if lag is not None else 3) if velocity else (1 if lag is not None else 2)])
    edges = np.unique(np.concatenate([t, (np.arange(len(command)) + delay) * Ts]).round(12))
    edges = edges[edges <= t[-1] + 1e-12]
    found = {0.0: x[0]}
    for a, b in itertools.pairwise(edges):
        middle = 0.5 * (a + b)
        x = solve_ivp(lambda at, x, m=middle: rate(m, x), (a, b), x, rtol=1e-9, atol=1e-12).y[:, -1]
        found[b] = x[0]
    every = np.array(sorted(found))
    return np.array([found[every[np.argmin(np.abs(every - at))]] for at in t])
