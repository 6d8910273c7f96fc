"""Graph: a traced function as a program over scalars, in which nothing stands twice and nothing is left that is known.

A node is an operation on other nodes. Asking for the same one again gives the one that is there. Nodes lie in blocks:
the function itself, the body of a loop, a branch. A node lies in the outermost block in which its arguments are known,
so that what does not change in a loop is computed before it; nothing is moved out of a branch. A node of shape (N,)
is a row: one scalar at N instants, such as what a scan stacks up.
"""

from collections.abc import Sequence

import numpy as np

from cnclik.engine.algebra import COMMUTES, COMPARISONS, SIMPLER, folded


class UnsupportedError(Exception):
    """The function does what C code can't; the message says what."""


class Node:
    """One scalar, or one row of scalars: an operation, its arguments and parameters, or a constant's value.

    `exact` marks a constant of the model itself, such as a zero of the robot's geometry: 0 times anything is 0 there.
    """

    __slots__ = ("args", "block", "dtype", "exact", "number", "op", "params", "shape", "value")

    def __init__(self, op, args, params, shape, dtype, value, block, number, exact=False):
        self.op, self.args, self.params, self.shape, self.dtype = op, args, params, shape, np.dtype(dtype)
        self.value, self.block, self.number, self.exact = value, block, number, exact

    @property
    def known(self) -> bool:
        """Whether it is a constant."""
        return self.op == "const"

    def __repr__(self):
        about = repr(self.value) if self.known else f"({', '.join(f'#{a.number}' for a in self.args)})"
        return f"#{self.number} {self.op} {about} {self.dtype}{list(self.shape) if self.shape else ''}"


class Block:
    """Nodes and regions in order, and a table of the nodes by what they compute."""

    def __init__(self, parent=None, *, branch=False):
        self.parent, self.branch, self.items, self.table = parent, branch, [], {}
        self.depth = 0 if parent is None else parent.depth + 1


class Region:
    """What holds blocks of its own: a `Scan`, `While` or `Cond`."""

    blocks: Sequence = ()


class Scan(Region):
    """`length` rounds of a block: carries start at `first` and go on as `then`; rows come from xs, ys are stacked up.

    `stacks` are the numbers of those ys that have a node of their own, which follow the carries' ends in `outs`.
    """

    def __init__(self, parent, length, reverse=False):
        self.length, self.reverse, self.block = length, reverse, Block(parent)
        self.first, self.carries, self.then = [], [], []
        self.xs, self.rows, self.ys, self.stacks, self.outs = [], [], [], [], []

    @property
    def blocks(self):
        """Its one block."""
        return [self.block]

    @property
    def used(self) -> list:
        """Nodes that its block ends with, or begins from."""
        return [*self.first, *self.then, *self.ys]

    def needs(self, what, i) -> list:
        """The nodes that one of its nodes rests on."""
        if what in ("carry", "end"):
            return [self.first[i], self.then[i], self.carries[i]]
        return [self.xs[i] if what == "row" else self.ys[i]]


class While(Region):
    """Rounds of `block` as long as `begins`, which `asking` computes from the carries."""

    def __init__(self, parent, counts):
        """counts: whether it only counts, as `jax.lax.fori_loop`: what does not change in it is computed before it."""
        self.asking = Block(parent, branch=not counts)
        self.block = Block(self.asking, branch=not counts)
        self.first, self.carries, self.then, self.outs, self.begins = [], [], [], [], None

    @property
    def blocks(self):
        """Its condition and its body."""
        return [self.asking, self.block]

    @property
    def used(self) -> list:
        """Nodes that its block ends with, or begins from."""
        return [*self.first, *self.then, self.begins]

    def needs(self, what, i) -> list:
        """The nodes that one of its nodes rests on: all carries, as they decide on the rounds."""
        return [*self.first, *self.then, *self.carries, self.begins]


class Cond(Region):
    """One of several blocks, by a node: a bool for two of them, else a whole number."""

    def __init__(self, which):
        self.which, self.blocks, self.results, self.outs = which, [], [], []

    @property
    def used(self) -> list:
        """Nodes that its blocks end with, or that choose between them."""
        return [self.which, *(n for results in self.results for n in results)]

    def needs(self, what, i) -> list:
        """The nodes that one of its results rests on."""
        return [self.which, *(results[i] for results in self.results)]


