"""`python -m tests.bench.trouble`: damping and limits on eight real robots, on three paths that lead into trouble.

Through a posture where the Jacobian loses rank, along a way that one joint could follow only past its limit, and to a
point out of reach: every robot of the example-robot-data wheel runs each path with every method, and what that does to
error, speed, chatter and status is one row. Into results/robots (more than ten minutes; two with CFLAGS=-O0).
"""

import argparse
import functools
import itertools
import pathlib

import jax
import numpy as np

import cnclik as ck
from cnclik.cli.progress import bar
from cnclik.measure.files import markdown
from cnclik.problem.names import start_from
from cnclik.robot.posture import arm_length
from tests import oracles

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "robots"
ORDER = ("Panda", "xArm7", "Talos arm", "iCub arm", "PR2 arm", "UR5", "UR10", "Kinova")
# Of the PR2 the arm alone, without the column that lifts it: all joints turn, so that "past" is in rad.
ROBOTS = {name: oracles.ARMS[name] for name in ORDER} | {"PR2 arm": (*oracles.ARMS["PR2 arm"][:2], "torso_lift_link")}
PATHS = {
    "singularity": "There and back through a posture where the Jacobian loses rank, reachable all the way",
    "limit": "There and back along a path that one joint could follow only 0.2 rad past its limit",
    "unreachable": "To a point 1.5 arm lengths further out, and on towards it",
}
TASK = ck.pose()
LAMBDA, CLAMP = 0.05, (0.1, 0.5)  # λ (λ_max) of every damped inverse; largest error that the gain sees [m, rad]
EPSILON = 0.1  # σ below which the singular-damped inverse is damped
ALPHA, TS, N, KNOTS = 5.0, 0.01, 800, 41
COLUMNS = {  # of a row, and the metrics that they are
    **{"position_rms": "rms_position_error", "orientation_rms": "rms_rotation_error"},
    **{"fastest": "max_qdot", "fastest_share": "velocity_ratio", "past_limit": "past_limit", "chatter": "chatter"},
    **{name.upper(): name for name in ("not_converged", "near_singular", "at_limit", "non_finite")},
}


def methods() -> dict:
    """Inverse, error clamp and limits of each; their numbers are arrays: robots of as many joints share programs."""
    damped, singular = ck.damped(LAMBDA), ck.singular_damped(LAMBDA, EPSILON)
    return {
        "pseudoinverse": (ck.pseudoinverse(), None, None),
        "damped, no clamp": (damped, None, None),
        "damped": (damped, CLAMP, None),
        "singular-damped": (singular, CLAMP, None),
        "same, velocity scaling": (singular, CLAMP, ck.velocity_scaling()),
        "same, bounded": (singular, CLAMP, ck.bounded()),
        "damped, bounded": (damped, CLAMP, ck.bounded()),
    }


def paths(chain, q0) -> dict:
    """The reference of each path, from q0; as many waypoints in all of them, so that they share programs, too."""
    pose = jax.jit(jax.vmap(functools.partial(ck.forward, chain)))
    s = np.linspace(0, 1, KNOTS)[:, None]
    bump = np.sin(np.pi * s) ** 2  # there and back, at rest at both ends
    moves = {"singularity": singular_posture(chain, q0) - q0, "limit": past_limit(chain, q0)}
    at = {path: pose(q0 + bump * move) for path, move in moves.items()}
    start, rotation = np.asarray(at["limit"].position[0]), np.asarray(at["limit"].rotation[0])
    away = np.where(s < 0.5, np.minimum(2 * bump, 1), 1) * 1.5 * arm_length(chain) * start / np.linalg.norm(start)
    at["unreachable"] = ck.Pose(position=start + away, rotation=np.broadcast_to(rotation, (KNOTS, 3, 3)))
    return {path: ck.waypoints(s[:, 0] * N * TS, way.position, way.rotation) for path, way in at.items()}


def singular_posture(chain, q0):
    """The most singular posture (n,) found from q0 by moving one joint after the other over its range."""
    jacobians = jax.jit(jax.vmap(functools.partial(ck.jacobian, chain)))
    q = q0.copy()
    for _ in range(3):
        for i in range(chain.n):
            tried = np.repeat(q[None], 201, axis=0)
            ends = max(chain.lower[i], q0[i] - 2.0), min(chain.upper[i], q0[i] + 2.0)
            tried[:, i] = np.append(np.linspace(*ends, 200), q[i])
            least = np.linalg.svd(np.asarray(jacobians(tried)), compute_uv=False)[:, -1]
            # Where rounding alone tells postures apart, the joint stays as near to where it is as it can.
            q = tried[np.argmin(np.where(least <= least.min() + 1e-9, np.abs(tried[:, i] - q[i]), np.inf))]
    return q


