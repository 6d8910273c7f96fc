"""To JAX: a graph as a JAX function of one lane, with one operation on scalars per node.

`jax.vmap` makes each scalar a contiguous row of lanes. Loops stay loops, and stacked outputs are arrays. A light branch
becomes a select; a heavy one becomes a loop that runs once if some lane needs it.
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import jaxpr_as_fun

from cnclik.engine.graph import Cond, Node, Scan, While, live
from cnclik.engine.operations import COST, NAMES
from cnclik.engine.reader import Trace, read, trace
from cnclik.engine.row_texts import all_items, cells_of
from cnclik.engine.stacks import Rows
from cnclik.engine.to_c import HEAVY, weight

LONGEST, WORTH = 40, 4  # measured; the speed hardly depends on them
FEWEST = 3  # operations, at least, of a stage

_OTHER_NAMES = {"and": "bitwise_and", "or": "bitwise_or", "xor": "bitwise_xor", "not": "bitwise_not"}


class Derived:
    """A function of one lane's arrays, read and written as JAX. Raises: UnsupportedError if it cannot be read."""

    def __init__(self, fn, avals, *, most=math.inf):
        """Args: fn: the function, or its `Trace`. most: nodes of its graph."""
        traced = fn if isinstance(fn, Trace) else trace(fn, avals)
        writer = functools.partial(_Writer, *read(traced.closed, most=most), fenced=jax.default_backend() == "cpu")
        types = [s.dtype for s in traced.shapes]
        closed = jax.make_jaxpr(lambda *x: writer(x).results(types))(*avals)
        self.tree, self.call = traced.tree, jaxpr_as_fun(closed)  # one function, so that `vmap` caches its result

    def __call__(self, *leaves) -> list:
        return self.call(*leaves)


