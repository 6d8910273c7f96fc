"""True one-step maps of whole loops, written apart from the package: NumPy, SciPy's expm, Pinocchio's Jacobians."""

import functools

import numpy as np
import pinocchio as pin
import scipy.linalg

from tests.oracles import planar_jacobian, robot_file

ROBOTS = ("planar2", "planar3", "planar5", "panda", "ur5", "tree")
TABLEAUX = {
    "EE": ([[0]], [1]),
    "IE": ([[1]], [1]),
    "CN": ([[0], [0, 1]], [0.5, 0.5]),
    "TRAPEZOID": ([[0], [0.5, 0.5]], [0.5, 0.5]),
    "HEUN": ([[0], [1, 0]], [0.5, 0.5]),
    "MIDPOINT": ([[0], [0.5, 0]], [0, 1]),
    "RK4": ([[0], [0.5, 0], [0, 0.5, 0], [0, 0, 1, 0]], [1 / 6, 1 / 3, 1 / 3, 1 / 6]),
}


def planar(q, rows=2):
    """Jacobian of a planar arm of unit links."""
    return np.vstack([planar_jacobian(np.ones(len(q)), q), np.ones(len(q))])[:rows]


def tree(q):
    """A torso joint that carries two planar arms of three links: (4, 7)."""
    left, right, jacobian = planar(q[:4]), planar(np.r_[q[0], q[4:7]]), np.zeros((4, 7))
    jacobian[:2, :4], jacobian[2:, 0], jacobian[2:, 4:] = left, right[:, 0], right[:, 1:]
    return jacobian


@functools.cache
def _model(name):
    model = pin.buildModelFromUrdf(str(robot_file(name)))
    if name == "panda":
        fingers = [model.getJointId(j) for j in model.names if "finger" in j]
        model = pin.buildReducedModel(model, fingers, pin.neutral(model))
    return model, model.createData(), model.getFrameId("panda_hand") if name == "panda" else model.nframes - 1


def jacobian(robot, rng):
    """J (m, n) at a random posture, and the task of each of its rows."""
    if robot == "tree":
        return tree(rng.uniform(-2, 2, 7)), np.array([0, 0, 1, 1])
    if robot.startswith("planar"):
        n = int(robot[-1])
        rows = 2 if n == 2 or rng.random() < 0.5 else 3
        return planar(rng.uniform(-np.pi, np.pi, n), rows), np.array([0, 0, 1])[:rows]
    model, data, frame = _model(robot)
    q = rng.uniform(np.maximum(model.lowerPositionLimit, -np.pi), np.minimum(model.upperPositionLimit, np.pi))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    return pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)[:, : model.nv], np.repeat([0, 1], 3)


def march(method, passes, Ts, M):
    """R (n, n): what a step of a method does to q, q̇ = −M q. Args: passes: None for exact stages."""
    rows, weights = TABLEAUX[method]
    eye, slopes = np.eye(len(M)), []
    for row in rows:
        base = eye + Ts * sum((a * k for a, k in zip(row[: len(slopes)], slopes, strict=False)), np.zeros_like(M))
        a = row[len(slopes)]
        if not a:
            slope = -M @ base
        elif passes is None:
            slope = np.linalg.solve(eye + a * Ts * M, -M @ base)
        else:
            slope = -M
            for _ in range(passes):
                slope = -M @ (base + a * Ts * slope)
        slopes.append(slope)
    return eye + Ts * sum(w * k for w, k in zip(weights, slopes, strict=True))


def hold(drive, Ts):
    """Φ, Γ₀, Γ₁ and whole samples of dead time, by SciPy's expm over the parts of a sample."""
    delay = drive.delay + drive.measurement_delay
    whole = int(np.floor(delay))
    if drive.order == 0:
        a, b = np.zeros((0, 0)), np.zeros(0)
    elif drive.order == 1:
        a, b = np.array([[-1 / float(drive.lag)]]), np.array([1 / float(drive.lag)])
    else:
        w, zeta = float(drive.natural_frequency), float(drive.damping_ratio)
        a, b = np.array([[0, 1.0], [-(w**2), -2 * zeta * w]]), np.array([0, w**2])
    if not drive.steps_positions:
        moved = np.zeros((len(a) + 1,) * 2)
        moved[1:, 1:], moved[0, 1:2] = a, 1.0
        a, b = moved, np.r_[0.0 if len(a) else 1.0, b]

    def held(h):
        e = scipy.linalg.expm(h * np.block([[a, b[:, None]], [np.zeros((1, len(b) + 1))]]))
        return e[:-1, :-1], e[:-1, -1]

    (first, now), (second, late) = held(Ts * (1 - delay % 1)), held(Ts * (delay % 1))
    return first @ second, now, first @ late, whole


def whole_map(S, drives, Ts):
    """The map of all joints' states of a loop whose step is (S − I) y, one drive a joint: (states·n, states·n).

    The states are those of the drives, commands under way, the sum of the steps, and the filtered signal.
    """
    n, step_of, first = len(S), S - np.eye(len(S)), drives[0]
    sampled = [hold(drive, Ts) for drive in drives]
    size, whole = len(sampled[0][0]), sampled[0][3]
    lines = whole + 1
    count, kept = size + lines + 2, float(first.kept(Ts)) if first.filters else 0.0

    def one(v):
        v = v.reshape(count, n)
        x, line, sent, mean = v[:size], v[size : size + lines], v[size + lines], v[size + lines + 1]
        seen = sent if first.feedback == "commanded" else x[0]
        used = seen
        if first.filters == "error":
            mean = used = kept * mean + (1 - kept) * seen
        step = step_of @ used
        sent = (seen if first.feedback == "rebased" else sent) + step
        command = sent if first.steps_positions else step / Ts
        if first.filters == "command":
            mean = command = kept * mean + (1 - kept) * command
        pushed, new = np.vstack([command, line]), np.zeros_like(x)
        for j, (phi, now, late, _) in enumerate(sampled):
            new[:, j] = phi @ x[:, j] + now * pushed[whole, j] + late * pushed[whole + 1, j]
        return np.concatenate([new.ravel(), pushed[:lines].ravel(), sent, mean])

    return np.stack([one(e) for e in np.eye(count * n)], 1)


def radius(S, drives, Ts) -> float:
    """Spectral radius of `whole_map`, directions apart that no step moves."""
    eigenvalues = np.linalg.eigvals(whole_map(S, drives, Ts))
    return float(np.abs(eigenvalues).max())
