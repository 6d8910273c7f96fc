"""Models of the loops of `tests.bench.loops`, and what they predict: cnclik's with drives, and MuJoCo's own equations.

cnclik's have a drive for each joint; "modes" has one for each direction in which the joints' inertia M parts from their
servos: with k_p in proportion to k_v the equations are then as many of a single number. That holds for a loop whose
step is the same share of each joint's error, which it is where there are as many joints as task coordinates.
"""

import functools
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh, expm
from scipy.optimize import least_squares

from cnclik.integrate.drive import Drive, sampled
from cnclik.stability.gain import gains
from tests.bench.loops_mujoco import LOST, SHIFT, Run, step_responses

BEGUN = 1e-4  # share of a motion by which it has begun
STEPPED = 0.02  # [rad, rad/s]
CLOSE = 0.01  # rms share of a motion that a fit may leave


def drives(setup, delay, inertia, fits=None) -> dict:
    """{model: Drive} of cnclik for a loop; the kinematic one has none of all this.

    Args: inertia (n, n) [kg m²]; fits: {model: keyword arguments of a Drive} that were estimated.
    """
    servo, feedback = setup.servo, dict(command=setup.servo.command, feedback=setup.feedback)
    kp, kv = setup.arm.gains(servo)
    m = np.diag(inertia)
    modes = eigh(inertia, np.diag(kv), eigvals_only=True)  # of M v = λ k_v v [s]
    at_once = "measured" if setup.feedback == "rebased" else setup.feedback  # without a lag both are the same
    made = {"kinematic": Drive(feedback=at_once), "delay": Drive(delay=delay, feedback=at_once)}
    if servo.command == "velocity":
        made["lag"] = Drive(delay=delay, lag=m / kv, **feedback)
        if setup.arm.n == 6:
            made["modes"] = Drive(delay=delay, lag=modes, **feedback)
    else:
        made["lag"] = Drive(delay=delay, lag=kv / kp, **feedback)
        made["second order"] = Drive(delay=delay, **second_order(kp / m, kv / m), **feedback)
        if setup.arm.n == 6:
            made["modes"] = Drive(delay=delay, **second_order((kp / kv)[0] / modes, 1 / modes), **feedback)
    return made | {name: Drive(**fit, **feedback) for name, fit in (fits or {}).items()}


def second_order(stiffness, damping) -> dict:
    """ω₀ and ζ of ẍ + damping ẋ + stiffness x."""
    w = np.sqrt(stiffness)
    return dict(natural_frequency=w, damping_ratio=damping / (2 * w))


def predicted(setup, drive):
    """(largest stable, without overshoot, recommended) alpha of explicit Euler, see `cnclik.gains`."""
    found = gains(Ts=setup.Ts, method="EE", drive=drive)
    return found.largest_stable, found.without_overshoot, found.recommended


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
    """M q̈ = k_p (u − q) + k_v (u̇ or 0 − q̇), exact for a held command, or in MuJoCo's steps (implicitfast)."""
    n, (kp, kv), rates = setup.arm.n, setup.arm.gains(setup.servo), setup.servo.command == "velocity"
    eye, zero, force, step = np.eye(n), np.zeros((n, n)), np.diag(kv if rates else kp), setup.step
    if stepped:
        of = np.linalg.inv(inertia + step * np.diag(kv))
        faster = np.hstack([-step * of * kp, of @ inertia, step * of @ force])
        one = np.vstack([np.hstack([eye, zero, zero]) + step * faster, faster, np.hstack([zero, zero, eye])])
        made = np.linalg.matrix_power(one, round(setup.Ts / step))
    else:
        of = np.linalg.inv(inertia)
        rate = np.vstack([np.hstack([zero, eye, zero]), np.hstack([-of * kp, -of * kv, of @ force])])
        made = expm(np.vstack([rate, np.zeros((n, 3 * n))]) * setup.Ts)
    return Linear(made[: 2 * n, : 2 * n], made[: 2 * n, 2 * n :], None, np.eye(n, 2 * n))


def linear_run(model: Linear):
    """As `loops_mujoco.run`, for the linear loop."""
    return functools.partial(_linear_run, model)


