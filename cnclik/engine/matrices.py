"""Matrices: rules that write out decompositions of small matrices."""

import functools

import numpy as np

from cnclik.engine.arrays import sums
from cnclik.engine.cells import array_of
from cnclik.engine.graph import UnsupportedError

LARGEST = 48  # rows, at most, that are written out
EXCHANGED = 16  # the same with row exchanges: their C compiles in 6 s, that of 20 rows in 13 s


def each_matrix(rule, largest=LARGEST):
    """The rule extended to any leading axes, for matrices of at most `largest` rows."""

    def several(g, eqn, *inputs):
        lead = inputs[0].shape[:-2]
        if max(inputs[0].shape[-2:]) > largest:
            raise UnsupportedError(f"`{eqn.primitive.name}` of {inputs[0].shape[-1]} rows has no C form")
        outs = [np.empty(v.aval.shape, object) for v in eqn.outvars]
        for at in np.ndindex(*lead) if any(out.size for out in outs) else ():
            for out, made in zip(outs, rule(g, eqn, *(x[at] for x in inputs)), strict=True):
                out[at] = made
        return outs

    return several


def _subtract(g, x, at, factors):
    """Subtracts from each of some entries of x the sum of products of its factors, see `sums`."""
    made = sums(g, "sub", [x[i] for i in at], [factors(*i) for i in at])
    for i, found in zip(at, made, strict=True):
        x[i] = found


def _inverse(g, x):
    return g.op("div", g.const(1, x.dtype), x)


def _cholesky(g, eqn, a):
    """The lower factor; all NaN if the matrix is not positive definite, as with LAPACK.

    It is L √D of L D Lᵀ. Solving with it later needs no root, see `_triangular_solve`.
    """
    m, dtype = len(a), a.flat[0].dtype
    unit, scaled = np.empty((m, m), object), a.copy()
    for j in range(m):
        _subtract(g, scaled, [(i, j) for i in range(j, m)], lambda i, j: (unit[j, :j], scaled[i, :j]))
        inverse = _inverse(g, scaled[j, j])
        for i in range(j + 1, m):
            unit[i, j] = g.op("mul", scaled[i, j], inverse)
    pivots = list(np.diagonal(scaled))
    zero, nan = g.const(0, dtype), g.const(np.nan, dtype)
    positive = functools.reduce(lambda ok, d: g.op("and", ok, g.op("gt", d, zero)), pivots, g.const(True, bool))
    roots = [g.select(positive, g.op("sqrt", d), nan) for d in pivots]
    out = array_of([zero] * (m * m), (m, m))
    for i, j in zip(*np.tril_indices(m), strict=True):
        out[i, j] = roots[i] if i == j else g.op("mul", unit[i, j], roots[j])
    inverses = [_inverse(g, root) for root in roots]
    for root, d in zip(inverses, pivots, strict=True):
        g.squares[root.number] = g.select(positive, _inverse(g, d), nan)
    g.factors[_key(out)] = unit, inverses
    return [out]


def _key(lower):
    return tuple(x.number for x in lower[np.tril_indices(len(lower))])


def _triangular_solve(g, eqn, a, b):
    """Substitution; a Cholesky factor L √D is solved by L and 1/√D: (L √D)⁻¹ = D^(−1/2) L⁻¹."""
    p, lower = eqn.params, eqn.params["lower"]
    unit, roots = g.factors.get(_key(a if lower else a.T), (None, None))
    if unit is None:
        unit = a
        pivots = [g.const(1, a.flat[0].dtype) if p["unit_diagonal"] else _inverse(g, d) for d in np.diagonal(a)]
    else:
        unit, pivots = unit if lower else unit.T, [g.const(1, a.flat[0].dtype)] * len(a)
    if p["transpose_a"]:
        unit, lower = unit.T, not lower
    if not p["left_side"]:
        unit, b, lower = unit.T, b.T, not lower

    def scaled(x):
        rows = [[g.op("mul", cell, root) for cell in row] for row, root in zip(x, roots, strict=True)]
        return array_of([cell for row in rows for cell in row], x.shape)

    x = b.copy() if roots is None or lower else scaled(b)
    order = range(len(x)) if lower else range(len(x))[::-1]

    def known(i, c, before):  # LAPACK skips zeros, too
        before = [k for k in before if not (x[k, c].known and x[k, c].value == 0)]
        return unit[i, before], x[before, c]

    for k, i in enumerate(order):
        _subtract(g, x, [(i, c) for c in range(x.shape[1])], functools.partial(known, before=order[:k]))
        for c in range(x.shape[1]):
            x[i, c] = g.op("mul", x[i, c], pivots[i])
    x = scaled(x) if lower and roots is not None else x
    return [x if p["left_side"] else x.T]


def _lu(g, eqn, a):
    """LU with partial pivoting: (L and U, the row exchanges, the permutation), as LAPACK's getrf."""
    a, (m, n) = a.copy(), a.shape
    kind = eqn.outvars[1].aval.dtype
    order = array_of([g.const(i, eqn.outvars[2].aval.dtype) for i in range(m)], (m,))
    pivots = []
    for j in range(min(m, n)):
        best, most = g.const(j, kind), g.op("abs", a[j, j])
        for i in range(j + 1, m):  # the first largest entry
            size = g.op("abs", a[i, j])
            larger = g.op("gt", size, most)
            best, most = g.select(larger, g.const(i, kind), best), g.select(larger, size, most)
        pivots.append(best)
        for i in range(j + 1, m):
            here = g.op("eq", best, g.const(i, kind))
            for c in range(n):
                a[i, c], a[j, c] = g.select(here, a[j, c], a[i, c]), g.select(here, a[i, c], a[j, c])
            order[i], order[j] = g.select(here, order[j], order[i]), g.select(here, order[i], order[j])
        safe = g.op("eq", a[j, j], g.const(0, a[j, j].dtype))
        inverse = _inverse(g, g.select(safe, g.const(1, a[j, j].dtype), a[j, j]))
        for i in range(j + 1, m):
            a[i, j] = g.op("mul", a[i, j], inverse)
            for c in range(j + 1, n):
                a[i, c] = g.op("sub", a[i, c], g.op("mul", a[i, j], a[j, c]))
    return [a, array_of(pivots, (len(pivots),)), order]


MATRICES = {
    "cholesky": each_matrix(_cholesky),
    "triangular_solve": each_matrix(_triangular_solve),
    "lu": each_matrix(_lu, EXCHANGED),
}
