"""Program: a function of one lane, built as a C library and called for a batch."""

import contextlib
import copy
import ctypes
import functools
import math
import pathlib
import tempfile
import time
from array import array

import jax
import numpy as np

from cnclik.cache import LRU
from cnclik.engine.compiler import CompilerError, SlowCompilerError, build_text, built, can_build, opened
from cnclik.engine.graph import SlowError, TooLargeError, UnsupportedError
from cnclik.engine.plan import most_nodes
from cnclik.engine.reader import read
from cnclik.engine.rounds import known_rounds, settled
from cnclik.engine.source import write
from cnclik.engine.tracing import to_be_read
from cnclik.threads import side_by_side

MOST_WORK = 64 << 20  # bytes of a tile's memory
FEW_TILES = 4  # at most, for a single thread
HUGE = 2 << 20  # bytes of a huge page: allocating small pages takes half as long again
CALLS = 4  # of each thread, so that slow lanes do not keep one core busy alone


class Program:
    """A function of one lane's arrays, of these avals, as a C library. Raises: UnsupportedError if it has no C form."""

    nodes = 0  # of the graph it was built from, or lines of its C if these are more
    rounds = 0  # those that a program of any number of rounds is asked for

    def __init__(self, fn, avals, *, single=False, quick=False, most=math.inf):
        """Args:
        single: for one lane only: it builds in half the time and is a little quicker.
        quick: it builds in half the time and runs some 5 % slower: fit for one that is waited for.
        most: nodes of its graph, and lines of its C.
        """
        if not can_build():
            raise UnsupportedError("there is no C compiler")
        with known_rounds():
            with to_be_read():
                graph, given, outs, (shapes, self.tree) = read(fn, *avals, most=most)
            shapes, grows = settled(shapes)
            text, self.operations = write(graph, given, outs, shapes, grows)
        self.nodes = max(graph.count, text.count("\n"))  # pieces load and store, and rows are written where used
        if self.nodes > most:
            raise TooLargeError(self.nodes)
        head = f"#define XLA_HANDLER\n#define FEW_TILES {FEW_TILES}\n#define CALLS {CALLS}\n"
        head += "#define BYTES MAIN\n" * single
        head += "#define LOADS __attribute__((noinline))\n" * quick
        scheduled = not (single or quick)
        build = functools.partial(build_text, head + text, include=[jax.ffi.include_dir()], scheduled=scheduled)
        self._have(avals, shapes, grows, build)

    @classmethod
    def kept(cls, avals, path, shapes, grows=()):
        """The program whose library another process has built. Raises: UnsupportedError if it no longer exists."""
        made = cls.__new__(cls)
        made._have(avals, jax.tree.leaves(shapes), grows, lambda folder: (built(folder, path), True))
        return made

    def _have(self, avals, shapes, grows, find):
        self.avals, self.shapes, self.grows = avals, shapes, grows
        self.library, self.path = _opened(find)
        self.lanes = self.library.width()
        self._find_work()

    def of_rounds(self, rounds):
        """The program of so many rounds, or the reason why there is none: they need too much memory."""
        found = copy.copy(self)
        found.rounds, pairs = rounds, zip(self.shapes, self.grows, strict=True)
        found.shapes = [s.update(shape=(s.shape[0] + rounds, *s.shape[1:])) if more else s for s, more in pairs]
        try:
            found._find_work()
        except UnsupportedError as error:
            return error
        return found

    def _find_work(self):
        self.work = self.library.work_bytes(self.rounds)
        if self.work > MOST_WORK:
            raise UnsupportedError(f"a tile needs {self.work >> 20} MiB of memory")

    def __call__(self, leaves, size, cores=1) -> list:
        """Results of a batch of `size` lanes, as NumPy arrays that `jax.device_put` takes without a copy.

        Args: leaves: arrays (size, ...), or (...) for what all lanes share.
        """
        made = [_empty((size, *s.shape), s.dtype) for s in self.shapes]
        rounds = ctypes.c_int32(self.rounds)
        given = Bound(self, ()), leaves, made, size, [ctypes.addressof(rounds)]
        if cores == 1 or size <= FEW_TILES * self.lanes:
            Bound.run(*given)
            return made
        with side_by_side(cores) as pool:
            Bound.run(*given, pool, cores)
        return made


