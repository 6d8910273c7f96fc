"""What each trick behind `lanes` is worth: the Panda's loop with one of them off at a time, in turn, on one core.

A trick is turned off by replacing, in a process of its own, the one function that does it.
"""

import contextlib
import functools
import json
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
import cnclik.hints as hints
from cnclik.bench import loops
from cnclik.bench import timing as bench


def all_on():
    pass


def without_one_function():
    _drop_metadata(lambda given: "xla_cpu_small_call" in given)


def without_opaque_stages():
    _drop_metadata(lambda given: given == {"inlineable": "false"})


def without_hints():
    # As CNCLIK_HINTS=0 does, which is read when cnclik is imported.
    hints._context = jax.make_user_context(default_value=False)


def without_own_sines():
    frames = sys.modules["cnclik.robot.frames"]  # not the function of that name
    assert hasattr(frames, "sincos")
    frames.sincos = hints.opaque(lambda angles: (tuple(map(jnp.sin, angles)), tuple(map(jnp.cos, angles))))


def without_wide_vectors():
    sys.modules["cnclik.integrate.lanes"].OPTIONS = {}


def without_tiles():
    ck.lanes = lambda fn, cores: jax.jit(jax.vmap(fn))


def without_any():
    without_own_sines()
    without_hints()
    without_tiles()


def quick():
    ck.lanes = functools.partial(ck.lanes, quick=True)


def quick_and_rolled():
    quick()
    hints._form = jax.make_user_context(default_value="rolled")


TRICKS = {
    "everything on": all_on,
    "without one native function per tile": without_one_function,
    "without opaque stages": without_opaque_stages,
    "without both (hints off)": without_hints,
    "library sine and cosine": without_own_sines,
    "without 512-bit vectors": without_wide_vectors,
    "without tiles (one vmap)": without_tiles,
    "without any: jit(vmap), hints off, library sine": without_any,
    "lanes(quick=True)": quick,
    "lanes(quick=True), rolled": quick_and_rolled,
}


def _drop_metadata(which):
    original = hints.set_xla_metadata
    hints.set_xla_metadata = lambda **given: contextlib.nullcontext() if which(given) else original(**given)


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
