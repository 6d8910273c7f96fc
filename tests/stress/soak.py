"""All calls in one process, always with new robots: is memory flat?

Every round has a robot, a path and functions that nobody has asked for before, as literals where that is how users
write them. What the process holds is looked at after each round. So that minutes show what a day does, caches of
programs hold 16 in place of more.
"""

import contextlib
import gc
import io
import pathlib
import resource
import zlib

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik import cache
from cnclik.cli import main
from cnclik.measure.files import save_netcdf

GROWTH, LEAST = 1.05, 30  # of the median of the last third over that of the second; rounds before it is looked at
CIRCLE = "--reference circle --N 20 --no-figures --overwrite"


def draw(rng):
    """A robot, its law, a path, a start: of Python numbers, as in an example."""
    n = int(rng.integers(2, 5))
    chain = ck.planar_arm([float(v) for v in rng.uniform(0.2, 1.0, n)])
    inverse = ck.damped(0.05) if rng.random() < 0.5 else ck.pseudoinverse()
    law = ck.Law(chain, ck.position("xy"), alpha=float(rng.uniform(1, 10)), inverse=inverse)
    q = rng.uniform(0.3, 1.2, n)
    tip, radius = np.asarray(ck.forward(chain, q).position)[:2], float(rng.uniform(0.01, 0.1))
    return law, ck.hold(tip + 0.05) if rng.random() < 0.5 else ck.circle(tip, radius=radius, period=2.0), q


def everything(rng, folder):
    """Ask for all that users ask for, once."""
    law, reference, q = draw(rng)
    Ts, gain = 0.01, float(rng.uniform(0.5, 2))
    method = ("EE", "CN", "EXP-MIDPOINT", "RK4")[rng.integers(4)]
    run = ck.solve(law, reference, q, Ts, 20, method)
    ck.step(law, reference, q, 0.0, Ts, method)
    ck.lanes(lambda q0: ck.solve(law, reference, q0, Ts, 5, "EE").e[-1] * gain)(np.tile(q, (8, 1)))
    drive = ck.Drive(delay=int(rng.integers(0, 9)), lag=gain / 100)
    ck.solve(law, reference, q, Ts, 20, "EE", drive=drive)
    ck.gains(Ts=Ts, drive=drive)
    ck.verdict(law, reference, run, method=method)
    ck.reach(law.chain, np.append(run.x[-1], 0.0), task=law.task)
    ck.tune(law, reference, q, Ts=Ts, N=10, steps=3)
    plt.close(ck.plot(run, law))
    save_netcdf(ck.measure.to_dataset(run, law), folder / "run.nc")
    lengths = ",".join(f"{v:.6f}" for v in rng.uniform(0.2, 1.0, 3))
    with contextlib.redirect_stdout(io.StringIO()):
        main(["solve", f"planar:{lengths}", *CIRCLE.split(), "--out", str(folder / "out")])


def resident() -> float:
    """What the process holds now [MiB]."""
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 2**20


def trials(seed, folder):
    """(round, what is wrong or nothing), without end."""
    cache.KEPT_PROGRAMS = cache.MOST_PROGRAMS = 16
    rng, held = np.random.default_rng(zlib.crc32(str(seed).encode())), []
    for k in range(10**9):
        everything(rng, folder)
        gc.collect()
        held.append(resident())
        _, second, third = (float(np.median(part)) for part in np.array_split(held, 3)) if k >= LEAST else (0, 1, 0)
        grows = f"the medians of the last thirds of {k} rounds are {second:.0f} and {third:.0f} MiB"
        yield f"round {k}, {held[-1]:.0f} MiB", grows if third > GROWTH * second else ""
