"""Over rows: rules of primitives on stacked rows, with rows as results; reducing over the rounds is a loop."""

import functools

import numpy as np

from cnclik.engine import arrays
from cnclik.engine.arrays import neutral
from cnclik.engine.cells import MOVES, array_of
from cnclik.engine.graph import Scan
from cnclik.engine.stacks import Rows, as_rows, entry, is_cells, stacked_node

MOST_MOVED = 1 << 22  # entries, at most, of moved data


def elementwise(g, eqn, inputs, params, name):
    """An elementwise operation on rows; None if the inputs are not rows of one length."""
    out = eqn.outvars[0].aval
    N, shape = out.shape[0], out.shape[1:]
    several = []
    for x in inputs:
        rows = as_rows(g, x, N)
        if rows is None or rows.length != N:
            return None
        several.append(np.broadcast_to(rows.cells, shape))
    flat = zip(*(s.flat for s in several), strict=True)
    return [Rows(array_of([g.apply(name, cells, out.dtype, params) for cells in flat], shape), N)]


def slid(g, row, start, stride, length):
    """Entries of a row: start, start + stride, ..."""
    if not row.shape or (start, stride, length) == (0, 1, row.shape[0]):
        return row
    if row.op == "array":
        return g.array(row.value[[start + stride * k for k in range(length)]])
    return g.shared("slid", (row,), (start, stride), (length,), row.dtype)


def _joined(g, pieces, lengths, dtype):
    if all(p is pieces[0] and not p.shape for p in pieces):
        return pieces[0]
    row, start = _part(pieces[0], lengths[0])
    follows = start
    for piece, length in zip(pieces, lengths, strict=True):
        if not row.shape or _part(piece, length) != (row, follows):
            return g.shared("joined", tuple(pieces), tuple(lengths), (sum(lengths),), dtype)
        follows += length
    return slid(g, row, start, 1, follows - start)


def _part(piece, length):
    """(row, index of its first entry) of adjacent entries. A carry's end is the last entry its scan stacks of it."""
    if piece.op == "slid" and piece.params[1] == 1:
        return piece.args[0], piece.params[0]
    if piece.op == "end" and length == 1 and isinstance(r := piece.value[0], Scan) and not r.reverse:
        same = [y for y in r.outs[len(r.carries) :] if r.ys[y.value[2]] is r.then[piece.value[2]]]
        return (same[0], r.length - 1) if same else (piece, 0)
    return piece, 0


def _each(rows, fn, length):
    return Rows(array_of([fn(c) for c in rows.cells.flat], rows.cells.shape), length)


def _slice(g, eqn, x):
    p, ndim = eqn.params, eqn.outvars[0].aval.ndim
    strides = p["strides"] or (1,) * ndim
    cuts = list(zip(p["start_indices"], p["limit_indices"], strides, strict=True))
    start, _, stride = cuts[0]
    length = eqn.outvars[0].aval.shape[0]
    inner = Rows(x.cells[(..., *(slice(*cut) for cut in cuts[1:]))], x.length)
    return [_each(inner, lambda c: slid(g, c, start, stride, length), length)]


def _split(g, eqn, x):
    axis, sizes = eqn.params["axis"], list(map(int, eqn.params["sizes"]))
    starts = np.cumsum([0, *sizes[:-1]]).tolist()
    if axis:
        return [Rows(part, x.length) for part in np.split(x.cells, starts[1:], axis - 1)]
    parts = zip(starts, sizes, strict=True)
    return [_each(x, lambda c, a=start, n=size: slid(g, c, a, 1, n), size) for start, size in parts]


def _concatenate(g, eqn, *inputs):
    axis, out, lengths = eqn.params["dimension"], eqn.outvars[0].aval, [v.aval.shape[0] for v in eqn.invars]
    rows = list(map(functools.partial(as_rows, g), inputs, lengths))
    if None in rows:
        return None
    if axis:
        return [Rows(np.concatenate([r.cells for r in rows], axis - 1), out.shape[0])]
    flat = zip(*(r.cells.flat for r in rows), strict=True)
    return [Rows(array_of([_joined(g, c, lengths, out.dtype) for c in flat], out.shape[1:]), out.shape[0])]


