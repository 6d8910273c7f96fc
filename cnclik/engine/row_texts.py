"""Rows in C: the text of a row's entry at round k; operations on rows are written where they are read."""

import itertools

import numpy as np

from cnclik.engine.graph import SHAPE, Node, Scan, UnsupportedError
from cnclik.engine.operations import NAMES, number, scalar
from cnclik.engine.stacks import Rows

_PLACED = ("stacked", "array")  # rows with random access


def all_items(*blocks) -> list:
    """All nodes and regions in blocks, including those inside regions."""
    blocks, items = list(blocks), []
    for block in blocks:
        items += block.items
        for item in block.items:
            if not isinstance(item, Node):
                blocks += item.blocks
    return items


def needed_rows(graph, needed, others) -> set:
    """Numbers of the rows that other loops, nodes or final results read."""
    read = [n for n in others if n.shape]
    for item in all_items(graph.root):
        if isinstance(item, Scan) and item.number in needed:
            read += [x for x, row in zip(item.xs, item.rows, strict=True) if x.shape and row.number in needed]
        elif isinstance(item, Node) and item.number in needed and not item.shape:
            read += filter(SHAPE, item.args)
    found, queue = set(), read
    while queue:
        n = queue.pop()
        if n.number not in found:
            found.add(n.number)
            queue += filter(SHAPE, n.args)
            if n.op == "stacked" and len(n.shape) == 2:
                queue.append(n.value[0].ys[n.value[2]])
    return found


def places_needed(graph, needed) -> set:
    """Numbers of the rows that are computed into memory, as they are read at other rounds than they are made in."""
    found = set()

    def placed(n):
        if not n.shape or n.op in _PLACED or n.op == "row" or n.number in found:
            return
        if n.op == "slid":
            placed(n.args[0])
        elif n.op == "joined":
            for a in n.args:
                placed(a)
        else:
            found.add(n.number)

    for item in all_items(graph.root):
        if isinstance(item, Node) and item.number in needed:
            if item.op in ("slid", "joined"):
                for a in item.args:
                    if item.op == "joined" or a.op in NAMES:
                        placed(a)
            elif item.op == "take" and not in_argument(item.args[0]):
                placed(item.args[0])
    return found


def in_argument(row) -> bool:
    """Whether a row lies in an argument, as numbers that can be read at any place."""
    return row.op == "column" and row.args[0].op == "input" and row.dtype.kind != "b"


def place_in(column, k) -> str:
    """The place of a column's entry k in its whole array."""
    inner = column.args[0].shape[1:]
    return f"({k}) * {int(np.prod(inner))} + {int(np.ravel_multi_index(column.params, inner)) if inner else 0}"


def cells_of(out) -> list:
    return list(out.cells.flat if isinstance(out, Rows) else out.flat if isinstance(out, np.ndarray) else [out])


def whole_results(outs) -> dict:
    """{index: (scan, first round, count, nodes of one round)} of results that are consecutive rounds of a scan."""
    found = {}
    for k, out in enumerate(outs):
        cells = cells_of(out) if isinstance(out, Rows) else []
        rounds = {_rounds(c) for c in cells if not c.known}
        if len(rounds) == 1 and None not in rounds:
            ((r, start),) = rounds
            ys = [c if c.known else r.ys[(c.args[0] if c.op == "slid" else c).value[2]] for c in cells]
            found[k] = r, start, out.length, ys
    return found


def _rounds(row):
    """(scan, first round) of a row that a scan outside all regions stacks, or of a part of it; otherwise None."""
    row, start = (row.args[0], row.params[0]) if row.op == "slid" and row.params[1] == 1 else (row, 0)
    stacked = row.op == "stacked" and len(row.shape) == 1 and row.block.parent is None
    return (row.value[0], start) if stacked else None


class RowTexts:
    """The part of a writer that handles rows."""

    def listed(self, cells, kind="const") -> str:
        """The name of an array of cells, written once for all that pick from it."""
        words = ", ".join(map(self.of, cells))
        key = "listed", self.type_of(cells[0].dtype), words
        if key not in self.names:
            self.names[key] = self.new("l")
            self.scopes[-1].append(key)
            self.line(f"{kind} {key[1]} {self.names[key]}[{len(cells)}] = {{{words}}};")
        return self.names[key]

    def materialise(self, n):
        k, array = self.new("k"), self.room(n.dtype, 1, n.shape[0])
        self.line(f"for (int64_t {k} = 0; {k} < {n.shape[0]}; ++{k}) {{")
        self.scopes.append([])
        self.line(f"{array}[{k}] = {self.row(n, k, {})};")
        self.leave()
        self.line("}")
        self.where[n.number] = lambda k: f"{array}[{k}]"

    def row(self, c, k, memo) -> str:
        """The text of a row at round k; statements that compute it are written before.

        Without recursion, as a sum over many coordinates is a chain longer than Python's stack.
        """
        queue = [c] if c.shape else []
        while queue:
            n = queue[-1]
            computed = n.op in NAMES and n.number not in self.where and n.number not in memo
            if missing := [a for a in n.args if computed and a.shape and a.number not in memo]:
                queue += missing[::-1]
            elif queue.pop().number not in memo:
                memo[n.number] = self._row(n, k, memo)
        return memo[c.number] if c.shape else self.of(c)

    def _row(self, c, k, memo):
        if c.number in self.where:
            return self.where[c.number](k)
        if c.op == "array":
            return self.table(c.value, k)
        if c.op == "column":
            return self._named(c, self.load(c.args[0], place_in(c, k)))
        if c.op == "within":
            return self.where[c.args[0].number](k, c.params)
        if c.op == "slid":
            start, stride = c.params
            return self.row(c.args[0], f"({start} + {stride} * ({k}))", {})
        if c.op == "joined":
            return self._joined(c, k)
        if c.op == "list":
            name = self.new("l")
            self.line(f"const {self.type_of(c.dtype)} {name}[{len(c.args)}] = {{{', '.join(map(self.of, c.args))}}};")
            return f"{name}[{k}]"
        if c.op in NAMES:
            words = self.applied(c, lambda a, plain: self.row(a, k, memo) if a.shape else self.of(a, plain))
            return words if c.op in ("sin", "cos") else self._named(c, words)
        raise UnsupportedError(f"rows of `{c.op}` have no C form")

    def _named(self, node, words):
        name = self.new()
        self.line(f"const {self.type_of(node.dtype)} {name} = {words};")
        return name

    def _joined(self, c, k):
        made, ends = None, list(itertools.accumulate(c.params))
        for a, end, length in reversed(list(zip(c.args, ends, c.params, strict=True))):
            piece = self.row(a, f"(({k}) - ({end - length}))", {})
            made = piece if made is None else f"(({k}) < ({end}) ? {piece} : {made})"
        return made

    def table(self, values, k) -> str:
        N = scalar(values.dtype)
        if values.dtype.kind in "iu":
            gap = int(values[1]) - int(values[0])
            if all(int(v) == int(values[0]) + gap * i for i, v in enumerate(values)):
                return self.splat(values.dtype, f"({N})({int(values[0])} + {gap} * ({k}))")
        name = self.new("table")
        kind = "int8_t" if values.dtype.kind == "b" else N
        self.tables.append(f"static const {kind} {name}[] = {{{', '.join(number(v, values.dtype) for v in values)}}};")
        return self.splat(values.dtype, f"{name}[{k}]")
