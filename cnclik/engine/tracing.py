"""Tracing: what the library leaves out where its programs are read by the engine."""

import contextlib

import jax

from cnclik.hints import few_lanes, use_hints

_read = jax.make_user_context(default_value=False)


@contextlib.contextmanager
def to_be_read():
    """Context manager: what is traced inside is read by the engine, without hints for XLA."""
    with use_hints(False), few_lanes(0), _read(True):
        yield


def is_read() -> bool:
    """Whether what is traced is read by the engine."""
    return _read.value


def checkpointed(step):
    """`jax.checkpoint` of a loop's step, which XLA needs; the engine itself finds what a gradient should store."""
    return step if _read.value else jax.checkpoint(step, prevent_cse=False, static_argnums=0)
