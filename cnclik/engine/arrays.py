"""Arrays: rules of primitives that combine several cells of an array.

A rule takes the graph, the equation and its inputs as arrays of scalar nodes, and returns a list of such arrays.
"""

import functools
import itertools

import numpy as np

from cnclik.engine.cells import array_of
from cnclik.engine.graph import UnsupportedError

REDUCTIONS = {
    **{"reduce_sum": "add", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and", "reduce_or": "or"},
    **{"reduce_prod": "mul", "reduce_xor": "xor"},
}
RUNNING = {"cumsum": "add", "cumprod": "mul", "cummax": "max", "cummin": "min"}
BESIDE = 8  # one by one, G1's steps take 1.05 to 1.25 times as long; from 4 to 12 the speed is the same


def _reduce(g, eqn, x):
    return [reduced(g, x, eqn.params["axes"], REDUCTIONS[eqn.primitive.name], eqn.outvars[0].aval.dtype)]


def reduced(g, x, axes, name, dtype):
    """Cells reduced over some axes."""
    kept = [a for a in range(x.ndim) if a not in axes]
    shape, op = [x.shape[a] for a in kept], functools.partial(g.op, name)
    rows = [x.transpose(*kept, *axes)[(*at, ...)].flat if x.size else () for at in np.ndindex(*shape)]
    return array_of([functools.reduce(op, row) if x.size else neutral(g, name, dtype) for row in rows], shape)


def sums(g, name, firsts, factors):
    """first ± Σ a b for several firsts and pairs of rows of a and b; a first of None is left out.

    `BESIDE` sums grow side by side: an addition then need not wait for the one before it, and several use what is in a
    register.
    """
    made = list(firsts)
    for start in range(0, len(made), BESIDE):
        some = range(start, min(start + BESIDE, len(made)))
        for k in range(max(len(factors[i][0]) for i in some)):
            for i in some:
                left, right = factors[i]
                if k >= len(left) or (made[i] is not None and (left[k].nothing or right[k].nothing)):
                    continue
                product = g.apply("mul", (left[k], right[k]), right[k].dtype)
                made[i] = product if made[i] is None else g.apply(name, (made[i], product), product.dtype)
    return made


def neutral(g, name, dtype):
    """What an operation reduces nothing to."""
    if name in ("max", "min"):
        raise UnsupportedError("the largest of no numbers has no C form")
    return g.const(np.invert(np.zeros((), dtype)) if name == "and" else name == "mul", dtype)


def _running(g, eqn, x):
    axis, back, op = eqn.params["axis"], eqn.params["reverse"], functools.partial(g.op, RUNNING[eqn.primitive.name])
    x = np.moveaxis(np.flip(x, axis) if back else x, axis, -1)
    rows = [cell for row in x.reshape(-1, x.shape[-1]) for cell in itertools.accumulate(row, op)] if x.size else []
    found = np.moveaxis(array_of(rows, x.shape), -1, axis)
    return [np.flip(found, axis) if back else found]


def _platform(g, eqn):
    several = eqn.params["platforms"]
    at = next((i for i, p in enumerate(several) if p is None or "cpu" in p), len(several) - 1)
    return [array_of([g.const(at, np.int32)], ())]


def _pad(g, eqn, x, value):
    (value,), out = value.flat, np.empty(eqn.outvars[0].aval.shape, object)
    out.fill(value)
    for at in np.ndindex(*x.shape):
        to = tuple(low + i * (gap + 1) for i, (low, _, gap) in zip(at, eqn.params["padding_config"], strict=True))
        if all(0 <= i < size for i, size in zip(to, out.shape, strict=True)):
            out[to] = x[at]
    return [out]


def _unstack(g, eqn, x):
    axis = eqn.params["axis"]  # jax 0.11 has it for iterating over an array
    return [np.squeeze(part, axis) for part in np.split(x, x.shape[axis], axis)]


def _dot_general(g, eqn, x, y):
    out = eqn.outvars[0].aval
    return [contracted(g, x, y, *eqn.params["dimension_numbers"], out.dtype).reshape(out.shape)]


def contracted(g, x, y, summed, batch, dtype):
    """Sums of products of two arrays' cells, flat; `summed` and `batch` are pairs of axes."""
    x, y = (array_of([g.apply("convert_element_type", (c,), dtype) for c in v.flat], v.shape) for v in (x, y))
    rows, columns = _folded(x, batch[0], summed[0]), _folded(y, batch[1], summed[1])
    every = [(a, b) for one, two in zip(rows.tolist(), columns.tolist(), strict=True) for a in one for b in two]
    made = sums(g, "add", [None] * len(every), every) if rows.shape[-1] else [g.const(0, dtype)] * len(every)
    return array_of(made, (len(made),))


def _folded(x, batch, axes):
    """An array with the batch axes first and the summed axes flattened."""
    free = [a for a in range(x.ndim) if a not in batch and a not in axes]
    size = [int(np.prod([x.shape[a] for a in group])) for group in (batch, free, axes)]
    return x.transpose(*batch, *free, *axes).reshape(size)


ARRAYS = {
    **dict.fromkeys(REDUCTIONS, _reduce),
    **dict.fromkeys(RUNNING, _running),
    **{"platform_index": _platform, "pad": _pad, "dot_general": _dot_general},
    "unstack": _unstack,
    "split": lambda g, eqn, x: np.split(x, np.cumsum(eqn.params["sizes"])[:-1], eqn.params["axis"]),
}
