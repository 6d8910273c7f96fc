"""Places: rules of gather, scatter and slices at known or computed places."""

import functools
import itertools

import numpy as np
from jax import lax

from cnclik.engine.cells import array_of
from cnclik.engine.graph import UnsupportedError
from cnclik.engine.stacks import Rows, as_rows, entry, is_cells

CHOSEN = 16  # cells, at most, to choose from by selects; more lie in an array
MOST_WRITES = 1 << 14  # pairs of an update and a possible cell
MOST_READS = 1 << 22  # pairs of a result's entry and a possible cell

_Mode = lax.GatherScatterMode


def pick(g, cells, index):
    """The cell at `index`, a node that is within bounds."""
    cells = list(cells)
    if index.known:
        return cells[int(index.value)]
    if all(c is cells[0] for c in cells):
        return cells[0]
    if len(cells) > CHOSEN:
        return g.shared("pick", (index, *cells), None, (), cells[0].dtype)
    found = cells[0]
    for i, cell in enumerate(cells[1:], 1):
        found = g.select(g.op("eq", index, g.const(i, index.dtype)), cell, found)
    return found


def _number(g, coords, shape, dtype):
    """The flat index of a cell from its coordinates, numbers or nodes."""
    total = g.const(0, dtype)
    for i, c in enumerate(coords):
        stride = int(np.prod(shape[i + 1 :]))
        node = g.const(c * stride, dtype) if not hasattr(c, "op") else g.op("mul", g.const(stride, dtype), c)
        total = g.op("add", total, node)
    return total


def _taken(g, x, coords, dtype):
    """The entry of cells or rows at coordinates, numbers or nodes within bounds."""
    if is_cells(x):
        return pick(g, x.flat, _number(g, coords, x.shape, dtype))
    time, *inner = coords
    rows = x.cells.flat if inner else [x.cells.item()]
    row = pick(g, rows, _number(g, inner, x.cells.shape, dtype)) if inner else rows[0]
    if inner and row.op in ("pick", "select_n") and any(c.shape for c in x.cells.flat):
        raise UnsupportedError("rows at places that are not known have no C form")
    if not row.shape:
        return row
    if not hasattr(time, "op") or time.known:
        return entry(g, row, int(getattr(time, "value", time)))
    return g.shared("take", (row, time), None, (), row.dtype)


def _held(g, index, most):
    """A start clipped to 0 … most, as JAX does."""
    low, high = g.const(0, index.dtype), g.const(most, index.dtype)
    return g.op("min", g.op("max", index, low), high)


def _wide(g, places):
    """Indices in at least 32 bits, as flat indices may exceed a small type."""
    if places.size == 0 or places.flat[0].dtype.itemsize >= 4:
        return places
    return array_of([g.apply("convert_element_type", [c], np.int32) for c in places.flat], places.shape)


def _type(places):
    """The type of indices, of which a whole slice has none."""
    return places.flat[0].dtype if places.size else np.dtype(np.int32)


def _plus(g, start, offset):
    if not hasattr(start, "op"):
        return start + offset
    return g.op("add", start, g.const(offset, start.dtype))


def _known(node):
    return int(node.value) if node.known else node


def _clipped(g, starts, shape, sizes):
    """(starts such that slices of these sizes are inside, their type)"""
    starts = [_wide(g, s).item() for s in starts]
    at = [_known(_held(g, s, m - n)) for s, m, n in zip(starts, shape, sizes, strict=True)]
    return at, starts[0].dtype if starts else np.dtype(np.int32)


def _dynamic_slice(g, eqn, x, *starts):
    sizes = eqn.params["slice_sizes"]
    at, dtype = _clipped(g, starts, x.shape, sizes)
    made = [_taken(g, x, list(map(_plus, itertools.repeat(g), at, where)), dtype) for where in np.ndindex(*sizes)]
    return [array_of(made, sizes)]


def _dynamic_update_slice(g, eqn, x, update, *starts):
    (at, dtype), out = _clipped(g, starts, x.shape, update.shape), x.reshape(-1).copy()
    for where in np.ndindex(*update.shape):
        number = _number(g, list(map(_plus, itertools.repeat(g), at, where)), x.shape, dtype)
        _put(g, out, number, None, update[where], lambda old, new: new)
    return [out.reshape(x.shape)]


def _put(g, out, number, inside, update, combine):
    """Puts an update into the cell at an index if it is inside."""
    for i in [int(number.value)] if number.known else range(len(out)):
        here = inside if number.known else g.op("eq", number, g.const(i, number.dtype))
        if inside is not None and not number.known:
            here = g.op("and", here, inside)
        made = combine(out[i], update)
        out[i] = made if here is None else g.select(here, made, out[i])


def _start(g, index, most, mode):
    """(a start within bounds, whether it was; None: always)"""
    if index.known and 0 <= int(index.value) <= most:
        return index, None
    held = _held(g, index, most)
    return held, None if mode == _Mode.CLIP else g.op("eq", held, index)


def _starts(g, vector, dims, sizes, shape, mode):
    """({dim: start}, whether all are inside; None: always) of one index vector."""
    found, several = {}, []
    for index, d in zip(vector, dims, strict=True):
        start, ok = _start(g, index, shape[d] - sizes[d], mode)
        found[d] = _known(start)
        several += [] if ok is None else [ok]
    return found, functools.reduce(functools.partial(g.op, "and"), several) if several else None


