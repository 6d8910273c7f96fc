"""Stacks: arrays over the rounds of a scan, kept as rows: one node of shape (N,) for each cell.

A value that a reader holds is one of four: cells (a NumPy array of scalar nodes), `Rows`, `Deep`, or a single node for
an array that stays whole (an argument too large to be taken apart, a table).
"""

import functools

import numpy as np

from cnclik.engine.cells import MOVES, array_of
from cnclik.engine.graph import Node, Scan, UnsupportedError

MANY = 64  # entries along axis 0 from which on a known array, or an argument, is taken as rows
MOST_MOVED = 1 << 22


class Rows:
    """An array (N, ...) whose cells are rows: nodes of shape (N,), or of shape () where all entries are the same."""

    def __init__(self, cells, length):
        self.cells, self.length = cells, length

    @property
    def shape(self) -> tuple:
        """Of the array."""
        return (self.length, *self.cells.shape)

    @property
    def size(self) -> int:
        """Entries of the array."""
        return self.length * self.cells.size


class Deep(Rows):
    """An array (N, n, ...) that a scan within a scan stacks up: its cells are nodes of shape (N, n), (N,) or ()."""

    def __init__(self, cells, length, inner):
        super().__init__(cells, length)
        self.inner = inner

    @property
    def shape(self) -> tuple:
        """Of the array."""
        return (self.length, self.inner, *self.cells.shape)

    @property
    def size(self) -> int:
        """Entries of the array."""
        return self.length * self.inner * self.cells.size


def is_cells(value) -> bool:
    """Whether a value is an array of scalar nodes."""
    return isinstance(value, np.ndarray)


def shallow(g, x: Deep) -> Rows:
    """A stack of stacks as rows, (N, n, ...) with a row for each of the n."""

    def one(cell, i):
        return g.shared("within", (cell,), i, (x.length,), cell.dtype) if len(cell.shape) == 2 else cell

    flat = [one(cell, i) for i in range(x.inner) for cell in x.cells.flat]
    return Rows(array_of(flat, (x.inner, *x.cells.shape)), x.length)


def entry(g, row, k):
    """The node of one entry of a row."""
    if not row.shape:
        return row
    if row.op == "array":
        return g.const(row.value[k], row.dtype)
    if row.op == "column":
        at = (k, *row.params)
        return g.shared("index", row.args, at, (), row.dtype)
    if row.op == "list":
        return row.args[k]
    if row.op == "slid":
        start, stride = row.params
        return entry(g, row.args[0], start + stride * k)
    return g.shared("index", (row,), (k,), (), row.dtype)


def constant(g, value, limit):
    """A known array: as cells, or as rows where it is long."""
    if value.size > limit or (value.ndim and len(value) >= MANY):
        return columns(g, g.array(value))
    return array_of([g.const(v, value.dtype) for v in value.ravel()], value.shape)


def known_value(x):
    """The array of numbers that a value is; None where it isn't known."""
    if is_cells(x):
        return np.array([c.value for c in x.flat]).reshape(x.shape) if all(c.known for c in x.flat) else None
    if isinstance(x, Node):
        return x.value if x.op == "array" else None
    if isinstance(x, Deep) or not all(c.known or c.op == "array" for c in x.cells.flat):
        return None
    flat = [np.broadcast_to(c.value, x.length) for c in x.cells.flat]
    return np.stack(flat, 1).reshape(x.shape)


def columns(g, node) -> Rows:
    """A whole array as rows."""
    N, *inner = node.shape
    if node.op == "array":
        flat = node.value.reshape(N, -1).T
        same = [bool((c == c[0]).all()) for c in flat]
        made = [
            g.const(c[0], c.dtype) if s else g.array(np.ascontiguousarray(c)) for c, s in zip(flat, same, strict=True)
        ]
    else:
        made = [g.shared("column", (node,), at, (N,), node.dtype) for at in np.ndindex(*inner)]
    return Rows(array_of(made, tuple(inner)), N)


def as_rows(g, x, N) -> Rows | None:
    """Any value as N rows; None where its leading axis has another length."""
    if isinstance(x, Deep):
        return shallow(g, x)
    if isinstance(x, Rows):
        return x
    if isinstance(x, Node):
        return columns(g, x) if x.shape and x.shape[0] == N else None
    if x.ndim == 0:
        return Rows(x, N)
    if len(x) == 1 and N != 1:
        return Rows(x.reshape(x.shape[1:]), N)
    if len(x) != N:
        return None
    return Rows(array_of([_row(g, column, N) for column in x.reshape(N, -1).T], x.shape[1:]), N)


