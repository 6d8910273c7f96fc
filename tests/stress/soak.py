"""`python -m tests.stress.soak`: half an hour of all calls in one process, always with new robots: is memory flat?

Every round has a robot, a path and functions that nobody has asked for before, as literals where that is how users
write them. What the process holds is looked at after each round. So that half an hour shows what a day does, caches of
programs hold 16 in place of 128, and all functions together in place of 64.

    python -m tests.stress.soak                      # 30 minutes
    python -m tests.stress.soak --minutes 3
"""

import argparse
import gc
import pathlib
import resource
import sys
import tempfile
import time

import jax
import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik import cache
from cnclik.cli import main as cnclik
from cnclik.cli.progress import bar
from cnclik.measure.files import markdown

INVERSES = (ck.pseudoinverse, lambda: ck.damped(0.05))
GROWTH = 1.05  # of the median of the last third over that of the second


def draw(rng):
    """A robot, its law, a path, a start: of Python numbers, as in an example."""
    n = int(rng.integers(2, 5))
    chain = ck.planar_arm([float(v) for v in rng.uniform(0.2, 1.0, n)])
    inverse = INVERSES[rng.integers(len(INVERSES))]()
    law = ck.Law(chain, ck.position("xy"), alpha=float(rng.uniform(1, 10)), inverse=inverse)
    q = rng.uniform(0.3, 1.2, n)
    tip = np.asarray(ck.forward(chain, q).position)[:2]
    reference = (
        ck.hold(tip + 0.05) if rng.random() < 0.5 else ck.circle(tip, radius=float(rng.uniform(0.01, 0.1)), period=2.0)
    )
    return law, reference, q


def everything(rng, folder):
    """Calls by name."""
    law, reference, q = draw(rng)
    Ts, gain = 0.01, float(rng.uniform(0.5, 2))
    method = ("EE", "CN", "EXP-MIDPOINT", "RK4")[rng.integers(4)]
    run = ck.solve(law, reference, q, Ts, 20, method)

    def lanes():
        ck.lanes(lambda q0: ck.solve(law, reference, q0, Ts, 5, "EE").e[-1] * gain)(np.tile(q, (8, 1)))

    def figure():
        plt.close(ck.plot(run, law))

    def files():
        data = ck.to_dataset(run, law)
        ck.measure.save_netcdf(data, folder / "run.nc")
        text = "".join(
            f'<link name="l{i}"/><joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<origin xyz="{rng.random()} 0 0"/><axis xyz="0 0 1"/></joint>'
            for i in range(4)
        )
        (folder / "arm.urdf").write_text(f'<robot name="r">{text}<link name="l4"/></robot>')
        chain = ck.load_urdf(folder / "arm.urdf")
        ck.forward(chain, np.zeros(chain.n))

    def path():
        ck.solve(law, ck.path(lambda t: (0.5 + 0.1 * gain * t, 0.5 + 0.0 * t)), q, Ts, 5)

    return {
        "solve": lambda: ck.solve(law, reference, q, Ts, int(rng.integers(1, 40)), method),
        "step": lambda: ck.step(law, reference, q, 0.0, Ts, method),
        "path": path,
        "gradient": lambda: jax.grad(
            lambda a: ck.solve(ck.replace(law, alpha=a), reference, q, Ts, 5, "EE").e[-1] @ np.ones(2)
        )(gain),
        "lanes": lanes,
        "reach": lambda: ck.reach(law.chain, np.append(run.x[-1], 0.0), task=law.task),
        "gains": lambda: ck.gains(Ts=Ts, drive=ck.Drive(delay=int(rng.integers(0, 9)), lag=float(gain) / 100)),
        "verdict": lambda: ck.verdict(law, reference, run, Ts=Ts, method=method),
        "sweep": lambda: ck.sweep(
            lambda alpha: ck.measure_run(
                ck.solve(ck.replace(law, alpha=alpha), reference, q, Ts, 10, "EE"), law, reference, ["final_error"]
            ),
            alpha=[1.0, gain],
        ),
        "tune": lambda: ck.tune(law, reference, q, Ts=Ts, N=10, steps=3),
        "plot": figure,
        "files": files,
        "command": lambda: cnclik(["robots", str(folder / "arm.urdf")]),
    }


def resident() -> float:
    """What the process holds now [MiB]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", help="names of calls, such as lanes")
    parser.add_argument("--kept", type=int, default=16, help="programs that a cache keeps")
    args = parser.parse_args()
    cache.KEPT_PROGRAMS = cache.MOST_PROGRAMS = args.kept
    rng, begun, held, calls, spent = np.random.default_rng(args.seed), time.time(), [], {}, {}
    with tempfile.TemporaryDirectory() as name, bar("minutes") as report:
        folder, out = pathlib.Path(name), sys.stdout
        while time.time() - begun < 60 * args.minutes:
            asked = everything(rng, folder)
            for what in asked if not args.only else args.only:
                start = time.perf_counter()
                with open(folder / "said", "w") as sys.stdout:  # what commands print
                    asked[what]()
                sys.stdout = out
                calls[what] = calls.get(what, 0) + 1
                spent[what] = spent.get(what, 0.0) + time.perf_counter() - start
            gc.collect()
            held.append((time.time() - begun, resident()))
            report(int((time.time() - begun) / 60), int(args.minutes), f"{held[-1][1]:.0f} MiB")
    memory = [m for _, m in held]
    thirds = [np.median(part) for part in np.array_split(memory, 3)]
    print(markdown(["call", "times", "mean [s]"], [[k, n, f"{spent[k] / n:.3f}"] for k, n in calls.items()]))
    rows = [[f"{t / 60:.0f}", f"{m:.0f}"] for t, m in held[:: max(len(held) // 15, 1)]]
    print(markdown(["minute", "resident [MiB]"], rows))
    flat = thirds[2] <= GROWTH * thirds[1]
    print(f"{len(held)} rounds; medians of the thirds {', '.join(f'{m:.0f}' for m in thirds)} MiB: "
          f"{'flat' if flat else 'growing'}.")  # fmt: skip
    sys.exit(not flat)


if __name__ == "__main__":
    main()
