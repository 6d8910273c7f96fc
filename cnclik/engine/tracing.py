"""Tracing: whether the engine reads what is being traced, which then leaves out hints for XLA."""

import contextlib

import jax

from cnclik.hints import few_lanes, use_hints
from cnclik.hints import read as _read


@contextlib.contextmanager
def to_be_read():
    """Context manager: the engine reads what is traced inside, without hints for XLA."""
    with use_hints(False), few_lanes(0), _read(True):
        yield


def is_read() -> bool:
    """Whether the engine reads what is being traced."""
    return _read.value


def checkpointed(step):
    """`jax.checkpoint` of a loop's step, for XLA only; the engine finds itself what a gradient should store."""
    return step if _read.value else jax.checkpoint(step, prevent_cse=False, static_argnums=0)


def together(fn, x):
    """fn of each row of x: by XLA of all at once, in the engine's programs one after the other."""
    return jax.lax.map(fn, x) if _read.value else jax.vmap(fn)(x)
