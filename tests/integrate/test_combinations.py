"""Every method with every inverse and way of limits, on drives in turn, against a loop written apart in NumPy.

182 loops of a planar arm along a circle, from a start that is far off, next to joint limits, near enough to a
singularity that all dampings act; with three joints under the inverses of `LARGE`, else with two. Axes have weights,
the feed-forward a factor, and measurements noise under the methods of `NOISY`.
Nothing here is the package's: tableaus, exponential steps, inverses, a quadratic program by trying each face, drives by
SciPy's exponential, fixed points by SciPy's root.
"""

import itertools

import numpy as np
import pytest
from scipy.optimize import root

import cnclik as ck
from cnclik.engine.compiler import can_build
from cnclik.engine.plan import chosen
from cnclik.engine.program import Program, lane_avals
from tests.oracles import planar_jacobian, planar_position
from tests.stability.plant import TABLEAUX, hold

LENGTHS, Q0, REST = {2: [1.0, 0.8], 3: [0.8, 0.6, 0.4]}, np.array([0.3, 0.7, 0.6]), np.array([0.5, 0.2, 0.9])
LOWER, UPPER, SPEED = np.array([0.1, -1.0, -2.0]), np.array([2.0, 0.75, 2.0]), np.array([1.2, 0.9, 1.1])
TS, N, RATE, PULL = 0.05, 6, 12.0, 1.5
GAINS, WEIGHTS, FEEDFORWARD = np.array([8.0, 6.0]), np.array([1.0, 1.4]), 0.9
NOISE = 0.02 * np.cos(2.0 * np.arange(N * 5)).reshape(N, 5)
CENTRE, RADIUS, SPIN = np.array([-0.75, 1.25]), 0.25, 1.3

