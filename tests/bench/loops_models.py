"""Models of the loops of `tests.bench.loops`, and what they predict: cnclik's with drives, and MuJoCo's own equations.

cnclik's have a drive for each joint; "modes" has one for each direction in which the joints' inertia M parts from their
servos: with k_p in proportion to k_v the equations are then as many of a single number. That holds for a loop whose
step is the same share of each joint's error, which it is where there are as many joints as task coordinates.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh, expm
from scipy.optimize import least_squares

from cnclik.integrate.drive import Drive, sampled
from cnclik.stability.recommend import recommend
from tests.bench.loops_arms import STEP
from tests.bench.loops_mujoco import LOST, SHIFT, Run, step_response

REACH = 8.0  # z up to which is looked


def drives(setup, delay, inertia, fitted=None) -> dict:
    """{model: Drive} of cnclik for a loop; the kinematic one has none of all this.

    Args: inertia (n, n) [kg m²]; fitted: keyword arguments of a Drive that were estimated, or None.
    """
    servo, feedback = setup.servo, dict(command=setup.servo.command, feedback=setup.feedback)
    kp, kv = setup.arm.gains(servo)
    m = np.diag(inertia)
    modes = eigh(inertia, np.diag(kv), eigvals_only=True)  # of M v = λ k_v v [s]
    made = {"kinematic": Drive(feedback=setup.feedback), "delay": Drive(delay=delay, feedback=setup.feedback)}
    if servo.command == "velocity":
        made["lag"] = Drive(delay=delay, lag=m / kv, **feedback)
        if setup.arm.n == 6:
            made["modes"] = Drive(delay=delay, lag=modes, **feedback)
    else:
        made["lag"] = Drive(delay=delay, lag=kv / kp, **feedback)
        made["second order"] = Drive(delay=delay, **second_order(kp / m, kv / m), **feedback)
        if setup.arm.n == 6:
            made["modes"] = Drive(delay=delay, **second_order((kp / kv)[0] / modes, 1 / modes), **feedback)
    if fitted is not None:
        made["fitted"] = Drive(**fitted, **feedback)
    return made


def second_order(stiffness, damping) -> dict:
    """ω₀ and ζ of ẍ + damping ẋ + stiffness x."""
    w = np.sqrt(stiffness)
    return dict(natural_frequency=w, damping_ratio=damping / (2 * w))


def predicted(setup, drive):
    """(largest, fastest without overshoot, recommended) alpha, by cnclik."""
    found = recommend(setup.arm.law, None, setup.arm.q, Ts=setup.Ts, method="EE", drive=drive, reach=REACH)
    return tuple(float(v) for v in (found.largest, found.monotone, found.recommended))


# --- in time ------------------------------------------------------------------------------------------


class Linear(NamedTuple):
    """x[k+1] = Φ x[k] + Γ₀ u[k−d] + Γ₁ u[k−d−1] of all joints together, q = C x, from the posture at rest."""

    phi: np.ndarray  # (S, S)
    now: np.ndarray  # (S, n)
    late: np.ndarray | None
    out: np.ndarray  # (n, S)


def of_drive(drive, Ts, n) -> Linear:
    """cnclik's drive, of n joints."""
    made = sampled(drive, Ts)
    phi, now, late = (
        None if v is None else np.broadcast_to(v, (n, *v.shape[v.ndim - k :])) if v.ndim == k else v
        for v, k in ((made.phi, 2), (made.now, 1), (made.late, 1))
    )
    phi, now, late = (v if v is None or len(v) == n else np.repeat(v, n, 0) for v in (phi, now, late))
    columns = [None if v is None else block_diag(*v[..., None]) for v in (now, late)]
    return Linear(block_diag(*phi), *columns, block_diag(*[np.eye(1, made.size)] * n))


def of_equations(setup, inertia, *, stepped) -> Linear:
    """M q̈ = k_p (u − q) + k_v (u̇ or 0 − q̇), exact for a held command, or in MuJoCo's steps of STEP (implicitfast)."""
    n, (kp, kv), rates = setup.arm.n, setup.arm.gains(setup.servo), setup.servo.command == "velocity"
    eye, zero, force = np.eye(n), np.zeros((n, n)), np.diag(kv if rates else kp)
    if stepped:
        of = np.linalg.inv(inertia + STEP * np.diag(kv))
        faster = np.hstack([-STEP * of * kp, of @ inertia, STEP * of @ force])
        one = np.vstack([np.hstack([eye, zero, zero]) + STEP * faster, faster, np.hstack([zero, zero, eye])])
        made = np.linalg.matrix_power(one, round(setup.Ts / STEP))
    else:
        of = np.linalg.inv(inertia)
        rate = np.vstack([np.hstack([zero, eye, zero]), np.hstack([-of * kp, -of * kv, of @ force])])
        made = expm(np.vstack([rate, np.zeros((n, 3 * n))]) * setup.Ts)
    return Linear(made[: 2 * n, : 2 * n], made[: 2 * n, 2 * n :], None, np.eye(n, 2 * n))


