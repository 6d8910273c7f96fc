"""cnclik and its peers on the Panda's pose loop: equal results first, then times, in turn, on one core.

Each contender lives in a worker process with the number type and the XLA flags it wants; "single thread" are those
that frax asks for, and JAX's dispatch in the calling thread. All workers are held to the same core, and only one of
them works at a time. A record is one contender on one task: `evaluations_per_second` (median of the rounds, with
`spread`), `seconds`, those of each round, and `difference`, from Pinocchio C++ in float64 on the very same starts and
targets.
"""

import functools
import json
import os
import subprocess
import sys
import time
from typing import NamedTuple

import jax
import numpy as np

import cnclik as ck
from tests.bench import cases, textbook
from tests.bench import timing as bench
from tests.bench.pinocchio_cpp import PinocchioCpp

FLAGS = {
    "default": "",
    "single thread": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
}
BATCH, STEPS = 65536, 50
CHECKED = 256  # lanes that are compared after all steps
TOLERANCE = {"float64": 1e-12, "float32": 1e-6}
ROUNDS = 7
SETTINGS = dict(alpha=cases.ALPHA, Ts=cases.TS)


class Contender(NamedTuple):
    """run(lanes, N) -> (q, ‖e‖) of the first lanes after N steps; `lanes` and `N` are those of a timed run."""

    name: str
    task: str  # EE or CN
    run: object
    lanes: int | None = None  # None: the whole batch
    N: int = STEPS
    inverse: str = "damped"

    @property
    def size(self):
        return min(self.lanes or BATCH, BATCH)

    @property
    def evaluations(self):
        return self.size * self.N * (1 if self.task == "EE" else 6)


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
    """Starts and targets; those of float32 are rounded."""
    return tuple(cases.inputs(cases.ROBOTS["panda"](), BATCH, dtype).values())


def passes(task):
    return None if task == "EE" else 5


# --- the contenders -----------------------------------------------------------------------------------


def ours(task, dtype, inverse="damped"):
    """cnclik through `lanes`, reduced to final q and error."""
    case = cases.ROBOTS["panda"]()
    if inverse == "pseudoinverse":
        case = case._replace(law=ck.replace(case.law, inverse=ck.pseudoinverse()))

    @functools.cache
    def batched(N):
        return ck.lanes(cases.loop(case, N, ck.METHODS[task], ck.picard(5)), cores=1)

    def run(lanes, N):
        return jax.block_until_ready(batched(N)(*(a[:lanes] for a in given(dtype))))

    return Contender("cnclik", task, run, inverse=inverse)


def pinocchio_cpp(task, dtype):
    solver = PinocchioCpp(*panda(), dtype)

    def run(lanes, N):
        arrays = (a[:lanes] for a in given(dtype))
        return solver.run(*arrays, damping=cases.DAMPING, N=N, M=passes(task), **SETTINGS)

    return Contender("Pinocchio C++", task, run, lanes=8192)


def pinocchio_python(task):
    """The same calls from Python, a loop over lanes and steps."""
    import pinocchio as pin

    origins, tip = panda()
    model = pin.Model()
    for i, origin in enumerate(origins):
        model.addJoint(i, pin.JointModelRZ(), pin.SE3(origin), f"q{i + 1}")
    model.addFrame(pin.Frame("tip", len(origins), 0, pin.SE3(tip), pin.FrameType.OP_FRAME))
    data, frame, shift = model.createData(), model.getFrameId("tip"), cases.DAMPING**2 * np.eye(6)

    def error(position, rotation):
        at = data.oMf[frame]
        return np.concatenate([position - at.translation, pin.log3(rotation @ at.rotation.T)])

    def field(q, position, rotation):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        j = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
        return j.T @ np.linalg.solve(j @ j.T + shift, cases.ALPHA * error(position, rotation))

    def one(q, position, rotation, N):
        for _ in range(N):
            first = slope = field(q, position, rotation)
            for _ in range(passes(task) or 0):
                slope = field(q + cases.TS * slope, position, rotation)
            q = q + cases.TS * 0.5 * (first + slope)
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacement(model, data, frame)
        return q, np.linalg.norm(error(position, rotation))

    def run(lanes, N):
        done = [one(*lane, N) for lane in zip(*(a[:lanes] for a in given("float64")), strict=True)]
        return np.array([q for q, _ in done]), np.array([e for _, e in done])

    return Contender("Pinocchio Python", task, run, lanes=128, N=20)


def textbook_jax(task, dtype, inverse="damped"):
    """4×4 matrices under vmap."""
    law = {"damped": textbook.damped, "pseudoinverse": textbook.pseudoinverse}[inverse]
    made = textbook.loop(textbook.panda(*panda()), law, damping=cases.DAMPING, M=passes(task), **SETTINGS)
    name = "textbook JAX, " + {"damped": "cho_solve", "pseudoinverse": "pinv"}[inverse]
    return Contender(name, task, _over(made, dtype), N=2, inverse=inverse)