def past_limit(chain, q0):
    """A motion (n,) of one joint, the one with the least room, to 0.2 rad past its limit."""
    below, above = q0 - np.array(chain.lower), np.array(chain.upper) - q0
    i = np.argmin(np.minimum(below, above))
    return np.eye(chain.n)[i] * (above[i] + 0.2 if above[i] < below[i] else -below[i] - 0.2)


def measured(report) -> list[dict]:
    """Every robot on every path with every method, as rows in the order of the page; progress goes to `report`."""
    rows = []
    for robot, (file, tip, base) in ROBOTS.items():
        chain = ck.load_urdf(oracles.robots() / file, tip, base)
        q0 = start_from(chain, TASK)
        ways, kinds = paths(chain, q0), methods()
        for method, (inverse, clamp, limits) in kinds.items():
            law = ck.Law(chain, TASK, alpha=ALPHA, inverse=inverse, error_clamp=clamp, limits=limits)
            for path, reference in ways.items():
                run = ck.solve(law, reference, q0, TS, N, "EE")
                found = ck.measure.measure_run(run, law, reference, tuple(COLUMNS.values()))
                row = {"path": path, "robot": robot, "method": method}
                rows.append(row | {column: found[metric].item() for column, metric in COLUMNS.items()})
            report(len(rows), len(ROBOTS) * len(kinds) * len(ways), f"{robot}, {method}")
    return sorted(rows, key=lambda row: list(PATHS).index(row["path"]))


SHORT = {"position [m]": "position_rms", "orientation [rad]": "orientation_rms", "speed/limit": "fastest_share",
         "past [rad]": "past_limit", "chatter [rad/s]": "chatter", "not finite": "NON_FINITE"}  # fmt: skip


def short(rows) -> str:
    """One line per path and method, over all robots: errors their median, counts their sum, the rest the worst."""
    lines, names = [], list(dict.fromkeys(row["method"] for row in rows))
    for path, method in itertools.product(PATHS, names):
        of = [row for row in rows if (row["path"], row["method"]) == (path, method)]
        over = {name: np.median if name.endswith("rms") else sum if name.isupper() else max for name in COLUMNS}
        cells = [f"{over[name]([row[name] for row in of]):.3g}" for name in SHORT.values()]
        lines.append((path if method == names[0] else "", method, *cells))
    return markdown(("path", "method", *SHORT), lines, left=2)


def full(rows) -> str:
    """One line per robot and method, of one path."""
    lines = [(row["robot"], row["method"], *(f"{row[name]:.3g}" for name in COLUMNS)) for row in rows]
    return markdown(("robot", "method", *COLUMNS), lines, left=2)


def page(rows) -> str:
    """The rows as a page of Markdown."""
    tables = (f"\n## {told}\n\n{full([row for row in rows if row['path'] == path])}" for path, told in PATHS.items())
    return f"""# Near trouble: damping and limits on real robots

Written by `python -m tests.bench.trouble`. Spatial pose tracking, explicit Euler, alpha = {ALPHA:g} 1/s, \
Ts = {TS:g} s, {N} steps. λ (λ_max) = {LAMBDA:g} for every damped inverse; the singular-damped one is damped below \
σ = {EPSILON:g}; *same* is the singular-damped one with a method for limits. All but the first two clamp the error at \
{CLAMP[0]:g} m and {CLAMP[1]:g} rad. Errors are RMS over the run; *fastest* is the largest joint velocity [rad/s], \
*share* that of its limit; *past* is how far a joint went beyond its position limit; *chatter* is the RMS joint speed \
that the next step reverses, over the second half of the run. Capitals count steps with a status.

## In short

Errors: median over the robots; speed, past and chatter: the worst robot.

{short(rows)}{"".join(tables)}"""


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.bench.trouble", description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=pathlib.Path, metavar="FOLDER", default=RESULTS, help="for trouble.md")
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    with bar("loops") as report:
        rows = measured(report)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "trouble.md").write_text(page(rows), encoding="utf-8")
    print(short(rows))


if __name__ == "__main__":
    main()
