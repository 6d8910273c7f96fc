"""Tracing: what JAX's traces depend on: the engine that the user has chosen, and whether the engine reads.

Both are part of JAX's cache keys. They are made together: each such context that JAX gets later makes it compile anew
what a user has compiled before.
"""

import jax

engine = jax.make_user_context(default_value=None)  # a name in `cnclik.engine.plan.ENGINES`; None: the quickest
_read = jax.make_user_context(default_value=False)


def to_be_read():
    """Context manager: the engine reads what is traced inside."""
    return _read(True)


def is_read() -> bool:
    """Whether the engine reads what is being traced."""
    return _read.value


def checkpointed(step):
    """`jax.checkpoint` of a loop's step, for XLA only; the engine finds itself what a gradient should store."""
    return step if _read.value else jax.checkpoint(step, prevent_cse=False, static_argnums=0)


def together(fn, x):
    """fn of each row of x: by XLA of all at once, in the engine's programs one after the other."""
    return jax.lax.map(fn, x) if _read.value else jax.vmap(fn)(x)
