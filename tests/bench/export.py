"""`python -m tests.bench.export`: the exported step beside Pinocchio C++ and JAX, its worst call, its numbers on ARM.

Into results/export (5 minutes); docs/export.md shows the table. Needs g++ and the extra `bench`; the numbers on
ARM need arm-linux-gnueabihf-gcc and qemu-arm (aarch64 likewise), from Debian. `budget.py` has its size there.
"""

import argparse
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import jax
import matplotlib.pyplot as plt
import numpy as np

import cnclik as ck
from cnclik import markup
from cnclik.measure.files import markdown
from cnclik.show import style
from cnclik.show.output import draw
from tests.bench import cases, document, peers
from tests.bench import export_lines as export
from tests.bench.pinocchio_cpp import PinocchioCpp

RESULTS = pathlib.Path(__file__).parents[2] / "results" / "export"
LANES = 8192  # of Pinocchio's batches


def pinocchio(dtype):
    """(seconds of a step in a row, seconds of a whole batch of BATCH) by Pinocchio C++."""
    solver = PinocchioCpp(*peers.panda(), dtype)
    given = peers.given(dtype)
    settings = dict(alpha=cases.ALPHA, Ts=cases.TS, damping=cases.DAMPING, M=None)

    def step(count=4000):
        return export.seconds(lambda: solver.run(*(v[:1] for v in given), N=count, **settings)) / count

    def batch():
        part = [v[:LANES] for v in given]
        return export.seconds(lambda: solver.run(*part, N=export.STEPS, **settings)) * export.BATCH / LANES

    return step, batch


def histogram(calls):
    """Time of each of many calls on one core."""
    calls = np.asarray(calls)
    fig, axes = plt.subplots(figsize=(style.PAGE, 2.4))
    edges = np.geomspace(max(calls.min(), 1) * 0.95, calls.max() * 1.05, 120)
    axes.hist(calls / 1e3, bins=edges / 1e3, color=markup.BLUE)
    middle = np.median(calls) / 1e3
    marks = ((middle, "median", "right"), (np.percentile(calls, 99.9) / 1e3, "99.9 %", "left"))
    for value, word, side in (*marks, (calls.max() / 1e3, "worst", "right")):
        axes.axvline(value, **style.GUIDE)
        where = dict(xycoords=("data", "axes fraction"), va="bottom", ha=side)
        axes.annotate(f"{word} {value:.4g} µs", (value, 1.02), **where, **style.NOTE)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="time of a call, the clock's own in it [µs]",
        ylabel=f"calls of {len(calls):,}",
    )
    return fig


def on_arm(folder) -> dict:
    """Whether ARM gives the same numbers (under qemu)."""
    law, found = cases.ROBOTS["panda"]().law, {}
    for runtime, name in ((None, "all parameters at run time"), ((), "all compiled in")):
        at = ck.export.c(
            law, out=folder / f"arm{runtime is None}", method="EE", dtype="float", runtime=runtime, batch=True
        )
        for cpu in ("arm-linux-gnueabihf", "aarch64-linux-gnu"):
            emulator = "qemu-" + cpu.split("-")[0]
            if shutil.which(f"{cpu}-gcc") and shutil.which(emulator):
                _run(f"{cpu}-gcc -std=c99 -O2 -ffp-contract=off -static clik_step.c example.c -lm -o {cpu}", at)
                _run(f"{cpu}-gcc -std=c99 -O2 -Wall -Wextra -Werror -pedantic -c clik_step_batch.c -o batch.o", at)
                found[f"{emulator}, {name}"] = {"example": _run(f"{emulator} {at / cpu}", at).strip()}
    return found


