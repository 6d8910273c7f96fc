"""Reader: turns a traced function of one lane into a `Graph`.

Small arrays become scalars, so moving data costs nothing; stacked results of scans stay rows (`stacks`); loops stay
loops (`regions`). A primitive without a rule raises UnsupportedError, which names it.
"""

import math
import operator
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.interpreters import partial_eval

from cnclik.engine import over_rows, stacks
from cnclik.engine.arrays import ARRAYS, REDUCTIONS, RUNNING
from cnclik.engine.cells import CALLS, MOVES, array_of, called
from cnclik.engine.graph import Graph, Node, UnsupportedError
from cnclik.engine.matrices import MATRICES
from cnclik.engine.operations import DTYPES, NAMES, check_dtype
from cnclik.engine.places import PLACES, out_of_whole
from cnclik.engine.regions import REGIONS
from cnclik.engine.stacks import Deep, Rows, is_cells
from cnclik.engine.tracing import model_p, to_be_read

LIMIT = 1 << 14  # entries, at most, of an array that becomes scalars
LARGE_INPUT = 2048  # entries, at least, of an argument that stays whole

_SAME = {"add_any": "add"}
ELEMENTWISE = NAMES - {"fmod"} | _SAME.keys() | {"clamp", "integer_pow", "one_minus_square", "lt_to", "le_to"}
_PASSED_ON = frozenset(["optimization_barrier", "real", "pcast", "pvary", "name"])
_PARAMS = {"integer_pow": "y", "round": "rounding_method"}
_DTYPE, _SIZE = map(operator.attrgetter, ("aval.dtype", "aval.size"))
RULES = ARRAYS | PLACES | MATRICES


def params_of(eqn):
    key = _PARAMS.get(eqn.primitive.name)
    return None if key is None else int(eqn.params[key])


class Reader:
    """Reads jaxprs into a graph. Values are cells, rows or whole arrays (see `stacks`)."""

    def __init__(self, graph: Graph):
        self.g = graph

    def constant(self, value, aval=None):
        check_dtype(getattr(value, "dtype", np.dtype(float)))  # random keys, before NumPy refuses them
        value = np.asarray(value, getattr(aval, "dtype", None))
        check_dtype(value.dtype)
        return stacks.constant(self.g, value, LIMIT)

    def cells(self, x):
        return stacks.cells_of(self.g, x, LIMIT)

    def run(self, jaxpr, consts, values) -> list:
        """Results of an open jaxpr."""
        held = dict(zip(jaxpr.constvars, map(self.constant, consts), strict=True))
        held |= zip(jaxpr.invars, values, strict=True)

        def value(v):
            return self.constant(v.val, v.aval) if hasattr(v, "val") else held[v]

        for eqn in jaxpr.eqns:
            held |= zip(eqn.outvars, self.equation(eqn, list(map(value, eqn.invars))), strict=True)
        return list(map(value, jaxpr.outvars))

    def equation(self, eqn, inputs) -> list:
        name = eqn.primitive.name
        if name in CALLS:
            jaxpr, consts = called(eqn)
            return self.run(jaxpr, consts, inputs)
        if name in _PASSED_ON or (name == "reduce_precision" and _keeps(eqn)):
            return list(inputs)
        if name == model_p.name:
            return [self._of_the_model(*inputs)]
        if name == "iota":
            (out,) = (v.aval for v in eqn.outvars)
            indices = np.indices(out.shape, out.dtype, sparse=True)[eqn.params["dimension"]]
            return [self.constant(np.broadcast_to(indices, out.shape))]
        if name in REGIONS:
            return REGIONS[name](self, eqn, *inputs)
        if name == "convert_element_type" and eqn.invars[0].aval.dtype == eqn.outvars[0].aval.dtype:
            return list(inputs)
        if name == "bitcast_convert_type" and eqn.invars[0].aval.shape != eqn.outvars[0].aval.shape:
            raise UnsupportedError(f"`{name}` to numbers of another size has no C form")
        if not DTYPES.issuperset(dtypes := list(map(_DTYPE, eqn.outvars))):
            any(map(check_dtype, dtypes))
        whole = not {*map(type, inputs)} <= {np.ndarray}  # most equations are of cells alone
        if whole:
            inputs = [stacks.shallow(self.g, x) if isinstance(x, Deep) else x for x in inputs]
            if (found := self._whole(eqn, inputs)) is not None:
                return found
        if name == "broadcast_in_dim" and (found := self._repeated(eqn, *inputs)) is not None:
            return found
        cells = list(map(self.cells, inputs)) if whole else inputs
        if sum(map(_SIZE, eqn.outvars)) > LIMIT:
            raise UnsupportedError(f"`{name}` makes an array of {eqn.outvars[0].aval.size} entries")
        return self._of_cells(name, eqn, cells)

    def _of_the_model(self, x):
        """The same value, with known numbers marked as constants of the model."""
        if not is_cells(x):
            return x
        return array_of([self.g.const(c.value, c.dtype, exact=True) if c.known else c for c in x.flat], x.shape)

    def _of_cells(self, name, eqn, cells):
        if name in MOVES:
            return [MOVES[name](*cells, **eqn.params)]
        if name in ELEMENTWISE:
            return [self._elementwise(eqn, cells)]
        if name in RULES:
            return RULES[name](self.g, eqn, *cells)
        if not all(c.known for x in cells for c in x.flat):
            raise UnsupportedError(f"the operation `{name}` has no C form")
        values = [
            np.array([c.value for c in x.flat], v.aval.dtype).reshape(x.shape)
            for x, v in zip(cells, eqn.invars, strict=True)
        ]
        with jax.ensure_compile_time_eval():  # of known numbers, such as the zeros that a derivative starts from
            made = eqn.primitive.bind(*values, **eqn.params)
        return list(map(self.constant, made if eqn.primitive.multiple_results else [made]))

    def _elementwise(self, eqn, inputs):
        out, params, name = eqn.outvars[0].aval, params_of(eqn), eqn.primitive.name
        name = _SAME.get(name, name)
        flat = [x.flat if x.shape == out.shape else np.broadcast_to(x, out.shape).flat for x in inputs]
        made = [self.g.apply(name, cells, out.dtype, params) for cells in zip(*flat, strict=True)]
        return array_of(made, out.shape)

    def _whole(self, eqn, inputs):
        """The results if some input is rows or stays whole; None if the equation has to be read cell by cell."""
        name = eqn.primitive.name
        if (found := out_of_whole(self.g, eqn, inputs)) is not None:
            return found
        rows = [stacks.columns(self.g, x) if isinstance(x, Node) and x.shape else x for x in inputs]
        if not any(isinstance(x, Rows) for x in rows):
            return None
        if name in ELEMENTWISE:
            return over_rows.elementwise(self.g, eqn, rows, params_of(eqn), _SAME.get(name, name))
        if name in REDUCTIONS and isinstance(rows[0], Rows):
            return [over_rows.reduced(self.g, rows[0], eqn.params["axes"], REDUCTIONS[name], eqn.outvars[0].aval.dtype)]
        if name in RUNNING and (found := over_rows.running(self.g, eqn, rows[0], RUNNING[name])) is not None:
            return found
        if name in over_rows.OVER_ROWS and (found := over_rows.OVER_ROWS[name](self.g, eqn, *rows)) is not None:
            return found
        return over_rows.moved(self.g, eqn, rows[0]) if name in MOVES and len(rows) == 1 else None

    def _repeated(self, eqn, x):
        """Cells broadcast along a long new axis 0, as constant rows."""
        shape, where = eqn.outvars[0].aval.shape, eqn.params["broadcast_dimensions"]
        if not shape or shape[0] < stacks.MANY or 0 in where or eqn.invars[0].aval.size > LIMIT:
            return None
        axes = [axis - 1 for axis in where]
        return [Rows(MOVES["broadcast_in_dim"](self.cells(x), shape[1:], axes), shape[0])]


