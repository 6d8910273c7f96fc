"""Program: a function of one lane, built as a C library and called for a batch."""

import contextlib
import ctypes
import functools
import math
import pathlib
import tempfile
import time
from array import array

import jax
import numpy as np

from cnclik.engine.compiler import build_text, can_build, opened
from cnclik.engine.graph import SlowError, UnsupportedError
from cnclik.engine.reader import Trace, read, trace
from cnclik.engine.source import write
from cnclik.threads import side_by_side

MOST_WORK = 64 << 20  # bytes of a tile's memory
FEW_TILES = 4  # at most, for a single thread
HUGE = 2 << 20  # bytes of a huge page: allocating small pages takes half as long again
CALLS = 4  # of each thread, so that slow lanes do not keep one core busy alone


class Program:
    """A function of one lane's arrays, of these avals, as a C library. Raises: UnsupportedError if it has no C form."""

    def __init__(self, fn, avals, *, single=False, most=math.inf):
        """Args:
        fn: the function, or its `Trace`.
        single: for one lane only: it builds in half the time and is a little quicker.
        most: nodes of its graph, and lines of its C.
        """
        if not can_build():
            raise UnsupportedError("there is no C compiler")
        closed, shapes, self.tree, _ = fn if isinstance(fn, Trace) else trace(fn, avals)
        self.avals, self.shapes = avals, shapes
        text, self.operations = write(*read(closed, most=most), shapes)
        if (lines := text.count("\n")) > most:  # rows are written where they are used
            raise SlowError(f"a program of {lines} lines of C takes long to build")
        head = f"#define XLA_HANDLER\n#define FEW_TILES {FEW_TILES}\n#define CALLS {CALLS}\n"
        head += "#define BYTES MAIN\n" * single
        self.library, self.path = _built(head + text, scheduled=not single)
        self.lanes = self.library.width()
        self.work = self.library.work_bytes()
        if self.work > MOST_WORK:
            raise UnsupportedError(f"a tile needs {self.work >> 20} MiB of memory")

    def __call__(self, leaves, size, cores=1) -> list:
        """Return the results of a batch of `size` lanes, as NumPy arrays that `jax.device_put` takes without a copy.

        Args: leaves: arrays (size, ...), or (...) for what all lanes share.
        """
        return Bound(self, ())(leaves, size, cores)


class Bound:
    """A program with first arguments that stay, shared by all lanes of all calls: each call is some 20 µs quicker."""

    def __init__(self, program, kept):
        self.program, avals = program, program.avals
        self.kept = [np.asarray(x, a.dtype, order="C") for x, a in zip(kept, avals, strict=False)]
        self.given = [(a.dtype, len(a.shape), a.size) for a in avals[len(kept) :]]
        self.places, self.zeros = [x.ctypes.data for x in self.kept], [0] * len(kept)

    def __call__(self, leaves, size, cores=1) -> list:
        """Return the results of a batch, as `Program` does. Args: leaves: the other arguments."""
        program, given = self.program, self.given
        made = [_empty((size, *s.shape), s.dtype) for s in program.shapes]
        leaves = [np.asarray(x, dtype, order="C") for x, (dtype, _, _) in zip(leaves, given, strict=True)]
        strides = [size_ if x.ndim > rank else 0 for x, (_, rank, size_) in zip(leaves, given, strict=True)]
        ins = [*self.places, *[x.ctypes.data for x in leaves]]
        ins, out = array("Q", ins), array("Q", [x.ctypes.data for x in made])  # quicker than arrays of ctypes
        strides = array("q", self.zeros + strides)
        places = [v.buffer_info()[0] for v in (ins, strides, out)]

        held = leaves, made, ins, strides, out  # for as long as threads work, also after an exception

        def part(start, end, held=held):
            memory = np.empty(program.work, np.uint8)
            program.library.run(start, end, *places, memory.ctypes.data)

        if cores == 1 or size <= FEW_TILES * program.lanes:
            part(0, size)
            return made
        step = -(-size // (CALLS * cores * program.lanes)) * program.lanes
        with side_by_side(cores) as pool:
            for _ in pool.map(lambda start: part(start, min(start + step, size)), range(0, size, step)):
                pass
        return made


def _empty(shape, dtype):
    """Return an array aligned to 64 bytes, as JAX's are, or to a huge page if it is large."""
    size = math.prod(shape) * dtype.itemsize
    unit = 64 if size < HUGE else HUGE
    whole = np.empty(-(-size // unit) * unit + unit, np.uint8)
    return whole[-whole.ctypes.data % unit :][:size].view(dtype).reshape(shape)


def _built(text, *, scheduled):
    """Return (the library of a C text, its file's name), kept where JAX keeps its compiled programs."""
    begun = time.time()
    folder = jax.config.jax_compilation_cache_dir if jax.config.jax_enable_compilation_cache else None
    try:
        with contextlib.nullcontext(folder) if folder else tempfile.TemporaryDirectory(prefix="cnclik-") as place:
            include = [jax.ffi.include_dir()]
            path, kept = build_text(text, pathlib.Path(place), include=include, scheduled=scheduled)
            library = opened(path)  # an open library needs no temporary file
            library.width.restype = library.work_bytes.restype = ctypes.c_int64
            library.run.restype = None
            library.run.argtypes = (ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * 4)
    except (OSError, AttributeError) as error:  # AttributeError: what it built has no such functions
        raise UnsupportedError(f"the C compiler failed: {error}") from None
    if kept:  # logged as JAX logs its own cache
        jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
    jax.monitoring.record_event_time_span("/jax/core/compile/backend_compile_duration", begun, time.time())
    return library, path.name


def key_of(avals) -> tuple:
    """Return the key of a function's program: its argument types, and whether JAX is in 64 bits."""
    types = ((a.shape, str(a.dtype), getattr(a, "weak_type", False)) for a in avals)
    return jax.config.jax_enable_x64, *types  # type: ignore[attr-defined]


canonical = functools.partial(jax.dtypes.canonicalize_dtype, allow_extended_dtype=True)  # in 32 bits what has 64


def lane_avals(leaves, *, batched=True) -> list:
    """Return the avals of one lane's arguments, as JAX takes them."""
    avals = map(jax.typeof, leaves)
    return [jax.ShapeDtypeStruct(a.shape[batched:], canonical(a.dtype), weak_type=a.weak_type) for a in avals]
