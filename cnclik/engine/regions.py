"""Regions: reads scan, while, cond and linear solves as loops and branches."""

import functools

import numpy as np

from cnclik.engine import stacks
from cnclik.engine.cells import array_of, consts_and_carry
from cnclik.engine.graph import Block, Cond, Scan, UnsupportedError, While
from cnclik.engine.operations import check_dtype
from cnclik.engine.residuals import computed_anew
from cnclik.engine.stacks import Deep, Rows, is_cells, row_node, stacked_node

LARGEST_ROW = 4096  # entries, at most, that one round takes or stacks


def _shapes(avals):
    return [((), a.dtype) for a in avals for _ in range(a.size)]


def _flat(reader, values):
    return [cell for v in values for cell in reader.cells(v).flat]


def _unflat(nodes, avals):
    nodes = iter(nodes)
    return [array_of([next(nodes) for _ in range(a.size)], a.shape) for a in avals]


def _small(avals, what):
    for a in avals:
        check_dtype(a.dtype)
    largest = max((a.size for a in avals), default=0)
    if largest > LARGEST_ROW:
        raise UnsupportedError(f"{what} of {largest} entries has no C form")


def _scan(reader, eqn, *inputs):
    g, params = reader.g, eqn.params
    jaxpr, length = params["jaxpr"], params["length"]
    nc, nk = consts_and_carry(eqn, jaxpr)
    inputs = [stacks.shallow(g, x) if isinstance(x, Deep) and i < nc + nk else x for i, x in enumerate(inputs)]
    consts, first, xs = inputs[:nc], inputs[nc : nc + nk], inputs[nc + nk :]
    carried, stacked = [v.aval for v in eqn.outvars[:nk]], [v.aval for v in jaxpr.jaxpr.outvars[nk:]]
    scanned = [v.aval for v in jaxpr.jaxpr.invars[nc + nk :]]
    _small([*carried, *stacked, *scanned], "a round of a scan")
    if length == 0:
        return [*first, *(array_of([], (0, *a.shape)) for a in stacked)]
    if length > 1 and (length == params["unroll"] or any(map(_is_mask, xs, scanned))):
        return _unrolled(reader, params, consts, first, [reader.cells(x) for x in xs], stacked)
    outside, first, still = g.block, _flat(reader, first), {}
    while True:
        r = Scan(outside, length, params["reverse"])
        r.first, r.carries = first, g.nodes(r, "carry", _shapes(carried), r.block)
        rows = _rows_of(reader, r, xs, scanned)
        here = _unflat([still.get(i, c) for i, c in enumerate(r.carries)], carried)
        g.block = r.block
        made = reader.run(jaxpr.jaxpr, jaxpr.consts, [*consts, *here, *rows])
        r.then = _flat(reader, made[:nk])
        deep = [type(v) is Rows and all(not c.shape or (c.op == "stacked" and c.block is r.block) for c in v.cells.flat)
                for v in made[nk:]]  # fmt: skip
        r.ys = [c for v, is_deep in zip(made[nk:], deep, strict=True)
                for c in (v.cells if is_deep else reader.cells(v)).flat]  # fmt: skip
        g.block = outside
        stays = {i: a for i, (a, *those) in enumerate(zip(first, r.carries, r.then, strict=True)) if _stays(a, *those)}
        if stays.keys() <= still.keys():
            break
        still |= stays  # read again: more is now known or loop-invariant
    outside.items.append(r)
    r.outs = g.nodes(r, "end", _shapes(carried), outside)
    ends = [t if t.block.depth <= outside.depth else end for t, end in zip(r.then, r.outs, strict=True)]
    ys = iter([stacked_node(g, r, i) for i in range(len(r.ys))])
    out = []
    for a, is_deep in zip(stacked, deep, strict=True):
        shape = a.shape[1:] if is_deep else a.shape
        cells = array_of([next(ys) for _ in range(int(np.prod(shape)))], shape)
        out.append(Deep(cells, length, a.shape[0]) if is_deep else Rows(cells, length))
    return [*_unflat(ends, carried), *out]


def _is_mask(x, aval) -> bool:
    """Whether it is a short known array of bools: rounds that know theirs are shorter when written out."""
    return aval.dtype == bool and is_cells(x) and all(c.known for c in x.flat)


def _unrolled(reader, params, consts, carry, xs, stacked):
    """The results of a scan, round by round."""
    jaxpr, rounds = params["jaxpr"], range(params["length"])
    ys = [[None] * len(rounds) for _ in stacked]
    for k in reversed(rounds) if params["reverse"] else rounds:
        made = reader.run(jaxpr.jaxpr, jaxpr.consts, [*consts, *carry, *(x[k, ...] for x in xs)])
        carry = made[: len(carry)]
        for y, v in zip(ys, made[len(carry) :], strict=True):
            y[k] = reader.cells(v)
    return [*carry, *map(np.stack, ys)]


