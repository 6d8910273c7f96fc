"""cnclik and its peers on the Panda's pose loop: equal results first, then times, all in one run on one core.

Run as `python -m tests.bench.peers [seconds]` it holds itself to one core and prints its records as JSON.
Each record is one contender on one task: `evaluations_per_second` (median of the rounds, with `spread`), and
`difference` from Pinocchio C++ in float64 on the very same starts and targets.
"""

import functools
import json
import os
import sys
import time
from typing import NamedTuple

if __name__ == "__main__":
    # Before JAX is loaded: one core, and the flags with which frax asks to be run.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-1:])
    os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["JAX_PLATFORMS"] = "cpu"
    os.environ["OPENBLAS_NUM_THREADS"] = "1"

import jax
import jax.numpy as jnp
import numpy as np

import cnclik as ck
from cnclik.study import bench
from tests.bench import textbook
from tests.bench.pinocchio_cpp import PinocchioCpp

BATCH, STEPS = 4096, 50
CHECKED = 256  # lanes on which the slow ones are compared, over all 50 steps
TOLERANCE = {"float64": 1e-12, "float32": 1e-6}
ROUNDS = 7
SETTINGS = dict(alpha=bench.ALPHA, Ts=bench.TS)


class Contender(NamedTuple):
    """run(lanes, N) -> (q, ‖e‖) for the first `lanes` lanes after N steps; `lanes` and `N` of a timed run."""

    name: str
    task: str  # EE or CN
    dtype: str
    run: object
    lanes: int = BATCH
    N: int = STEPS
    inverse: str = "damped"


# --- the robot, as the peers want it ------------------------------------------------------------------


def matrix(offset) -> np.ndarray:
    """An Offset of cnclik as a 4×4 matrix."""
    m = np.eye(4)
    m[:3, :3], m[:3, 3] = offset.rotation, offset.position
    return m


def panda():
    """(origins (7, 4, 4), tip (4, 4)): every joint turns about the z of its own frame."""
    chain = ck.panda()
    assert all(joint.axis == (0.0, 0.0, 1.0) for joint in chain.joints)
    return np.stack([matrix(joint.origin) for joint in chain.joints]), matrix(chain.tip)


@functools.cache
def given(dtype):
    """Starts and targets in a type; those of float64 are not those of float32."""
    return tuple(bench.inputs(bench.ROBOTS["panda"](), BATCH, dtype).values())


def passes(task):
    return None if task == "EE" else 5


# --- the contenders -----------------------------------------------------------------------------------


def ours(task, dtype, inverse="damped"):
    """cnclik through `lanes`, reduced to final q and error."""
    problem = bench.ROBOTS["panda"]()
    if inverse == "pseudoinverse":
        problem = problem._replace(law=ck.replace(problem.law, inverse=ck.pseudoinverse()))
    batched = functools.cache(
        lambda N: bench.over_lanes(bench.loop(problem, N, ck.METHODS[task], ck.picard(5)), cores=1)
    )

    def run(lanes, N):
        q, e, _ = batched(N)(jnp.asarray(bench.ALPHA, dtype), *(a[:lanes] for a in on_device(dtype)))
        return q, e

    return Contender("cnclik", task, dtype, _in_type(dtype, run), inverse=inverse)


def pinocchio_cpp(task, dtype):
    solver = PinocchioCpp(*panda(), dtype)

    def run(lanes, N):
        arrays = (a[:lanes] for a in given(dtype))
        return solver.run(*arrays, damping=bench.DAMPING, N=N, M=passes(task), **SETTINGS)

    return Contender("Pinocchio C++", task, dtype, run, lanes=4096)


