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
import platform
import stat
import sys
import time
import types
import warnings

import jax
import numpy as np

from cnclik.cache import LRU
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
ENDING = "-program"  # of files' names; JAX, if told a size, wants the time of each "-cache" in a file beside it
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
    # As JAX tells of a program from its own cache.
    jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
    jax.monitoring.record_event_time_span("/jax/core/compile/backend_compile_duration", begun, time.time())
    return program, results


# --- JAX's persistent compilation cache, in a folder of the user's own --------------------------------
# An entry is code that will be run: the folder is readable and writable by its owner alone. Homes are shared between
# machines: each version of jaxlib and each kind of processor has a sub-folder.


MOST_BYTES = 1 << 30  # of all programs kept; what was used longest ago goes first
LEAST_SECONDS = 0.0  # of compiling, for a program to be kept: a hundred small ones take longer than a large one


def use_cache(folder: str | os.PathLike | None = None, *, most_bytes: int = MOST_BYTES) -> pathlib.Path | None:
    """Keep compiled programs in a folder, and take them from there; the command line calls this.

    The environment has the last word: JAX_ENABLE_COMPILATION_CACHE=0 switches it off, and where
    JAX_COMPILATION_CACHE_DIR (or `jax.config`) names a folder and `folder` is None, that is used as it is, without a
    limit of its size. A folder that can't be written, or that others may write, is no error: nothing is kept.

    Args:
      folder: by default `cnclik` in the user's cache folder (XDG_CACHE_HOME, ~/.cache; ~/Library/Caches on macOS).
      most_bytes: size down to which the folder is cut now, by leaving out what was used longest ago.

    Returns: where programs are kept, or None.
    """
    if not jax.config.jax_enable_compilation_cache:  # type: ignore[attr-defined]
        return None
    _keep_quick_programs()
    named = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if folder is None and named:
        return pathlib.Path(named)
    try:
        own = _private(pathlib.Path(folder) if folder is not None else user_folder())
        place = _private(own / machine())
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        return None
    cut(own, most_bytes)
    if str(place) != named:
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()  # one that is in use keeps its folder
        jax.config.update("jax_compilation_cache_dir", str(place))
    return place


def user_folder() -> pathlib.Path:
    """Where this user's programs keep what can be made again, cnclik's part of it."""
    named = os.environ.get("XDG_CACHE_HOME")
    if named and os.path.isabs(named):  # others are to be ignored, says the XDG specification
        return pathlib.Path(named, "cnclik")
    home = pathlib.Path.home()
    return (home / "Library" / "Caches" if sys.platform == "darwin" else home / ".cache") / "cnclik"


def machine() -> str:
    """Name of the version of jaxlib and the kind of processor that a program is compiled for."""
    import jaxlib

    kind = [platform.system(), platform.machine(), platform.processor()]
    with contextlib.suppress(OSError), open("/proc/cpuinfo") as info:
        kind += sorted({row for row in info if row.startswith(("model name", "flags", "Features", "CPU part"))})
    return f"jaxlib-{jaxlib.__version__}-{hashlib.sha256(repr(kind).encode()).hexdigest()[:12]}"


def cut(folder: pathlib.Path, most_bytes: int) -> None:
    """Remove the programs in a folder that were used longest ago, until the rest fits, and what is no file where a
    program's should be: a link may lead to a device without an end."""
    found = []
    for path in (p for end in ("-cache", ENDING, ".so") for p in folder.glob(f"jaxlib-*/*{end}")):
        with contextlib.suppress(OSError):  # another process may be at it, too
            about = path.lstat()
            if stat.S_ISREG(about.st_mode):
                found.append((max(about.st_atime, about.st_mtime), about.st_size, path))
            elif not stat.S_ISDIR(about.st_mode):
                path.unlink()
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= most_bytes:
            return
        with contextlib.suppress(OSError):
            path.unlink()
            total -= size


def _keep_quick_programs() -> None:
    """JAX would keep what took a second; and an entry that can't be read or written is no matter for the terminal."""
    for name, value in (("min_compile_time_secs", LEAST_SECONDS), ("min_entry_size_bytes", -1)):
        if f"JAX_PERSISTENT_CACHE_{name.upper()}" not in os.environ:
            jax.config.update(f"jax_persistent_cache_{name}", value)
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")


def _private(folder: pathlib.Path) -> pathlib.Path:
    """The folder, there and its owner's alone. Raises OSError where it can't be written, or others may write it."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.stat()
    theirs = hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022)
    if theirs or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(str(folder))
    return folder