def _run(line, folder) -> str:
    done = subprocess.run(line, shell=True, cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{line}: {done.stdout} {done.stderr}")
    return done.stdout


def table(found) -> str:
    """What was to be reached, and what was measured."""
    steps, us = found["steps"], found["steps"]["microseconds"]
    rounds = steps["rounds"]

    def ratio(a, b):
        return float(np.median(np.array(rounds[a]) / np.array(rounds[b])))

    rows = [
        ("Panda pose step, damped, EE, float64, from C, against Pinocchio C++", "at least 2.5×",
         f"{ratio('Pinocchio C++', 'C from C'):.3g}× ({us['C from C']:.3g} and {us['Pinocchio C++']:.3g} µs)"),
        ("the same with the gain and its like compiled in, and a target at rest", "",
         f"{ratio('Pinocchio C++', 'C from C, parameters compiled in'):.3g}×"),
        ("the first called from Python with all its arguments", "under 4 µs",
         f"{us['C from Python']:.3g} µs; with the joints alone {us['C from Python, joints alone']:.3g} µs; "
         f"JAX's step {us['JAX step']:.3g} µs"),
        ("export and compile", "under 2 s", f"{steps['export_s'] + steps['compile_s']:.2g} s"),
    ]  # fmt: skip
    for b, (least_lanes, least_peer) in zip(found["batches"], ((1.4, 18), (1.3, 9)), strict=True):
        t, s = b["times_as_fast"], b["steps_per_second"]
        rows.append((f"batch of 65,536 loops of 50 steps, {b['dtype']}, one core, against `lanes`", f"{least_lanes}×",
                     f"{t['lanes']:.3g}× ({s['C'] / 1e6:.3g} and {s['lanes'] / 1e6:.3g} M steps/s)"))  # fmt: skip
        rows.append((f"the same against Pinocchio C++ ({b['dtype']})", f"{least_peer}× without AVX-512",
                     f"{t['Pinocchio C++']:.3g}×"))  # fmt: skip
        built = f"{b['compile_s']:.2g} s (`lanes`: {b['lanes_compile_s']:.2g} s)"
        rows.append((f"its compile time, {b['dtype']}", "under 2 s", built))
    calls = np.asarray(found["calls"])
    worst = f"{calls.max() / np.median(calls):.3g}× ({calls.max() / 1e3:.3g} and {np.median(calls) / 1e3:.3g} µs)"
    rows.append(("worst of 1e6 calls over their median, on one core", "reported", worst))
    for name, value in found["arm"].items():
        rows.append((name, "reported", value["example"]))
    return markdown(("what", "to reach", "measured"), rows, left=3)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.export", description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=export.ROUNDS)
    parser.add_argument("--out", type=pathlib.Path, default=RESULTS)
    args = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    by_type = {dtype: pinocchio(dtype) for dtype in ("float32", "float64")}
    others = {"step": {"Pinocchio C++": by_type["float64"][0]}}
    others |= {dtype: {"Pinocchio C++": batch} for dtype, (_, batch) in by_type.items()}
    found = export.measure(args.rounds, others=others)
    with tempfile.TemporaryDirectory() as folder:
        found["arm"] = on_arm(pathlib.Path(folder))
    calls = found["steps"].pop("calls")
    args.out.mkdir(parents=True, exist_ok=True)
    draw({"calls.png": (lambda: histogram(calls), {"Title": "time of each of many calls"})}, args.out)
    found |= {"machine": document.machine(), "measured": time.strftime("%Y-%m-%d"), "load": os.getloadavg()[0]}
    found["calls"] = [int(v) for v in np.percentile(calls, [*np.linspace(0, 100, 201), 99.9, 99.99])]
    (args.out / "export.json").write_text(json.dumps(found, indent=1) + "\n")
    text = table(found)
    page = f"# What the exported step does\n\n`python -m tests.bench.export` on {_machine(found)}:\n\n{text}\n"
    page += "![Time of each of a million calls](calls.png)\n"
    (args.out / "README.md").write_text(page, encoding="utf-8")
    print(text, file=sys.stderr)


def _machine(found) -> str:
    return "{processor}, {cores} cores, {vectors}, {system}, JAX {jax}, load {load}".format(**found["machine"])


if __name__ == "__main__":
    main()
