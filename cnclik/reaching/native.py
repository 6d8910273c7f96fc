"""Native: the search for targets as C, built by the system's compiler where it has one.

The same tries as those of `search`, but one after the other and all in float64: a target's lane is free for the next
as soon as it has arrived. Built in a second, where JAX compiles for ten.
"""

import ctypes
import pathlib
import tempfile
import warnings

import numpy as np

from cnclik import errors
from cnclik.hints import hints_on
from cnclik.native.arrays import UnsupportedError
from cnclik.native.compiler import build, can_build, closed_after, opened
from cnclik.reaching.asked import Asked
from cnclik.reaching.native_source import native_source
from cnclik.reaching.result import Reached, as_rows, fields, from_rows, width
from cnclik.reaching.search import PLACES, setup_of
from cnclik.reaching.single import FAR
from cnclik.record import kept, replace
from cnclik.robot.posture import start_posture
from cnclik.threads import cores, side_by_side

AT_ONCE, FEW = 4, 32  # chains that are not asked of often, and targets that are sooner searched for in other ways
BLOCK, SMALLEST = 4096, 256  # targets that a core searches for at a time
FIRST = 16  # tries of all targets; nearly all need no more
TRIES_BEYOND = 48  # of the search that tells why there is no answer
_ENDLESS = 1 << 40  # looks
_NUMBERS = ("cost", "steep", "looks", "found")
_POINTERS = ("low", "high", "lower", "upper", "turns", "postures", "middle", "width", "features", "factors", "roots")


class _Call(ctypes.Structure):
    """`Asked` of the C source."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("pose", "near", "made", "rows", *_POINTERS)),
        *(("tolerance", ctypes.c_double * 2), ("jump", ctypes.c_double)),
        *((name, ctypes.c_int64) for name in ("done", "tries", "budget", "seed", "downhill")),
    )


def native_for(asked: Asked, targets: int, soon: bool):
    """The native search for so many targets; None where there is no compiler, or it isn't worth its while.

    The first few chains of a process have it at once; in a loop over many, each asked of a few targets, the rolled
    programs, which serve all chains, are sooner ready.

    Args: soon: whether the chain has been asked of often.
    """
    if not hints_on():
        return None
    made = asked.__dict__.get("_native")
    if made is None:
        name = f"_native_{asked.task.position}_{asked.task.orientation}_{asked.task.weights is None}"
        if not (soon or targets > FEW or Native.libraries < AT_ONCE or name in asked.chain.__dict__):
            return None
        library = kept(asked.chain, name, lambda _: can_build() and _built(asked))
        made = kept(asked, "_native", lambda asked: library and Native(asked, library))
    return made or None


def _built(asked):
    """The C library, or False where it can't be built."""
    try:
        text = native_source(asked.chain, asked.unweighted()[0], asked.task.weights is not None)
        with tempfile.TemporaryDirectory(prefix="cnclik-reach-") as folder:  # not needed once it is open
            source = pathlib.Path(folder, "reach_lanes.c")
            source.write_text(text, encoding="utf-8")
            library = closed_after(opened(build([source], folder, flags=["-O2"])))
    except (errors.ArgumentError, UnsupportedError, OSError) as error:
        warnings.warn(f"reach runs without native code: {error}", stacklevel=2)
        return False
    of = (ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)
    library.search.restype, library.search.argtypes = None, of
    library.along.restype, library.along.argtypes = ctypes.c_int64, (ctypes.c_void_p, *of)
    Native.libraries += 1
    return library


