"""Compiled programs kept between runs: JAX's persistent compilation cache, in a folder of the user's own.

An entry is code that will be run: the folder is readable and writable by its owner alone. Homes are shared between
machines: each version of jaxlib and each kind of processor has a sub-folder.
"""

import contextlib
import hashlib
import os
import pathlib
import platform
import stat
import sys
import warnings

import jax

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
    for path in (*folder.glob("jaxlib-*/*-cache"), *folder.glob("jaxlib-*/*.so")):
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
