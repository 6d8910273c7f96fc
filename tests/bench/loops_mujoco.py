"""The loop of `tests.bench.loops` in MuJoCo: many gains and delays side by side, and what is measured of them.

A lane is a gain and a number of samples of delay. It starts at rest in the posture, its target 0.5 mm and 1 mrad away.
Python runs at the controller's rate, C at the physics'.
"""

from typing import NamedTuple

import mujoco
import numpy as np

from tests.bench.loops_arms import STEP, World

DIRECTION = np.array([0.6, -0.5, 0.62, 0.6, 0.5, -0.6])
SHIFT = (
    DIRECTION
    / np.repeat([np.linalg.norm(DIRECTION[:3]), np.linalg.norm(DIRECTION[3:])], 3)
    * np.repeat([5e-4, 1e-3], 3)
)
LOST = 100.0  # times the first error, from which on a lane is given up
GONE = 1e-6  # of the first error, below which it is rounding that goes up and down
FLAT = 1e-3  # growth up to which an error stays as it is: what the commands alone don't see remains
OVERSHOOT = 0.01


class Setup(NamedTuple):
    """What the lanes of a run share."""

    arm: object
    servo: object
    Ts: float
    feedback: str = "measured"
    step: float = STEP  # of the physics [s]
    world: World = World()


class Run(NamedTuple):
    """Errors (N + 1, B, 6) of the true tip [m, rad]; NaN after a lane is given up."""

    e: np.ndarray


def turn_from(wanted, rotation):
    """Rotation vectors (B, 3) from rotations (B, 3, 3) to those that are wanted."""
    r = wanted @ np.swapaxes(rotation, -1, -2)
    half = 0.5 * np.stack([r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]], -1)
    sine = np.linalg.norm(half, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(r, axis1=1, axis2=2) - 1.0))
    return half * np.where(sine > 1e-9, angle / np.maximum(sine, 1e-9), 1.0)[:, None]


