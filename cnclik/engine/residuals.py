"""Residuals: what a backward loop needs of the forward loop: which values to store and which to recompute.

The answer is a minimum cut of the forward loop's graph. Storing a scalar costs as much as some operations; recomputing
it costs its operations, starting from stored scalars (Griewank & Walther 2008, ch. 12, for the setting).
"""

import numpy as np

from cnclik.engine.graph import Scan
from cnclik.engine.operations import COST, NAMES
from cnclik.engine.stacks import row_node, stacked_node

STORE = (8, 16, 32)  # cost of storing a scalar, in operations; raised until a tile's store fits MANY_BYTES
MANY_BYTES = 2 << 20
LANES_BYTES = 64  # of a scalar, for all lanes of a tile
ALWAYS = 1 << 20


def computed_anew(g, r, rows) -> dict:
    """{number of a row that another scan stacks: its node inside the scan `r`}."""
    sources = {}
    for c in rows:
        if c.shape and c.op == "stacked" and isinstance(c.value[0], Scan) and c.value[0].length == r.length:
            sources.setdefault(id(c.value[0]), (c.value[0], {}))[1][c.number] = c
    found = {}
    for one, wanted in sources.values():
        targets = [one.ys[c.value[2]] for c in wanted.values()]
        for store in STORE:
            kept = _cut(one, targets, store)
            if len(kept) * one.length * LANES_BYTES <= MANY_BYTES:
                break
        found |= _again(g, r, one, wanted, kept)
    return found


def _free(n, one):
    """Whether a node is available in another scan without storing or recomputing it."""
    return n.known or n.block.depth < one.block.depth


def _is_base(n, one):
    return n.block is not one.block or n.op not in NAMES


def _again(g, r, one, wanted, kept):
    outside, g.block, memo = g.block, r.block, {}

    def leaf(n):
        if n.op == "row" and n.value[0] is one:
            return row_node(g, r, one.xs[n.value[2]])
        one.ys.append(n)
        return row_node(g, r, stacked_node(g, one, len(one.ys) - 1))

    def of(n):
        return n if _free(n, one) else memo[n.number]

    for target in (one.ys[c.value[2]] for c in wanted.values()):
        queue = [target]
        while queue:
            n = queue[-1]
            if _free(n, one) or n.number in memo:
                queue.pop()
            elif n.number in kept or _is_base(n, one):
                memo[n.number] = leaf(n)
            elif missing := [a for a in n.args if not _free(a, one) and a.number not in memo]:
                queue += missing
            else:
                memo[n.number] = g.apply(n.op, tuple(map(of, n.args)), n.dtype, n.params)
    g.block = outside
    return {number: of(one.ys[c.value[2]]) for number, c in wanted.items()}


def _cut(one, targets, store) -> set:
    """Numbers of the nodes of a scan that are to be stored."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    nodes, queue = {}, list(targets)
    while queue:
        n = queue.pop()
        if n.number not in nodes and not _free(n, one):
            nodes[n.number] = n
            queue += [] if _is_base(n, one) else n.args
    if not nodes:
        return set()
    place = {number: i for i, number in enumerate(nodes)}
    source, sink = 2 * len(nodes), 2 * len(nodes) + 1
    edges = {}
    for number, n in nodes.items():
        i, base = place[number], _is_base(n, one)
        given = n.op == "row" and n.value[0] is one
        edges[2 * i, 2 * i + 1] = 0 if given and one.xs[n.value[2]].op == "array" else store
        edges[source, 2 * i] = ALWAYS if base else COST.get(n.op, 1)
        edges[2 * i + 1, 2 * i] = ALWAYS
        for a in () if base else n.args:
            if a.number in place:
                edges[2 * place[a.number] + 1, 2 * i] = ALWAYS
    for y in targets:
        if y.number in place:
            edges[2 * place[y.number] + 1, sink] = ALWAYS
    at = np.array(list(edges))
    graph = csr_array((np.array(list(edges.values()), np.int32), (at[:, 0], at[:, 1])), shape=(sink + 1, sink + 1))
    rest = (graph - maximum_flow(graph, source, sink).flow).tocsr()
    rest.data = np.maximum(rest.data, 0)
    rest.eliminate_zeros()
    reached = set(breadth_first_order(rest, source, return_predecessors=False))
    return {number for number, i in place.items() if 2 * i in reached and 2 * i + 1 not in reached}
