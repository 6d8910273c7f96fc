"""Matrices: rules of decompositions of small matrices, written out."""

import functools

import numpy as np

from cnclik.engine.cells import array_of
from cnclik.engine.graph import UnsupportedError

LARGEST = 48  # rows that are written out


def each_matrix(rule):
    """The rule for leading axes of any number: a batch of matrices."""

    def several(g, eqn, *inputs):
        lead = inputs[0].shape[:-2]
        if max(inputs[0].shape[-2:]) > LARGEST:
            raise UnsupportedError(
                f"`{eqn.primitive.name}` of {inputs[0].shape[-1]} rows has no C form; {LARGEST} have"
            )
        outs = [np.empty(v.aval.shape, object) for v in eqn.outvars]
        for at in np.ndindex(*lead):
            for out, made in zip(outs, rule(g, eqn, *(x[at] for x in inputs)), strict=True):
                out[at] = made
        return outs

    return several


def _minus(g, first, products):
    """first − Σ a b."""
    return functools.reduce(lambda s, ab: g.op("sub", s, g.op("mul", *ab)), products, first)


def _inverse(g, x):
    return g.op("div", g.const(1, x.dtype), x)


def _cholesky(g, eqn, a):
    """The lower factor; NaN everywhere where the matrix isn't positive definite, as LAPACK's result is marked."""
    m, dtype = len(a), a.flat[0].dtype
    zero = g.const(0, dtype)
    out = array_of([zero] * (m * m), (m, m))
    for j in range(m):
        out[j, j] = g.op("sqrt", _minus(g, a[j, j], [(out[j, k], out[j, k]) for k in range(j)]))
        inverse = _inverse(g, out[j, j])
        for i in range(j + 1, m):
            out[i, j] = g.op("mul", _minus(g, a[i, j], [(out[i, k], out[j, k]) for k in range(j)]), inverse)
    positive = functools.reduce(
        lambda ok, j: g.op("and", ok, g.op("gt", out[j, j], zero)), range(m), g.const(True, bool)
    )
    for i, j in zip(*np.tril_indices(m), strict=True):
        out[i, j] = g.select(positive, out[i, j], g.const(np.nan, dtype))
    return [out]


def _triangular_solve(g, eqn, a, b):
    p = eqn.params
    lower, left = p["lower"], p["left_side"]
    if p["transpose_a"]:
        a, lower = a.T, not lower
    if not left:
        a, b, lower = a.T, b.T, not lower
    x, m = b.copy(), len(a)
    for i in range(m) if lower else reversed(range(m)):
        before = range(i) if lower else range(i + 1, m)
        inverse = None if p["unit_diagonal"] else _inverse(g, a[i, i])
        for c in range(x.shape[1]):
            rest = _minus(g, x[i, c], [(a[i, k], x[k, c]) for k in before])
            x[i, c] = rest if inverse is None else g.op("mul", rest, inverse)
    return [x if left else x.T]


def _lu(g, eqn, a):
    """LU with partial pivoting: (L and U, the row exchanges, the permutation), as LAPACK's getrf."""
    a, (m, n) = a.copy(), a.shape
    kind = eqn.outvars[1].aval.dtype
    order = array_of([g.const(i, eqn.outvars[2].aval.dtype) for i in range(m)], (m,))
    pivots = []
    for j in range(min(m, n)):
        best, most = g.const(j, kind), g.op("abs", a[j, j])
        for i in range(j + 1, m):  # the first of the largest
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


def _lu_pivots_to_permutation(g, eqn, pivots):
    size, kind = eqn.params["permutation_size"], eqn.outvars[0].aval.dtype
    lead = pivots.shape[:-1]
    out = np.empty((*lead, size), object)
    for at in np.ndindex(*lead):
        order = array_of([g.const(i, kind) for i in range(size)], (size,))
        for j, best in enumerate(pivots[at]):
            for i in range(j + 1, size):
                here = g.op("eq", best, g.const(i, best.dtype))
                order[i], order[j] = g.select(here, order[j], order[i]), g.select(here, order[i], order[j])
        out[at] = order
    return [out]


MATRICES = {
    "cholesky": each_matrix(_cholesky),
    "triangular_solve": each_matrix(_triangular_solve),
    "lu": each_matrix(_lu),
    "lu_pivots_to_permutation": _lu_pivots_to_permutation,
}
