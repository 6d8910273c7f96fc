"""Native: the search for targets as C, built by the system's compiler where it has one.

The same tries as those of `search`, but one after the other and all in float64: a target's lane is free for the next
as soon as it has arrived. Built in a second, where JAX compiles for ten.
"""

import ctypes
import pathlib
import tempfile
import threading
import warnings

import numpy as np

from cnclik import errors
from cnclik.engine.compiler import build, closed_after, opened
from cnclik.engine.graph import UnsupportedError
from cnclik.engine.plan import in_c
from cnclik.reaching.asked import Asked
from cnclik.reaching.native_source import native_source
from cnclik.reaching.result import Reached, as_rows, fields, from_rows, width
from cnclik.reaching.search import BLOCK, CAREFUL, DOWNHILL, PLACES, SMALLEST, setup_of
from cnclik.reaching.single import FAR
from cnclik.record import kept, replace
from cnclik.robot.posture import start_posture
from cnclik.threads import cores, side_by_side

AT_ONCE = 16  # chains of a process that have native code from their first call on
ENDLESS = 1 << 40  # looks
LONGEST = 60.0  # [s] that the compiler may take; it takes a second
FIRST = 16  # tries of all targets; nearly all need no more
_NUMBERS = ("cost", "steep", "looks", "found")
_POINTERS = (
    *("low", "high", "lower", "upper", "jump", "periods", "turns"),
    *("postures", "middle", "width", "features", "factors", "roots"),
)
_building = threading.Lock()