def rotation_of(v):
    """Rotation matrix of a rotation vector (3,)."""
    quaternion, out = np.empty(4), np.empty(9)
    angle = float(np.linalg.norm(v))
    mujoco.mju_axisAngle2Quat(quaternion, v / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
    mujoco.mju_quat2Mat(out, quaternion)
    return out.reshape(3, 3)


def run(setup: Setup, alphas, delays, N, shift=SHIFT, velocity=None) -> Run:
    """N steps of lanes with gains alphas (B,) and delays (B,).

    Args:
      shift: (6,) of the target from the posture's pose [m, rad]. velocity: (3,) with which it then moves [m/s].
    """
    arm, servo, Ts, feedback, physics, world = setup
    model = arm.model(servo, physics, world)
    tip, n, B, sub = model.body(arm.tip).id, arm.n, len(alphas), round(Ts / physics)
    look = mujoco.MjData(model)  # what the controller computes, and where the true tip is
    datas = [mujoco.MjData(model) for _ in range(B)]
    position, steps = servo.command == "position", np.asarray(alphas)[:, None] * Ts
    rest = arm.q if position else np.zeros(n)
    for data in datas:
        begin(data, arm.q, rest)
    qs, us = [d.qpos for d in datas], [d.ctrl for d in datas]
    j, at, rotation = np.zeros((B, 6, n)), np.zeros((B, 3)), np.zeros((B, 3, 3))
    line = np.tile(rest, (max(delays) + 1, B, 1))  # commands of the last samples, those of before the start at rest
    sent, size = np.tile(arm.q, (B, 1)), line.shape[0]
    look.qpos[:] = arm.q
    mujoco.mj_kinematics(model, look)
    goal, wanted = look.xpos[tip] + shift[:3], rotation_of(shift[3:]) @ look.xmat[tip].reshape(3, 3)
    e = np.full((N + 1, B, 6), np.nan)
    alive = list(range(B))

    def seen(values, b, jacobian):
        look.qpos[:] = values
        mujoco.mj_kinematics(model, look)
        if jacobian:
            mujoco.mj_comPos(model, look)
            mujoco.mj_jacBody(model, look, j[b, :3], j[b, 3:], tip)
        at[b], rotation[b] = look.xpos[tip], look.xmat[tip].reshape(3, 3)

    def error(k):
        here = goal if velocity is None else goal + velocity * (k * Ts)
        return np.concatenate([here - at, turn_from(wanted, rotation)], -1)

    def measured(values):
        return np.round(values / world.resolution) * world.resolution if world.resolution else values

    exact = feedback != "commanded" and not world.resolution
    for k in range(N + 1):
        for b in alive:
            seen(qs[b], b, exact)
        e[k, alive] = error(k)[alive]
        told = e[k]
        if not exact:
            for b in alive:
                seen(sent[b] if feedback == "commanded" else measured(qs[b]), b, True)
            told = error(k)
        big = np.abs(e[k]).max(-1) > max(LOST * np.abs(SHIFT).max(), 10 * np.abs(shift).max())
        if big.any():
            alive = [b for b in alive if not big[b]]
            if not alive:
                break
        told = np.where(np.isfinite(told), told, 0.0)[..., None]
        if n == 6:
            step = np.linalg.solve(j, told)[..., 0] * steps
        else:
            across = np.swapaxes(j, -1, -2)
            step = (across @ np.linalg.solve(j @ across, told))[..., 0] * steps
        sent = (measured(np.stack(qs)) if feedback == "rebased" else sent) + step
        line[k % size] = rest + world.gain * ((sent if position else step / Ts) - rest)
        for b in alive:
            us[b].reshape(-1, n)[:] = line[(k - delays[b]) % size, b]
            mujoco.mj_step(model, datas[b], sub)
    return Run(e)


# --- what is measured ---------------------------------------------------------------------------------


def growth(e) -> np.ndarray:
    """Logarithm (B,) of how the envelope of ‖e‖ changed from the last sixth but one of a run to the last; inf if given
    up. By then what decays has gone, and what swings at the limit is left. An error that is larger than the first one
    counts as growing: fast joints may swing without end."""
    size = np.linalg.norm(e * np.repeat([1.0, 0.5], 3), axis=-1)
    part = len(size) // 6
    with np.errstate(all="ignore"):
        found = np.log(size[-part:].max(0) / size[-2 * part : -part].max(0))
    found = np.where(size[-part:].max(0) < GONE * size[0], -1.0, found)
    found = np.where(size[-part:].max(0) > size[0], np.maximum(found, FLAT), found - FLAT)
    return np.where(np.isfinite(size[-1]), found, np.inf)


def beyond(e) -> np.ndarray:
    """How far the tip moved beyond its target along the step (B,), as a share of it; inf if given up."""
    along = e[..., :3] @ SHIFT[:3] / (SHIFT[:3] @ SHIFT[:3])
    return np.where(np.isfinite(e[-1, :, 0]), np.nanmax(-along, 0), np.inf)


def first_crossing(values, delays, low, high, lanes=6, rounds=3):
    """Smallest gain (K,) where values(alphas (B,), delays (B,), effort) -> (B,) is above 0, of a loop for each delay.

    Each round looks at `lanes` gains in geometric steps between the last one below 0 and the first one above; in the
    end a line is drawn between these two. inf where none is found up to `high`, 0 where `low` is above already.
    """
    K, delays = len(delays), np.asarray(delays)
    low, high = np.broadcast_to(low, K).astype(float), np.broadcast_to(high, K).astype(float)
    below, above = np.full(K, -np.inf), np.full(K, np.inf)
    found = np.full(K, np.nan)
    for turn in range(rounds):
        share = (np.arange(lanes) / (lanes - 1) if turn == 0 else np.arange(1, lanes + 1) / (lanes + 1))[:, None]
        effort = 2.0 ** (turn - 1)
        if turn:  # a round looks longer than the one before, and so may find less to be stable
            low, below = 0.8 * low, np.full(K, -np.inf)
        alphas = low * (high / low) ** share
        open_ = np.flatnonzero(np.isnan(found))
        seen = np.full((lanes, K), np.nan)
        looked = alphas[:, open_]
        seen[:, open_] = values(looked.ravel(), np.tile(delays[open_], lanes), effort).reshape(looked.shape)
        for i in open_:
            over = np.flatnonzero(seen[:, i] > 0)
            first = over[0] if len(over) else lanes
            if turn == 0 and first in (0, lanes):
                found[i] = 0.0 if first == 0 else np.inf
                continue
            if first < lanes:
                high[i], above[i] = alphas[first, i], seen[first, i]
            if first > 0:
                low[i], below[i] = alphas[first - 1, i], seen[first - 1, i]
    with np.errstate(invalid="ignore"):
        share = np.where(np.isfinite(above), -below / (above - below), 0.5)
    return np.where(
        np.isnan(found), low * (high / low) ** np.where(np.isfinite(share), np.clip(share, 0, 1), 0.5), found
    )


def samples(setup, delay, least=300) -> int:
    """How long a lane runs: a dozen periods of a loop with this delay, and of the servo's own."""
    own = (6.0 if setup.servo.command == "position" else 1.0) / setup.Ts
    return int(max(least, own, 80 * (delay + 1)))


def limits(setup, delays, scale, runner=run, *, calm=True):
    """Largest stable gain, and the fastest without overshoot, of a loop for each delay.

    Args:
      scale (K,): gains of about the right size: from 1/50 to 4 times these, and below, is looked.
      runner: runner(setup, alphas, delays, N) -> Run. calm: whether the second is looked for.
    """

    def by_length(what):
        def values(alphas, lags, effort):
            out = np.empty(len(alphas))
            for N in {samples(setup, d) for d in lags}:
                mine = np.array([samples(setup, d) == N for d in lags])
                steps = int(N * (effort if what is growth else 0.5))
                out[mine] = what(runner(setup, alphas[mine], lags[mine], steps).e)
            return out

        return values

    scale = np.asarray(scale, float)
    largest = first_crossing(by_length(growth), delays, scale / 50, scale * 4)
    if not calm:
        return largest, None
    top = np.where(np.isfinite(largest) & (largest > 0), largest, scale)
    smooth = first_crossing(by_length(lambda e: beyond(e) - OVERSHOOT), delays, top / 1000, top)
    return largest, smooth


def ramp_lag(setup, alphas, delays, runner=run, seconds=8.0, speed=2e-3):
    """How far behind a ramp the tip is in the end, as a time [s] (B,)."""
    velocity = speed * SHIFT[:3] / np.linalg.norm(SHIFT[:3])
    N = round(seconds / setup.Ts)
    e = runner(setup, np.asarray(alphas), np.asarray(delays), N, SHIFT * 0.0, velocity).e
    return e[-1, :, :3] @ velocity / speed**2


def begin(data, q, command):
    """At rest at q, and commanded to be there, integral parts as well."""
    data.qpos[:] = q
    data.ctrl.reshape(-1, len(q))[:] = command
    data.act[:] = q[: len(data.act)]


def step_responses(setup, size, N, together):
    """Motions (N + 1, n) of the joints from rest, each after a step of its command: one by one, or all at once."""
    arm, servo, Ts, _, physics, world = setup
    model = arm.model(servo, physics, world)
    rest = arm.q if servo.command == "position" else np.zeros(arm.n)
    motions = np.zeros((N + 1, arm.n))
    for stepped in [np.arange(arm.n)] if together else np.arange(arm.n)[:, None]:
        data = mujoco.MjData(model)
        begin(data, arm.q, rest)
        data.ctrl.reshape(-1, arm.n)[:, stepped] += world.gain * size
        for k in range(N):
            mujoco.mj_step(model, data, round(Ts / physics))
            motions[k + 1, stepped] = data.qpos[stepped] - arm.q[stepped]
    return motions
