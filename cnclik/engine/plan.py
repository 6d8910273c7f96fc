"""Plan: which engine runs which call."""

import jax

from cnclik import errors
from cnclik.engine.compiler import can_build
from cnclik.hints import switched_on

ENGINES = ("native", "xla")
_engine = jax.make_user_context(default_value=None)


def use_engine(name):
    """Context manager: what runs the batches and functions called inside, "native" (C) or "xla"; None: the quicker one.

    All give the same numbers, to rounding. Where there is no C compiler, or a function has no C form, XLA runs it.
    """
    return _engine(name if name is None else errors.one_of("name", name, ENGINES))


def in_c() -> bool:
    """Whether functions run as C where they can."""
    return _engine.value != "xla" and switched_on() and jax.default_backend() == "cpu" and can_build()