def _windows(g, over, shape, places, mapped, sizes, mode, window, hidden, batching):
    """(place, coordinates of its cell, whether they are inside; None: always) of each entry of windows of shape `over`.

    Args: as `GatherDimensionNumbers` names them: mapped: start_index_map; window: offset_dims; hidden: the axes that a
      window lacks; batching: the pairs of batching axes.
    """
    kept, batch = ([d for d in range(len(s)) if d not in some] for s, some in ((shape, hidden), (over, window)))
    known = {}
    for at in np.ndindex(*over):
        which = tuple(at[d] for d in batch)
        if which not in known:
            starts, inside = _starts(g, places[which], mapped, sizes, shape, mode)
            known[which] = starts | {d: which[b] for d, b in batching}, inside
        starts, inside = known[which]
        offsets = dict(zip(kept, (at[d] for d in window), strict=True))
        yield at, [_plus(g, starts.get(d, 0), offsets.get(d, 0)) for d in range(len(shape))], inside


def _gather(g, eqn, x, places):
    p, out, places = eqn.params, eqn.outvars[0].aval, _wide(g, places)
    numbers, sizes, mode = p["dimension_numbers"], p["slice_sizes"], p["mode"]
    mode = _Mode.CLIP if mode == _Mode.PROMISE_IN_BOUNDS else mode  # as XLA does; it drops updates out of bounds
    hidden = (*numbers.collapsed_slice_dims, *numbers.operand_batching_dims)
    cells = x.size if is_cells(x) else x.cells.size
    if not all(c.known for c in places.flat) and out.size * cells > MOST_READS:
        raise UnsupportedError(f"`gather` of {out.size} entries at unknown places among {cells} has no C form")
    batching = zip(numbers.operand_batching_dims, numbers.start_indices_batching_dims, strict=True)
    made, of = [], (numbers.start_index_map, sizes, mode, numbers.offset_dims, hidden, list(batching))
    if whole := _keeps_rows(x, places, numbers.start_index_map, hidden, numbers.offset_dims, out.shape):
        shape, x = (1, *out.shape[1:]), x.cells[None]
    else:
        shape = out.shape
    for _, coords, inside in _windows(g, shape, x.shape, places, *of):
        cell = _taken(g, x, coords, _type(places))
        made.append(cell if inside is None else g.select(inside, cell, g.const(p["fill_value"], cell.dtype)))
    return [Rows(array_of(made, out.shape[1:]), out.shape[0]) if whole else array_of(made, out.shape)]


def _keeps_rows(x, places, mapped, hidden, window, shape) -> bool:
    """Whether entries of rows at known places, such as x[:, (0, 2)], are rows of the same length."""
    inner = isinstance(x, Rows) and 0 not in (*mapped, *hidden) and window[:1] == (0,)
    return inner and shape[0] == x.length and all(place.known for place in places.flat)


def _scatter(combine):
    def rule(g, eqn, x, places, updates):
        p, places = eqn.params, _wide(g, places)
        numbers, mode, out = p["dimension_numbers"], p["mode"], x.reshape(-1).copy()
        hidden = (*numbers.inserted_window_dims, *numbers.operand_batching_dims)
        own = iter(updates.shape[d] for d in numbers.update_window_dims)
        sizes = [1 if d in hidden else next(own) for d in range(x.ndim)]
        if not all(c.known for c in places.flat) and updates.size * x.size > MOST_WRITES:
            raise UnsupportedError(f"`{eqn.primitive.name}` of {updates.size} entries at unknown places has no C form")
        batching = zip(numbers.operand_batching_dims, numbers.scatter_indices_batching_dims, strict=True)
        of = numbers.scatter_dims_to_operand_dims, sizes, mode, numbers.update_window_dims, hidden, list(batching)
        for at, coords, inside in _windows(g, updates.shape, x.shape, places, *of):
            if inside is not None and inside.known:
                if not inside.value:
                    continue
                inside = None
            number = _number(g, coords, x.shape, _type(places))
            _put(g, out, number, inside, updates[at], lambda old, new: combine(g, old, new))
        return [out.reshape(x.shape)]

    return rule


def _by(name):
    return _scatter(lambda g, old, new: g.op(name, old, new))


def out_of_whole(g, eqn, inputs):
    """Entries of rows at given places; None for any other equation."""
    name, x = eqn.primitive.name, inputs[0]
    if name not in ("dynamic_slice", "gather") or is_cells(x) or not all(map(is_cells, inputs[1:])):
        return None
    x = x if isinstance(x, Rows) else as_rows(g, x, x.shape[0])
    return PLACES[name](g, eqn, x, *inputs[1:])


PLACES = {
    **{"dynamic_slice": _dynamic_slice, "dynamic_update_slice": _dynamic_update_slice, "gather": _gather},
    **{"scatter": _scatter(lambda g, old, new: new), "scatter-add": _by("add"), "scatter-mul": _by("mul")},
    **{"scatter-min": _by("min"), "scatter-max": _by("max"), "scatter-sub": _by("sub")},
}