def _keeps(eqn) -> bool:
    """Whether a `reduce_precision`, which `jax.checkpoint` puts around what it keeps, changes no number."""
    about = jax.numpy.finfo(eqn.invars[0].aval.dtype)
    return eqn.params["exponent_bits"] >= about.nexp and eqn.params["mantissa_bits"] >= about.nmant


class Trace(NamedTuple):
    """A traced function: its closed jaxpr, None once it is read, and the shapes and the tree of its results."""

    closed: Any
    shapes: list
    tree: Any
    stays: bool  # where it is called: it has effects, or closes over values of a surrounding trace


def trace(fn, avals) -> Trace:
    """Trace a function of arrays of these avals, to be read."""
    with to_be_read():
        closed, shapes = jax.make_jaxpr(fn, return_shape=True)(*avals)
    stays = bool(closed.effects) or any(isinstance(x, jax.core.Tracer) for x in closed.consts)
    return Trace(closed, *jax.tree.flatten(shapes), stays)


def part(traced, wanted) -> Trace:
    """Return the trace of a list of the wanted results alone, one bool for each."""
    jaxpr, _ = partial_eval.dce_jaxpr(traced.closed.jaxpr, wanted, instantiate=True)
    shapes = [s for s, w in zip(traced.shapes, wanted, strict=True) if w]
    return Trace(traced.closed.replace(jaxpr=jaxpr), shapes, jax.tree.structure(shapes), traced.stays)


def read(closed, most=math.inf):
    """(graph, input nodes, output values) of a closed jaxpr of one lane.

    Args: most: nodes of the graph. Raises: SlowError as soon as there are more.
    """
    if closed.effects:
        raise UnsupportedError(f"effects, such as {next(iter(closed.effects))}, have no C form")
    if any(isinstance(x, jax.core.Tracer) for x in closed.consts):
        raise UnsupportedError("what the function closes over is traced")
    jaxpr, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    g = Graph(most)
    reader, given, values = Reader(g), [], []
    for i, a in enumerate(closed.in_avals):
        check_dtype(a.dtype)
        node = g.new("input", (), None, a.shape, a.dtype, i, g.root)
        given.append(node)
        if not a.shape:
            values.append(array_of([node], ()))
        elif a.shape[0] >= stacks.MANY:
            values.append(stacks.columns(g, node))
        else:
            values.append(reader.cells(node) if a.size <= LARGE_INPUT else node)
    found = reader.run(jaxpr, closed.consts, values)
    return g, given, [stacks.shallow(g, x) if isinstance(x, Deep) else x for x in found]