def _linear_run(model, setup, alphas, delays, N, shift=SHIFT, velocity=None) -> Run:
    j, B = setup.arm.jacobian(), len(alphas)
    back, steps, lanes = np.linalg.pinv(j), np.asarray(alphas)[:, None] * setup.Ts, np.arange(B)
    x, sent, n = np.zeros((B, len(model.phi))), np.zeros((B, setup.arm.n)), setup.arm.n
    delays = np.asarray(delays)
    size = int(max(delays)) + 2
    line, e = np.zeros((size, B, n)), np.full((N + 1, B, 6), np.nan)
    for k in range(N + 1):  # line: commands relative to those at rest
        q = x @ model.out.T
        goal = shift if velocity is None else shift + np.append(velocity * (k * setup.Ts), np.zeros(3))
        e[k] = goal - q @ j.T
        told = goal - sent @ j.T if setup.feedback == "commanded" else e[k]
        step = told @ back.T * steps
        sent = (q if setup.feedback == "rebased" else sent) + step
        line[k % size] = sent if setup.servo.command == "position" else step / setup.Ts
        x = x @ model.phi.T + line[(k - delays) % size, lanes] @ model.now.T
        if model.late is not None:
            x = x + line[(k - delays - 1) % size, lanes] @ model.late.T
        x = np.where(np.abs(e[k]).max(-1, keepdims=True) > LOST * np.abs(SHIFT).max(), np.nan, x)
    return Run(e)


# --- fitted -------------------------------------------------------------------------------------------


def response(drive, Ts, command):
    """Motion (N + 1,) from rest at 0 of one joint's drive to a command (N,)."""
    made, x = sampled(drive, Ts), np.zeros((1, sampled(drive, Ts).size))
    line, q = (np.zeros(1),) * made.remembered, np.zeros(len(command) + 1)
    for k, u in enumerate(command):
        sent = np.array([u])
        x, line = made.moved(x, line, sent), (sent, *line)[: made.remembered]
        q[k + 1] = x[0, 0]
    return q


def fitted_drive(command, motion, Ts, kind) -> dict:
    """Delay [samples] and lag, or ω₀ and ζ, of the drive whose response to a command is nearest to a motion.

    The delay is kept to where the motion begins: least squares alone would trade it for lag where other joints, which
    no drive of one joint knows, bend the response.
    """
    first = int(np.argmax(np.abs(motion) > BEGUN * np.abs(motion).max()))

    def made(p):
        own = dict(lag=np.exp(p[1])) if kind == "velocity" else second_order(np.exp(p[1]), np.exp(p[2]))
        return dict(delay=float(max(p[0], 0.0)), **own)

    def off(p):
        return (response(Drive(command=kind, **made(p)), Ts, command) - motion) / np.abs(motion).max()

    tries = [[0.01], [0.001]] if kind == "velocity" else [[500.0, 100.0], [5000.0, 300.0]]
    starts = [np.array([max(first - 1.0, 0.05), *np.log(own)]) for own in tries]
    low = [max(first - 1.5, 0.0), *[np.log(1e-4)] * (len(starts[0]) - 1)]
    high = [first + 0.5, *[np.log(1e6)] * (len(starts[0]) - 1)]
    scale = [0.3, *[1.0] * (len(low) - 1)]
    fits = []
    for start in starts:
        fits.append(least_squares(off, start, bounds=(low, high), x_scale=scale, max_nfev=40))
        if np.sqrt(2 * fits[-1].cost / len(motion)) < CLOSE:
            break
    return made(min(fits, key=lambda f: f.cost).x)


def fitted(setup, delay, together) -> dict:
    """Keyword arguments of the Drive that is estimated from steps, recorded with this delay: of each joint alone while
    others hold, or of all joints at once."""
    N = int(np.clip((1.0 if setup.servo.command == "position" else 0.15) / setup.Ts, 40, 200))
    motions = step_responses(setup, STEPPED, N, together)
    late = np.concatenate([np.zeros((delay, setup.arm.n)), motions[: len(motions) - delay]])
    found = [fitted_drive(np.full(N, STEPPED), q, setup.Ts, setup.servo.command) for q in late.T]
    joined = {name: np.array([one[name] for one in found]) for name in found[0]}
    return joined | {"delay": float(np.median(joined["delay"]))}