def _row(g, column, N):
    """N scalar nodes as one row."""
    first = column[0]
    if all(c is first for c in column):
        return first
    whole = first.args[0] if first.op == "index" else None
    if whole is not None and all(c.op == "index" and c.args[0] is whole for c in column):
        rest = tuple(first.params[1:])
        if whole.shape[0] == N and all(c.params == (k, *rest) for k, c in enumerate(column)):
            return (
                whole
                if len(whole.shape) == 1 and whole.op != "input"
                else g.shared("column", (whole,), rest, (N,), whole.dtype)
            )
    if all(c.known for c in column):
        return g.array(np.array([c.value for c in column], first.dtype))
    return g.shared("list", tuple(column), None, (N,), first.dtype)


def row_node(g, r, x):
    """The node in a scan of what it takes from an array in each round."""
    for row, known in zip(r.rows, r.xs, strict=True):
        if known is x:
            return row
    node = g.new("row", (), None, x.shape[1:], x.dtype, (r, "row", len(r.xs)), r.block)
    r.xs.append(x)
    r.rows.append(node)
    return node


def stacked_node(g, r, i):
    """The node of what a scan stacks up: one for the same thing, and none for what does not change."""
    y = r.ys[i]
    if y.known or y.block.depth < r.block.depth:
        return y
    if y.op == "row" and y.value[0] is r:
        return r.xs[y.value[2]]
    for k, at in enumerate(r.stacks):
        if r.ys[at] is y:
            return r.outs[len(r.carries) + k]
    node = g.new("stacked", (), None, (r.length, *y.shape), y.dtype, (r, "stacked", i), r.block.parent)
    r.stacks.append(i)
    r.outs.append(node)
    return node


# --- operations on rows -------------------------------------------------------------------------------


def elementwise(g, eqn, inputs, params, name):
    """An elementwise operation on rows, None where the inputs are no rows of one length."""
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
    """Some entries of a row: start, start + stride, ..."""
    if not row.shape or (start, stride, length) == (0, 1, row.shape[0]):
        return row
    if row.op == "array":
        return g.array(row.value[[start + stride * k for k in range(length)]])
    return g.shared("slid", (row,), (start, stride), (length,), row.dtype)


def _joined(g, pieces, lengths, dtype):
    if all(p is pieces[0] and not p.shape for p in pieces):
        return pieces[0]
    return g.shared("joined", tuple(pieces), tuple(lengths), (sum(lengths),), dtype)


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


def _rev(g, eqn, x):
    dimensions = eqn.params["dimensions"]
    x = Rows(np.flip(x.cells, [d - 1 for d in dimensions if d]), x.length)
    return [_each(x, lambda c: slid(g, c, x.length - 1, -1, x.length), x.length) if 0 in dimensions else x]


def _concatenate(g, eqn, *inputs):
    out = eqn.outvars[0].aval
    if eqn.params["dimension"] != 0:
        rows = [as_rows(g, x, out.shape[0]) for x in inputs]
        if None in rows:
            return None
        return [Rows(np.concatenate([r.cells for r in rows], eqn.params["dimension"] - 1), out.shape[0])]
    rows = [as_rows(g, x, v.aval.shape[0]) for x, v in zip(inputs, eqn.invars, strict=True)]
    if None in rows:
        return None
    lengths = [v.aval.shape[0] for v in eqn.invars]
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


def _broadcast(g, eqn, x):
    """Rows to rows of a larger shape, where axis 0 stays what it is."""
    shape, where = eqn.params["shape"], eqn.params["broadcast_dimensions"]
    if not where or where[0] != 0 or shape[0] != x.length:
        return None
    sizes = [1] * (len(shape) - 1)
    for axis, size in zip(where[1:], x.cells.shape, strict=True):
        sizes[axis - 1] = size
    return [Rows(np.broadcast_to(x.cells.reshape(sizes), shape[1:]), x.length)]


def _stack(g, eqn, *inputs):
    axis, out = eqn.params["axis"], eqn.outvars[0].aval
    rows = [as_rows(g, x, out.shape[0]) for x in inputs]
    return None if axis == 0 or None in rows else [Rows(np.stack([r.cells for r in rows], axis - 1), out.shape[0])]


def _dot(g, eqn, x, y):
    """A contraction of inner axes of rows with an array that is the same at all instants."""
    (left, right), (bx, by) = eqn.params["dimension_numbers"]
    out = eqn.outvars[0].aval
    if bx or by or not isinstance(x, Rows) or not is_cells(y) or 0 in left:
        return None
    cells = np.tensordot(_Sum.of(g, x.cells, out.dtype), _Sum.of(g, y, out.dtype), ([a - 1 for a in left], right))
    return [Rows(array_of([c.node for c in np.asarray(cells, object).flat], out.shape[1:]), x.length)]