class _Writer:
    def __init__(self, graph, given, outs, leaves, *, fenced):
        self.graph, self.outs, self.fenced, self.active = graph, outs, fenced, None
        self.values = {n.number: x for n, x in zip(given, leaves, strict=True)}
        ends = [n for out in outs for n in cells_of(out)]
        self.needed = live(ends)[1]
        self.users, self.stages = _users(graph, self.needed, ends), {}

    def results(self, dtypes) -> list:
        self.block(self.graph.root)
        return [self.result(out, d) for out, d in zip(self.outs, dtypes, strict=True)]

    def result(self, out, dtype):
        if isinstance(out, Node):
            return self.whole(out)
        shape = (out.length,) if isinstance(out, Rows) else ()
        cells = [self.whole(c, shape) for c in cells_of(out)]
        return jnp.stack(cells, len(shape)).reshape(out.shape) if cells else jnp.zeros(out.shape, dtype)

    def of(self, n):
        return n.value if n.op in ("const", "array") else self.values[n.number]

    def whole(self, n, shape=None):
        """The value of a node as an array of a shape; default: its own."""
        x, shape = jnp.asarray(self.of(n), n.dtype), n.shape if shape is None else shape
        return x if x.shape == shape else lax.broadcast_in_dim(x, shape, range(x.ndim))

    # --- blocks ---------------------------------------------------------------------------------------

    def block(self, block):
        items = [i for i in block.items if i.number in self.needed]
        group = []
        for item in items:
            if isinstance(item, Node) and item.op in NAMES and not item.shape:
                group.append(item)
                continue
            self.operations(group)
            group = []
            if isinstance(item, Node):
                self.values[item.number] = self.node(item)
            else:
                {Scan: self.scan, While: self.loop, Cond: self.choice}[type(item)](item)
        self.operations(group)

    def operations(self, nodes):
        if not self.fenced:
            for n in nodes:
                self.values[n.number] = self.applied(n, self.of)
            return
        for stage, outs in _stages(nodes, self.users):
            self.stage(stage, outs)

    def stage(self, nodes, outs):
        """Some operations as a function that XLA must not inline; identical stages share one function."""
        if len(nodes) < FEWEST:
            for n in nodes:
                self.values[n.number] = self.applied(n, self.of)
            return
        inside = {n.number: n for n in nodes}
        given = {a.number: a for n in nodes for a in n.args if a.number not in inside and not a.known}
        place = {number: i for i, number in enumerate([*given, *inside])}

        def about(a):
            return (a.dtype.str, a.value.tobytes()) if a.known else place[a.number]

        key = tuple((n.op, n.params, n.dtype.str, *map(about, n.args)) for n in nodes)
        key = key, tuple(place[n.number] for n in outs), tuple(a.dtype.str for a in given.values())
        if key not in self.stages:

            def body(*values):
                own = dict(zip(given, values, strict=True))
                for n in nodes:
                    own[n.number] = self.applied(n, lambda a: a.value if a.known else own[a.number])
                return [own[n.number] for n in outs]

            self.stages[key] = jax.jit(body, inline=False)
        with set_xla_metadata(inlineable="false"):
            found = self.stages[key](*map(self.whole, given.values()))
        self.values |= zip((n.number for n in outs), found, strict=True)

    # --- nodes ----------------------------------------------------------------------------------------

    def applied(self, n, of):
        args = [of(a) for a in n.args]
        if n.shape:
            args = [x if np.shape(x) == n.shape else lax.broadcast_in_dim(x, n.shape, range(np.ndim(x))) for x in args]
        if n.op in ("convert_element_type", "bitcast_convert_type"):
            return getattr(lax, n.op)(args[0], n.dtype)
        if n.op == "round":
            return lax.round(args[0], lax.RoundingMethod(n.params))
        if n.op == "integer_pow":
            return lax.integer_pow(args[0], n.params)
        return getattr(lax, _OTHER_NAMES.get(n.op, n.op))(*args)

    def node(self, n):
        """A node other than an operation on scalars."""
        if n.op in NAMES:
            return self.applied(n, self.of)
        if n.op in ("index", "column", "within"):
            at = n.params if n.op == "index" else (slice(None), *np.atleast_1d(n.params).tolist())
            return jnp.asarray(self.of(n.args[0]))[at]
        return getattr(self, f"_{n.op}")(n, *n.args)

    def _slid(self, n, x):
        start, stride = n.params
        last = start + stride * (n.shape[0] - 1)
        low, high = min(start, last), max(start, last)
        x = lax.slice(self.whole(x), (low,), (high + 1,), (abs(stride),))
        return lax.rev(x, (0,)) if stride < 0 else x

    def _joined(self, n, *pieces):
        return lax.concatenate([self.whole(p, (size,)) for p, size in zip(pieces, n.params, strict=True)], 0)

    def _list(self, n, *cells):
        return jnp.stack(list(map(self.whole, cells)))

    def _pick(self, n, index, *cells):
        return lax.dynamic_index_in_dim(self._list(n, *cells), self.of(index), keepdims=False)

    def _take(self, n, row, index):
        return lax.dynamic_index_in_dim(self.whole(row), self.of(index), keepdims=False)

    # --- regions --------------------------------------------------------------------------------------

    def within(self, nodes, values, active=None):
        """A writer for the inside of a region, where some nodes have these values.

        Args: active: whether the lane takes part in it; inner loops do not wait for inactive lanes.
        """
        inner = object.__new__(type(self))
        inner.__dict__ |= self.__dict__
        if active is not None:
            inner.active = active if self.active is None else active & self.active
        inner.values = self.values | {n.number: x for n, x in zip(nodes, values, strict=True)}
        return inner

    def ended(self, nodes, values):
        self.values |= {n.number: x for n, x in zip(nodes, values, strict=True)}

    def scan(self, r):
        nk = len(r.carries)
        alive = [i for i, c in enumerate(r.carries) if {c.number, r.outs[i].number} & self.needed]
        rows = [i for i, row in enumerate(r.rows) if row.number in self.needed]
        stacked = [k for k, node in enumerate(r.outs[nk:]) if node.number in self.needed]

        def body(carry, xs):
            inner = self.within([*(r.carries[i] for i in alive), *(r.rows[i] for i in rows)], [*carry, *xs])
            inner.block(r.block)
            return [inner.whole(r.then[i]) for i in alive], [inner.whole(r.ys[r.stacks[k]]) for k in stacked]

        first, xs = [self.whole(r.first[i]) for i in alive], [self.whole(r.xs[i]) for i in rows]
        ends, ys = lax.scan(body, first, xs, length=r.length, reverse=r.reverse)
        self.ended([*(r.outs[i] for i in alive), *(r.outs[nk + k] for k in stacked)], [*ends, *ys])

    def loop(self, r):
        def asked(carry):
            inner = self.within(r.carries, carry)
            inner.block(r.asking)
            begins = inner.whole(r.begins)
            return inner, begins if self.active is None else begins & self.active

        def body(carry):
            inner = asked(carry)[0]  # values that condition and body share
            inner = inner.within((), (), inner.whole(r.begins))
            inner.block(r.block)
            return list(map(inner.whole, r.then))

        ends = lax.while_loop(lambda carry: asked(carry)[1], body, list(map(self.whole, r.first)))
        self.ended(r.outs, ends)

    def choice(self, r):
        alive = [i for i, o in enumerate(r.outs) if o.number in self.needed]
        which, found = self.whole(r.which), None
        for k, (block, results) in enumerate(zip(r.blocks, r.results, strict=True)):
            results = [results[i] for i in alive]
            here = (~which, which)[k] if which.dtype == bool else which == k
            made = (self.where_needed if weight(block, self.needed) >= HEAVY else self.always)(block, results, here)
            found = made if found is None else [lax.select(here, x, y) for x, y in zip(made, found, strict=True)]
        self.ended([r.outs[i] for i in alive], found)

    def always(self, block, results, here):
        """Results of a branch, computed for all lanes."""
        inner = self.within((), (), here)
        inner.block(block)
        return list(map(inner.whole, results))

    def where_needed(self, block, results, here):
        """Results of a branch, by a loop that runs once if some lane takes it; undefined for other lanes.

        Its inputs pass an optimization barrier, as XLA would otherwise move invariants out of the loop.
        """
        read = {n.number: n for n in results}
        for item in all_items(block):
            read |= {n.number: n for n in (item.args if isinstance(item, Node) else item.used)}
        reals = [n for n in read.values() if n.number in self.values and n.dtype.kind == "f"]
        values = list(map(self.whole, reals))

        def body(state):
            goes, seen = lax.optimization_barrier((state[0], values))
            inner = self.within(reals, seen, goes)
            inner.block(block)
            return jnp.zeros_like(here), list(map(inner.whole, results))

        empty = [jnp.zeros(n.shape, n.dtype) for n in results]
        return lax.while_loop(lambda state: state[0], body, (here, empty))[1]


