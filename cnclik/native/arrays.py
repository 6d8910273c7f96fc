"""Arrays: operations that look at several cells of an array at once, by name of the primitive.

Each is called with the reader, the equation, and its inputs as arrays of nodes.
"""

import functools
import itertools

import jax
import numpy as np

from cnclik.engine.cells import array_of
from cnclik.native.graph import BOOL, INT, REAL


class UnsupportedError(Exception):
    """The function does what C code can't; the message names it."""


_KINDS = {"f": REAL, "i": INT, "u": INT, "b": BOOL}


def kind_of(aval) -> str:
    """The kind of an array's entries."""
    if aval.dtype.kind not in _KINDS:
        raise UnsupportedError(f"numbers of type {aval.dtype} have no C form here")
    return _KINDS[aval.dtype.kind]


_REDUCTIONS = {
    **{"reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and"},
    **{"reduce_or": "or", "cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"},
}


def _iota(reader, equation, *_):
    params, aval = equation.params, equation.outvars[0].aval
    shape, axis = aval.shape, params["dimension"]
    counted = np.arange(shape[axis]).reshape([-1 if i == axis else 1 for i in range(len(shape))])
    return [reader.constant(np.broadcast_to(counted, shape), aval)]


def _split(reader, equation, x):
    ends = np.cumsum(equation.params["sizes"])[:-1]
    return list(np.split(x, ends, equation.params["axis"]))


def _reduce(reader, equation, x):
    op, axes = _REDUCTIONS[equation.primitive.name], equation.params["axes"]
    kept = [a for a in range(x.ndim) if a not in axes]
    rows = x.transpose(*kept, *axes).reshape(int(np.prod([x.shape[a] for a in kept])), -1)
    apply = functools.partial(reader.graph.apply, op)
    return [array_of([functools.reduce(apply, row) for row in rows], [x.shape[a] for a in kept])]


def _running(reader, equation, x):
    op, axis, back = _REDUCTIONS[equation.primitive.name], equation.params["axis"], equation.params["reverse"]
    x = np.flip(np.moveaxis(x, axis, -1), -1) if back else np.moveaxis(x, axis, -1)
    apply = functools.partial(reader.graph.apply, op)
    rows = [cell for row in x.reshape(-1, x.shape[-1]) for cell in itertools.accumulate(row, apply)]
    found = array_of(rows, x.shape)
    return [np.moveaxis(np.flip(found, -1) if back else found, -1, axis)]


def _argmax(reader, equation, x, op="lt"):
    (axis,), g = equation.params["axes"], reader.graph

    def best(row):
        at, most = g.const(0, INT), row[0]
        for i, cell in enumerate(row[1:], 1):
            better = g.apply(op, most, cell)
            at, most = g.apply("select", better, g.const(i, INT), at), g.apply("select", better, cell, most)
        return at

    rows = np.moveaxis(x, axis, -1)
    return [array_of([best(row) for row in rows.reshape(-1, rows.shape[-1])], rows.shape[:-1])]


def _argmin(reader, equation, x):
    return _argmax(reader, equation, x, "gt")


def _dot_general(reader, equation, x, y):
    (left, right), (left_batch, right_batch) = equation.params["dimension_numbers"]
    rows, columns = (_folded(a, batch, axes) for a, batch, axes in ((x, left_batch, left), (y, right_batch, right)))
    found = [_dot(reader, a, b) for one, two in zip(rows, columns, strict=True) for a in one for b in two]
    return [array_of(found, equation.outvars[0].aval.shape)]


def _dot(reader, a, b):
    g = reader.graph
    return functools.reduce(functools.partial(g.apply, "add"), map(functools.partial(g.apply, "mul"), a, b))


def _dynamic_slice(reader, equation, x, *starts):
    """At known or unknown places; what would reach out of the array is moved inside, as JAX does."""
    g, sizes = reader.graph, equation.params["slice_sizes"]
    flat, offset = list(x.reshape(-1)), g.const(0, INT)
    for start, size, most, stride in zip(starts, sizes, x.shape, _strides(x.shape), strict=True):
        (at,) = start.flat
        at = g.apply("min", g.apply("max", at, g.const(0, INT)), g.const(most - size, INT))
        offset = g.apply("add", offset, g.apply("mul", at, g.const(stride, INT)))
    inside = sum(
        np.arange(size).reshape([-1 if i == axis else 1 for i in range(len(sizes))]) * stride
        for axis, (size, stride) in enumerate(zip(sizes, _strides(x.shape), strict=True))
    )
    inside = np.broadcast_to(inside, sizes)
    return [array_of([_at(reader, flat, offset, int(i)) for i in inside.flat], sizes)]


def _at(reader, flat, offset, i):
    if offset.known:
        return flat[offset.value + i]
    return reader.graph.pick(offset, flat[i:] if i else flat)


def _by_numbers(reader, equation, *inputs):
    """What picks cells at known places: the same done with their numbers."""
    name, (x, *others) = equation.primitive.name, inputs
    scatters = name == "scatter"
    places, values = (others[0], others[1]) if scatters else (others, None)
    known = [places] if scatters else list(places)
    if not all(cell.known for a in known for cell in a.flat):
        raise UnsupportedError(f"the operation `{name}` at places that are not known has no C form")
    at = [np.array([c.value for c in a.flat], v.aval.dtype).reshape(a.shape)
          for a, v in zip(known, equation.invars[1:], strict=False)]  # fmt: skip
    numbers = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    cells, given = list(x.flat), [numbers, *at]
    if scatters:
        given.append(np.arange(values.size, dtype=np.int32).reshape(values.shape) + x.size)
        cells += list(values.flat)
    with jax.ensure_compile_time_eval():
        found = np.asarray(equation.primitive.bind(*given, **equation.params))
    if found.size and not (found.min() >= 0 and found.max() < len(cells)):
        raise UnsupportedError(f"the operation `{name}` reaches out of its array")
    return [array_of([cells[i] for i in found.flat], found.shape)]


def _dynamic_update_slice(reader, equation, x, update, *starts):
    if not all(cell.known for s in starts for cell in s.flat):
        raise UnsupportedError("the operation `dynamic_update_slice` at places that are not known has no C form")
    made = x.copy()
    at = [min(max(int(s.flat[0].value), 0), m - u) for s, m, u in zip(starts, x.shape, update.shape, strict=True)]
    made[tuple(slice(a, a + u) for a, u in zip(at, update.shape, strict=True))] = update
    return [made]


def _folded(x, batch, axes):
    """An array as rows of what is summed over, for each of the batch."""
    free = [a for a in range(x.ndim) if a not in batch and a not in axes]
    size = [int(np.prod([x.shape[a] for a in group])) for group in (batch, free, axes)]
    return x.transpose(*batch, *free, *axes).reshape(size)


def _strides(shape):
    return [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]


ARRAYS = {
    "iota": _iota,
    "split": _split,
    "argmax": _argmax,
    "argmin": _argmin,
    "dot_general": _dot_general,
    "dynamic_slice": _dynamic_slice,
    "dynamic_update_slice": _dynamic_update_slice,
    "gather": _by_numbers,
    "scatter": _by_numbers,
    **{name: _running if name.startswith("cum") else _reduce for name in _REDUCTIONS},
}