def frax(task, dtype):
    """frax's forward kinematics and Jacobian, the textbook's law and step."""
    from frax.assets import FRANKA_ASSETS_DIR
    from frax.core.manipulator import Manipulator

    robot = Manipulator(FRANKA_ASSETS_DIR / "panda.urdf", ee_offset=panda()[1])

    def at(q):
        j, pose = robot.velocity_control_matrices(q)
        return pose, j

    made = textbook.loop(at, textbook.damped, damping=cases.DAMPING, M=passes(task), **SETTINGS)
    return Contender("frax 0.1.0", task, _over(made, dtype), N=2)


def _over(made, dtype):
    arrays = functools.cache(lambda: tuple(jax.device_put(a) for a in given(dtype)))
    return lambda lanes, N: jax.block_until_ready(made(*(a[:lanes] for a in arrays()), N))


WORKERS = (("default", "float64"), ("default", "float32"), ("single thread", "float64"), ("single thread", "float32"))


def contenders(flags, dtype) -> list[Contender]:
    """Those of one worker."""
    made = [textbook_jax("EE", dtype)]
    if flags == "default":
        made += [peer(task, dtype) for task in ("EE", "CN") for peer in (pinocchio_cpp, ours)]
        if dtype == "float64":
            made += [pinocchio_python("EE"), pinocchio_python("CN")]
        else:
            made += [ours("EE", dtype, "pseudoinverse")]
    elif dtype == "float32":
        made += [frax("EE", dtype), frax("CN", dtype), textbook_jax("CN", dtype)]
        made += [textbook_jax("EE", dtype, "pseudoinverse")]
    return made


# --- a worker: equal first, then timed ----------------------------------------------------------------


