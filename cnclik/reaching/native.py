"""The search for targets in C, where the system has a compiler.

It makes the same tries as `search`, one after the other: as soon as a target is solved, its lane takes the next one. It
compiles in a second and is twenty times as fast as JAX's programs.
"""

import ctypes
import pathlib
import tempfile
import threading
import warnings

import jax.numpy as jnp
import numpy as np

from cnclik import errors
from cnclik.engine.compiler import build, opened
from cnclik.engine.graph import UnsupportedError
from cnclik.engine.plan import in_c
from cnclik.engine.routine import INT, Field, read
from cnclik.engine.source import vectors
from cnclik.engine.to_c import Writer
from cnclik.reaching import strategy
from cnclik.reaching.asked import TOUCHING, Asked
from cnclik.reaching.result import Reached, ReachStatus, as_rows, fields, from_rows, width
from cnclik.reaching.search import SCATTER, Found, nothing
from cnclik.reaching.seeds import SETS, SIZE, STRETCHES, compared, seeds
from cnclik.reaching.step import Search, iterate
from cnclik.reaching.strategy import CAREFUL, FAR, IN_C, SoFar, alone, phases, wanted
from cnclik.reaching.targets import WIDTH, aims, owners, told_apart
from cnclik.record import memoized, replace
from cnclik.robot.posture import start_posture
from cnclik.threads import cores, side_by_side

AT_ONCE = 16  # so many chains of a process get native code at their first call
LONGEST = 60.0  # [s] time limit of the compiler; it needs about 1 s
MOST_PER_TASK, SMALLEST = 4096, 256  # number of targets per task of a core
_POINTERS = (
    *("low", "high", "lower", "upper", "jump", "periods", "turns"),
    *("postures", "middle", "width", "features", "factors", "roots"),
)
_building = threading.Lock()