def _stays(first, carry, then) -> bool:
    """Whether a carry is the same in each round."""
    known = first.known and then.known
    return then is first or then is carry or (known and first.value.tobytes() == then.value.tobytes())


def _rows_of(reader, r, xs, scanned):
    """The values inside the loop of the arrays that a scan goes over."""
    g, wanted = reader.g, []
    for x in xs:
        rows = x if isinstance(x, Deep) and x.length == r.length else stacks.as_rows(g, x, r.length)
        if rows is None or rows.length != r.length:
            raise UnsupportedError("a scan over an array in an unknown form has no C form")
        wanted.append(rows)
    again = computed_anew(g, r, [c for x in wanted for c in x.cells.flat])

    def here(c):
        return c if not c.shape else again[c.number] if c.number in again else row_node(g, r, c)

    values = []
    for x, a in zip(wanted, scanned, strict=True):
        cells = [here(c) for c in x.cells.flat]
        values.append(Rows(array_of(cells, a.shape[1:]), x.inner) if isinstance(x, Deep) else array_of(cells, a.shape))
    return values


def _while(reader, eqn, *inputs):
    g, params = reader.g, eqn.params
    cond, body, ahead = params["cond_jaxpr"], params["body_jaxpr"], params["cond_nconsts"]
    of_cond, of_body = inputs[:ahead], inputs[ahead:][: params["body_nconsts"]]
    carried = [v.aval for v in eqn.outvars]
    _small(carried, "a round of a loop")
    r = While(g.block, counts=[e.primitive.name for e in cond.jaxpr.eqns] in (["lt"], ["lt_to"]))
    r.first = _flat(reader, inputs[ahead + params["body_nconsts"] :])
    r.carries = g.nodes(r, "carry", _shapes(carried), r.block)
    outside, g.block = g.block, r.asking
    here = _unflat(r.carries, carried)
    (begins,) = reader.run(cond.jaxpr, cond.consts, [*of_cond, *here])
    begins = reader.cells(begins)
    r.begins = functools.reduce(functools.partial(g.op, "or"), begins.flat, g.const(False, bool))
    g.block = r.block
    then = map(reader.cells, reader.run(body.jaxpr, body.consts, [*of_body, *here]))
    if begins.ndim:  # of a batch: who has ended stays as it is, while others go on
        then = map(functools.partial(_where, g, begins), then, here)
    r.then = [node for x in then for node in x.flat]
    g.block = outside
    outside.items.append(r)
    r.outs = g.nodes(r, "end", _shapes(carried), outside)
    return _unflat(r.outs, carried)


def _where(g, condition, yes, no):
    """yes where a condition holds, on their first axes."""
    condition = condition.reshape(*condition.shape, *[1] * (yes.ndim - condition.ndim))
    flat = zip(np.broadcast_to(condition, yes.shape).flat, yes.flat, no.flat, strict=True)
    return array_of([g.select(*cells) for cells in flat], yes.shape)


def _cond(reader, eqn, index, *inputs):
    g, branches = reader.g, eqn.params["branches"]
    which = reader.cells(index).item()
    if which.known:
        b = branches[min(max(int(which.value), 0), len(branches) - 1)]
        return reader.run(b.jaxpr, b.consts, inputs)
    avals = [v.aval for v in eqn.outvars]
    _small(avals, "a branch's result")
    last = g.const(len(branches) - 1, which.dtype)
    if which.dtype.kind != "b":
        which = g.op("min", g.op("max", which, g.const(0, which.dtype)), last)
        which = g.op("eq", which, last) if len(branches) == 2 else which
    r, outside = Cond(which), g.block
    for b in branches:
        g.block = Block(outside, branch=True)
        r.blocks.append(g.block)
        r.results.append(_flat(reader, reader.run(b.jaxpr, b.consts, inputs)))
        g.block = outside
    outside.items.append(r)
    r.outs = g.nodes(r, "out", _shapes(avals), outside)
    same = [all(n is several[0] for n in several) and several[0].block.depth <= outside.depth
            for several in zip(*r.results, strict=True)]  # fmt: skip
    found = [r.results[0][i] if s else node for i, (s, node) in enumerate(zip(same, r.outs, strict=True))]
    return _unflat(found, avals)


def _linear_solve(reader, eqn, *inputs):
    lengths, solve = eqn.params["const_lengths"], eqn.params["jaxprs"].solve
    before = lengths.matvec + lengths.vecmat
    own = inputs[before : before + lengths.solve]
    return reader.run(solve.jaxpr, solve.consts, [*own, *inputs[before + lengths.solve + lengths.transpose_solve :]])


REGIONS = {"scan": _scan, "while": _while, "cond": _cond, "custom_linear_solve": _linear_solve}
