"""`python -m tests.bench.starts`: from 1,000 random starts, how often does a loop arrive, whatever its gain?

Eight real robots (those of tests/integrate/test_real_robots.py, which their wheel brings), the whole pose, damped
inverse with λ = 0.01. Starts and targets are drawn within the joint limits (within ±π where there are none), so every
target can be reached; limits are not respected on the way. Ts = 0.1 s, N = 150; arrived is who ends within 1e-3 (norm
of position [m] and turn [rad]). Exponential steps at z = 0.1 … 100 against explicit Euler at z = 0.1 … 1.9;
EXP-MIDPOINT also with its error clamped to 0.1 m and 0.3 rad. Loops that don't arrive are near singular at the end
(least singular value below 2λ), still on their way (their error fell by 1 % in the last 20 steps), or neither. Into
results/methods_starts: shares.csv, and tables.md with what its README shows.

    python -m tests.bench.starts                       # all: minutes
    python -m tests.bench.starts --robots Panda UR5    # some, to the terminal alone
"""

import argparse
import csv
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.measure.files import markdown
from cnclik.sweeps.sweep import sweep
from tests.integrate.test_real_robots import ROBOTS, folder

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "methods_starts"
STARTS, TS, N, TOLERANCE, SEED = 1000, 0.1, 150, 1e-3, 13
DAMPING = 0.01
Z = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0]
EULER = [0.1, 0.3, 0.5, 0.7, 1.0, 1.5, 1.9]
LOOPS = {  # method, z, error_clamp [m, rad]
    "EE": ("EE", EULER, None),
    **{method: (method, Z, None) for method in ("EXP-EE", "EXP-MIDPOINT")},
    "EXP-MIDPOINT, clamped": ("EXP-MIDPOINT", Z, (0.1, 0.3)),
}


def drawn(chain, rng):
    """Joint values (STARTS, n) within the limits."""
    low, high = (np.clip(np.array(v, float), -np.pi, np.pi) for v in (chain.lower, chain.upper))
    return low + (high - low) * rng.random((STARTS, chain.n))


def arrivals(name, loops=LOOPS, progress=None) -> list:
    """One row per loop and z of a robot: the share that arrives, and why others don't."""
    file, tip, base = ROBOTS[name]
    chain = ck.load_urdf(folder() / file, tip, base)
    rng = np.random.default_rng(SEED)
    starts, goals = drawn(chain, rng), drawn(chain, rng)
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: ck.forward(chain, q)))(goals)
        position, rotation = np.asarray(at.position), np.asarray(at.rotation)
        least = jax.jit(jax.vmap(lambda q: jnp.linalg.svd(ck.jacobian(chain, q), compute_uv=False)[-1]))

    def study(method, z, k):
        law = ck.Law(chain, ck.pose(), alpha=z / TS, inverse=ck.damped(DAMPING), error_clamp=clamp)
        path = ck.hold(jnp.asarray(position)[k], jnp.asarray(rotation)[k])
        run = ck.solve(law, path, jnp.asarray(starts)[k], TS, N, method)
        size = jnp.linalg.norm(run.e[jnp.array([-21, -1])], axis=1)
        return {"before": size[0], "final": size[1], "q": run.q[-1]}

    made = []
    for loop in loops:
        method, gains, clamp = LOOPS[loop]
        found = sweep(study, method=[method], z=gains, k=np.arange(STARTS)).isel({"method": 0})
        for j, z in enumerate(gains):
            before, final, q = (found[v].values[j] for v in ("before", "final", "q"))
            arrived = final <= TOLERANCE
            with jax.enable_x64(True):
                singular = ~arrived & ~(np.asarray(least(np.nan_to_num(q))) > 2 * DAMPING)
            slow = ~arrived & ~singular & (final < 0.99 * before)
            shares = {"arrived": arrived, "singular": singular, "on_the_way": slow}
            row = {"robot": name, "loop": loop, "z": z} | {k: round(float(v.mean()), 4) for k, v in shares.items()}
            made.append(row | {"neither": round(1 - sum(row[k] for k in shares), 4)})
        if progress is not None:
            progress(loop)
    return made


def table(made) -> str:
    """Shares [%], a line per robot and loop, beside explicit Euler's at its best z and at 1."""
    lines = []
    for robot in dict.fromkeys(r["robot"] for r in made):
        mine = {(r["loop"], r["z"]): r["arrived"] for r in made if r["robot"] == robot}
        euler = {z: mine["EE", z] for z in EULER}
        best = max(euler, key=euler.get)
        told = f"{100 * euler[best]:.1f} (z = {best:g})", f"{100 * euler[1.0]:.1f}"
        lines += [
            [robot, loop, *told, *(f"{100 * mine[loop, z]:.1f}" for z in Z)]
            for loop in dict.fromkeys(loop for loop, _ in mine)
            if loop != "EE"
        ]
    return markdown(["robot", "loop", "EE, best", "EE, z = 1", *(f"z = {z:g}" for z in Z)], lines, left=2)


def why(made) -> str:
    """Where exponential Euler's loops at z = 10 end that don't arrive, and explicit Euler's at z = 1 [%]."""
    kinds = ("singular", "on_the_way", "neither")
    lines = [
        [r["robot"], f"{r['loop']}, z = {r['z']:g}", *(f"{100 * r[k]:.1f}" for k in kinds)]
        for r in made
        if (r["loop"], r["z"]) in (("EE", 1.0), ("EXP-EE", 10.0))
    ]
    return markdown(["robot", "loop", "near singular", "on its way", "neither"], lines, left=2)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="*", choices=list(ROBOTS), default=list(ROBOTS))
    asked = parser.parse_args()
    made = []
    for name in asked.robots:
        rows = arrivals(name, progress=lambda loop, name=name: print(name, loop, flush=True))
        print(table(rows), why(rows), sep="\n", flush=True)
        made += rows
    text = f"Share that arrives [%]\n\n{table(made)}\nShare that does not, by how it ends [%]\n\n{why(made)}"
    if asked.robots == list(ROBOTS):
        RESULTS.mkdir(parents=True, exist_ok=True)
        (RESULTS / "tables.md").write_text(text, encoding="utf-8")
        with (RESULTS / "shares.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, list(made[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(made)


if __name__ == "__main__":
    main()
