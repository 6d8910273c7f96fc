"""Graph: a traced function as a program over scalars, without duplicates and with known values folded.

A node is an operation on other nodes. Requesting the same operation again returns the existing node. Nodes lie in
blocks: the function itself, the body of a loop, a branch. A node lies in the outermost block in which its arguments are
known, so loop invariants are computed before the loop; nothing moves out of a branch. A node of shape (N,) is a row:
one scalar at N instants, such as what a scan stacks.
"""

import math
import operator
from typing import TYPE_CHECKING, Any

import numpy as np

from cnclik.engine.algebra import COMMUTES, COMPARISONS, SIMPLER, folded

IS_EXACT, IS_KNOWN, NUMBER, SHAPE, VALUE = map(operator.attrgetter, ("exact", "known", "number", "shape", "value"))


class UnsupportedError(Exception):
    """The function has no C form; the message gives the reason."""


class SlowError(UnsupportedError):
    """It takes so long to build that the source itself, by XLA, answers sooner."""


class Node:
    """One scalar, or one row of scalars: an operation, its arguments and parameters, or a constant's value.

    `known` marks a constant, `exact` one of the model, such as a zero of the robot's geometry. `nothing` is an exact
    zero: times anything it is 0.
    """

    __slots__ = (
        *("args", "block", "dtype", "exact", "known", "nothing", "number", "op", "params", "shape", "value", "zero"),
    )
    if TYPE_CHECKING:  # `Graph.new` sets them

        def __getattr__(self, name: str) -> Any: ...


class Block:
    """Nodes and regions in order, and a table of the nodes by what they compute."""

    def __init__(self, parent=None, *, branch=False):
        self.parent, self.branch, self.items, self.table = parent, branch, [], {}
        self.depth = 0 if parent is None else parent.depth + 1


class Region:
    """A node that contains `blocks`: a `Scan`, `While` or `Cond`."""

    @property
    def number(self) -> int:
        """What it is known by among the numbers of nodes that outputs need, see `live`."""
        return id(self)


class Scan(Region):
    """`length` rounds of a block. Carries start at `first` and continue as `then`; rows come from xs, ys are stacked.

    `stacks` are the indices of the ys that have a node; in `outs` these nodes follow the carries' ends.
    """

    def __init__(self, parent, length, reverse=False):
        self.length, self.reverse, self.block = length, reverse, Block(parent)
        self.blocks = [self.block]
        self.first, self.carries, self.then = [], [], []
        self.xs, self.rows, self.ys, self.stacks, self.outs = [], [], [], [], []

    @property
    def used(self) -> list:
        """The nodes that its block starts from, takes or ends with."""
        return [*self.first, *self.xs, *self.then, *self.ys]

    def needs(self, what, i) -> list:
        """The nodes that one of its nodes depends on."""
        if what in ("carry", "end"):
            return [self.first[i], self.then[i], self.carries[i]]
        return [self.xs[i] if what == "row" else self.ys[i]]


class While(Region):
    """Rounds of `block` while `begins` is true, which `asking` computes from the carries."""

    def __init__(self, parent, counts):
        """counts: whether it is a `jax.lax.fori_loop`: its invariants are computed before it."""
        self.asking = Block(parent, branch=not counts)
        self.block = Block(self.asking, branch=not counts)
        self.blocks = [self.asking, self.block]
        self.first, self.carries, self.then, self.outs, self.begins = [], [], [], [], None

    @property
    def used(self) -> list:
        """The nodes that its blocks start from or end with."""
        return [*self.first, *self.then, self.begins]

    def needs(self, what, i) -> list:
        """The nodes that one of its nodes depends on: all carries, as they decide the number of rounds."""
        return [*self.first, *self.then, *self.carries, self.begins]


class Cond(Region):
    """One of several blocks, chosen by a node: a bool for two blocks, otherwise a whole number."""

    def __init__(self, which):
        self.which, self.blocks, self.results, self.outs = which, [], [], []

    @property
    def used(self) -> list:
        """The nodes that its blocks end with, and the one that chooses."""
        return [self.which, *(n for results in self.results for n in results)]

    def needs(self, what, i) -> list:
        """The nodes that one of its results depends on."""
        return [self.which, *(results[i] for results in self.results)]