class _Call(ctypes.Structure):
    """The struct `Asked` of the C source."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("pose", "near", "skip", "made", "rows", *_POINTERS)),
        ("tolerance", ctypes.c_double * 2),
        *((name, ctypes.c_int64) for name in ("done", "tries", "budget", "seed", "downhill")),
    )


def native_for(asked: Asked, soon: bool):
    """The native search; None where there is no compiler, or compiling does not pay.

    The first chains of a process have it at once; in a loop over many, each asked of a few targets, JAX's
    programs, which serve all chains, are sooner ready.

    Args: soon: whether the chain is used often.
    """
    if not in_c():
        return None
    made = asked.__dict__.get("_native")
    if made is None:
        name = f"_native_{told_apart(asked.task)}_{asked.task.weights is None}"
        if not (soon or Native.libraries < AT_ONCE or name in asked.chain.__dict__):
            return None
        with _building:
            library = memoized(asked.chain, name, lambda _: _built(asked))
        made = memoized(asked, "_native", lambda asked: library and Native(asked, library))
    return made or None


def _built(asked):
    """The C library, or False where it cannot be built."""
    try:
        text = native_source(asked.chain, asked.task)
        with tempfile.TemporaryDirectory(prefix="cnclik-reach-") as folder:  # the file is not needed once it is open
            source = pathlib.Path(folder, "reach_lanes.c")
            source.write_text(text, encoding="utf-8")
            library = opened(build([source], folder, flags=["-O2"], limit=LONGEST))
        of = (ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
        library.search.restype, library.search.argtypes = None, of
        library.along.restype, library.along.argtypes = ctypes.c_int64, (ctypes.c_void_p, *of[:2])
    except (errors.ArgumentError, UnsupportedError, OSError) as error:  # no C, no room: JAX's programs do the same
        warnings.warn(f"reach runs without native code, several times as slowly: {error}", stacklevel=2)
        return False
    Native.libraries += 1
    return library


class Native:
    libraries = 0  # that this process has built

    def __init__(self, asked: Asked, library):
        known = seeds(asked.chain)
        to, (lower, upper) = compared(asked.chain, asked.task), asked.limited()
        self.first, *self.rest = map(_as_c, phases(asked))
        given: dict = {"lower": lower, "upper": upper, "turns": asked.turns(), "periods": asked.periods}
        given |= {name: getattr(known, name) for name in ("postures", "middle", "width")}
        given = {name: np.ascontiguousarray(v, float) for name, v in given.items()}
        given |= {"features": to.features, "factors": to.factors}
        self.asked, self.library, self.given = asked, library, given  # the latter: what pointers point to
        self.shared = _Call(tolerance=tuple(asked.tolerance), seed=int(asked.seed))
        _put(self.shared, **given, **_numbers(self.first))
        empty = nothing((), asked.chain.n)
        self.empty = np.empty((), [(name, float, v.shape) for name, v in zip(Found._fields, empty, strict=True)])
        self.empty[()] = tuple(empty)

    def reached(self, pose, near, progress=None) -> Reached:
        """Answers for (B, t) targets, near (B, n) or None."""
        B, rows = len(pose), self._rows(len(pose))
        made = np.empty(B, self.empty.dtype)
        made["found"] = 0
        skip = None if self.asked.downhill else self.asked.too_far(pose).astype(np.uint8)
        report = progress and (lambda found: progress(found, B))
        self._run(made, pose, near, report, rows=rows, skip=skip)
        if not made["found"].all():
            left = np.flatnonzero(made["found"] == 0)
            report = progress and (lambda found: progress(B - len(left) + found, B))
            answer = self._answered(made[left], pose[left], None if near is None else near[left], report)
            rows[left] = as_rows(fields(answer))
        if progress is not None:
            progress(B, B)
        return from_rows(self.asked.chain, self.asked.task, rows)

    def along(self, pose, progress=None) -> Reached:
        """Answers for the targets of a path, each searched from the last answer before it.

        `jump` does not apply to the first waypoint.
        """
        asked, rows, k = self.asked, self._rows(len(pose)), 0
        at = start_posture(asked.chain, asked.task)[None]
        if asked.jump is None:
            found = self.reached(pose[:1], at)
        else:
            free = memoized(asked, "_free_to_jump", lambda asked: Native(replace(asked, jump=FAR), self.library))
            found = free.reached(pose[:1], at)
        made = np.empty(min(len(pose), MOST_PER_TASK), self.empty.dtype)
        while True:
            if found is not None:
                rows[k] = as_rows(fields(found))[0]
                at = found.q if found.solved[0] else at
                k += 1
            if progress is not None:
                progress(k, len(pose))
            if k == len(pose):
                return from_rows(asked.chain, asked.task, rows)
            count = min(len(made), len(pose) - k)
            near = np.empty((count + 1, asked.chain.n))
            near[0] = at
            call = self._call(made, pose[k : k + count], near, rows=rows[k : k + count])
            done = self.library.along(ctypes.byref(call), near.ctypes.data, count)
            k, at, found = k + done, near[done : done + 1], None
            if done < count:
                found = self._answered(made[done : done + 1], pose[k : k + 1], at)

    def tried(self, pose, near, number, wide=False) -> Found:
        """The result of one try, of number (B,), for each of (B, t) targets. `wide`: without bounds."""
        made = np.full(len(pose), self.empty)
        for k in np.unique(number).tolist():
            self._on(made, number == k, pose, near, alone(self.first, wide)._replace(done=k, tries=k + 1))
        return _found(made)

    def descended(self, pose, near, start) -> Found:
        """The result of a careful search from one posture (B, n) for each of (B, t) targets."""
        made = np.full(len(pose), self.empty)
        made["places"][:, 0], made["costs"][:, 0] = start, 0.0
        self._on(made, np.ones(len(pose), bool), pose, near, self.first._replace(tries=1, downhill=CAREFUL))
        return _found(made)

    def _on(self, made, which, pose, near, phase, report=None):
        """Run a phase for the targets that need it; the indices of these targets."""
        ids = np.flatnonzero(which)
        part = made[ids]
        self._run(part, pose[ids], None if near is None else near[ids], report, phase=phase)
        made[ids] = part
        return ids

    def _answered(self, made, pose, near, report=None):
        """The record of targets that the first tries did not solve."""
        asked, far, B = self.asked, self.asked.too_far(pose), len(pose)
        known, there = asked.finite(pose, near), made.copy()
        so_far = SoFar(_found(made), _found(there), np.zeros(B, bool), np.zeros(B, int))
        for k, phase in enumerate(self.rest):
            of = there if phase.status else made
            ids = self._on(of, wanted(phase, so_far, known, far), pose, near, phase, report)
            if k == 0:
                so_far.sure[:] = asked.sure(made["looks"]) & ~far
                count = np.count_nonzero(made["found"])
                # Few of the further tries succeed.
                report = report and (lambda _, before=report, count=count: before(count))
            if phase.status:
                so_far.why[ids] = asked.meaning(phase.status, there["found"] != 0, there["squares"])[ids]
        q, squares, _, steep, looks, found, *_ = so_far.made
        return asked.reached(pose, near, q, squares, steep, looks, found != 0, so_far.sure, so_far.why)

    def _rows(self, count):
        return np.empty((count, width(self.asked.chain.n)))

    def _call(self, made, pose, near, phase=None, **others):
        """The arguments of the C functions: arrays, and a phase in place of the first.

        It keeps the arrays alive, because threads may still write to them after an exception.
        """
        call = _Call.from_buffer_copy(self.shared)
        others |= {"made": made, "pose": np.ascontiguousarray(pose, float)} | ({} if phase is None else _numbers(phase))
        call.held = others | {"near": None if near is None else np.ascontiguousarray(near, float)}
        _put(call, **call.held)
        return call

    def _run(self, made, pose, near, report=None, **others):
        """One call of the C function, on all cores. `report` is called repeatedly with the number of solved targets."""
        call, B = self._call(made, pose, near, **others), len(made)
        if B <= SMALLEST:
            self.library.search(ctypes.byref(call), 0, B)
            return
        size = max(min(MOST_PER_TASK, -(-B // (4 * cores()))), SMALLEST)

        def block(first):
            self.library.search(ctypes.byref(call), first, min(first + size, B))

        with side_by_side() as pool:
            for _ in pool.map(block, range(0, B, size)):
                if report is not None:
                    report(int(np.count_nonzero(made["found"])))


def _put(call, **values):
    """Put the addresses of arrays, and numbers, into the fields of a call."""
    for name, value in values.items():
        if value is not None:
            setattr(call, name, value.ctypes.data if isinstance(value, np.ndarray) else value)


def _numbers(phase) -> dict:
    return {name: getattr(phase, name) for name in IN_C}


def _as_c(phase):
    """The phase, its arrays as C has them."""
    return phase._replace(
        **{k: np.ascontiguousarray(v, float) if np.ndim(v) else v for k, v in phase._asdict().items()}
    )


def _found(made) -> Found:
    return Found(*(made[name] for name in Found._fields))


# --- the search in C, around the traced iteration -----------------------------------------------------
# Each lane of a vector works on one target. As soon as that is done the lane takes the next one, so that no lane waits.
# All numbers are float64, so that no second program is needed for the last digits.


SEARCH = (pathlib.Path(__file__).parent / "c" / "search.c").read_text(encoding="utf-8")


def native_source(chain, task) -> str:
    """The text: `search` for the targets `first` to `last` - 1 of what `asked` points to, and `along` for a path's."""
    program, real = look_of(chain, task), np.dtype(np.float64)
    writer = Writer(program.graph, program.given, program.outs, real, *program.places(lambda _, f: f"s->{f.name}"))
    look = ["static void look(Lanes *s)", "{", *writer.statements(), "}"]
    fields = program.inputs["lanes"]
    lanes = [f"  {'S32' if f.kind == INT else 'F64'} {f.name}{f'[{f.size}]' * bool(f.shape)};" for f in fields]
    numbers = {"N": chain.n, "M": task.m, "SETS": SETS, "SIZE": SIZE, "SCATTER": SCATTER}
    numbers |= {"AIMS": len(aims(task)), "OWNERS": ", ".join(map(str, owners(task, chain)))}
    numbers |= {"STRETCHES": len(STRETCHES), "STRETCHED": ", ".join(map(str, STRETCHES))}
    numbers |= {"TOUCHING": TOUCHING, "JUMP": int(ReachStatus.JUMP)}
    numbers |= {name: getattr(strategy, name) for name in strategy.NUMBERS}
    defined = [f"#define {name} {value}" for name, value in numbers.items()]
    struct = ["typedef struct {", *lanes, "} Lanes;"]
    return "\n".join([vectors(writer, real), *writer.tables, *struct, *look, *defined, SEARCH])


def look_of(chain, task):
    """One iteration: evaluate a posture and step from it; a lane's state goes in and comes out."""
    n = chain.n
    state = [Field("q", (n,)), Field("best", (n,)), Field("squares", (2,))]
    state += [Field(name, ()) for name in ("cost", "steep", "trust")] + [Field("arrived", (), INT)]
    own = [Field("careful", (), INT), Field("low", (n,)), Field("high", (n,)), Field("tolerance", (2,))]
    own += [Field("target", (WIDTH * len(aims(task)),)), Field("roots", (task.m,))]

    def one(q, best, squares, cost, steep, trust, arrived, careful, low, high, tolerance, target, roots):
        zero = jnp.zeros((), float)
        at = Search(q, best, squares, cost, steep, trust, zero, arrived != 0)
        weights = None if task.weights is None else roots
        made = iterate(chain, task, at, target, (low, high), tolerance, careful != 0, weights)
        return [made.q, made.best, made.squares, made.cost, made.steep, made.trust, made.arrived.astype(jnp.int32)]

    return read(one, {"lanes": [*state, *own]}, {"lanes": state}, dtype=float)
