"""Plan: which engine runs which function, by one rule."""

import contextlib
import math

import jax

from cnclik import errors
from cnclik.engine.compiler import can_build
from cnclik.engine.graph import SlowError
from cnclik.engine.program import Program
from cnclik.engine.to_jax import Derived
from cnclik.engine.tracing import engine

ENGINES = ("native", "xla", "plain")
MOST_NODES = 100_000  # of a function's graph, for C, whose compiler takes a fifth of a millisecond for each
MOST_SCALARS = 60_000  # the same for XLA, which takes 1 to 3 ms for each


def use_engine(name: str | None) -> contextlib.AbstractContextManager:
    """Choose, inside a `with`, the engine that runs batches and functions; None: the quickest.

    "native": C; "xla": the engine's scalars, compiled by XLA; "plain": the source itself, by XLA. All give the same
    numbers, to rounding. Without a C compiler, or if a function has no C form, XLA runs it.
    """
    return engine(name if name is None else errors.one_of("name", name, ENGINES))


def in_c(platform=None) -> bool:
    """Whether functions run as C if they can, on JAX's platform or another one."""
    return engine.value in (None, "native") and (platform or jax.default_backend()) == "cpu" and can_build()


def chosen(function, avals, *, batch: bool, platform=None) -> Program | Derived | SlowError | None:
    """Return what runs a function of one lane's arrays, for one lane or for a batch, on JAX's platform or another one.

    C (`Program`) on a CPU with a compiler, unless its graph has more than `MOST_NODES` nodes. Otherwise JAX gets the
    function: in a batch its scalars (`Derived`), as operations on contiguous lanes; for one lane its source (None).
    A `SlowError` stands for its source with that of all it calls: none of their C would come sooner. `use_engine`
    chooses without regard to size.

    Args: function: `cnclik.engine.native.Function`.
    """
    free = engine.value is None
    if in_c(platform):
        form = function.form("lanes" if batch else "lane", avals, MOST_NODES if free else math.inf)
        if isinstance(form, Program | SlowError):
            return form
    if engine.value == "xla" or (batch and engine.value != "plain"):
        form = function.form("scalars", avals, MOST_SCALARS if free else math.inf)
        if isinstance(form, Derived):
            return form
    return None


def as_here(fn):
    """The function with the caller's engine, precision and device, for another thread to run in."""
    wide, device, name = jax.config.jax_enable_x64, jax.config.jax_default_device, engine.value

    def there(*args, **named):
        with jax.enable_x64(wide), jax.default_device(device), engine(name):
            return fn(*args, **named)

    return there
