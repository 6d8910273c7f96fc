"""Stacks: arrays over the rounds of a scan, kept as rows: one node of shape (N,) per cell.

A reader's value is one of four: cells (a NumPy array of scalar nodes), `Rows`, `Deep`, or a single node for an array
that stays whole (a large argument or a table).
"""

import numpy as np

from cnclik.engine.cells import array_of
from cnclik.engine.graph import Node, Scan, UnsupportedError

MANY = 64  # entries along axis 0, at least, for a known array or an argument to become rows


class Rows:
    """An array (N, ...) whose cells are rows: nodes of shape (N,), or of shape () if all entries are the same."""

    def __init__(self, cells, length):
        self.cells, self.length = cells, length

    @property
    def shape(self) -> tuple:
        return (self.length, *self.cells.shape)


class Deep(Rows):
    """An array (N, n, ...) that a nested scan stacks; its cells are nodes of shape (N, n), (N,) or ()."""

    def __init__(self, cells, length, inner):
        super().__init__(cells, length)
        self.inner = inner

    @property
    def shape(self) -> tuple:
        return (self.length, self.inner, *self.cells.shape)


def is_cells(value) -> bool:
    """Whether a value is an array of scalar nodes."""
    return isinstance(value, np.ndarray)


def shallow(g, x: Deep) -> Rows:
    """A stack of stacks as rows (N, n, ...), with a row for each of the n."""

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
    if row.op == "stacked" and isinstance(r := row.value[0], Scan) and k == (0 if r.reverse else r.length - 1):
        y = r.ys[row.value[2]]
        if y in r.then:  # the carry holds the value of the last round
            return r.outs[r.then.index(y)]
    return g.shared("index", (row,), (k,), (), row.dtype)


def constant(g, value, limit):
    """A known array, as cells, or as rows if it is long."""
    if value.size > limit or (value.ndim and len(value) >= MANY):
        return columns(g, g.array(value))
    return array_of([g.const(v, value.dtype) for v in value.ravel()], value.shape)


def columns(g, node) -> Rows:
    N, *inner = node.shape
    if node.op == "array":
        flat = node.value.reshape(N, -1).T
        same = [bool((c == c[0]).all()) for c in flat]
        some = zip(flat, same, strict=True)
        made = [g.const(c[0], c.dtype) if s else g.array(np.ascontiguousarray(c)) for c, s in some]
    else:
        made = [g.shared("column", (node,), at, (N,), node.dtype) for at in np.ndindex(*inner)]
    return Rows(array_of(made, tuple(inner)), N)


def as_rows(g, x, N) -> Rows | None:
    """Any value as N rows; None if its leading axis has another length."""
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
    if len(x) != N or not N:
        return None
    return Rows(array_of([_row(g, column, N) for column in x.reshape(N, -1).T], x.shape[1:]), N)


def _row(g, column, N):
    """N scalar nodes as one row."""
    first = column[0]
    if set(map(id, column)) == {id(first)}:
        return first
    whole = first.args[0] if first.op == "index" else None
    if whole is not None and all(c.op == "index" and c.args[0] is whole for c in column):
        rest = tuple(first.params[1:])
        if whole.shape[0] == N and all(c.params == (k, *rest) for k, c in enumerate(column)):
            if len(whole.shape) == 1 and whole.op != "input":
                return whole
            return g.shared("column", (whole,), rest, (N,), whole.dtype)
    if all(c.known for c in column):
        return g.array(np.array([c.value for c in column], first.dtype))
    return g.shared("list", tuple(column), None, (N,), first.dtype)


def row_node(g, r, x):
    """The node inside a scan of an array that it takes row by row."""
    key = "row", x.number  # a gradient takes tens of thousands: none is searched for
    if (found := r.block.table.get(key)) is not None:
        return found
    node = r.block.table[key] = g.new("row", (), None, x.shape[1:], x.dtype, (r, "row", len(r.xs)), r.block)
    r.xs.append(x)
    r.rows.append(node)
    return node


def stacked_node(g, r, i):
    """The node of a stacked output: one node for equal outputs, and the value itself if it is constant."""
    y = r.ys[i]
    if y.known or y.block.depth < r.block.depth:
        return y
    if y.op == "row" and y.value[0] is r:
        return r.xs[y.value[2]]
    key = "stacked", y.number
    if (found := r.block.table.get(key)) is not None:
        return found
    node = r.block.table[key] = g.new(
        "stacked", (), None, (r.length, *y.shape), y.dtype, (r, "stacked", i), r.block.parent
    )
    r.stacks.append(i)
    r.outs.append(node)
    return node


def cells_of(g, x, limit):
    """Any value as cells. Raises: UnsupportedError if there are too many."""
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
