"""Replay: repeat the first steps of a run, to check that the described loop made it."""

import contextlib

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.solve import solve
from cnclik.integrate.status import Status
from cnclik.robot.chart import apart
from cnclik.stability import trial

STEPS = 32  # number of steps compared
ROUNDINGS = 100.0  # tolerance in roundings of joint values, times the growth of a small difference at the start
ROUGH = Status.NEAR_SINGULAR | Status.DIVERGED  # after such steps only rounding may be left


def check_made(law, reference, run, Ts, method, stage, drive) -> None:
    """Raise ArgumentError where the first steps of a run without noise, one lane, are not the loop's own.

    The steps are made in the run's precision, by the program that has made it where `solve` did. What can't be judged
    passes: a record that is not of steps Ts long, or of part of a run that went through drives, and what follows a step
    at which roundings decide.
    """
    q, t, N = np.asarray(run.q), np.asarray(run.t, float), len(run.residual)
    eps = float(np.finfo(q.dtype).eps)
    k = min(N, STEPS)
    rough = np.flatnonzero(np.asarray(run.status)[:k] & int(ROUGH))
    k = int(rough[0]) if len(rough) else k
    floor = ROUNDINGS * eps * (1 + np.abs(q[: k + 1]).max(axis=1))
    stepped = np.abs(_apart(law, q[:k], q[1 : k + 1]) - Ts * np.asarray(run.qdot)[:k]).max(axis=1)
    remembers = not drive.prompt
    if N > trial.MOST_TRIED or not (stepped <= floor[1:]).all() or (remembers and t[0] != 0):
        return
    size = N if N >= trial.SHORTEST else trial.whole_trial(N)

    def again(start):
        with jax.enable_x64(True) if eps < 1e-9 else contextlib.nullcontext():
            made = solve(law, reference, start, Ts, size, method, stage, t0=t[0], drive=drive)
        return np.asarray(made.q)[: k + 1]

    made = again(q[0])
    off = np.abs(_apart(law, made, q[: k + 1])).max(axis=1)
    if (off <= floor).all():
        return
    nudge = (4 * eps * (1 + np.abs(q[0]))).astype(q.dtype)
    signs = 1, 1 - 2 * (np.arange(len(nudge), dtype=q.dtype) % 2)  # in one direction what grows may cancel
    beside = [np.abs(_apart(law, made, again(q[0] + sign * nudge))).max(axis=1) for sign in signs]
    spread = np.maximum.accumulate(np.max(beside, axis=0))
    if (other := np.isfinite(spread + off) & (off > floor + ROUNDINGS * spread)).any():
        first = int(np.argmax(other))
        must = "be made by the loop that is described, with its drive, noise, method and stage"
        found = f"at t = {t[first]:.4g} s its joints differ from that loop's by {off[first]:.2g} [rad, m]"
        raise errors.fail("run", must, found)


def _apart(law, starts, several):
    with jax.enable_x64(True) if several.dtype == np.float64 else contextlib.nullcontext():
        return np.asarray(apart(law.chain, starts, several))