class _Call(ctypes.Structure):
    """`Asked` of the C source."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("pose", "near", "skip", "made", "rows", *_POINTERS)),
        ("tolerance", ctypes.c_double * 2),
        *((name, ctypes.c_int64) for name in ("done", "tries", "budget", "seed", "downhill", "steps")),
    )


def native_for(asked: Asked, soon: bool):
    """The native search for what is asked; None where there is no compiler, or it isn't worth its while.

    The first chains of a process have it at once; in a loop over many, each asked of a few targets, JAX's
    programs, which serve all chains, are sooner ready.

    Args: soon: whether the chain has been asked of often.
    """
    if not in_c():
        return None
    made = asked.__dict__.get("_native")
    if made is None:
        name = f"_native_{asked.task.position}_{asked.task.orientation}_{asked.task.weights is None}"
        if not (soon or Native.libraries < AT_ONCE or name in asked.chain.__dict__):
            return None
        with _building:
            library = kept(asked.chain, name, lambda _: _built(asked))
        made = kept(asked, "_native", lambda asked: library and Native(asked, library))
    return made or None


def _built(asked):
    """The C library, or False where it can't be built."""
    try:
        text = native_source(asked.chain, asked.unweighted()[0], asked.task.weights is not None)
        with tempfile.TemporaryDirectory(prefix="cnclik-reach-") as folder:  # not needed once it is open
            source = pathlib.Path(folder, "reach_lanes.c")
            source.write_text(text, encoding="utf-8")
            library = closed_after(opened(build([source], folder, flags=["-O2"], limit=LONGEST)))
        of = (ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
        library.search.restype, library.search.argtypes = None, of
        library.along.restype, library.along.argtypes = ctypes.c_int64, (ctypes.c_void_p, *of[:2])
    except (errors.ArgumentError, UnsupportedError, OSError) as error:  # no C, no room: JAX's programs do the same
        warnings.warn(f"reach runs without native code, several times as slowly: {error}", stacklevel=2)
        return False
    Native.libraries += 1
    return library


class Native:
    """The native search for what is asked."""

    libraries = 0  # that this process has built

    def __init__(self, asked: Asked, library):
        setup, n = setup_of(asked), asked.chain.n
        lower, upper = asked.limited()
        roots = np.ones(asked.task.m) if setup.roots is None else setup.roots
        given = {"low": lower, "high": upper, "lower": lower, "upper": upper, "turns": asked.turns(), "roots": roots}
        given |= {name: getattr(setup.seeds, name) for name in ("postures", "middle", "width")}
        given |= {"periods": setup.periods, "jump": np.broadcast_to(np.inf if asked.jump is None else asked.jump, n)}
        given = {name: np.ascontiguousarray(v, float) for name, v in given.items()}
        given |= {"features": setup.compared.features, "factors": setup.compared.factors}
        self.asked, self.library, self.tries = asked, library, setup.tries
        numbers = {"tolerance": tuple(setup.tolerance), "budget": setup.budget, "seed": setup.seed, "steps": DOWNHILL}
        self.shared = _Call(**numbers, **{name: v.ctypes.data for name, v in given.items()})
        self.given = given  # what the pointers point to
        columns = [("q", float, (n,)), ("squares", float, (2,)), *((name, float) for name in _NUMBERS)]
        self.made = np.dtype([*columns, ("places", float, (PLACES, n)), ("costs", float, (PLACES,))])

    def reached(self, pose, near, progress=None) -> Reached:
        """Answers for (B, 12) targets, near (B, n) or None."""
        B, rows = len(pose), self._rows(len(pose))
        made = np.empty(B, self.made)
        made["found"] = 0
        skip = None if self.asked.downhill else self.asked.too_far(pose).astype(np.uint8)
        report = progress and (lambda found: progress(found, B))
        self._run(made, pose, near, report, rows=rows, skip=skip, tries=min(FIRST, self.tries))
        if not made["found"].all():
            left = np.flatnonzero(made["found"] == 0)
            report = progress and (lambda found: progress(B - len(left) + found, B))
            told = self._told(made[left], pose[left], None if near is None else near[left], report)
            rows[left] = as_rows(fields(told))
        if progress is not None:
            progress(B, B)
        return from_rows(self.asked.chain, self.asked.task, rows)

    def along(self, pose, progress=None) -> Reached:
        """Answers for the targets of a path, each from the answer before it; where there was none, from the last one.

        What is nearest to the first waypoint is not held to `jump`.
        """
        asked, rows, k = self.asked, self._rows(len(pose)), 0
        at = start_posture(asked.chain, asked.task)[None]
        first = self if asked.jump is None else Native(replace(asked, jump=FAR), self.library)
        found = first.reached(pose[:1], at)
        made = np.empty(min(len(pose), BLOCK), self.made)
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
            call = self._call(made, pose[k : k + count], near, rows=rows[k : k + count], tries=min(FIRST, self.tries))
            done = self.library.along(ctypes.byref(call), near.ctypes.data, count)
            k, at, found = k + done, near[done : done + 1], None
            if done < count:
                found = self._told(made[done : done + 1], pose[k : k + 1], at)

    def from_starts(self, pose, near, start, free=False):
        """One careful search from each of (B, n) postures, `free` of all bounds or not: what `Asked.reached` takes."""
        made = np.zeros(len(pose), self.made)
        made["places"][:, 0], made["costs"][:, 1:], made["cost"], made["squares"] = start, np.inf, np.inf, np.inf
        made["steep"], roots = np.nan, np.ones(self.asked.task.m)
        wide = np.full(self.asked.chain.n, np.inf)
        bounds = {"low": -wide, "high": wide, "jump": wide} if free else {}
        self._run(made, pose, near, downhill=1, tries=1, steps=CAREFUL, roots=roots, **bounds)
        return self._answers(made)

    def _told(self, made, pose, near, report=None) -> Reached:
        """The record of targets that the first tries have no answer for."""
        asked, far = self.asked, self.asked.too_far(pose)
        known = asked.finite(pose, near)

        def more(made, which, report, **numbers):
            """Search on for some of the targets."""
            ids = np.flatnonzero(which)
            part = made[ids]
            self._run(part, pose[ids], None if near is None else near[ids], report, **numbers)
            made[ids] = part

        def nearest(made, which, **numbers):
            """Search on for the nearest poses to some that have no answer."""
            made["cost"][which] = np.inf
            more(made, which, still, downhill=1, tries=PLACES, **numbers)

        more(made, known & ~far, report, done=FIRST, tries=self.tries)
        sure, why = asked.sure(made["looks"]) & ~far, np.zeros(len(made), int)
        count = np.count_nonzero(made["found"])
        still = report and (lambda _: report(count))  # of what follows hardly any is an answer
        if asked.downhill:
            nearest(made, known & (made["found"] == 0))
        for less, done, tries in asked.longer():
            hard = sure & (made["found"] == 0) & asked.close(made["squares"], less)
            more(made, hard, still, done=int(done), tries=int(tries), budget=ENDLESS)
        for status, bounds, tries in asked.beyond():
            wide = dict(zip(("low", "high", "jump"), (*bounds, np.full(asked.chain.n, np.inf)), strict=True))
            which = known & sure & (made["found"] == 0) & (why == 0)
            there = made.copy()
            more(there, which, still, tries=int(tries), budget=ENDLESS, **wide)
            close = which & (there["found"] == 0) & asked.close(there["costs"].min(axis=1, keepdims=True))
            nearest(there, close, roots=np.ones(asked.task.m), **wide)
            why[which] = asked.meaning(status, there["found"] != 0, there["squares"])[which]
        return asked.reached(pose, near, *self._answers(made), sure, why)

    def _answers(self, made):
        return *(made[name] for name in ("q", "squares", "steep", "looks")), made["found"] != 0

    def _rows(self, count):
        """Rows of the record for so many targets."""
        return np.empty((count, width(self.asked.chain.n)))

    def _call(self, made, pose, near, **others):
        """What the C functions are given: arrays, and numbers in the place of what all calls share.

        It holds the arrays: threads that an exception has left alone still write to them.
        """
        call = _Call.from_buffer_copy(self.shared)
        call.held = arrays = {"made": made, "pose": np.ascontiguousarray(pose, float)}
        if near is not None:
            arrays["near"] = np.ascontiguousarray(near, float)
        for name, value in others.items():
            if isinstance(value, np.ndarray):
                arrays[name] = value
            elif value is not None:
                setattr(call, name, value)
        for name, value in arrays.items():
            setattr(call, name, value.ctypes.data)
        return call

    def _run(self, made, pose, near, report=None, **others):
        """One call of the C function, on all cores. `report` is called with how many are found, again and again."""
        call, B = self._call(made, pose, near, **others), len(made)
        if B <= SMALLEST:
            self.library.search(ctypes.byref(call), 0, B)
            return
        size = max(min(BLOCK, -(-B // (4 * cores()))), SMALLEST)

        def block(first):
            self.library.search(ctypes.byref(call), first, min(first + size, B))

        with side_by_side() as pool:
            for _ in pool.map(block, range(0, B, size)):
                if report is not None:
                    report(int(np.count_nonzero(made["found"])))
