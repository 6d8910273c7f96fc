"""Caches of programs: bounded ones in memory, as a process meets new literals and lambdas all day, and one on disk."""

import collections
import contextlib
import ctypes
import functools
import gc
import hashlib
import os
import pathlib
import platform
import sys
import warnings

import jax
import jaxlib

KEPT_PROGRAMS = 128  # of an `LRU`
MOST_PROGRAMS = 32  # of one function of `bounded_jit`, at some 6 MiB and 200 mappings of memory each
KEPT_TRACES = 16  # programs, for which JAX keeps what it traced on the way to them, some 8 MiB each


class LRU(collections.OrderedDict):
    """A dict of at most KEPT_PROGRAMS entries: what was asked for longest ago makes room."""

    def get(self, key, default=None):
        """The value of a key, which thereby becomes the newest."""
        with contextlib.suppress(KeyError):  # there is none, or another thread has let it go
            self.move_to_end(key)
            return self[key]
        return default

    def made(self, key, make):
        """The value of a key; where there is none, make(key)."""
        value = self.get(key)
        if value is None:
            value = self[key] = make(key)
        return value

    def __setitem__(self, key, value):
        super().__setitem__(key, value)
        while len(self) > KEPT_PROGRAMS:
            self.popitem(last=False)


_traced = []  # once for each program of all functions, since what JAX keeps of them was last forgotten


def bounded_jit(fn, **options):
    """`jax.jit` that forgets its programs when there are more than MOST_PROGRAMS.

    Numbers of steps, literals and lambdas are parts of a program: a process meets new ones all day.
    """
    made = []  # once for each program; within a gradient or a batch jit's own count knows nothing of them

    @functools.wraps(fn)
    def counted(*args, **kwargs):
        made.append(None)
        _traced.append(None)
        return fn(*args, **kwargs)

    jitted = jax.jit(counted, **options)

    @functools.wraps(fn)
    def call(*args, **kwargs):
        result = jitted(*args, **kwargs)
        if len(made) > MOST_PROGRAMS:
            jitted.clear_cache()
            made.clear()
        if len(_traced) > KEPT_TRACES:
            _forget_traces()
        return result

    return call


def _forget_traces():
    """Drop what JAX keeps of tracing, up to 2,048 pieces of each of many kinds. What is compiled stays, and runs."""
    with contextlib.suppress(ImportError, AttributeError):  # another version of JAX, which keeps them
        from jax._src import core, util

        if not core.trace_state_clean():
            return  # in the midst of tracing: the next call tries again
        util.clear_all_caches()
    _traced.clear()
    give_back()


def give_back():
    """Hand memory that is free back to the system: C's library on Linux keeps it, in pieces that nothing else fits."""
    gc.collect()
    with contextlib.suppress(OSError, TypeError, AttributeError):  # another system, another library
        ctypes.CDLL(None).malloc_trim(0)


# --- JAX's persistent compilation cache, and the engine's libraries, in a folder of the user's own -----
# An entry is code that will be run: the folder is readable and writable by its owner alone. Homes are shared between
# machines: each version of jaxlib and each kind of processor has a sub-folder.

MOST_BYTES = 1 << 30  # of all programs kept; what was used longest ago goes first


def use_cache(folder: str | os.PathLike | None = None) -> pathlib.Path | None:
    """Keep compiled programs in a folder, and take them from there; the command line calls this.

    JAX_ENABLE_COMPILATION_CACHE=0 switches it off. Where JAX_COMPILATION_CACHE_DIR (or `jax.config`) names a folder and
    `folder` is None, that is used as it is; all others are cut to 1 GiB, by what was used longest ago.

    Args: folder: by default `cnclik` in the user's cache folder (XDG_CACHE_HOME, ~/.cache; ~/Library/Caches on macOS).
    Returns: where programs are kept, or None: the folder can't be written, or others may write it.
    """
    if not jax.config.jax_enable_compilation_cache:  # type: ignore[attr-defined]
        return None
    for name, value in (("min_compile_time_secs", 0.0), ("min_entry_size_bytes", -1)):  # JAX keeps what took a second
        if f"JAX_PERSISTENT_CACHE_{name.upper()}" not in os.environ:
            jax.config.update(f"jax_persistent_cache_{name}", value)
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    named = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if folder is None and named:
        return pathlib.Path(named)
    try:
        own = _private(pathlib.Path(folder) if folder is not None else user_folder())
        place = _private(own / machine())
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        return None
    cut(own, MOST_BYTES)
    if str(place) != named:
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()  # one that is in use keeps its folder
        jax.config.update("jax_compilation_cache_dir", str(place))
    return place


def user_folder() -> pathlib.Path:
    """Where this user's programs keep what can be made again, cnclik's part of it."""
    usual = "Library/Caches" if sys.platform == "darwin" else ".cache"
    return pathlib.Path.home() / (os.environ.get("XDG_CACHE_HOME") or usual) / "cnclik"


def machine() -> str:
    """Name of the version of jaxlib and the kind of processor that a program is compiled for."""
    kind = [platform.system(), platform.machine(), platform.processor()]
    with contextlib.suppress(OSError), open("/proc/cpuinfo") as info:
        kind += sorted({row for row in info if row.startswith(("model name", "flags", "Features", "CPU part"))})
    return f"jaxlib-{jaxlib.version.__version__}-{hashlib.sha256(repr(kind).encode()).hexdigest()[:12]}"


def cut(folder: pathlib.Path, most_bytes: int) -> None:
    """Remove the programs in a folder that were used longest ago, so that the rest fits."""
    found, total = [], 0
    for path in (p for end in ("-cache", ".so") for p in folder.glob(f"jaxlib-*/*{end}")):
        with contextlib.suppress(OSError):  # another process may be at it, too
            about = path.lstat()
            found.append((max(about.st_atime, about.st_mtime), about.st_size, path))
    for _, size, path in sorted(found, reverse=True):
        total += size
        if total > most_bytes:
            with contextlib.suppress(OSError):
                path.unlink()


def _private(folder: pathlib.Path) -> pathlib.Path:
    """The folder, there and its owner's alone. Raises OSError where it can't be written, or others may write it."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    about = folder.stat()
    theirs = hasattr(os, "getuid") and (about.st_uid != os.getuid() or about.st_mode & 0o022)
    if theirs or not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(str(folder))
    return folder
