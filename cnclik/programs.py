"""Programs kept whole between runs: what an earlier process has traced and compiled is loaded, and not made again.

JAX's own cache knows a program by its text, which has to be traced first: most of what is waited for the second time.
Here it is known by all that its text is made of: the function with all that it has got hold of, and the source of this
package; literals, shapes and types of its arguments; JAX's settings and its version; the environment and the machine.
A program of what can't be told so, as of a function of the user's, is left to JAX's own cache.
"""

import contextlib
import contextvars
import dataclasses
import functools
import hashlib
import io
import marshal
import os
import pathlib
import pickle
import sys
import time
import types

import jax
import numpy as np

from cnclik.cache import LRU
from cnclik.compilation import machine
from cnclik.reading import read_bytes

_BEGUN = time.time()  # sources that are younger are not what this process runs
_NUMBERS = (bool, int, float, complex)
_ARRAYS = (np.ndarray, np.generic, jax.Array)
# What says that a program can't be written down: JAX's own are RuntimeErrors and ValueErrors.
_NOT_KEPT = (OSError, RuntimeError, ValueError, TypeError, AttributeError, pickle.PicklingError)
# Packages whose names say what they mean.
_KNOWN = ("builtins", "cnclik", "collections", "jax", "jaxlib", "numpy", "optax")
# Beginnings of variables of the environment that programs depend on.
_SWITCHES = ("CC", "CFLAGS", "CNCLIK_", "JAX_", "XLA_")
ENDING = "-cache"  # of files' names, as JAX's own
place = None  # where programs are kept; None: nowhere
loaded = LRU()  # by this process
_needed = contextvars.ContextVar("what the program that is being made needs", default=None)


class _UnknownError(Exception):
    """Something that names no program."""


class _Place:
    """Where an array stands in arguments or results, and what is known of it beforehand."""

    def __init__(self, value, *_):
        self.shape, self.weak = np.shape(value), isinstance(value, _NUMBERS) or bool(getattr(value, "weak_type", False))
        self.kind = type(value).__name__ if isinstance(value, _NUMBERS) else str(value.dtype)


class _Pickler(pickle.Pickler):
    def reducer_override(self, value):
        package = str(getattr(value, "__module__", None)).partition(".")[0]
        if (callable(value) or isinstance(value, type)) and package not in _KNOWN:
            raise _UnknownError
        if dataclasses.is_dataclass(value) and not isinstance(value, type):  # and not what else it remembers
            return _Place, (0, type(value), [getattr(value, f.name) for f in dataclasses.fields(value)])
        if package != "cnclik" or not isinstance(value, types.FunctionType):
            return NotImplemented
        if value.__globals__["__name__"] != value.__module__:  # a wrapper with our function's name
            raise _UnknownError
        # Our own, also one that is made anew by each call: by its code and what it has got hold of.
        held = [cell.cell_contents for cell in value.__closure__ or ()]
        code = marshal.dumps(value.__code__, 0)
        return _Place, (0, value.__module__, code, value.__defaults__, value.__kwdefaults__, held)


def keep(folder) -> None:
    """Keep programs in a folder, one that only its owner may write; None: keep none."""
    global place
    place = None if folder is None else pathlib.Path(folder)


def keeping() -> bool:
    """Whether programs are kept at all."""
    return place is not None


def kept(fn, context, options, static, args, named):
    """What fn gives for arguments, by a program that was kept, or is now; None where it can't be.

    Args:
      fn: the pure function, from this package. static: names of arguments that are compiled in.
      context: all that tracing depends on besides, in values that can be pickled.
      options: the compiler's.
      args, named: fn's.
    """
    if jax.default_backend() != "cpu" or jax.config.jax_disable_jit:
        return None
    asked = _asked(fn, context, options, static, args, named)
    if asked is None:
        return None
    key, leaves, make = asked
    program, results = loaded.made(key, lambda key: _read(key) or _made(key, leaves, make, options))
    return jax.tree.unflatten(jax.tree.structure(results), program(*leaves))


def _asked(fn, context, options, static, args, named):
    """(key, leaves, the function of these leaves alone), or None where arguments are traced or can't be named."""
    compiled_in = {name: value for name, value in named.items() if name in static}
    others = {name: value for name, value in named.items() if name not in static}
    leaves, tree = jax.tree.flatten((args, others))
    if any(isinstance(leaf, jax.core.Tracer) or not isinstance(leaf, (*_NUMBERS, *_ARRAYS)) for leaf in leaves):
        return None
    key = name_of((fn, context, options, compiled_in), (args, others))
    if key is None:
        return None

    def make(*leaves):
        args, others = jax.tree.unflatten(tree, leaves)
        return fn(*args, **others, **compiled_in)

    return key, leaves, make


