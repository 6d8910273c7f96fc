"""What each trick behind `lanes` is worth: the Panda's loop with one of them off at a time, in turn, on one core.

A trick is turned off by replacing, in a process of its own, the one function that does it.
"""

import functools
import json
import os
import subprocess
import sys

import jax
import numpy as np

import cnclik as ck
import cnclik.hints as hints
from cnclik.bench import loops
from cnclik.bench import timing as bench
from cnclik.engine import plan
from cnclik.engine.native import native


def all_on():
    pass


def by_xla():
    plan._engine = jax.make_user_context(default_value="xla")


def without_hints():
    by_xla()
    hints._context = jax.make_user_context(default_value=False)  # as CNCLIK_HINTS=0 does, read when cnclik is imported


def without_wide_vectors():
    by_xla()
    sys.modules["cnclik.integrate.lanes"].OPTIONS = {}  # not the function of that name


def by_vmap():
    ck.lanes = lambda fn, cores: jax.jit(jax.vmap(native(fn)))


def without_any():
    without_hints()
    by_vmap()


def quick():
    by_xla()
    ck.lanes = functools.partial(ck.lanes, quick=True)


TRICKS = {
    "everything on": all_on,
    "jit(vmap), as C within": by_vmap,
    "by XLA": by_xla,
    "by XLA, hints off": without_hints,
    "by XLA, without 512-bit vectors": without_wide_vectors,
    "without any: jit(vmap) by XLA, hints off": without_any,
    "by XLA, lanes(quick=True)": quick,
}


# --- a process per trick ------------------------------------------------------------------------------


def work(name, dtype, batch) -> None:
    """Compile the loop with one trick off, then time a run per line on stdin."""
    bench.hold_to(1)
    TRICKS[name]()
    case = loops.ROBOTS["panda"]()
    arrays = tuple(loops.inputs(case, batch, dtype).values())
    batched = ck.lanes(loops.loop(case, bench.STEPS, ck.EE, ck.picard(5)), cores=1)
    run = functools.partial(batched, *arrays)
    first = bench.clock(run)
    second = bench.clock(run)
    q, _ = run()
    print(json.dumps([first - second, np.asarray(q[:64], float).tolist()]), flush=True)
    for _ in sys.stdin:
        print(bench.clock(run), flush=True)


def compare(rounds=5, batch=65536, dtype="float32", say=lambda text: None) -> list[dict]:
    """Records with name, evaluations_per_second, spread, compile_s, difference (of q, from everything on)."""
    environment = dict(os.environ) | {"JAX_PLATFORMS": "cpu", "JAX_ENABLE_X64": str(int(dtype == "float64"))}
    workers, records, reference = {}, [], None
    try:
        for name in TRICKS:
            command = [sys.executable, "-m", "tests.bench.tricks", name, dtype, str(batch)]
            pipe = subprocess.PIPE
            workers[name] = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)
            compile_s, q = json.loads(workers[name].stdout.readline())
            reference = reference or q
            found = float(np.abs(np.subtract(q, reference)).max())
            if not found <= (1e-12 if dtype == "float64" else 2e-6):
                raise SystemExit(f"{name} differs by {found:.3g}: nothing is timed.")
            say(f"{name}: equal to {found:.1e}, compiled in {compile_s:.1f} s")
            records.append({"name": name, "dtype": dtype, "batch": batch, "compile_s": compile_s, "difference": found})
        taken = {name: [] for name in workers}
        for _ in range(rounds):
            for name, worker in workers.items():
                worker.stdin.write("run\n")
                worker.stdin.flush()
                taken[name].append(float(worker.stdout.readline()))
    finally:
        for worker in workers.values():
            worker.stdin.close()
            worker.wait()
    for record in records:
        t = bench.timing(taken[record["name"]])
        record |= {"evaluations_per_second": batch * bench.STEPS / t.median, "spread": t.spread}
        record["seconds"] = [s / (batch * bench.STEPS) for s in taken[record["name"]]]
    return records


if __name__ == "__main__":
    work(sys.argv[1], sys.argv[2], int(sys.argv[3]))
