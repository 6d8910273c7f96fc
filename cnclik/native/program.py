"""Program: a function as JAX traces it, as a graph with named arguments and results."""

from typing import NamedTuple

import jax
import numpy as np

from cnclik.engine.cells import array_of
from cnclik.hints import few_lanes, use_form, use_hints
from cnclik.native.graph import REAL, Graph
from cnclik.native.reader import Reader, repeats


class Field(NamedTuple):
    """An argument or a result."""

    name: str
    shape: tuple
    kind: str = REAL
    about: str = ""
    value: object = None  # what it is where nothing else is said

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))


class Program(NamedTuple):
    """A traced function: its arguments and results in groups, and the graph between them."""

    graph: Graph
    inputs: dict  # {group: [Field]}: parameters, input, history
    outputs: dict  # {group: [(Field, nodes)]}: output, history

    @property
    def ends(self) -> list:
        """All result nodes."""
        return [node for group in self.outputs.values() for _, nodes in group for node in nodes]


def shape(size, dtype):
    """An argument to trace with."""
    return jax.ShapeDtypeStruct(size, dtype)


def traced(fn, groups, dtype):
    """The jaxpr of a function of flat arguments, field by field."""
    shapes = [shape(f.shape, dtype if f.kind == REAL else np.int32) for some in groups.values() for f in some]
    # With hints, so that what is fenced off is a call: what is called several times becomes a function.
    with use_hints(True), use_form("unrolled"), few_lanes(0), jax.enable_x64(dtype == np.float64):
        return jax.make_jaxpr(fn)(*shapes)


def arguments(graph, groups, runtime=None):
    """Nodes of all arguments, {group: [array]}, and the fields that are left at run time.

    Args: runtime: names of the `parameters` that are; the others become constants. None: all.
    """
    kept, values = {}, {}
    for group, some in groups.items():
        kept[group], values[group] = [], []
        for field in some:
            if group == "parameters" and runtime is not None and field.name not in runtime:
                cells = [graph.const(v, field.kind) for v in np.ravel(field.value).tolist()]
            else:
                clean = field.name == "velocity"  # what is not finite there makes the joints' velocities so
                key = f"{group}.{field.name}"
                cells = [graph.input(key, i, field.kind, clean=clean) for i in range(field.size)]
                kept[group].append(field)
            values[group].append(array_of(cells, field.shape))
    return values, kept


def read(fn, groups, told, *, dtype, runtime=None) -> Program:
    """The program of a function of flat arguments; `told` are its results in groups."""
    jaxpr = traced(fn, groups, dtype)
    graph = Graph(dtype)
    values, kept = arguments(graph, groups, runtime)
    reader = Reader(graph, repeats(jaxpr.jaxpr))
    found = iter(reader.run(jaxpr.jaxpr, jaxpr.consts, [v for some in values.values() for v in some]))
    outputs = {group: [(field, list(next(found).flat)) for field in some] for group, some in told.items()}
    return Program(graph, kept, outputs)
