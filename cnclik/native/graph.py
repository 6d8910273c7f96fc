"""Graph: a program over scalars, with nothing in it twice and nothing that can be known already.

A node is an operation on other nodes; asking for the same one again gives the one that is there. Nodes live in blocks:
the function itself, the body of a loop, a branch. A node goes into the outermost block where its arguments are known,
so that what does not change in a loop is worked out before it; out of a branch nothing is taken.
"""

import math

import numpy as np

from cnclik.native.operations import OPERATIONS, folded

REAL, INT, BOOL = "real", "int", "bool"


class Node:
    """One scalar: an operation, its arguments, its kind, and what else it needs (a constant's or an input's value)."""

    __slots__ = ("args", "block", "clean", "kind", "number", "op", "value")

    def __init__(self, op, args, kind, value, block, number):
        self.op, self.args, self.kind, self.value, self.block, self.number = op, args, kind, value, block, number
        self.clean = False  # whether 0 times it is 0: it is finite, or what makes it infinite or NaN is told elsewhere

    @property
    def known(self) -> bool:
        """Whether it is a constant."""
        return self.op == "const"


class Block:
    """Nodes and regions in order, and where they may float to."""

    def __init__(self, parent=None, *, branch=False):
        self.parent, self.branch = parent, branch
        self.depth = 0 if parent is None else parent.depth + 1
        self.items, self.table = [], {}


class Loop:
    """A body run `length` times (a number, a node or a C name): carries start at `first` and go on as `then`."""

    def __init__(self, block, length, first):
        self.block, self.length, self.first = block, length, first
        self.carries, self.then, self.index = [], [], None


class Choice:
    """One of several blocks, by a node: a BOOL for two of them, else an INT."""

    def __init__(self, which, blocks):
        self.which, self.blocks, self.results = which, blocks, []


class Function:
    """A part that is called several times: from REAL arguments, its input "a", to REAL results."""

    def __init__(self, graph):
        self.graph, self.results = graph, []


class Call:
    """A call of a function."""

    def __init__(self, function, args):
        self.function, self.args = function, args


class Graph:
    """A program being written, in one precision."""

    def __init__(self, dtype):
        self.dtype = np.dtype(dtype)
        self.root = self.block = Block()
        self.ends = []  # nodes that stand for what a region ended with
        self.count = 0

    # --- nodes ----------------------------------------------------------------------------------------

    def const(self, value, kind) -> Node:
        """A known number."""
        if kind == REAL:
            value = float(self.dtype.type(value))
            key = ("const", kind, value.hex() if not math.isnan(value) else "nan")
        else:
            value = bool(value) if kind == BOOL else int(value)
            key = ("const", kind, value)
        found = self.root.table.get(key)
        if found is None:
            found = self.root.table[key] = self._new("const", (), kind, value, self.root)
            found.clean = kind != REAL or math.isfinite(value)
        return found

    def input(self, name, place, kind, *, clean=False) -> Node:
        """An entry of an argument of the function."""
        node = self._new("input", (), kind, (name, place), self.root)
        node.clean = clean
        return node

    def apply(self, op, *args, kind=None) -> Node:
        """An operation on nodes, simplified where that changes no digit."""
        kind = kind or OPERATIONS[op].kind or args[-1].kind
        if op in _SWAPPED:
            op, args = _SWAPPED[op], args[::-1]
        if all(a.known for a in args) and (value := folded(op, [a.value for a in args], self.dtype, args)) is not None:
            return self.const(value, kind)
        simpler = _SIMPLER.get(op)
        if simpler is not None and (found := simpler(self, *args)) is not None:
            return found
        if op in _EITHER_WAY and args[0].number > args[1].number:
            args = args[::-1]
        return self._shared(op, args, kind)

    def pick(self, index, cells) -> Node:
        """The cell whose number `index` is; the index is within bounds."""
        if index.known:
            return cells[index.value]
        return self._shared("pick", (index, *cells), cells[0].kind)

    def _shared(self, op, args, kind, value=None):
        key = (op, kind, value, *(a.number for a in args))
        block = self.block
        while block is not None:
            if (found := block.table.get(key)) is not None:
                return found
            block = block.parent
        home = self._home(args)
        node = home.table[key] = self._new(op, args, kind, value, home)
        node.clean = op in _KEEPS_CLEAN and all(a.clean for a in args)
        home.items.append(node)
        return node

    def _new(self, op, args, kind, value, block):
        self.count += 1
        return Node(op, args, kind, value, block, self.count)

    def _home(self, args):
        """The outermost block for a node of these arguments."""
        deepest = max((a.block.depth for a in args), default=0)
        block = self.block
        while block.depth > deepest and not block.branch:
            block = block.parent
        return block

    # --- regions --------------------------------------------------------------------------------------

    def loop(self, length, first, body, *, kinds):
        """`length` times body(index, carried) from `first`; the carried nodes after the last.

        Args:
          length: a number, an INT node, or the name of a C variable.
          first: nodes, and their kinds.
          body: (index node, nodes) to as many nodes.
        """
        made = Loop(Block(self.block), length, list(first))
        made.index = self._new("index", (), INT, made, made.block)
        made.carries = [self._new("carry", (), k, (made, i), made.block) for i, k in enumerate(kinds)]
        outside, self.block = self.block, made.block
        made.then = list(body(made.index, made.carries))
        self.block = outside
        outside.items.append(made)
        return [self._end(made, i, k) for i, k in enumerate(kinds)]

    def choose(self, which, branches, kinds):
        """The nodes of the branch that `which` tells: of two by a BOOL, the second where it is true."""
        made = Choice(which, [])
        outside = self.block
        for branch in branches:
            self.block = Block(outside, branch=True)
            made.blocks.append(self.block)
            made.results.append(list(branch()))
            self.block = outside
        outside.items.append(made)
        found = []
        for i, kind in enumerate(kinds):
            several = [results[i] for results in made.results]
            same = several[0] if all(s is several[0] for s in several) else None
            visible = same is not None and same.block.depth <= outside.depth
            found.append(same if visible else self._end(made, i, kind))
        return found

    def call(self, function, args):
        """The results of a function."""
        key = ("call", id(function), *(a.number for a in args))
        block = self.block
        while block is not None:
            if (found := block.table.get(key)) is not None:
                return found
            block = block.parent
        home, made = self._home(args), Call(function, list(args))
        home.items.append(made)
        found = home.table[key] = [self._end(made, i, REAL, home) for i in range(len(function.results))]
        return found

    def _end(self, region, i, kind, block=None):
        self.ends.append(self._new("out", (), kind, (region, i), block or self.block))
        return self.ends[-1]


