"""Plan: which engine runs which call."""

import contextlib
import math
from contextlib import AbstractContextManager

import jax

from cnclik import errors
from cnclik.engine.compiler import can_build
from cnclik.hints import engine as _engine
from cnclik.hints import switched_on

ENGINES = ("native", "xla", "plain")

# As measured, a node of a graph takes C 0.2 ms of compiling, and XLA, which gets the source, 12 ns a round: C pays
# from some 10,000 rounds on, or where the program is called again and again.
MOST_NODES = 100_000  # of a run's graph, for C: half a minute of compiling
MOST_NODES_ONCE = 15_000  # of one that is called a few times only
MOST_NODES_EVER = 600_000  # of any function, for C: the compiler's two minutes, see `compiler.MOST_SECONDS`
MOST_SCALARS = 60_000  # of any function, for XLA: it takes 1 to 3 ms for each, on a CPU or for a GPU
MANY_ROUNDS = 8192  # of a run that is C at any size
_only = {"once": False}  # what holds for the whole process


def use_engine(name: str | None) -> AbstractContextManager:
    """Context manager: the engine that runs the batches and functions called inside; None: the quickest.

    "native": C; "xla": the engine's scalars, compiled by XLA; "plain": the source itself, by XLA. All give the same
    numbers, to rounding. Without a C compiler, or if a function has no C form, XLA runs it.
    """
    return _engine(name if name is None else errors.one_of("name", name, ENGINES))


def unless_chosen(name):
    """Context manager: the engine inside, unless the user has chosen one."""
    return _engine(name if _engine.value is None else _engine.value)


def in_c() -> bool:
    """Whether functions run as C if they can."""
    return _engine.value in (None, "native") and switched_on() and jax.default_backend() == "cpu" and can_build()


def choice() -> tuple:
    """What may differ between two calls in what this file decides."""
    return _engine.value, switched_on(), _only["once"]


def in_scalars() -> bool:
    """Whether XLA gets functions scalar by scalar if they can be read."""
    return _engine.value != "plain"


def may_be_plain() -> bool:
    """Whether XLA may get the source itself if that answers sooner."""
    return _engine.value != "xla"


@contextlib.contextmanager
def called_once(rounds):
    """Context manager: inside, in all threads, a run has so many rounds and is called a few times only."""
    before, _only["once"] = _only["once"], rounds <= MANY_ROUNDS
    try:
        yield
    finally:
        _only["once"] = before


def most_nodes(rounds=0) -> float:
    """The nodes, at most, of a graph from which C comes in time; beyond, the source itself is used.

    Args: rounds: of a run; 0: any other function.
    """
    if _engine.value is not None:
        return math.inf
    if not 0 < rounds <= MANY_ROUNDS:
        return MOST_NODES_EVER
    return MOST_NODES_ONCE if _only["once"] else MOST_NODES


def most_scalars() -> float:
    """The same for XLA, which gets one operation per node."""
    return math.inf if _engine.value is not None else MOST_SCALARS