class Native:
    """The native search for what is asked."""

    libraries = 0  # that this process has built

    def __init__(self, asked: Asked, library):
        setup, n = setup_of(asked), asked.chain.n
        (lower, upper), wide = asked.limited(), asked.beyond()
        turns = np.where(np.array(asked.chain.periodic) & np.isinf(lower) & np.isinf(upper), 2 * np.pi, 0.0)
        roots = np.ones(asked.task.m) if setup.roots is None else setup.roots
        given = {"low": lower, "high": upper, "lower": lower, "upper": upper, "turns": turns, "roots": roots}
        given |= {name: getattr(setup.seeds, name) for name in ("postures", "middle", "width")}
        given = {name: np.ascontiguousarray(v, float) for name, v in given.items()}
        given |= {"features": setup.compared.features, "factors": setup.compared.factors}
        self.asked, self.library, self.tries = asked, library, setup.tries
        self.wide = wide and dict(zip(("low", "high"), wide, strict=True)) | {"jump": np.inf}
        self.given = given  # what the pointers point to
        numbers = {"tolerance": tuple(setup.tolerance), "budget": setup.budget, "seed": setup.seed}
        numbers["jump"] = np.inf if asked.jump is None else float(asked.jump)
        self.shared = _Call(**numbers, **{name: v.ctypes.data for name, v in given.items()})
        fields = [("q", float, (n,)), ("squares", float, (2,)), *((name, float) for name in _NUMBERS)]
        self.made = np.dtype([*fields, ("places", float, (PLACES, n)), ("costs", float, (PLACES,))])

    def reached(self, pose, near, progress=None) -> Reached:
        """Answers for (B, 12) targets, near (B, n) or None."""
        made, rows = self._blank(len(pose))
        self._run(made, pose, near, progress, rows=rows.ctypes.data, tries=min(FIRST, self.tries))
        if not made["found"].all():
            left = np.flatnonzero(made["found"] == 0)
            told = self._told(made[left], pose[left], None if near is None else near[left])
            rows[left] = as_rows(fields(told))
        if progress is not None:
            progress(len(pose), len(pose))
        return from_rows(self.asked.chain, self.asked.task, rows)

    def along(self, pose, progress=None) -> Reached:
        """Answers for the targets of a path, each from the answer before it; where there was none, from the last one.

        What is nearest to the first waypoint is not held to `jump`.
        """
        asked, start = self.asked, start_posture(self.asked.chain, self.asked.task)
        first = self if asked.jump is None else Native(replace(asked, jump=FAR), self.library)
        found = first.reached(pose[:1], start[None])
        made, rows = self._blank(len(pose))
        near = np.tile(start, (len(pose) + 1, 1))
        call, k = self._call(made, pose, near, rows=rows.ctypes.data, tries=min(FIRST, self.tries)), 0
        while True:
            if found is not None:
                rows[k] = as_rows(fields(found))[0]
                near[k + 1] = found.q[0] if found.solved[0] else near[k]
                k += 1
            if progress is not None:
                progress(k, len(pose))
            if k == len(pose):
                return from_rows(asked.chain, asked.task, rows)
            end = min(k + BLOCK, len(pose))
            k, found = self.library.along(ctypes.byref(call), near.ctypes.data, k, end), None
            if k < end:
                found = self._told(made[k : k + 1], pose[k : k + 1], near[k : k + 1])

    def from_starts(self, pose, near, start):
        """One careful search from each of (B, n) postures: what `Asked.reached` takes."""
        made, _ = self._blank(len(pose))
        made["places"][:, 0], made["costs"], made["cost"], made["looks"], made["found"] = start, np.inf, np.inf, 0, 0
        made["costs"][:, 0] = 0
        self._run(made, pose, near, downhill=1, tries=1, budget=_ENDLESS)
        return self._answers(made)

    def _told(self, made, pose, near) -> Reached:
        """The record of targets that the first tries have no answer for."""
        asked, beyond, far = self.asked, np.zeros(len(made), bool), self.asked.too_far(pose)
        known = np.isfinite(pose).all(axis=1) & (True if near is None else np.isfinite(near).all(axis=1))

        def more(which, **numbers):
            """Search on for some, of which what is found is returned."""
            ids = np.flatnonzero(which)
            part = made[ids]
            self._run(part, pose[ids], None if near is None else near[ids], **numbers)
            return ids, part

        ids, part = more(known & ~far, done=FIRST, tries=self.tries)
        made[ids] = part
        if asked.explain or asked.accept is not None:
            made["cost"][made["found"] == 0] = np.inf
            ids, part = more(known & (made["found"] == 0), downhill=1, tries=PLACES, budget=_ENDLESS)
            made[ids] = part
        if self.wide is not None:
            wide = {name: v if name == "jump" else v.ctypes.data for name, v in self.wide.items()}
            ids, part = more(known & ~far & (made["found"] == 0), tries=min(TRIES_BEYOND, self.tries), **wide)
            beyond[ids] = part["found"] != 0
        return asked.reached(pose, near, *self._answers(made), beyond)

    def _answers(self, made):
        return *(made[name] for name in ("q", "squares", "steep", "looks")), made["found"] != 0

    def _blank(self, count):
        """What a search for so many targets writes to: `Found` of the C source, and rows of the record."""
        return np.empty(count, self.made), np.empty((count, width(self.asked.chain.n)))

    def _call(self, made, pose, near, **numbers):
        """What the C functions are given."""
        call = _Call.from_buffer_copy(self.shared)
        call.pose, call.made = pose.ctypes.data, made.ctypes.data
        if near is not None:
            call.near = near.ctypes.data
        for name, value in numbers.items():
            setattr(call, name, value)
        return call

    def _run(self, made, pose, near, progress=None, **numbers):
        """One call of the C function, on all cores; `numbers` in the place of what all calls share."""
        call, B = self._call(made, pose, near, **numbers), len(made)
        where = ctypes.byref(call)
        if B <= SMALLEST:
            self.library.search(where, 0, B)
            return
        size = max(min(BLOCK, -(-B // (4 * cores()))), SMALLEST)

        def block(first):
            self.library.search(where, first, min(first + size, B))

        with side_by_side() as pool:
            for _ in pool.map(block, range(0, B, size)):
                if progress is not None:
                    progress(int((made["found"] != 0).sum()), B)
