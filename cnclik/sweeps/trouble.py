"""Near trouble: real robots on paths through a singularity, along a joint limit and to a target out of reach.

Every damping and limit method runs the same loops; what each does to error, speed, chatter and status is one row.
"""

import functools
import importlib.metadata
import pathlib

import jax
import numpy as np

from cnclik import errors
from cnclik.integrate.solve import solve
from cnclik.integrate.status import Status
from cnclik.law import inverse, limits
from cnclik.law.law import Law
from cnclik.law.reference import waypoints
from cnclik.law.task import pose as pose_task
from cnclik.measure.metrics import chatter
from cnclik.problem.build import start_from
from cnclik.robot.chain import REVOLUTE
from cnclik.robot.kinematics import _jacobian, _pose
from cnclik.robot.posture import arm_length as length
from cnclik.robot.urdf import load_urdf

# name: (file in the example-robot-data wheel, tip, base)
ROBOTS = {
    "Panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp", None),
    "xArm7": ("xarm_description/urdf/xarm7.urdf", None, None),
    "Talos arm": ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", "torso_2_link"),
    "iCub arm": ("icub_description/robots/icub.urdf", "l_hand", "chest"),
    "PR2 arm": ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", "torso_lift_link"),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", "tool0", None),
    "UR10": ("ur_description/urdf/ur10_robot.urdf", "tool0", None),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
}
LAMBDA, EPSILON = 0.05, 0.1  # λ (λ₀, λ_max) of every damped inverse; σ below which the last is damped
CLAMP = (0.1, 0.5)
METHODS = {  # name: the law's options, from a manipulability to be damped below
    "pseudoinverse": lambda w: {},
    "damped, no clamp": lambda w: {"inverse": inverse.damped(LAMBDA)},
    "damped": lambda w: {"inverse": inverse.damped(LAMBDA), "error_clamp": CLAMP},
    "manipulability-damped": lambda w: {"inverse": inverse.manipulability_damped(LAMBDA, w), "error_clamp": CLAMP},
    "singular-damped": lambda w: _singular_damped(),
    "same, velocity scaling": lambda w: _singular_damped() | {"limits": limits.velocity_scaling()},
    "same, weighted": lambda w: _singular_damped() | {"limits": limits.weighted_least_norm()},
    "same, saturation": lambda w: _singular_damped() | {"limits": limits.saturation()},
}
PATHS = ("singularity", "limit", "unreachable")
ALPHA, TS, N, KNOTS = 5.0, 0.01, 800, 41