class Bound:
    """A program with first arguments that stay, shared by all lanes of all calls: each call is some 20 µs quicker."""

    def __init__(self, program, kept):
        self.program, avals = program, program.avals
        self.kept = [np.asarray(x, a.dtype, order="C") for x, a in zip(kept, avals, strict=False)]
        self.given = [(a.dtype, len(a.shape), a.size) for a in avals[len(kept) :]]
        self.places, self.zeros = [x.ctypes.data for x in self.kept], [0] * len(kept)

    def __call__(self, leaves, size, pool=None, cores=1) -> list:
        """Return the results of a batch, as `Program` does, without their alignment. Args: leaves: the others."""
        made = [np.empty((size, *s.shape), s.dtype) for s in self.program.shapes]
        self.run(leaves, made, size, (0,), pool, cores)
        return made

    def run(self, leaves, made, size, more, pool=None, cores=1):
        """Fill the results, on the threads of a pool. Args: more: the address of what the C has beside the function's."""
        program, given = self.program, self.given
        leaves = [np.asarray(x, dtype, order="C") for x, (dtype, _, _) in zip(leaves, given, strict=True)]
        strides = [size_ if x.ndim > rank else 0 for x, (_, rank, size_) in zip(leaves, given, strict=True)]
        ins = array("Q", [*self.places, *[x.ctypes.data for x in leaves], *more])  # quicker than arrays of ctypes
        strides, out = array("q", self.zeros + strides), array("Q", [x.ctypes.data for x in made])
        places = [v.buffer_info()[0] for v in (ins, strides, out)]

        def part(
            start, end, held=(leaves, made, ins, strides, out)
        ):  # for as long as threads work, also after an exception
            memory = np.empty(program.work, np.uint8)
            program.library.run(start, end, *places, memory.ctypes.data)

        if pool is None:
            part(0, size)
            return
        step = -(-size // (CALLS * cores * program.lanes)) * program.lanes
        for _ in pool.map(lambda start: part(start, min(start + step, size)), range(0, size, step)):
            pass


def _empty(shape, dtype):
    """An array aligned to 64 bytes, as JAX's are, or to a huge page if it is large."""
    size = int(np.prod(shape)) * dtype.itemsize
    unit = 64 if size < HUGE else HUGE
    whole = np.empty(-(-size // unit) * unit + unit, np.uint8)
    return whole[-whole.ctypes.data % unit :][:size].view(dtype).reshape(shape)


def _opened(find):
    """(the library that `find` returns for a folder, its name)"""
    begun = time.time()
    folder = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    try:
        with contextlib.nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="cnclik-") as place:
            path, kept = find(pathlib.Path(place))
            library = opened(path)  # an open library needs no temporary file
    except (CompilerError, OSError) as error:
        slow = isinstance(error, SlowCompilerError)
        raise (SlowError if slow else UnsupportedError)(f"the C compiler failed: {error}") from None
    if kept:  # logged as JAX logs its own cache
        jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
    jax.monitoring.record_event_time_span("/jax/core/compile/backend_compile_duration", begun, time.time())
    library.width.restype = library.work_bytes.restype = ctypes.c_int64
    library.work_bytes.argtypes = (ctypes.c_int64,)
    library.run.restype = None
    library.run.argtypes = (ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4)
    return library, path.name


class Programs:
    """The programs of a function of flat arguments, by argument types; the reason where there is none."""

    def __init__(self, fn, make=Program, most=most_nodes):
        """Args: make: makes a program from (fn, avals, most=): `Program` or `to_jax.Derived`; most: what most is."""
        self.fn, self.make, self.most, self.found = fn, make, most, LRU()

    def of(self, avals, most=None):
        """The program for flat arguments of these avals, or the reason why there is none.

        Args: most: nodes of its graph, and lines of its C.
        """
        key, most = key_of(avals), self.most() if most is None else most
        found = self.found.get(key)
        if found is None or (isinstance(found, TooLargeError) and found.nodes <= most):
            found = self.found[key] = self._made(avals, most)
        return found

    def known(self, avals):
        """The same if it was requested before, otherwise None."""
        return self.found.get(key_of(avals))

    def _made(self, avals, most):
        try:
            return self.make(self.fn, avals, most=most)
        except UnsupportedError as error:
            return error


def key_of(avals) -> tuple:
    """The key of a function's program: its argument types, and whether JAX is in 64 bits."""
    types = ((a.shape, str(a.dtype), getattr(a, "weak_type", False)) for a in avals)
    return jax.config.jax_enable_x64, *types  # type: ignore[attr-defined]


def lane_avals(leaves, *, batched=True) -> list:
    found = []
    for x in leaves:
        a = jax.typeof(x)
        found.append(jax.ShapeDtypeStruct(a.shape[1:] if batched else a.shape, a.dtype, weak_type=a.weak_type))
    return found
