"""Every metric once more, in plain NumPy on one trajectory."""

import numpy as np

import cnclik as ck


def norms(rows):
    return np.linalg.norm(rows, axis=-1)


def metrics(run, law, tangent, tolerance, velocity_limit, lower, upper):
    """All scalar metrics; `tangent` holds the path's unit tangent at every instant (0 at rest)."""
    q, e, qdot = (np.asarray(getattr(run, n)) for n in ("q", "e", "qdot"))
    residual, status = np.asarray(run.residual), np.asarray(run.status)
    position, rotation = e[:, : len(law.task.position)], e[:, len(law.task.position) :]
    parts = {"error": e, "position_error": position, "rotation_error": rotation}
    along = np.sum(position * tangent, axis=1)
    parts |= {"along": along[:, None], "across": position - along[:, None] * tangent}
    out = {}
    for name, rows in parts.items():
        size = norms(rows)
        out |= {f"final_{name}": size[-1], f"mean_{name}": size.mean(), f"max_{name}": size.max()}
        out[f"rms_{name}"] = np.sqrt(np.mean(size**2))
    size, steps = norms(e), len(qdot)
    inside = [k for k in range(len(size)) if size[k] <= tolerance]
    out["steps_to_tolerance"] = inside[0] if inside else np.inf
    out["evaluations_to_tolerance"] = out["steps_to_tolerance"] * float(run.evaluations) / steps
    out["converged"] = float(size[-1] <= tolerance)
    out["max_qdot"] = np.abs(qdot).max()
    out["velocity_ratio"] = (np.abs(qdot) / velocity_limit).max()
    out["past_limit"] = max(0.0, *(q - upper).ravel(), *(lower - q).ravel())
    late = qdot[steps // 2 :]
    pairs = zip(late[:-1].T, late[1:].T, strict=True)
    back = [[min(abs(a), abs(b)) * (a * b < 0) for a, b in zip(u, v, strict=True)] for u, v in pairs]
    out["chatter"] = np.sqrt(np.mean(np.sum(np.square(back), axis=0)))
    rows = [*map("xyz".index, law.task.position), *(3 + "xyz".index(axis) for axis in law.task.orientation)]
    jacobians = np.stack([np.asarray(ck.jacobian(law.chain, one))[rows] for one in q])
    out["least_singular_value"] = np.linalg.svd(jacobians, compute_uv=False).min()
    out["residual"] = residual.max()
    out["evaluations"] = float(run.evaluations)
    out["ok"] = int(np.sum(status == 0))
    for bit in ck.Status:
        if bit:
            out[bit.name.lower()] = int(np.sum((status & bit.value) > 0))
    return out