def pinocchio_python(task):
    """The same calls from Python, a loop over lanes and steps."""
    import pinocchio as pin

    origins, tip = panda()
    model = pin.Model()
    for i, origin in enumerate(origins):
        model.addJoint(i, pin.JointModelRZ(), pin.SE3(origin), f"q{i + 1}")
    model.addFrame(pin.Frame("tip", 7, 0, pin.SE3(tip), pin.FrameType.OP_FRAME))
    data, frame, eye = model.createData(), model.getFrameId("tip"), bench.DAMPING**2 * np.eye(6)

    def error(position, rotation):
        at = data.oMf[frame]
        return np.concatenate([at.rotation.T @ (position - at.translation), pin.log3(at.rotation.T @ rotation)])

    def field(q, position, rotation):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        j = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
        return j.T @ np.linalg.solve(j @ j.T + eye, bench.ALPHA * error(position, rotation))

    def one(q, position, rotation, N):
        for _ in range(N):
            first = slope = field(q, position, rotation)
            for _ in range(passes(task) or 0):
                slope = field(q + bench.TS * slope, position, rotation)
            q = q + bench.TS * 0.5 * (first + slope)
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        return q, np.linalg.norm(error(position, rotation))

    def run(lanes, N):
        done = [one(*lane, N) for lane in zip(*(a[:lanes] for a in given("float64")), strict=True)]
        return np.array([q for q, _ in done]), np.array([e for _, e in done])

    return Contender("Pinocchio Python", task, "float64", run, lanes=64, N=20)


def textbook_jax(task, dtype, inverse="damped"):
    origins, tip = panda()
    of_law = textbook.damped if inverse == "damped" else textbook.pseudoinverse
    looped = textbook.loop(
        textbook.panda(origins, tip), of_law, damping=bench.DAMPING, M=passes(task), **SETTINGS
    )
    name = "textbook JAX, " + ("cho_solve" if inverse == "damped" else "pinv")
    return Contender(name, task, dtype, _in_type(dtype, _over(looped, dtype)), N=2, inverse=inverse)


def frax(task, dtype):
    """frax's forward kinematics and Jacobian, the textbook's law and step."""
    from frax.assets import FRANKA_ASSETS_DIR
    from frax.core.manipulator import Manipulator

    robot = Manipulator(FRANKA_ASSETS_DIR / "panda.urdf", ee_offset=panda()[1])

    def at(q):
        j, pose = robot.velocity_control_matrices(q)
        return pose, j

    looped = textbook.loop(at, textbook.damped, damping=bench.DAMPING, M=passes(task), **SETTINGS)
    return Contender("frax 0.1.0", task, dtype, _in_type(dtype, _over(looped, dtype)), N=5)


def _over(looped, dtype):
    return lambda lanes, N: looped(*(a[:lanes] for a in on_device(dtype)), N)


@functools.cache
def on_device(dtype):
    """`given` as JAX arrays."""
    return tuple(jax.device_put(a) for a in given(dtype))


def _in_type(dtype, run):
    """Without x64 for float32, so that no constant widens it."""

    def inside(lanes, N):
        with jax.enable_x64(dtype == "float64"):
            return jax.block_until_ready(run(lanes, N))

    return inside


def contenders():
    """All of them; the C++ of the same task is first."""
    made = []
    for task in ("EE", "CN"):
        made += [pinocchio_cpp(task, dtype) for dtype in ("float64", "float32")]
        made += [ours(task, dtype) for dtype in ("float64", "float32")]
        made += [textbook_jax(task, "float32"), frax(task, "float32"), pinocchio_python(task)]
    made += [textbook_jax("EE", "float64"), ours("EE", "float32", "pseudoinverse")]
    return [*made, textbook_jax("EE", "float32", "pseudoinverse")]


# --- equal first, then timed --------------------------------------------------------------------------