def _pad(g, eqn, x, value):
    out = eqn.outvars[0].aval
    (low, high, between), *others = eqn.params["padding_config"]
    if between or any(config != (0, 0, 0) for config in others) or not is_cells(value):
        return None
    (value,) = value.flat
    cut = max(-low, 0), max(-high, 0)
    length = x.length - sum(cut)

    def one(c):
        parts = [(value, max(low, 0)), (slid(g, c, cut[0], 1, length), length), (value, max(high, 0))]
        parts = [p for p in parts if p[1]]
        return _joined(g, *zip(*parts, strict=True), out.dtype)

    return [_each(x, one, out.shape[0])]


def _stack(g, eqn, *inputs):
    axis, out = eqn.params["axis"], eqn.outvars[0].aval
    rows = [as_rows(g, x, out.shape[0]) for x in inputs]
    return None if axis == 0 or None in rows else [Rows(np.stack([r.cells for r in rows], axis - 1), out.shape[0])]


def _dot(g, eqn, x, y):
    """A contraction of inner axes of rows with an array that is constant over the rounds."""
    (left, right), (bx, by) = eqn.params["dimension_numbers"]
    out = eqn.outvars[0].aval
    if bx or by or not isinstance(x, Rows) or not is_cells(y) or 0 in left:
        return None
    cells = arrays.contracted(g, x.cells, y, ([a - 1 for a in left], right), ((), ()), out.dtype)
    return [Rows(cells.reshape(out.shape[1:]), x.length)]


def reduced(g, x, axes, name, dtype):
    """A reduction of rows: over inner axes cell by cell, over axis 0 by a loop."""
    inner = tuple(a - 1 for a in axes if a)
    cells = arrays.reduced(g, x.cells, inner, name, dtype) if inner else x.cells
    if 0 not in axes:
        return Rows(cells, x.length)
    return array_of(_loop(g, list(cells.flat), x.length, name).outs, cells.shape)


def _loop(g, cells, length, name, *, reverse=False) -> Scan:
    """A loop that reduces the entries of rows, and as often what is the same in all rounds."""
    r, shapes = Scan(g.block, length, reverse), [((), c.dtype) for c in cells]
    start = length - 1 if reverse else 0
    r.first = [entry(g, c, start) if name in ("max", "min") else neutral(g, name, c.dtype) for c in cells]
    r.xs = [c for c in cells if c.shape]
    r.carries = g.nodes(r, "carry", shapes, r.block)
    r.rows = g.nodes(r, "row", [((), c.dtype) for c in r.xs], r.block)
    outside, g.block, rows = g.block, r.block, iter(r.rows)
    r.then = [g.op(name, a, next(rows) if c.shape else c) for a, c in zip(r.carries, cells, strict=True)]
    g.block = outside
    outside.items.append(r)
    r.outs = g.nodes(r, "end", shapes, outside)
    return r


def running(g, eqn, x, name):
    """A running reduction, such as cumsum, over axis 0 of rows; None over another axis."""
    if eqn.params["axis"] != 0:
        return None
    r = _loop(g, list(x.cells.flat), x.length, name, reverse=eqn.params["reverse"])
    r.ys = list(r.then)
    return [Rows(array_of([stacked_node(g, r, i) for i in range(len(r.ys))], x.cells.shape), x.length)]


def moved(g, eqn, x):
    """A move of data that keeps axis 0 in place; None for any other."""
    out, N = eqn.outvars[0].aval, x.length
    if not out.ndim or out.shape[0] != N or out.size > MOST_MOVED:
        return None
    size = x.cells.size
    numbers = np.asarray(MOVES[eqn.primitive.name](np.arange(N * size).reshape(x.shape), **eqn.params))
    here = numbers.reshape(N, -1) - size * np.arange(N)[:, None]
    if not here.size or not (here == here[0]).all():  # then no row reaches into another: neither the first nor the last
        return None
    flat = x.cells.reshape(-1)
    return [Rows(array_of([flat[i] for i in here[0]], out.shape[1:]), N)]


OVER_ROWS = {
    **{"slice": _slice, "concatenate": _concatenate, "pad": _pad},
    **{"stack": _stack, "split": _split, "dot_general": _dot},
}
