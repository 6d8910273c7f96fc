"""`python -m tests.bench.starts`: from 1,000 random starts, how often does a loop arrive, whatever its gain?

Eight real robots (those of tests/oracles.py, which their wheel brings), the whole pose, damped
inverse with λ = 0.01. Starts and targets are drawn within the joint limits (within ±π where there are none), so every
target can be reached; limits are not respected on the way. Ts = 0.1 s, N = 150; arrived is who ends within 1e-3 (norm
of position [m] and turn [rad]). Exponential steps at z = 0.1 … 100 against explicit Euler at z = 0.1 … 1.9;
EXP-MIDPOINT also with its error clamped to 0.1 m and 0.3 rad. Into results/methods_starts: tables.md, which its
README shows.

    python -m tests.bench.starts                       # all: minutes
    python -m tests.bench.starts --robots Panda UR5    # some, to the terminal alone
"""

import argparse
import pathlib

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.measure.files import markdown
from cnclik.sweeps.sweep import sweep
from tests.oracles import ARMS, robots

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


def arrivals(name, loops=LOOPS) -> list:
    """One row per loop and z of a robot: the share that arrives."""
    file, tip, base = ARMS[name]
    chain = ck.load_urdf(robots() / file, tip, base)
    rng = np.random.default_rng(SEED)
    starts, goals = drawn(chain, rng), drawn(chain, rng)
    with jax.enable_x64(True):
        at = jax.jit(jax.vmap(lambda q: ck.forward(chain, q)))(goals)
        position, rotation = np.asarray(at.position), np.asarray(at.rotation)

    def study(method, z, k):
        law = ck.Law(chain, ck.pose(), alpha=z / TS, inverse=ck.damped(DAMPING), error_clamp=clamp)
        path = ck.hold(jnp.asarray(position)[k], jnp.asarray(rotation)[k])
        run = ck.solve(law, path, jnp.asarray(starts)[k], TS, N, method)
        return {"final": jnp.linalg.norm(run.e[-1])}

    made = []
    for loop in loops:
        method, gains, clamp = LOOPS[loop]
        found = sweep(study, method=[method], z=gains, k=np.arange(STARTS)).isel({"method": 0})
        for j, z in enumerate(gains):
            share = float((found["final"].values[j] <= TOLERANCE).mean())
            made.append({"robot": name, "loop": loop, "z": z, "arrived": share})
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


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", nargs="*", choices=list(ARMS), default=list(ARMS))
    asked = parser.parse_args()
    made = []
    for name in asked.robots:
        made += arrivals(name)
        print(table(made), flush=True)
    if asked.robots == list(ARMS):
        RESULTS.mkdir(parents=True, exist_ok=True)
        (RESULTS / "tables.md").write_text(f"Share that arrives [%]\n\n{table(made)}", encoding="utf-8")


if __name__ == "__main__":
    main()