class Graph:
    """A program that is being written."""

    def __init__(self):
        self.root = self.block = Block()
        self.count = 0
        self.factors = {}  # {numbers of a Cholesky factor's nodes: L of L D Lᵀ, and 1/√D}
        self.squares = {}  # {number of such a 1/√d: 1/d}

    def new(self, op, args, params, shape, dtype, value, block, *, exact=False) -> Node:
        """A node that is not looked up and not listed."""
        self.count += 1
        return Node(op, args, params, shape, dtype, value, block, self.count, exact)

    def const(self, value, dtype, *, exact=False) -> Node:
        """A known scalar."""
        dtype = np.dtype(dtype)
        value = np.asarray(value, dtype)[()]
        key = ("const", dtype.str, value.tobytes(), exact)
        found = self.root.table.get(key)
        if found is None:
            found = self.root.table[key] = self.new("const", (), None, (), dtype, value, self.root, exact=exact)
        return found

    def array(self, value) -> Node:
        """A known array, whole."""
        return self.new("array", (), None, value.shape, value.dtype, value, self.root)

    def shared(self, op, args, params, shape, dtype) -> Node:
        """The node of an operation; the one that is there already if there is one."""
        dtype = np.dtype(dtype)
        key = (op, params, shape, dtype.str, *(a.number for a in args))
        block = self.block
        while block is not None:
            if (found := block.table.get(key)) is not None:
                return found
            block = block.parent
        home = self._home(args)
        node = home.table[key] = self.new(op, args, params, shape, dtype, None, home)
        home.items.append(node)
        return node

    def _home(self, args):
        """The outermost block for a node of these arguments."""
        deepest = max((a.block.depth for a in args), default=0)
        block = self.block
        while block.depth > deepest and not block.branch:
            block = block.parent
        return block

    def apply(self, name, args, dtype, params=None) -> Node:
        """An elementwise operation on scalars, or on rows of them, simplified where that changes at most a sign of 0.

        Args: params: what the operation needs besides, hashable.
        """
        dtype = np.dtype(dtype)
        simpler = SIMPLER.get(name)
        if simpler is not None and (found := simpler(self, args, params, dtype)) is not None:
            return found
        if all(a.known for a in args) and (value := folded(name, [a.value for a in args], dtype, params)) is not None:
            nothing = name == "mul" and value == 0 and any(a.exact and a.value == 0 for a in args)
            return self.const(value, dtype, exact=nothing or all(a.exact for a in args))
        if (found := self._through_select(name, args, dtype, params)) is not None:
            return found
        if name in COMMUTES and args[0].number > args[1].number:
            args = args[::-1]
        shape = max((a.shape for a in args), key=len)
        return self.shared(name, tuple(args), params, shape, dtype)

    def _through_select(self, name, args, dtype, params):
        """An operation on a choice that lies in a loop for its condition alone: a choice of two results from before it.

        The length of a step, for one: it is Ts but in the last round, where nothing moves, and exp(−alpha Ts) with it.
        """
        which = next((a.args[0] for a in args if _is_choice(a)), None)
        if which is None or any(a.shape for a in args) or not which.block.depth:
            return None
        no, yes = (tuple(self._given(which, value, a) for a in args) for value in (False, True))
        if max(a.block.depth for a in (*no, *yes)) >= which.block.depth:
            return None
        no, yes = (self.apply(name, several, dtype, params) for several in (no, yes))
        return self.select(which, yes, no)

    def _given(self, which, value, node):
        """A node where it is known whether `which` holds."""
        if node is which or (node.op == "not" and node.args[0] is which):
            return self.const(value is (node is which), bool)
        return node.args[1 + value] if _is_choice(node) and node.args[0] is which else node

    def op(self, name, *args) -> Node:
        """An operation whose dtype is that of its arguments, or bool for a comparison."""
        return self.apply(name, args, np.bool_ if name in COMPARISONS else args[-1].dtype)

    def select(self, condition, yes, no) -> Node:
        """yes where the condition holds, else no."""
        return self.apply("select_n", (condition, no, yes), yes.dtype)

    def nodes(self, region, what, shapes, block) -> list:
        """Nodes of a region: its carries, rows or results, of (shape, dtype) each."""
        return [self.new(what, (), None, s, d, (region, what, i), block) for i, (s, d) in enumerate(shapes)]


def _is_choice(node) -> bool:
    """Whether a node is one of two others, by a condition."""
    return node.op == "select_n" and node.args[0].dtype.kind == "b"


def live(outputs) -> set:
    """Numbers of all nodes, and ids of all regions, that the outputs need."""
    needed, queue = set(), list(outputs)
    while queue:
        node = queue.pop()
        if node.number in needed:
            continue
        needed.add(node.number)
        queue += node.args
        if isinstance(node.value, tuple) and isinstance(node.value[0], Region):
            region, what, i = node.value
            needed.add(id(region))
            queue += region.needs(what, i)
    return needed
