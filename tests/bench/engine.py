"""`python -m tests.bench.engine [ROW ...]`: the rows of docs/speed.md on one core, all in one run, in turn (3 minutes).

By CPU time, Pinocchio C++ (`pinocchio_cpp.py`) among them. Each row is a call that is repeated; a ratio is taken within
a round, and the table has the medians. The first call is that with tracing and the C compiler; rows that agree in what
they run share the library.
"""

import argparse
import dataclasses
import functools
import os
import resource
import statistics
import time

import jax
import jax.numpy as jnp

import cnclik as ck
from cnclik.integrate.method import evaluations_per_step
from tests.bench import cases

LANES, STEPS, FEW = 16384, 50, 4096
OF_GRADIENT = 20  # steps


def seconds() -> float:
    """CPU time of this process, and of those it has waited for."""
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def case(**changes):
    """The Panda's pose loop, damped least squares, with some of its law changed."""
    made = cases.ROBOTS["panda"]()
    return made._replace(law=dataclasses.replace(made.law, **changes))


@functools.cache
def given(dtype="float32", lanes=LANES):
    """Starts and targets."""
    return tuple(cases.inputs(case(), lanes, dtype).values())


def end(name, method="EE", stage=None, dtype="float32", of=case):
    """A row: evaluations a second of loops of which the end alone is kept."""
    stage = stage or ck.picard(5)

    def make():
        return functools.partial(ck.lanes(cases.loop(of(), STEPS, ck.METHODS[method], stage), cores=1), *given(dtype))

    return name, make, LANES * STEPS * evaluations_per_step(ck.METHODS[method], stage, 7), dtype


def last(run):
    return run.q[-1]


def solved(what, **options):
    """What of a run, as a function of one lane."""

    def one(q0, position, rotation):
        return what(ck.solve(case().law, ck.hold(position, rotation), q0, cases.TS, STEPS, "EE", **options))

    return one


def loss(alpha, *lane):
    return cases.tracking_loss(case(), OF_GRADIENT, ck.EE, ck.picard(5))(alpha, *lane)


def value(*lane):
    return loss(jnp.float32(cases.ALPHA), *lane)


def forward(*lane):
    return jax.jvp(lambda a: loss(a, *lane), (jnp.float32(cases.ALPHA),), (jnp.float32(1),))


def by_lanes(fn):
    return ck.lanes(fn, cores=1)


def by_vmap(fn):
    return jax.jit(jax.vmap(fn))


def row(name, fn, lanes, steps, by=by_lanes):
    """A row: evaluations a second of a function of one lane, by `lanes` or in a jit of one's own."""
    return name, lambda: functools.partial(by(fn), *given(lanes=lanes)), lanes * steps, "float32"


def pinocchio(dtype="float64"):
    """A row."""

    def make():
        from tests.bench.peers import panda
        from tests.bench.pinocchio_cpp import PinocchioCpp

        solver, some = PinocchioCpp(*panda(), dtype), given(dtype, 1024)
        return lambda: solver.run(*some, alpha=cases.ALPHA, damping=cases.DAMPING, Ts=cases.TS, N=STEPS, M=None)

    return f"Pinocchio C++, {dtype}", make, 1024 * STEPS, dtype


DRIVEN = {"delay": 2, "lag": 0.05}
ROWS = [
    pinocchio(),
    end("EE"),
    end("EE, float64", dtype="float64"),
    end("CN, picard(5)", "CN"),
    end("EXP-MIDPOINT", "EXP-MIDPOINT"),
    end("RK4", "RK4"),
    end("TRAPEZOID, chord(2)", "TRAPEZOID", ck.chord(2)),
    end("EE, J#", of=lambda: case(inverse=ck.pseudoinverse())),
    end("bounded", of=lambda: case(limits=ck.bounded())),
    end("velocity scaling", of=lambda: case(limits=ck.velocity_scaling())),
    end("posture, J#", of=lambda: case(inverse=ck.pseudoinverse(), null_velocity=ck.posture(case().posture))),
    row("drive of two samples and a lag", solved(last, drive=ck.Drive(**DRIVEN)), FEW, STEPS),
    row("EE, solve(...).q[-1]", solved(last), FEW, STEPS),
    row("EE, q of all instants", solved(lambda run: run.q), FEW, STEPS),
    row("EE, the whole record", solved(lambda run: run), FEW, STEPS),
    row("EE, q[-1], jit(vmap)", solved(last), FEW, STEPS, by_vmap),
    row("EE, q of all instants, jit(vmap)", solved(lambda run: run.q), FEW, STEPS, by_vmap),
    row("EE, the whole record, jit(vmap)", solved(lambda run: run), FEW, STEPS, by_vmap),
    row("value", value, FEW, OF_GRADIENT),
    row("value and gradient, forward", forward, FEW, OF_GRADIENT),
    row("value and gradient, reverse", jax.value_and_grad(value), FEW, OF_GRADIENT),
    row("value and gradient, reverse, jit(vmap)", jax.value_and_grad(value), FEW, OF_GRADIENT, by_vmap),
]


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engine", description=__doc__.splitlines()[0])
    parser.add_argument("row", nargs="*", help="words in the names of the rows that are measured; by default all")
    parser.add_argument("--rounds", type=int, default=9)
    args = parser.parse_args()
    rows = [r for r in ROWS if not args.row or any(word in r[0] for word in args.row)]
    calls, first, taken = {}, {}, {}
    for name, make, _, dtype in rows:
        with jax.enable_x64(dtype == "float64"):
            begun = seconds()
            calls[name] = make()
            jax.block_until_ready(calls[name]())
            first[name] = seconds() - begun
        print(f"{name}: first {first[name]:.2f} s", flush=True)
    for _ in range(args.rounds):
        for name, _, _, dtype in rows:
            with jax.enable_x64(dtype == "float64"):
                begun = time.process_time()
                jax.block_until_ready(calls[name]())
                taken.setdefault(name, []).append(time.process_time() - begun)
    print("| what | M evaluations/s | times Pinocchio | first call [s] |\n| --- | ---: | ---: | ---: |")
    per = {name: [t / count for t in taken[name]] for name, _, count, _ in rows}
    base = per[rows[0][0]]
    for name, *_ in rows:
        ratio = statistics.median(b / t for b, t in zip(base, per[name], strict=True))
        print(f"| {name} | {1e-6 / statistics.median(per[name]):.3g} | {ratio:.3g} | {first[name]:.1f} |")


if __name__ == "__main__":
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # before JAX counts the cores
    main()