def linear_run(setup, model: Linear, alphas, delays, N) -> Run:
    """As `loops_mujoco.run`, for the linear loop."""
    j, B = setup.arm.jacobian(), len(alphas)
    back, steps, lanes = np.linalg.pinv(j), np.asarray(alphas)[:, None] * setup.Ts, np.arange(B)
    x, sent, n = np.zeros((B, len(model.phi))), np.zeros((B, setup.arm.n)), setup.arm.n
    delays = np.asarray(delays)
    size = int(max(delays)) + 2
    line, e = np.zeros((size, B, n)), np.full((N + 1, B, 6), np.nan)
    for k in range(N + 1):
        q = x @ model.out.T
        e[k] = SHIFT - q @ j.T
        told = SHIFT - sent @ j.T if setup.feedback == "commanded" else e[k]
        step = told @ back.T * steps
        sent = (q if setup.feedback == "rebased" else sent) + step
        line[k % size] = sent if setup.servo.command == "position" else step / setup.Ts
        x = x @ model.phi.T + line[(k - delays) % size, lanes] @ model.now.T
        if model.late is not None:
            x = x + line[(k - delays - 1) % size, lanes] @ model.late.T
        x = np.where(np.abs(e[k]).max(-1, keepdims=True) > LOST * np.abs(SHIFT).max(), np.nan, x)
    return Run(e)


def radius(setup, model: Linear, alpha, delay) -> float:
    """Largest |eigenvalue| of a loop whose joints are where they began but for its task, `measured` feedback."""
    n, S = setup.arm.n, len(model.phi)
    j = setup.arm.jacobian()
    ask = -alpha * setup.Ts * np.linalg.pinv(j) @ j @ model.out
    late = int(model.late is not None)
    size = S + n * (1 + delay + late)  # state, sum of steps, commands under way, the newest first
    a = np.zeros((size, size))
    row = np.zeros((n, size))
    row[:, :S] = ask
    row[:, S : S + n] = np.eye(n)
    rate = setup.servo.command == "velocity"
    command = (row - np.eye(n, size, S)) / setup.Ts if rate else row
    under_way = [command, *(np.eye(n, size, S + n * (1 + i)) for i in range(delay + late))]
    a[:S, :S] = model.phi
    a[:S] += model.now @ under_way[delay]
    if late:
        a[:S] += model.late @ under_way[delay + 1]
    a[S : S + n] = row
    for i in range(delay + late):
        a[S + n * (1 + i) : S + n * (2 + i)] = under_way[i]
    found = np.linalg.eigvals(a)
    return np.sort(np.abs(np.delete(found, np.argsort(np.abs(found - 1))[: n - 6 + n * rate])))[-1]


# --- fitted -------------------------------------------------------------------------------------------


def response(drive, Ts, command):
    """Motion (N + 1,) from rest at 0 of one joint's drive to a command (N,)."""
    made, x = sampled(drive, Ts), np.zeros((1, sampled(drive, Ts).size))
    line, q = (np.zeros(1),) * made.remembered, np.zeros(len(command) + 1)
    for k, u in enumerate(command):
        x, line = made.moved(x, line, np.array([u]))
        q[k + 1] = x[0, 0]
    return q


def fitted_drive(command, motion, Ts, kind) -> dict:
    """Delay [samples] and lag, or ω₀ and ζ, of the drive whose response to a command is nearest to a motion."""
    first = int(np.argmax(np.abs(motion) > 1e-3 * np.abs(motion).max()))

    def made(p):
        own = dict(lag=np.exp(p[1])) if kind == "velocity" else second_order(np.exp(p[1]), np.exp(p[2]))
        return dict(delay=float(max(p[0], 0.0)), **own)

    def off(p):
        return (response(Drive(command=kind, **made(p)), Ts, command) - motion) / np.abs(motion).max()

    tries = [[0.01], [0.001]] if kind == "velocity" else [[500.0, 100.0], [5000.0, 300.0]]
    starts = [np.array([max(first - 1 - late, 0.05), *np.log(own)]) for own in tries for late in (0.05, 0.6)]
    fits = [least_squares(off, start, x_scale=[0.3, *[1.0] * (len(start) - 1)], max_nfev=60) for start in starts]
    return made(min(fits, key=lambda f: f.cost).x)


def fitted(setup, delay) -> dict:
    """Keyword arguments of the Drive that is estimated from a step of each joint, recorded with this delay."""
    N = int(np.clip((1.0 if setup.servo.command == "position" else 0.15) / setup.Ts, 40, 300))
    found = []
    for joint in range(setup.arm.n):
        command, motion = step_response(setup, joint, 0.02, N)
        motion = np.concatenate([np.zeros(delay), motion[: len(motion) - delay]])
        found.append(fitted_drive(command, motion, setup.Ts, setup.servo.command))
    joined = {name: np.array([one[name] for one in found]) for name in found[0]}
    return joined | {"delay": float(np.median(joined["delay"]))}
