"""`python -m tests.bench.gpu [ROW ...]`: batches on a GPU beside the plain source, in one run (4 minutes).

Each row is a batch of loops on the device, its inputs there too: by `lanes`, by the user's own `jit(vmap)`, and by that
of the source as it is (`use_engine("plain")`). Times are wall times of calls that are waited for; medians. All three
are compared first with the same loops on a CPU.
"""

import argparse
import dataclasses
import functools
import itertools
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.integrate.method import evaluations_per_step
from cnclik.measure.files import markdown
from tests.bench import cases, timing
from tests.bench.engine import OF_GRADIENT, STEPS, case, forward, value

LANES, MANY = 1 << 16, (10_000, 100_000, 1_000_000, 10_000_000)
SECONDS, FEW = 0.4, 256  # of repeated runs; lanes that are compared
WAYS = ("lanes", "jit(vmap)", "plain")


@dataclasses.dataclass(frozen=True)
class Row:
    """Loops side by side: `fn` of one lane, `evaluations` of f in it; `inputs(batch, dtype)` its arguments."""

    name: str
    fn: object
    inputs: object
    evaluations: int
    batch: int = LANES
    dtype: str = "float32"


def end(name, method="EE", stage=None, batch=LANES, dtype="float32", **changes):
    """A row of the Panda's pose loop, of which the end alone is kept."""
    arm, stage = case(**changes), stage or ck.picard(5)
    each = STEPS * evaluations_per_step(ck.METHODS[method], stage, 7)

    def one(q0, position, rotation):
        return cases.end(arm.law, ck.hold(position, rotation), q0, cases.TS, STEPS, method, stage)[0]

    return Row(name, one, functools.partial(cases.inputs, arm), each, batch, dtype)


def two_arms(name):
    """A row of two Pandas on one turning base, the poses of both hands in one stack, damped: 12 rows, 15 joints."""
    arm = case()
    base = ck.planar_arm([0.1])
    left = ck.join(base, arm.law.chain, prefix="left_", transform=(0.0, 0.4, 0.0), keep=True)
    robot = ck.join(left, arm.law.chain, at="tip", prefix="right_", transform=(0.0, -0.4, 0.0))
    task = ck.stack(left=ck.pose(tip="left_tip"), right=ck.pose(tip="right_tip"))
    law = ck.Law(robot, task, alpha=cases.ALPHA, inverse=ck.damped(cases.DAMPING))

    def targets(q):
        return [ck.forward(robot, q, tip=tip) for tip in ("left_tip", "right_tip")]

    def inputs(batch, dtype):
        draw = np.random.default_rng(0)
        q0, goals = (np.array((0.0, *arm.posture * 2)) + arm.spread * draw.uniform(-1, 1, (batch, 15)) for _ in "ab")
        with jax.enable_x64(True):
            left, right = jax.jit(jax.vmap(targets))(goals)
        found = {"q0": q0, "p": left.position, "r": left.rotation, "p_right": right.position, "r_right": right.rotation}
        return {name: np.asarray(v, dtype) for name, v in found.items()}

    def one(q0, p, r, p_right, r_right):
        both = ck.references(left=ck.hold(p, r), right=ck.hold(p_right, r_right))
        return ck.solve(law, both, q0, cases.TS, STEPS, ck.METHODS["EE"]).q[-1]

    return Row(name, one, inputs, STEPS)


def rows() -> list[Row]:
    """All rows."""
    arm = case()
    inputs, reverse = functools.partial(cases.inputs, arm), jax.value_and_grad(value)
    return [
        end("EE"),
        end("EE, float64", dtype="float64"),
        end("CN, picard(5)", "CN"),
        end("EXP-MIDPOINT", "EXP-MIDPOINT"),
        end("RK4", "RK4"),
        end("TRAPEZOID, chord(2)", "TRAPEZOID", ck.chord(2)),
        end("EE, J#", inverse=ck.pseudoinverse()),
        end("EE, bounded", limits=ck.bounded()),
        end("EE, posture, J#", inverse=ck.pseudoinverse(), null_velocity=ck.posture(arm.posture)),
        two_arms("EE, two arms, 12 rows of 15 joints"),
        Row("value", value, inputs, OF_GRADIENT),
        Row("value and gradient, forward", forward, inputs, OF_GRADIENT),
        Row("value and gradient, reverse", reverse, inputs, OF_GRADIENT),
        *(end(f"EE, {count:,} lanes", batch=count) for count in MANY),
        end("CN, 1,000,000 lanes", "CN", batch=1_000_000),
    ]


