"""Routine: a traced function with named arguments and results, for C that other C calls."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cnclik.engine import reader
from cnclik.engine.graph import Graph
from cnclik.engine.tracing import to_be_read

REAL, INT = "real", "int"


class Field(NamedTuple):
    """An argument or a result."""

    name: str
    shape: tuple = ()
    kind: str = REAL
    about: str = ""
    value: Any = None  # the default

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


class Routine(NamedTuple):
    """A function as a graph; its arguments and results are fields in groups."""

    inputs: dict  # {group: [Field]}
    outputs: dict  # {group: [Field]}
    graph: Graph
    given: Sequence  # its input nodes, field by field
    outs: Sequence  # its results, field by field
    fn: Callable  # of flat arrays

    def places(self, place) -> tuple:
        """The readers and writers for `Writer`; `place(group, field)` gives a field's place in C."""
        reads = [_entry(place(g, f), f) for g, some in self.inputs.items() for f in some]
        there = [_entry(place(g, f), f) for g, some in self.outputs.items() for f in some]
        return reads, [functools.partial(_stored, entry) for entry in there]


def _entry(place, field):
    return lambda at: f"{place}[{at}]" if field.shape else place


def _stored(entry, at, *several):
    """Statements that store entries from `at` on, in the form `Writer.store` expects."""
    return " ".join(f"{entry(f'{at} + {i}' if i else at)} = {words};" for i, words in enumerate(several))


def read(fn, groups, outputs, *, dtype) -> Routine:
    """The routine of a function of flat arrays, field by field. Args: outputs: its results in groups."""
    types = {REAL: np.dtype(dtype), INT: np.dtype(np.int32)}
    every = [(f, types[f.kind]) for some in groups.values() for f in some]
    wanted = [types[f.kind] for some in outputs.values() for f in some]

    def typed(*flat):
        return [jnp.asarray(x, t) for x, t in zip(jax.tree.leaves(fn(*flat)), wanted, strict=True)]

    with to_be_read(), jax.enable_x64(types[REAL].itemsize == 8):
        closed = jax.make_jaxpr(typed)(*(jax.ShapeDtypeStruct(f.shape, t) for f, t in every))
    graph, given, outs = reader.read(closed)
    return Routine(groups, outputs, graph, given, outs, typed)