def difference(contender) -> float:
    """Largest difference of final q and ‖e‖ from a float64 loop on the same inputs.

    Damped: from Pinocchio C++. With J#: from the textbook's `jnp.linalg.pinv`.
    """
    arrays = tuple(np.asarray(a[:CHECKED], float) for a in given(contender.dtype))
    if contender.inverse == "damped":
        solver = PinocchioCpp(*panda(), "float64")
        wanted = solver.run(*arrays, damping=bench.DAMPING, N=STEPS, M=passes(contender.task), **SETTINGS)
    else:
        with jax.enable_x64(True):
            looped = textbook.loop(
                textbook.panda(*panda()), textbook.pseudoinverse, damping=None, M=passes(contender.task), **SETTINGS
            )
            wanted = looped(*arrays, STEPS)
    found = contender.run(CHECKED, STEPS)
    return max(float(np.abs(np.asarray(a, float) - np.asarray(b)).max()) for a, b in zip(found, wanted, strict=True))


def compare(rounds=ROUNDS, say=lambda text: None) -> list[dict]:
    """Check each contender, then time all of them in turn, round after round."""
    field, records = contenders(), []
    for c in field:
        found = difference(c)
        if not found <= TOLERANCE[c.dtype]:
            raise SystemExit(f"{c.name} ({c.task}, {c.dtype}) differs by {found:.3g}: not timed, nothing is.")
        say(f"{c.name}, {c.task}, {c.inverse}, {c.dtype}: equal to {found:.1e}")
        records.append(
            {"name": c.name, "task": c.task, "inverse": c.inverse, "dtype": c.dtype, "difference": found}
            | {"batch": c.lanes, "N": c.N}
        )
        c.run(c.lanes, c.N)  # compile, and warm up
    durations = [[] for _ in field]
    for i in range(rounds):
        say(f"round {i + 1} of {rounds}")
        for c, taken in zip(field, durations, strict=True):
            start = time.perf_counter()
            c.run(c.lanes, c.N)
            taken.append(time.perf_counter() - start)
    for c, taken, record in zip(field, durations, records, strict=True):
        t = bench.timing(taken)
        work = c.lanes * c.N * (1 if c.task == "EE" else 6)
        record |= {"evaluations_per_second": work / t.median, "run_s": t.median, "spread": t.spread, "runs": t.runs}
        record["seconds_per_evaluation"] = [s / work for s in taken]
    return records


def single(rounds=ROUNDS) -> list[dict]:
    """One warm solve of 50 steps from Python against Pinocchio C++'s time for it, in turn; [s] per solve."""
    problem, records = bench.ROBOTS["panda"](), []
    for dtype in ("float64", "float32"):
        lane = tuple(a[0] for a in given(dtype))
        cpp = PinocchioCpp(*panda(), dtype)
        few = tuple(a[:1] for a in given(dtype))
        with jax.enable_x64(dtype == "float64"):
            reference = ck.hold(*lane[1:])

            def solve(q0=lane[0], reference=reference):
                return jax.block_until_ready(ck.solve(problem.law, reference, q0, bench.TS, STEPS))

            calls = {
                "cnclik": solve,
                "Pinocchio C++": lambda few=few, cpp=cpp: cpp.run(
                    *few, damping=bench.DAMPING, N=STEPS, M=None, **SETTINGS
                ),
            }
            found = float(np.abs(np.asarray(solve().q[-1]) - calls["Pinocchio C++"]()[0][0]).max())
            if not found <= TOLERANCE[dtype]:
                raise SystemExit(f"a single solve in {dtype} differs by {found:.3g}: not timed.")
            taken = {name: [] for name in calls}
            for _ in range(rounds):
                for name, call in calls.items():
                    taken[name].append(bench.repeat(call, 0.2).median)
        for name, durations in taken.items():
            t = bench.timing(durations)
            records.append(
                {"name": name, "dtype": dtype, "N": STEPS, "run_s": t.median, "spread": t.spread, "runs_s": durations}
                | {"difference": found}
            )
    return records


if __name__ == "__main__":
    say = functools.partial(print, file=sys.stderr, flush=True)
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else ROUNDS
    print(json.dumps({"device": bench.processor(), "peers": compare(rounds, say), "single": single(rounds)}))