def arguments(row):
    return [jnp.asarray(v) for v in row.inputs(row.batch, row.dtype).values()]


def measured(row, way) -> dict:
    """First call [s], median time of one [s], evaluations a second, by one way; values of the first lanes."""
    given = jax.block_until_ready(arguments(row))
    with ck.use_engine("plain" if way == "plain" else None):
        call = ck.lanes(row.fn) if way == "lanes" else jax.jit(jax.vmap(row.fn))
        begun = time.perf_counter()
        found = jax.block_until_ready(call(*given))
        first = time.perf_counter() - begun
        run = timing.cpu(lambda: call(*given), SECONDS, clock=time.perf_counter)
    values = [np.asarray(leaf[:FEW]).tolist() for leaf in jax.tree.leaves(found)]
    return {"first_s": first, "run_s": run, "per_s": row.batch * row.evaluations / run, "values": values}


def on_cpu(names) -> dict:
    """The first lanes of rows, in this process's CPU."""
    found = {}
    for row in rows():
        if row.name in names:
            with jax.enable_x64(row.dtype == "float64"):
                few = [v[:FEW] for v in arguments(row)]
                got = jax.block_until_ready(ck.lanes(row.fn)(*few))
            found[row.name] = [np.asarray(leaf).tolist() for leaf in jax.tree.leaves(got)]
    return found


def far(values, others) -> float:
    """The largest difference of values, over the largest of them."""
    pairs = [(np.array(a), np.array(b)) for a, b in zip(values, others, strict=True)]
    return max(float(np.max(np.abs(a - b)) / max(np.max(np.abs(b)), 1e-30)) for a, b in pairs)


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.bench.gpu", description=__doc__.splitlines()[0])
    parser.add_argument("row", nargs="*", help="words in the names of the rows that are measured; by default all")
    parser.add_argument("--there", type=pathlib.Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    chosen = [r for r in rows() if not args.row or any(word in r.name for word in args.row)]
    if args.there:  # in the process that has a CPU alone
        args.there.write_text(json.dumps(on_cpu([r.name for r in chosen])))
        return
    print(f"{jax.local_devices()[0].device_kind}, JAX {jax.__version__}", flush=True)
    records = {r.name: {"name": r.name, "batch": r.batch, "dtype": r.dtype} for r in chosen}
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "there.json"
        command = [sys.executable, "-m", "tests.bench.gpu", *args.row, "--there", str(file)]
        with subprocess.Popen(command, env={**os.environ, "JAX_PLATFORMS": "cpu"}):
            for way, row in itertools.product(WAYS, chosen):
                with jax.enable_x64(row.dtype == "float64"):
                    try:
                        records[row.name][way] = one = measured(row, way)
                    except jax.errors.JaxRuntimeError as error:  # too little memory: the others are still wanted
                        print(f"{way}, {row.name}: {str(error)[:300]}", flush=True)
                        continue
                rate, first = one["per_s"] / 1e6, one["first_s"]
                print(f"{way}, {row.name}: {rate:,.0f} M/s, first call {first:.1f} s", flush=True)
        there = json.loads(file.read_text())
    for name, record in records.items():
        for way in set(WAYS) & set(record):
            record[way]["difference"] = far(record[way].pop("values"), there[name])
    lines = []
    for name, record in records.items():
        found = [record.get(way, {}) for way in WAYS]
        first, far_off = (max(r.get(key, 0.0) for r in found) for key in ("first_s", "difference"))
        rates = [f"{r['per_s'] / 1e6:,.0f}" if r else "" for r in found]
        lines.append((name, *rates, f"{first:.1f}", f"{far_off:.1e}"))
    print(markdown(("loops", *(f"{way} [M/s]" for way in WAYS), "first call [s]", "largest difference"), lines))


if __name__ == "__main__":
    main()