class Graph:
    """A graph of at most so many nodes. Raises: SlowError from its methods that make the next one."""

    def __init__(self, most=math.inf):
        self.most = most
        self.root = self.block = Block()
        self.count = 0
        self.factors = {}  # {node numbers of a Cholesky factor: (L of L D Lᵀ, 1/√D)}
        self.squares = {}  # {node number of such a 1/√d: 1/d}

    def new(self, op, args, params, shape, dtype, value, block, *, exact=False) -> Node:
        """A new node, neither looked up nor listed."""
        self.count += 1
        if self.count > self.most:
            raise SlowError(f"a program of more than {self.most} operations takes long to build")
        node: Any = Node()  # there are many thousands: a constructor would be a call more
        node.op, node.args, node.params, node.shape, node.dtype = op, args, params, shape, np.dtype(dtype)
        node.value, node.block, node.number, node.exact = value, block, self.count, exact
        node.known = op == "const"
        node.zero = node.known and bool(value == 0)
        node.nothing = exact and node.zero
        return node

    def const(self, value, dtype, *, exact=False) -> Node:
        dtype = np.dtype(dtype)
        value = np.asarray(value, dtype)[()]
        key = ("const", dtype.str, value.tobytes(), exact)
        found = self.root.table.get(key)
        if found is None:
            found = self.root.table[key] = self.new("const", (), None, (), dtype, value, self.root, exact=exact)
        return found

    def array(self, value) -> Node:
        """A known array as one node."""
        return self.new("array", (), None, value.shape, value.dtype, value, self.root)

    def shared(self, op, args, params, shape, dtype) -> Node:
        """The node of an operation; the existing one if there is one."""
        dtype = np.dtype(dtype)
        key = (op, params, shape, dtype.str, *map(NUMBER, args))
        block = self.block
        while block is not None:
            if (found := block.table.get(key)) is not None:
                return found
            block = block.parent
        home, deepest = self.block, 0
        for a in args:
            deepest = max(deepest, a.block.depth)
        while home.depth > deepest and not home.branch:  # the outermost block for a node of these arguments
            home = home.parent
        node = home.table[key] = self.new(op, args, params, shape, dtype, None, home)
        home.items.append(node)
        return node

    def apply(self, name, args, dtype, params=None) -> Node:
        """An elementwise operation on scalars, or on rows of them, simplified.

        Args: params: what the operation needs besides, hashable.
        """
        dtype = np.dtype(dtype)
        simpler = SIMPLER.get(name)
        if simpler is not None and (found := simpler(self, args, params, dtype)) is not None:
            return found
        if all(map(IS_KNOWN, args)) and (value := folded(name, list(map(VALUE, args)), dtype, params)) is not None:
            nothing = name == "mul" and value == 0 and any(a.exact and a.value == 0 for a in args)
            return self.const(value, dtype, exact=nothing or all(map(IS_EXACT, args)))
        shape = max(map(SHAPE, args), key=len)
        if name in COMMUTES and args[0].number > args[1].number:
            args = args[::-1]
        return self.shared(name, tuple(args), params, shape, dtype)

    def op(self, name, *args) -> Node:
        """An operation with the dtype of its arguments, or bool for a comparison."""
        return self.apply(name, args, np.bool_ if name in COMPARISONS else args[-1].dtype)

    def select(self, condition, yes, no) -> Node:
        """yes where the condition holds, else no."""
        return self.apply("select_n", (condition, no, yes), yes.dtype)

    def nodes(self, region, what, shapes, block) -> list:
        """Nodes of a region, its carries, rows or results, one for each (shape, dtype)."""
        return [self.new(what, (), None, s, d, (region, what, i), block) for i, (s, d) in enumerate(shapes)]


def live(outputs) -> tuple:
    """(all nodes that the outputs need, numbers of them and of their regions)"""
    nodes, needed, queue = [], set(), list(outputs)
    while queue:
        node = queue.pop()
        if node.number in needed:
            continue
        needed.add(node.number)
        nodes.append(node)
        queue += node.args
        if isinstance(node.value, tuple) and isinstance(node.value[0], Region):
            region, what, i = node.value
            needed.add(region.number)
            queue += region.needs(what, i)
    return nodes, needed