def _users(graph, needed, ends) -> dict:
    """{number of a node: numbers of the operations that use it, and −1 for any other use}."""
    found = {}
    for item in all_items(graph.root):
        if isinstance(item, Node):
            by = item.number if item.op in NAMES and not item.shape else -1
            for a in item.args if item.number in needed else ():
                found.setdefault(a.number, set()).add(by)
        elif item.number in needed:
            for n in (n for out in item.outs for n in item.needs(*out.value[1:])):
                found.setdefault(n.number, set()).add(-1)
    for n in ends:
        found.setdefault(n.number, set()).add(-1)
    return found


def _stages(nodes, users):
    """Operations as stages, [(nodes, those used outside)], so that XLA computes little twice.

    XLA computes each result of a stage in its own loop over the lanes, with all operations that lead to it. So
    operations that several results share become results of an earlier stage, unless they are cheap.
    """
    cones = _roots({n.number: n for n in nodes}, users)
    by_number, stage_of, stages = {n.number: n for n in nodes}, {}, []
    for root in cones:
        before = (a.number for k in cones[root] for a in by_number[k].args)
        at = max((stage_of[a] + 1 for a in before if a in stage_of), default=0)
        while at < len(stages) and len(stages[at][0]) > LONGEST:
            at += 1
        if at == len(stages):
            stages.append((set(), []))
        stage_of[root] = at
        stages[at][0].update(cones[root])
        stages[at][1].append(by_number[root])
    return [([by_number[k] for k in sorted(inside)], outs) for inside, outs in stages]


def _roots(nodes, users):
    """{number of a node with its own loop: numbers of the nodes computed in it}, in order."""
    top, shared = {}, {}
    for number in reversed(nodes):
        above = {top.get(u, -1) for u in users[number]}
        if len(above) > 1 or -1 in above:
            top[number], shared[number] = number, np.inf if -1 in above else len(above) - 1
        else:
            (top[number],) = above
    cones, open_cones = {}, {}
    for number, n in nodes.items():
        cone = {number}.union(*(open_cones.get(a.number, ()) for a in n.args))
        copies = shared.get(number, 0)
        if copies * sum(COST.get(nodes[k].op, 1) for k in cone) >= WORTH:
            cones[number] = cone
        else:
            open_cones[number] = cone
    return cones