class _Sum:
    """A node with + and *, for NumPy's tensordot."""

    def __init__(self, g, node):
        self.g, self.node = g, node

    @staticmethod
    def of(g, cells, dtype):
        return array_of([_Sum(g, c) for c in cells.flat], cells.shape)

    def __add__(self, other):
        return _Sum(self.g, self.g.op("add", self.node, other.node))

    def __mul__(self, other):
        return _Sum(self.g, self.g.op("mul", self.node, other.node))


def reduced(g, x, axes, name, dtype):
    """A reduction of rows: over inner axes cell by cell, over axis 0 by a loop."""
    inner = tuple(a - 1 for a in axes if a)
    cells = x.cells
    if inner:
        kept = [a for a in range(cells.ndim) if a not in inner]
        shape = [cells.shape[a] for a in kept]
        flat = cells.transpose(*kept, *inner).reshape(int(np.prod(shape)), -1)
        cells = array_of([functools.reduce(functools.partial(g.op, name), r) for r in flat], shape)
    if 0 not in axes:
        return Rows(cells, x.length)
    moving = [c for c in cells.flat if c.shape]
    ends = iter(_over_rounds(g, moving, x.length, name))

    def still(node):  # the same at all instants
        if name == "add":
            return g.op("mul", g.const(x.length, dtype), node)
        if name == "mul":
            return g.apply("integer_pow", (node,), dtype, x.length)
        return node

    return array_of([next(ends) if c.shape else still(c) for c in cells.flat], cells.shape)


def _over_rounds(g, rows, length, name):
    """One node for each row: all its entries put together by an operation."""
    return _loop(g, rows, length, name).outs if rows else []


def _loop(g, rows, length, name, *, reverse=False) -> Scan:
    """A loop that puts the entries of rows together by an operation."""
    r, shapes = Scan(g.block, length, reverse), [((), c.dtype) for c in rows]
    r.xs, r.first = list(rows), [_start(g, name, c, length - 1 if reverse else 0) for c in rows]
    r.carries = g.nodes(r, "carry", shapes, r.block)
    r.rows = g.nodes(r, "row", shapes, r.block)
    outside, g.block = g.block, r.block
    r.then = [g.op(name, a, b) for a, b in zip(r.carries, r.rows, strict=True)]
    g.block = outside
    outside.items.append(r)
    r.outs = g.nodes(r, "end", shapes, outside)
    return r


def running(g, eqn, x, name):
    """A running reduction over axis 0 of rows: cumsum and its kin; None over another axis."""
    if eqn.params["axis"] != 0:
        return None
    moving = [c if c.shape else g.shared("list", (c,) * x.length, None, (x.length,), c.dtype) for c in x.cells.flat]
    r = _loop(g, moving, x.length, name, reverse=eqn.params["reverse"])
    r.ys = list(r.then)
    return [Rows(array_of([stacked_node(g, r, i) for i in range(len(r.ys))], x.cells.shape), x.length)]


def _start(g, name, row, k):
    if name in ("max", "min"):
        return entry(g, row, k)
    return g.const({"add": 0, "mul": 1, "or": 0, "xor": 0, "and": -1 if row.dtype.kind in "iu" else 1}[name], row.dtype)


def moved(g, eqn, x):
    """A move of data that leaves axis 0 where it is; None for any other."""
    out, N = eqn.outvars[0].aval, x.length
    if not out.ndim or out.shape[0] != N or out.size > MOST_MOVED:
        return None
    size = x.cells.size
    numbers = np.asarray(MOVES[eqn.primitive.name](np.arange(N * size).reshape(x.shape), **eqn.params))
    here = numbers.reshape(N, -1) - size * np.arange(N)[:, None]
    if not here.size or not (here == here[0]).all() or here.min() < 0 or here.max() >= size:
        return None
    flat = x.cells.reshape(-1)
    return [Rows(array_of([flat[i] for i in here[0]], out.shape[1:]), N)]


OVER_ROWS = {
    **{"slice": _slice, "rev": _rev, "concatenate": _concatenate, "pad": _pad, "broadcast_in_dim": _broadcast},
    **{"stack": _stack, "dot_general": _dot},
}


def cells_of(g, x, limit):
    """Any value as cells. Raises UnsupportedError where they are too many."""
    if is_cells(x):
        return x
    if int(np.prod(x.shape)) > limit:
        raise UnsupportedError(f"an array of {int(np.prod(x.shape))} entries is read entry by entry")
    if isinstance(x, Deep):
        x = shallow(g, x)
    if isinstance(x, Rows):
        return array_of([entry(g, c, k) for k in range(x.length) for c in x.cells.flat], x.shape)
    if x.op == "array":
        return array_of([g.const(v, x.dtype) for v in x.value.flat], x.shape)
    return array_of([g.shared("index", (x,), at, (), x.dtype) for at in np.ndindex(*x.shape)], x.shape)
