"""`python -m tests.bench.engine [ROW ...]`: the rows of docs/speed.md on one core, all in one run, in turn (4 minutes).

By CPU time, Pinocchio C++ (`pinocchio_cpp.py`), frax and a textbook in JAX among them. Each row is a call that is
repeated; all ends of the pose loop must agree first, to 1e-12 or 1e-6; a ratio is taken within a round, and the table
has the medians. The first call is that with tracing and the C compiler; rows that agree in what they run share it.
"""

import argparse
import functools
import statistics

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.integrate.method import evaluations_per_step
from tests.bench import cases, textbook, timing
from tests.bench.cases import case, panda_matrices
from tests.bench.pinocchio_cpp import PinocchioCpp

LANES, STEPS, FEW = 16384, 50, 4096
OF_GRADIENT = 20  # steps
SETTINGS = dict(alpha=cases.ALPHA, damping=cases.DAMPING, Ts=cases.TS)
TOLERANCE = {"float64": 1e-12, "float32": 1e-6}


@functools.cache
def given(dtype="float32", lanes=LANES):
    """Starts and targets."""
    return tuple(cases.inputs(case(), lanes, dtype).values())


def end(name, method="EE", stage=None, dtype="float32", of=case):
    """A row: evaluations a second of loops of which the end alone is kept."""
    stage = stage or ck.picard(5)

    def one(q0, position, rotation):
        return cases.end(of().law, ck.hold(position, rotation), q0, cases.TS, STEPS, method, stage)

    def make():
        return functools.partial(ck.lanes(one, cores=1), *given(dtype))

    return name, make, LANES * STEPS * evaluations_per_step(ck.METHODS[method], stage, 7), dtype


def solved(what, **options):
    """What of a run, as a function of one lane."""

    def one(q0, position, rotation):
        return what(ck.solve(case().law, ck.hold(position, rotation), q0, cases.TS, STEPS, "EE", **options))

    return one


def loss(alpha, *lane):
    return cases.tracking_loss(case(), OF_GRADIENT)(alpha, *lane)


def value(*lane):
    return loss(jnp.float32(cases.ALPHA), *lane)


def forward(*lane):
    return jax.jvp(lambda a: loss(a, *lane), (jnp.float32(cases.ALPHA),), (jnp.float32(1),))


def by_lanes(fn):
    return ck.lanes(fn, cores=1)


def by_vmap(fn):
    return jax.jit(jax.vmap(fn))


def row(name, fn, steps, by=by_lanes):
    """A row: evaluations a second of a function of one lane, by `lanes` or in a jit of one's own."""
    return name, lambda: functools.partial(by(fn), *given(lanes=FEW)), FEW * steps, "float32"


def alone(dtype):
    """A row: one warm solve from Python."""

    def make():
        q0, position, rotation = (v[0] for v in given(dtype))
        return functools.partial(ck.solve, case().law, ck.hold(position, rotation), q0, cases.TS, STEPS, "EE")

    return f"one solve from Python, {dtype}", make, STEPS, dtype


def pinocchio(dtype="float64", lanes=1024):
    """A row."""

    def make():
        solver = PinocchioCpp(*panda_matrices(), dtype)
        return functools.partial(solver.run, *given(dtype, lanes), N=STEPS, M=None, **SETTINGS)

    return f"Pinocchio C++, {dtype}", make, lanes * STEPS, dtype


def in_jax(name, pose_and_jacobian, steps=2):
    """A row: another library's kinematics and a textbook's step under vmap."""

    def make():
        at = pose_and_jacobian()

        def one(q, position, rotation):
            step = functools.partial(textbook.step, at, position=position, rotation=rotation, **SETTINGS)
            return jax.lax.fori_loop(0, steps, lambda _, q: step(q), q)

        return functools.partial(by_vmap(one), *(v.astype("float32") for v in given(lanes=FEW)))

    return name, make, FEW * steps, "float32"


def frax():
    from frax.assets import FRANKA_ASSETS_DIR
    from frax.core.manipulator import Manipulator

    robot = Manipulator(FRANKA_ASSETS_DIR / "panda.urdf", ee_offset=panda_matrices()[1])
    return lambda q: robot.velocity_control_matrices(q)[::-1]


last = lambda run: run.q[-1]  # noqa: E731
ROWS = [
    pinocchio(),
    pinocchio("float32"),
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
    row("drive of two samples and a lag", solved(last, drive=ck.Drive(delay=2, lag=0.05)), STEPS),
    row("EE, q of all instants", solved(lambda run: run.q), STEPS),
    row("EE, the whole record", solved(lambda run: run), STEPS),
    row("EE, q[-1], jit(vmap)", solved(last), STEPS, by_vmap),
    row("value", value, OF_GRADIENT),
    row("value and gradient, forward", forward, OF_GRADIENT),
    row("value and gradient, reverse", jax.value_and_grad(value), OF_GRADIENT),
    row("value and gradient, reverse, jit(vmap)", jax.value_and_grad(value), OF_GRADIENT, by_vmap),
    alone("float32"),
    alone("float64"),
    in_jax("textbook JAX", lambda: textbook.panda(*panda_matrices())),
    in_jax("frax", frax),
]


def agree():
    """Nothing is timed unless cnclik's ends are Pinocchio's."""
    for dtype, limit in TOLERANCE.items():
        with jax.enable_x64(dtype == "float64"):
            wanted, found = (make()()[0] for _, make, *_ in (pinocchio(dtype, LANES), end("EE", dtype=dtype)))
        off = float(np.abs(np.asarray(found) - wanted).max())
        assert off < limit, f"EE differs from Pinocchio by {off:g} rad in {dtype}"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench.engine", description=__doc__.splitlines()[0])
    parser.add_argument("row", nargs="*", help="words in the names of the rows that are measured; by default all")
    parser.add_argument("--rounds", type=int, default=9)
    args = parser.parse_args()
    agree()
    rows = [r for r in ROWS if not args.row or any(word in r[0] for word in args.row)]
    calls, first = {}, {}
    for name, make, _, dtype in rows:
        with jax.enable_x64(dtype == "float64"):
            try:
                calls[name] = make()
            except ModuleNotFoundError as error:
                print(f"{name}: {error}", flush=True)
                continue
            first[name] = timing.first(calls[name])
        print(f"{name}: first {first[name]:.2f} s", flush=True)
    rows, taken = [r for r in rows if r[0] in calls], {name: [] for name in calls}
    for _ in range(args.rounds):
        for name, _, count, dtype in rows:
            with jax.enable_x64(dtype == "float64"):
                taken[name].append(timing.cpu(calls[name], least=0.05) / count)
    print("| what | M evaluations/s | times the first row | first call [s] |\n| --- | ---: | ---: | ---: |")
    for name, *_ in rows:
        ratio = timing.ratio(taken[rows[0][0]], taken[name])
        print(f"| {name} | {1e-6 / statistics.median(taken[name]):.3g} | {ratio:.3g} | {first[name]:.1f} |")


if __name__ == "__main__":
    timing.one_core()
    main()
