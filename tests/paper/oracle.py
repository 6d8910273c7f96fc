"""The paper's experiments in plain NumPy, straight from its equations and sharing nothing with cnclik."""

import numpy as np


def tip(q, sense):
    angle = np.pi / 2 + sense * np.cumsum(q)
    return np.array([np.cos(angle).sum(), np.sin(angle).sum()])


def jacobian(q, sense):
    angle = np.pi / 2 + sense * np.cumsum(q)
    columns = [(-np.sin(angle[i:]).sum(), np.cos(angle[i:]).sum()) for i in range(len(q))]
    return sense * np.array(columns).T


def run(n, case, method, rotation="on-path", Ts_reading="once", feedforward="consistent"):
    """Errors ‖e[k]‖ (31,) and joint paths (31, n)."""
    Ts, N, M, alpha = 0.1, 30, 5, 5.0
    sense = -1.0 if rotation == "on-path" else 1.0
    if case == "reach":
        target = np.array({2: (1.0, 0.0), 5: (3.0, 1.0)}[n])
        x_d, velocity = (lambda k: target), np.zeros(2)
    else:
        begin = np.array({2: (1.0, 1.0), 5: (4.0, 1.0)}[n])
        x_d = lambda k: begin - np.array([k / N, 0.0])  # noqa: E731
        velocity = np.array([-1 / 3 if feedforward == "consistent" else -1.0, 0.0])

    def slope(q, k):
        return np.linalg.pinv(jacobian(q, sense)) @ (velocity + alpha * (x_d(k) - tip(q, sense)))

    q = np.zeros(n)
    q[1] = np.pi / 2
    path = [q]
    for k in range(N):
        first = implicit = slope(q, k)
        for _ in range(M):
            implicit = slope(q + (Ts if Ts_reading == "once" else Ts * Ts) * implicit, k + 1)
        q = q + Ts * {"EE": first, "IE": implicit, "CN": (first + implicit) / 2}[method]
        path.append(q)
    return np.array([np.linalg.norm(x_d(k) - tip(q, sense)) for k, q in enumerate(path)]), np.array(path)