def example_robots() -> pathlib.Path:
    """Folder of the installed `example-robot-data` wheel's robots. Raises ArgumentError if there is none."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
        return pathlib.Path(next(f for f in files if f.name == "panda.urdf").locate()).resolve().parents[2]
    except (importlib.metadata.PackageNotFoundError, StopIteration):
        raise errors.fail("robots", "be a folder, or example-robot-data be installed", "neither is") from None


def _singular_damped():
    return {"inverse": inverse.singular_damped(LAMBDA, EPSILON), "error_clamp": CLAMP}


def run(folder=None, robots=None, track=lambda tasks: tasks) -> list[dict]:
    """Every robot on every path with every method, as rows.

    Args:
      folder: where the robots' files are; the installed wheel by default.
      robots: names among `ROBOTS`, all by default.
      track: wraps the list of (robot, method) for a progress bar.
    """
    folder = example_robots() if folder is None else pathlib.Path(folder)
    robots = list(ROBOTS) if robots is None else robots
    files = {robot: ROBOTS[errors.one_of("robots", robot, ROBOTS)] for robot in robots}
    chains = {robot: load_urdf(folder / file, tip, base) for robot, (file, tip, base) in files.items()}
    made = {}
    rows = []
    for robot, method in track([(r, m) for r in robots for m in METHODS]):
        if robot not in made:
            made[robot] = _paths(chains[robot])
        chain, w0, paths = made[robot]
        law = Law(chain, pose_task(), alpha=ALPHA, **METHODS[method](w0))
        for path, (start, reference) in paths.items():
            run = solve(law, reference, start, TS, N)
            rows.append({"path": path, "robot": robot, "method": method} | measure(run, chain))
    return sorted(rows, key=lambda row: PATHS.index(row["path"]))


def measure(run, chain) -> dict:
    """Errors, speed, chatter and status counts of one run."""
    e, qdot, status = (np.asarray(v) for v in (run.e, run.qdot, run.status))
    past = np.maximum(np.asarray(run.q) - chain.upper, np.asarray(chain.lower) - np.asarray(run.q))
    rms = lambda v: float(np.sqrt(np.mean(np.sum(v**2, axis=1))))  # noqa: E731
    return {
        "position_rms": rms(e[:, :3]),
        "orientation_rms": rms(e[:, 3:]),
        "fastest": float(np.max(np.abs(qdot))),
        "fastest_share": float(np.max(np.abs(qdot) / np.array(chain.velocity_limit))),
        "past_limit": float(max(past.max(), 0.0)),
        "chatter": float(chatter(qdot)),
        **{s.name: int(np.sum(status & s.value != 0)) for s in Status if s},
    }


# --- paths --------------------------------------------------------------------------------------------


def _paths(chain):
    """The chain, a manipulability to be damped below, and for each kind of trouble (q0, waypoints of equal number)."""
    task = pose_task()
    q0 = start_from(chain, task)
    least = _least(chain)
    pose = jax.jit(jax.vmap(functools.partial(_pose, chain)))
    s = np.linspace(0, 1, KNOTS)
    times = s * N * TS
    bump = np.sin(np.pi * s)[:, None] ** 2  # there and back, at rest at both ends

    def along(way):
        at = pose(way)
        return way[0], waypoints(times, at.position, at.rotation)

    at = pose(q0[None])
    outward = np.asarray(at.position[0])
    outward = outward / np.linalg.norm(outward) * 1.5 * length(chain)
    away = np.asarray(at.position[0]) + np.minimum(2 * bump * (s[:, None] < 0.5) + (s[:, None] >= 0.5) * 2, 1) * outward
    turned = np.broadcast_to(np.asarray(at.rotation[0]), (KNOTS, 3, 3))
    w = float(np.sqrt(np.linalg.det(_gram(chain, q0))))
    return (
        chain,
        0.3 * w,
        {
            "singularity": along(q0 + bump * (_singular(chain, q0, least) - q0)),
            "limit": along(q0 + bump * _beyond(chain, q0)),
            "unreachable": (q0, waypoints(times, away, turned)),
        },
    )


def _gram(chain, q):
    j = np.asarray(_jacobian(chain, q))
    return j @ j.T


def _least(chain):
    jacobians = jax.jit(jax.vmap(functools.partial(_jacobian, chain)))
    return lambda q: np.linalg.svd(np.asarray(jacobians(q)), compute_uv=False)[:, -1]


def _singular(chain, q0, least):
    """The most singular posture found from q0 by moving one joint after the other over its range."""
    q = q0.copy()
    for _ in range(3):
        for i in range(chain.n):
            low, high = max(chain.lower[i], q0[i] - 2.0), min(chain.upper[i], q0[i] + 2.0)
            tried = np.repeat(q[None], 201, axis=0)
            tried[:, i] = np.append(np.linspace(low, high, 200), q[i])
            q = tried[np.argmin(least(tried))]
    return q


def _beyond(chain, q0):
    """A motion of one joint, the one with the least room, to 0.2 rad (or 2 cm) past its limit."""
    room = np.array([min(u - x, x - l, key=abs) for x, l, u in zip(q0, chain.lower, chain.upper, strict=True)])
    turning = {j.coordinate for j in chain.joints if j.kind == REVOLUTE}
    i = min((i for i in range(chain.n) if i in turning), key=lambda i: room[i])
    up = chain.upper[i] - q0[i] < q0[i] - chain.lower[i]
    move = np.zeros(chain.n)
    move[i] = (room[i] + 0.2) * (1 if up else -1)
    return move


# --- report -------------------------------------------------------------------------------------------

_TOLD = {
    "singularity": "There and back through a posture where the Jacobian loses rank, reachable all the way",
    "limit": "There and back along a path that one joint could follow only 0.2 rad past its limit",
    "unreachable": "To a point 1.5 arm lengths further out, and on towards it",
}


def page(rows) -> str:
    """The rows as a page of Markdown."""
    lines = [
        "# Near trouble: damping and limits on real robots",
        "",
        f"Written by `cnclik trouble`. Spatial pose tracking, explicit Euler, alpha = {ALPHA:g} 1/s, Ts = {TS:g} s,"
        f" {N} steps. λ (λ₀, λ_max) = {LAMBDA:g} for every damped inverse; the singular-damped one is damped below"
        f" σ = {EPSILON:g}, the manipulability-damped one below 0.3 of the start's w; *same* is the singular-damped one"
        f" with a method for limits. All but the first two clamp the error at {CLAMP[0]:g} m and {CLAMP[1]:g} rad.",
        "",
        "Errors are RMS over the run; *speed* is the largest joint velocity, and in brackets its share of that joint's"
        " limit; *past* is how far a joint went beyond its position limit; *chatter* is the RMS joint speed that the"
        " next step takes back, over the second half of the run. Steps are counted by status: near singular (least"
        " singular value below 0.01; *damped* and *manipulability-damped* know it from below only), at limit, not"
        " finite.",
        "",
        "## In short",
        "",
        "Errors: median over the robots; speed, past and chatter: the worst robot.",
        *_short(rows),
    ]
    for path in PATHS:
        lines += [
            "",
            f"## {_TOLD[path]}",
            "",
            "| robot | method | position [m] | orientation [rad] | speed [rad/s] | past [rad] | chatter [rad/s] | "
            "singular | limit | not finite |",
            "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
        ]
        before = None
        for row in (r for r in rows if r["path"] == path):
            share = row["fastest_share"]
            speed = f"{row['fastest']:.3g}" + (f" ({100 * share:.0f} %)" if share > 0 else "")
            shown = [
                row["robot"] if row["robot"] != before else "",
                row["method"],
                f"{row['position_rms']:.2e}",
                f"{row['orientation_rms']:.2e}",
                speed,
                f"{row['past_limit']:.2g}",
                f"{row['chatter']:.2g}",
                *(str(row[name]) for name in ("NEAR_SINGULAR", "AT_LIMIT", "NON_FINITE")),
            ]
            lines.append(f"| {' | '.join(shown)} |")
            before = row["robot"]
    return "\n".join(lines) + "\n"


def _short(rows):
    """One line per path and method, over all robots."""
    lines = [
        "",
        "| path | method | position [m] | orientation [rad] | speed/limit | past [rad] |"
        " chatter [rad/s] | not finite |",
        f"| --- | --- {'| ---: ' * 6}|",
    ]
    for path in PATHS:
        for k, method in enumerate(METHODS):
            those = [r for r in rows if r["path"] == path and r["method"] == method]
            if not those:
                continue
            columns = {name: [r[name] for r in those] for name in those[0]}
            shown = [
                path if k == 0 else "",
                method,
                f"{np.median(columns['position_rms']):.2e}",
                f"{np.median(columns['orientation_rms']):.2e}",
                f"{max(columns['fastest_share']):.3g}",
                f"{max(columns['past_limit']):.2g}",
                f"{max(columns['chatter']):.2g}",
                str(sum(columns["NON_FINITE"])),
            ]
            lines.append(f"| {' | '.join(shown)} |")
    return lines