def functions(graph, found=None) -> list:
    """All functions that a graph calls, those that others call before them."""
    found = [] if found is None else found
    blocks = [graph.root]
    for block in blocks:
        for item in block.items:
            if isinstance(item, Call) and item.function not in found:
                functions(item.function.graph, found)
                found += [] if item.function in found else [item.function]
            elif isinstance(item, (Loop, Choice)):
                blocks += [item.block] if isinstance(item, Loop) else item.blocks
    return found


def live(graph, outputs) -> set:
    """The numbers of all nodes, and the ids of all regions, that the outputs need."""
    needed, queue = set(), list(outputs)
    while queue:
        node = queue.pop()
        if node.number in needed:
            continue
        needed.add(node.number)
        queue += node.args
        if node.op in ("carry", "out"):
            region, i = node.value
            if isinstance(region, Loop):
                queue += [region.first[i], region.then[i], region.carries[i]]
                queue += [region.length] if isinstance(region.length, Node) else []
            elif isinstance(region, Call):
                queue += region.args
            else:
                queue += [region.which, *(results[i] for results in region.results)]
            needed.add(id(region))
        elif node.op == "index":
            needed.add(id(node.value))
    return needed


# --- what changes no digit ----------------------------------------------------------------------------

_SWAPPED = {"gt": "lt", "ge": "le"}
_EITHER_WAY = frozenset(["add", "mul", "eq", "ne", "and", "or", "xor"])
_KEEPS_CLEAN = frozenset(["add", "sub", "mul", "neg"])


def _is(node, value):
    return node.known and node.value == value


def _add(g, a, b):
    if _is(a, 0):
        return b
    if _is(b, 0):
        return a
    if b.op == "neg":
        return g.apply("sub", a, b.args[0])
    return g.apply("sub", b, a.args[0]) if a.op == "neg" else None


def _sub(g, a, b):
    if _is(b, 0):
        return a
    if _is(a, 0):
        return g.apply("neg", b)
    return g.apply("add", a, b.args[0]) if b.op == "neg" else None


def _mul(g, a, b):
    for x, y in ((a, b), (b, a)):
        if _is(x, 1):
            return y
        if _is(x, -1):
            return g.apply("neg", y)
        if _is(x, 0) and y.clean:
            return x
        if x.op == "neg" and not y.known:
            return g.apply("neg", g.apply("mul", x.args[0], y))
    return None


def _div(g, a, b):
    return a if _is(b, 1) else None


def _neg(g, a):
    return a.args[0] if a.op == "neg" else g.apply("sub", *a.args[::-1]) if a.op == "sub" and a.kind == REAL else None


def _select(g, condition, yes, no):
    if condition.known:
        return yes if condition.value else no
    if yes is no:
        return yes
    if condition.op == "not":
        return g.apply("select", condition.args[0], no, yes)
    if yes.kind == BOOL and yes.known and no.known:
        return condition if yes.value else g.apply("not", condition)
    return None


def _and(g, a, b):
    for x, y in ((a, b), (b, a)):
        if x.known and x.kind == BOOL:
            return y if x.value else x
    return a if a is b else None


def _or(g, a, b):
    for x, y in ((a, b), (b, a)):
        if x.known and x.kind == BOOL:
            return x if x.value else y
        if x.kind == INT and _is(x, 0):
            return y
    return a if a is b else None


def _lt(g, a, b):
    return g.const(False, BOOL) if a is b else None


def _whole(answer):
    """A comparison of a node with itself, where it can't be NaN."""

    def simpler(g, a, b):
        return g.const(answer, BOOL) if a is b and a.kind != REAL else None

    return simpler


def _least(g, a, b):
    return a if a is b else None


def _not(g, a):
    return a.args[0] if a.op == "not" else None


_SIMPLER = {
    "add": _add,
    "sub": _sub,
    "mul": _mul,
    "div": _div,
    "neg": _neg,
    "select": _select,
    "and": _and,
    "or": _or,
    "not": _not,
    "lt": _lt,
    "le": _whole(True),
    "eq": _whole(True),
    "ne": _whole(False),
    "max": _least,
    "min": _least,
}