METHODS = [m for m in ck.METHODS if not ck.METHODS[m].implicit]
NOISY = ["EE", "EXP-EE"]
IMPLICIT = ["IE", "CN", "TRAPEZOID"]
PICARD, TURNS = [ck.picard(3)], [ck.chord(80), ck.newton(8)]  # with derivatives: each takes every other law
SOLVERS = [*((m, PICARD) for m in (*METHODS, *IMPLICIT)), ("CN", TURNS), ("TRAPEZOID", TURNS)]  # CN has the stage of IE
INVERSES = {
    "pseudoinverse": ck.pseudoinverse(),
    "damped": ck.damped(0.2),
    "singular_damped": ck.singular_damped(0.3, 0.9),
    "error_damped": ck.error_damped(0.1),
    "levels": ck.levels(["hand"], ["rest"], damping=(0.05, 0.4)),
}
LIMITS = {"none": None, "velocity_scaling": ck.velocity_scaling(), "bounded": ck.bounded(rate=RATE)}
DRIVES = [
    None,
    ck.Drive(lag=np.array([0.04, 0.02, 0.03]), delay=1.4, measurement_delay=1),  # of each joint
    ck.Drive(natural_frequency=25.0, damping_ratio=0.7, command="position", smoothing=0.3, smoothed="command"),
    ck.Drive(delay=2, command="position", feedback="commanded", smoothing=0.3, smoothed="target"),
    ck.Drive(lag=0.03, command="position", feedback="rebased", delay=0.5, smoothing=0.4, smoothed="error"),
    ck.Drive(lag=0.05, measurement_delay=2, smoothing=0.4, smoothed="target"),
]
EXCLUDED = ("pseudoinverse", "bounded")  # refused
LARGE = ("pseudoinverse", "damped", "levels")  # but with Newton and its chord, whose programs are large
LAWS = [law for law in itertools.product(INVERSES, LIMITS) if law != EXCLUDED]
DTYPES = (np.float64, np.float32)
TABLE = [  # of a method the stages take turns
    (method, stages, stages[(s + k) % len(stages)], *law, DRIVES[i % len(DRIVES)], DTYPES[i // len(DRIVES) % 2])
    for s, (method, stages) in enumerate(SOLVERS)
    for k, law in enumerate(LAWS)
    for i in [s * len(LAWS) + k]
]


# --- the law ------------------------------------------------------------------------------------------


def target(t):
    return CENTRE + RADIUS * np.array([np.cos(SPIN * t), np.sin(SPIN * t)])


def target_velocity(t):
    return RADIUS * SPIN * np.array([-np.sin(SPIN * t), np.cos(SPIN * t)])


def rows(rest, q):
    """J of the tip, and of joints whose aims are the second level; without levels `rest` is empty. Before weights."""
    return np.vstack([planar_jacobian(LENGTHS[len(q)], q), np.eye(len(q))[: len(rest)]])


def aim(rest, t):
    return np.r_[target(t), rest]


def aim_velocity(rest, t):
    """What the law takes of it."""
    return FEEDFORWARD * np.r_[target_velocity(t), 0 * rest]


def error(rest, q, t):
    return aim(rest, t) - np.r_[planar_position(LENGTHS[len(q)], q), q[: len(rest)]]


def dampings(inverse, J, e):
    """λ² of each row."""
    if inverse == "levels":
        return np.repeat([0.05**2, 0.4**2], [2, len(e) - 2])
    sigma = np.linalg.svd(J, compute_uv=False)[-1]
    return np.full(2, {
        "pseudoinverse": 1e-13,
        "damped": 0.2**2,
        "singular_damped": max(0.3**2 * (1 - (sigma / 0.9) ** 2), 0.0),
        "error_damped": 0.1**2 + 0.5 * e @ e,
    }[inverse])  # fmt: skip


def joint_velocity(inverse, limits, rest, q, e, v, pull):
    """q̇ for a task velocity v and a pull of the null space."""
    weights, speed = np.r_[WEIGHTS, 0 * rest + 1.0], SPEED[: len(q)]
    J, v = weights[:, None] * rows(rest, q), weights * v
    D = dampings(inverse, J, weights * e)
    qdot = pull + J.T @ np.linalg.solve(J @ J.T + np.diag(D), v - J @ pull)
    if limits == "velocity_scaling":
        qdot = qdot * min(1.0, (speed / np.abs(qdot)).min())
    if limits == "bounded":
        low, high = (np.clip(RATE * (limit[: len(q)] - q), -speed, speed) for limit in (LOWER, UPPER))
        qdot = least_within(J.T / D @ J + np.eye(len(q)), J.T / D @ v + pull, low, high)
    return qdot


def least_within(H, g, low, high):
    """Minimum of q̇ᵀHq̇/2 − gᵀq̇ in a box: the face on which it is, where forces point outwards."""
    asked = np.linalg.solve(H, g)
    likely = (asked > high) * 1 - (asked < low)  # the best face is alone, in whichever order they are tried
    for face in itertools.chain([likely], itertools.product((0, -1, 1), repeat=len(g))):
        face = np.array(face)
        free, qdot = face == 0, np.where(face < 0, low, high)
        qdot[free] = np.linalg.solve(H[np.ix_(free, free)], (g - H[:, ~free] @ qdot[~free])[free])
        inside = np.all((low - 1e-12 <= qdot) & (qdot <= high + 1e-12))
        if inside and np.all(face * (g - H @ qdot) >= -1e-12):
            return qdot
    raise AssertionError("no face is the best")


# --- a step -------------------------------------------------------------------------------------------


def step(method, stage, inverse, limits, rest, q, t, offset):
    """Joint values after a step from q, whose error is measured with an offset."""
    gains, posture, home = np.r_[GAINS, 0 * rest + 3.0], 0.0 if len(rest) else PULL, REST[: len(q)]
    exponential = method.startswith("EXP-")
    A, b = TABLEAUX[method.removeprefix("EXP-")]
    times = [sum(row) for row in A]
    e0 = error(rest, q, t) + offset
    if exponential:
        z = gains * TS
        whole, half = -np.expm1(-z) / TS * e0, -np.expm1(-z / 2) / (TS / 2) * e0
        half = whole + (half - whole) / (1 + np.max(z) ** 4)
        missed = FEEDFORWARD * (aim(rest, t + TS) - aim(rest, t)) / TS
        missed = missed - sum(w * aim_velocity(rest, t + c * TS) for w, c in zip(b, times, strict=True))
        within = [(2 - 4 * c) * half + (4 * c - 1) * whole if len(b) > 2 else whole for c in times]
        pull0 = -np.expm1(-posture * TS) / TS * (home - q)

    def field(i, q):
        at = t + times[i] * TS
        if exponential:
            return joint_velocity(inverse, limits, rest, q, e0, aim_velocity(rest, at) + within[i] + missed, pull0)
        e = error(rest, q, at) + offset
        return joint_velocity(inverse, limits, rest, q, e, aim_velocity(rest, at) + gains * e, posture * (home - q))

    explicit = field(0, q) if times[0] == 0 else None
    slopes = []
    for i, row in enumerate(A):
        base = q + TS * sum((a * k for a, k in zip(row[:i], slopes, strict=False)), 0 * q)
        if len(row) > i and row[i]:
            if explicit is None:  # the slope of explicit Euler
                e = error(rest, q, t) + offset
                v = aim_velocity(rest, t) + gains * e
                explicit = joint_velocity(inverse, limits, rest, q, e, v, posture * (home - q))
            slope, h = explicit, row[i] * TS
            for _ in range(3 * (stage in PICARD)):
                slope = field(i, base + h * slope)
            if stage not in PICARD:
                slope = root(lambda k, i=i, base=base, h=h: field(i, base + h * k) - k, slope, tol=1e-14).x
        else:
            slope = field(i, base)
        slopes.append(slope)
    qdot = sum(w * k for w, k in zip(b, slopes, strict=True))
    if limits == "none":
        return q + TS * qdot
    after = q + TS * qdot * min(1.0, (SPEED[: len(q)] / np.abs(qdot)).min())
    low, high = np.minimum(LOWER[: len(q)], q), np.maximum(UPPER[: len(q)], q)
    return np.clip(after, low, high) if limits == "bounded" else after


def drives_of(drive, n):
    """The drive of n joints."""
    return ck.replace(drive, lag=drive.lag[:n]) if drive is not None and np.ndim(drive.lag) else drive


def loop(method, stage, inverse, limits, drive, q0=Q0):
    """Joint values (N + 1, n) of the loop, through its drives."""
    drive, rest = drive or ck.Drive(), REST[: len(q0) if inverse == "levels" else 0]
    each = [hold(ck.replace(one, measurement_delay=0), TS) for one in drives_of(drive, len(q0)).joints]
    kept, positions = float(drive.kept(TS)) if drive.filters else 0.0, drive.steps_positions
    whole, path, x = each[0][3], [q0], np.zeros((len(each[0][0]), len(q0)))
    x[0] = sent = q0
    mean = q0 if positions else 0 * q0
    line, first = [mean] * (whole + 2), error(rest, q0, 0.0)
    late, smooth = [first * (drive.filters != "target")] * drive.measurement_delay, 0 * first
    smooth_aim = aim(rest, 0.0) - first
    for k in range(N):
        seen = sent if drive.feedback == "commanded" else x[0]
        e = found = error(rest, seen, k * TS)
        if drive.filters == "target":
            smooth_aim = kept * smooth_aim + (1 - kept) * aim(rest, k * TS)
            found = e + smooth_aim - aim(rest, k * TS)
        late = [found, *late]
        measured = late.pop() + NOISE[k, : len(e)] * (method in NOISY)
        if drive.filters == "error":
            measured = smooth = kept * smooth + (1 - kept) * measured
        moved = step(method, stage, inverse, limits, rest, seen, k * TS, measured - e) - seen
        sent = (seen if drive.feedback == "rebased" else sent) + moved
        command = sent if positions else moved / TS
        if drive.filters == "command":
            mean = command = kept * mean + (1 - kept) * command
        line = [command, *line]
        pushed = zip(itertools.cycle(each), x.T, line[whole], line[whole + 1], strict=False)
        x = np.stack([phi @ y + now * new + before * old for (phi, now, before, _), y, new, old in pushed], axis=1)
        path.append(x[0])
    return np.array(path)


# --- the package's ------------------------------------------------------------------------------------


def run(stage, inverse, limits, drive, q0, method):
    n, lower, upper, speed = len(q0), *(tuple(v[: len(q0)]) for v in (LOWER, UPPER, SPEED))
    arm = ck.replace(ck.planar_arm(LENGTHS[n]), lower=lower, upper=upper, velocity_limit=speed)
    hand, circle = ck.position("xy", weights=WEIGHTS), ck.circle([*CENTRE], RADIUS, period=2 * np.pi / SPIN)
    law = dict(inverse=INVERSES[inverse], limits=LIMITS[limits], feedforward=FEEDFORWARD)
    if inverse == "levels":
        law = ck.Law(arm, ck.stack(hand=hand, rest=ck.joints()), alpha=np.r_[GAINS, [3.0] * n], **law)
        circle = ck.references(hand=circle, rest=ck.hold(REST[:n]))
    else:
        law = ck.Law(arm, hand, alpha=GAINS, null_velocity=ck.posture(REST[:n], PULL), **law)
    noise = NOISE[:, : law.task.m] if method in NOISY else None
    made = ck.solve(law, circle, q0, TS, N, method, stage, drive=drives_of(drive, n), noise=noise)
    return made.q, made.e


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(("method", "stages"), SOLVERS, ids=str)
def test_combinations_are_the_loop_written_apart(method, stages, dtype):
    """All laws and drives of a method are one program: a third of the time goes into a compiler's start."""
    rows = [row[2:6] for row in TABLE if row[0] == method and row[1] is stages and row[6] is dtype]
    starts = [Q0[: 3 if stages is PICARD and row[1] in LARGE else 2] for row in rows]
    together = ck.native(lambda *each: [run(*row, q0, method) for row, q0 in zip(rows, each, strict=True)])
    given = [q0.astype(dtype) for q0 in starts]
    found = together(*given)
    function, leaves = together.of(*given)
    assert not can_build() or isinstance(chosen(function, lane_avals(leaves, batched=False), batch=False), Program)
    for row, q0, (q, e) in zip(rows, starts, found, strict=True):
        assert q.dtype == e.dtype == dtype
        rest = REST[: e.shape[1] - 2]
        near = 1e-9 if dtype is np.float64 else 2e-5
        np.testing.assert_allclose(q, loop(method, *row, q0), atol=near, err_msg=str(row))
        np.testing.assert_allclose(e, [error(rest, at, k * TS) for k, at in enumerate(q)], atol=near, err_msg=str(row))


@pytest.mark.parametrize("inverse", INVERSES)
def test_limits_act(inverse):
    free, *limited = (loop("EE", None, inverse, kind, None) for kind in LIMITS if (inverse, kind) != EXCLUDED)
    assert min(np.abs(q - free).max() for q in limited) > 1e-2


def test_every_pair_of_values_occurs():
    """Drives, dtypes and the stages with derivatives take turns: each meets each of the others."""
    for i, j in itertools.combinations((2, 3, 4, 5, 6), 2):
        values = [{str(row[k]) for row in TABLE} for k in (i, j)]
        assert {(str(row[i]), str(row[j])) for row in TABLE} == set(itertools.product(*values)) - {EXCLUDED}, (i, j)
    assert len(TABLE) == len(SOLVERS) * (len(INVERSES) * len(LIMITS) - 1) == 182
