"""All calls in one process, always with new robots, paths and functions: is memory flat?

So that minutes show what a day does, caches of programs hold 16 in place of more.
"""

import contextlib
import gc
import io
import pathlib
import resource
import zlib

import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik import cache
from cnclik.cli import main
from cnclik.measure.files import save_netcdf

CIRCLE = "--reference circle --N 20 --no-figures --overwrite"


def everything(rng, folder):
    """Ask for all that users ask for, once, of a robot of Python numbers as in an example."""
    n, Ts, gain = int(rng.integers(2, 5)), 0.01, float(rng.uniform(0.5, 2))
    arm = ck.planar_arm([float(v) for v in rng.uniform(0.2, 1.0, n)])
    inverse = ck.damped(0.05) if rng.random() < 0.5 else ck.pseudoinverse()
    law = ck.Law(arm, ck.position("xy"), alpha=float(rng.uniform(1, 10)), inverse=inverse)
    q = rng.uniform(0.3, 1.2, n)
    tip, radius = np.asarray(ck.forward(arm, q).position)[:2], float(rng.uniform(0.01, 0.1))
    reference = ck.hold(tip + 0.05) if rng.random() < 0.5 else ck.circle(tip, radius=radius, period=2.0)
    method = ("EE", "CN", "EXP-MIDPOINT", "RK4")[rng.integers(4)]
    run = ck.solve(law, reference, q, Ts, 20, method)
    ck.step(law, reference, q, 0.0, Ts, method)
    ck.lanes(lambda q0: ck.solve(law, reference, q0, Ts, 5, "EE").e[-1] * gain)(np.tile(q, (8, 1)))
    drive = ck.Drive(delay=int(rng.integers(0, 9)), lag=gain / 100)
    ck.solve(law, reference, q, Ts, 20, "EE", drive=drive)
    ck.gains(Ts=Ts, drive=drive)
    ck.verdict(law, reference, run, method=method)
    ck.reach(arm, np.append(run.x[-1], 0.0), task=law.task)
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
    plt.switch_backend("agg")
    cache.KEPT_PROGRAMS = cache.MOST_PROGRAMS = 16
    rng, held = np.random.default_rng(zlib.crc32(str(seed).encode())), []
    for k in range(10**9):
        everything(rng, folder)
        gc.collect()
        held.append(resident())
        _, second, third = (np.median(part) for part in np.array_split(held, 3)) if k >= 48 else (0, 1, 0)
        grows = f"the medians of the last thirds of {k} rounds are {second:.0f} and {third:.0f} MiB"
        yield f"round {k}, {held[-1]:.0f} MiB", grows * bool(third > 1.05 * second)