def difference(contender, dtype) -> float:
    """Largest difference of final q and ‖e‖ from a float64 loop on the same inputs: Pinocchio C++; with J#, which
    that has not, `numpy.linalg.pinv`."""
    # What is fast enough is checked as it is timed, on its first and last lanes; the others on fewer lanes.
    size = contender.size if contender.N == STEPS else min(CHECKED, contender.size)
    lanes = np.unique(np.r_[: CHECKED // 2, size - CHECKED // 2 : size] % size)
    arrays = tuple(np.asarray(a[:size][lanes], float) for a in given(dtype))
    if contender.inverse == "damped":
        settings = dict(damping=cases.DAMPING, N=STEPS, M=passes(contender.task), **SETTINGS)
        wanted = PinocchioCpp(*panda(), "float64").run(*arrays, **settings)
    else:
        wanted = with_pinv(*arrays)
    found = (np.asarray(a, float)[lanes] for a in contender.run(size, STEPS))
    return max(float(np.abs(a - b).max()) for a, b in zip(found, wanted, strict=True))


def with_pinv(q, position, rotation):
    """Explicit Euler with J# in NumPy, all lanes side by side: (q, ‖e‖) after all steps."""
    from scipy.spatial.transform import Rotation

    origins, tip = panda()

    def at(q):
        frames, m = [], np.broadcast_to(np.eye(4), (len(q), 4, 4))
        for origin, angle in zip(origins, q.T, strict=True):
            turn = np.tile(np.eye(4), (len(q), 1, 1))
            turn[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * [0.0, 0.0, 1.0]).as_matrix()
            m = m @ origin @ turn
            frames.append(m)
        m = m @ tip
        turn = Rotation.from_matrix(rotation @ np.swapaxes(m[:, :3, :3], 1, 2)).as_rotvec()
        e = np.concatenate([position - m[:, :3, 3], turn], axis=1)
        axes = np.stack([f[:, :3, 2] for f in frames], axis=1)
        arms = np.stack([m[:, :3, 3] - f[:, :3, 3] for f in frames], axis=1)
        return e, np.swapaxes(np.concatenate([np.cross(axes, arms), axes], axis=2), 1, 2)

    for _ in range(STEPS):
        e, j = at(q)
        q = q + cases.TS * cases.ALPHA * np.einsum("bij,bj->bi", np.linalg.pinv(j), e)
    return q, np.linalg.norm(at(q)[0], axis=1)


def single(dtype, seconds=0.2) -> dict:
    """One warm solve of 50 steps from Python, one of none (what the call costs), and Pinocchio C++'s time [s].

    Their results are NumPy arrays, which are there: `jax.block_until_ready` of a whole run would be 11 µs more.
    """
    return {name: bench.repeat(call, seconds, wait=_nothing).median for name, call in _single(dtype).items()}


def _nothing(_):
    """In place of waiting for results."""


@functools.cache
def _single(dtype):
    case = cases.ROBOTS["panda"]()
    few = tuple(a[:1] for a in given(dtype))
    q0, position, rotation = (a[0] for a in few)
    reference, solver = ck.hold(position, rotation), PinocchioCpp(*panda(), dtype)

    def solve(N=STEPS):
        return ck.solve(case.law, reference, q0, cases.TS, N, "EE")

    def cpp():
        return solver.run(*few, damping=cases.DAMPING, N=STEPS, M=None, **SETTINGS)

    found = float(np.abs(np.asarray(solve().q[-1]) - cpp()[0][0]).max())
    if not found <= TOLERANCE[dtype]:
        raise SystemExit(f"a single solve in {dtype} differs by {found:.3g}")
    return {"cnclik": solve, "cnclik, no step": functools.partial(solve, 0), "Pinocchio C++": cpp}


def work(flags, dtype, batch) -> None:
    """Answer orders on stdin, one line of JSON each."""
    global BATCH
    BATCH = int(batch)
    bench.hold_to(1)  # before JAX makes its threads, which is on first use
    jax.config.update("jax_cpu_enable_async_dispatch", flags != "single thread")
    field = contenders(flags, dtype)

    def told(i):
        c = field[i]
        return {"name": c.name, "task": c.task, "inverse": c.inverse, "batch": c.size, "N": c.N}

    def check(i):
        found = difference(field[i], dtype)
        field[i].run(field[i].size, field[i].N)  # compile what is timed, and warm up
        return found

    def time_of(i):
        start = time.perf_counter()
        field[i].run(field[i].size, field[i].N)
        return time.perf_counter() - start, field[i].evaluations

    orders = {"check": check, "time": time_of, "tell": told, "single": lambda _: single(dtype)}
    print(json.dumps(len(field)), flush=True)
    for order in sys.stdin:
        verb, i = json.loads(order)
        print(json.dumps(orders[verb](i)), flush=True)


# --- the run ------------------------------------------------------------------------------------------


class Worker:
    """A process with contenders that does one thing when told."""

    def __init__(self, flags, dtype, batch):
        self.flags, self.dtype = flags, dtype
        command = [sys.executable, "-W", "ignore", "-m", "tests.bench.peers", flags, dtype, str(batch)]
        environment = dict(os.environ) | {
            "XLA_FLAGS": FLAGS[flags],
            "JAX_PLATFORMS": "cpu",
            "JAX_ENABLE_X64": str(int(dtype == "float64")),
            "OPENBLAS_NUM_THREADS": "1",
        }
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)
        self.count = self._answer()

    def __call__(self, verb, i=0):
        self._process.stdin.write(json.dumps([verb, i]) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self):
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"the worker for {self.flags}, {self.dtype} ended.")
        return json.loads(line)

    def close(self):
        self._process.stdin.close()
        self._process.wait()


def compare(rounds=ROUNDS, batch=BATCH, say=lambda text: None) -> dict:
    """Check every contender, then time all of them in turn, round after round: {"peers": [...], "single": [...]}."""
    workers = [Worker(*worker, batch) for worker in WORKERS]
    try:
        places, records = [], []
        for worker in workers:
            for i in range(worker.count):
                record = worker("tell", i) | {"dtype": worker.dtype, "flags": worker.flags}
                who = "{name} {task} {inverse} {dtype} ({flags} flags)".format(**record)
                record["difference"] = worker("check", i)
                if not record["difference"] <= TOLERANCE[worker.dtype]:
                    raise SystemExit(f"{who} differs by {record['difference']:.3g}: nothing is timed.")
                say(f"{who}: equal to {record['difference']:.1e}")
                places.append((worker, i))
                records.append(record)
        taken, solves = [[] for _ in records], {worker: [] for worker in workers}
        for k in range(rounds):
            say(f"round {k + 1} of {rounds}")
            for (worker, i), times in zip(places, taken, strict=True):
                times.append(worker("time", i))
            for worker, made in solves.items():
                made.append(worker("single"))
    finally:
        for worker in workers:
            worker.close()
    for record, times in zip(records, taken, strict=True):
        t = bench.timing(seconds for seconds, _ in times)
        record |= {"evaluations_per_second": times[0][1] / t.median, "spread": t.spread}
        record["seconds"] = [seconds / evaluations for seconds, evaluations in times]
    singles = [
        {"name": name, "dtype": worker.dtype, "flags": worker.flags, "N": STEPS, "seconds": [one[name] for one in made]}
        for worker, made in solves.items()
        for name in made[0]
    ]
    return {"peers": records, "single": singles}


if __name__ == "__main__":
    work(*sys.argv[1:])