def name_of(about, arguments):
    """What a program is kept by: all it depends on, JAX's settings and what processes share; None: it is not kept.

    Args: about: functions and values that are compiled in. arguments: a tree of arrays, whose shapes and types count.
    """
    if not keeping():
        return None
    settings = sorted((name, repr(value)) for name, value in jax.config.values.items())
    text = io.BytesIO()
    try:
        pickler = _Pickler(text, protocol=5)
        pickler.fast = True  # by what things are, and not by which of them are the same
        pickler.dump((about, jax.tree.map(_Place, arguments), settings))
        return hashlib.sha256(text.getvalue() + surroundings()).hexdigest()
    except (_UnknownError, pickle.PicklingError, TypeError, ValueError, AttributeError, RecursionError):
        return None


@functools.cache
def surroundings() -> bytes:
    """A digest of what all programs of a process share: versions, this package's source, the environment."""
    from importlib.metadata import version

    here, digest = pathlib.Path(__file__).parent, hashlib.sha256(machine().encode())
    switches = sorted((k, v) for k, v in os.environ.items() if k.startswith(_SWITCHES))
    versions = sys.version, *(version(name) for name in ("jax", "jaxlib", "numpy", "optax"))
    digest.update(repr((versions, switches, len(jax.devices()))).encode())
    for file in sorted((*here.rglob("*.py"), *here.rglob("c/*.[ch]"))):
        if file.stat().st_mtime >= _BEGUN:
            raise _UnknownError
        digest.update(file.relative_to(here).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.digest()


def _made(key, leaves, make, options):
    """(program, what it returns with a place for each array), compiled now and kept where that is possible."""
    outcome = {}

    def flat(*leaves):
        arrays, tree = jax.tree.flatten(make(*leaves))
        outcome["results"] = jax.tree.unflatten(tree, map(_Place, arrays))
        return arrays

    flat.__name__ = f"kept_{key}"  # a name that JAX's own cache doesn't know: what comes from there can't be kept again
    before = _needed.set([])
    try:
        lowered = jax.jit(flat, compiler_options=options or None).lower(*leaves)
        needed = _needed.get()
    finally:
        _needed.reset(before)
    from jax._src.config import persistent_cache_min_compile_time_secs as kept_by_jax_from

    with kept_by_jax_from(float("inf")):
        program = lowered.compile()
    results = outcome["results"]
    from jax.experimental import serialize_executable

    remember(key, lambda: (serialize_executable.serialize(program), results, needed))
    return program, results


def needs(*call) -> None:
    """Tell that the program that is being made calls what another process has first to make ready, by this call.

    Args: call: a function of this package, and arguments that can be pickled.
    """
    if (needed := _needed.get()) is not None:
        needed.append(call)


def remember(key, value):
    """Keep what a program can be had from again by a name of `name_of`. Args: value: makes it, where it can be made."""
    with contextlib.suppress(*_NOT_KEPT):  # callbacks, a full disk: what isn't kept is made again
        whole = pickle.dumps(value(), protocol=5)
        beside = place / f".{key}-{os.getpid()}{ENDING}"
        try:
            beside.write_bytes(_seal(key, whole) + whole)
            beside.replace(place / f"{key}{ENDING}")
        finally:
            beside.unlink(missing_ok=True)


def recalled(key):
    """What was kept by a name; None where there is nothing that is whole."""
    with contextlib.suppress(Exception):  # whatever pickle makes of an entry of another version: there is another way
        whole = memoryview(read_bytes("cache", place / f"{key}{ENDING}", "a program"))
        return pickle.loads(whole[32:]) if _seal(key, whole[32:]) == whole[:32] else None


def _seal(key, whole) -> bytes:
    """What stands before an entry: it is whole, and of no other program."""
    return hashlib.sha256(key.encode() + whole).digest()


@functools.cache
def _know_lapack():
    """JAX finds LAPACK when it first writes a program that calls it; one that is loaded would call nothing."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), "float32"))


def _read(key):
    """(program, results) as `_made`, or None where there is none that is whole."""
    begun = time.time()
    try:
        from jax.experimental import serialize_executable

        _know_lapack()
        serialized, results, needed = recalled(key)
        for ready, *args in needed:
            ready(*args)
        program = serialize_executable.deserialize_and_load(*serialized)
    except Exception:  # whatever XLA makes of another machine's program: there is another way
        return None
    # As JAX tells of a program from its own cache; `--timings` counts both.
    jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
    jax.monitoring.record_event_time_span("/jax/core/compile/backend_compile_duration", begun, time.time())
    return program, results
