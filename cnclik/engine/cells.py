"""Cells: reads a traced function with every array as a NumPy array of cells.

Operations that only move data are done while reading, so they cost nothing in the written program.
"""

import functools

import jax
import numpy as np


def array_of(cells, shape):
    """An array whose entries are the cells."""
    made = np.empty(len(cells), object)
    for i, cell in enumerate(cells):
        made[i] = cell
    return made.reshape(shape)


def _broadcast_in_dim(x, shape, broadcast_dimensions, **_):
    sizes = [1] * len(shape)
    for axis, size in zip(broadcast_dimensions, x.shape, strict=True):
        sizes[axis] = size
    return np.broadcast_to(x.reshape(sizes), shape)


# NumPy moves the cells as the primitive would move numbers.
MOVES = {
    "broadcast_in_dim": _broadcast_in_dim,
    "squeeze": lambda x, dimensions: np.squeeze(x, dimensions),
    "expand_dims": lambda x, dimensions: np.expand_dims(x, dimensions),
    "reshape": lambda x, new_sizes, **_: x.reshape(new_sizes),
    "transpose": lambda x, permutation: x.transpose(permutation),
    "tile": lambda x, reps: np.tile(x, reps),
    "rev": lambda x, dimensions: np.flip(x, dimensions),
    "concatenate": lambda *xs, dimension: np.concatenate(xs, dimension),
    "stack": lambda *xs, axis: np.stack(xs, axis),
    "slice": lambda x, start_indices, limit_indices, strides: x[
        tuple(map(slice, start_indices, limit_indices, strides or (1,) * x.ndim))
    ],
    **dict.fromkeys(("copy", "copy_p", "stop_gradient"), lambda x, **_: x),
}


_CALLS_NAMES = """
    jit pjit closed_call core_call remat remat2 checkpoint custom_jvp_call custom_vjp_call custom_vmap_call
    call_hi_primitive eval_jaxpr
"""
CALLS = frozenset(_CALLS_NAMES.split())


def called(equation):
    of, params = equation.primitive, equation.params
    if of.name == "call_hi_primitive":  # jax 0.11 has it for `custom_root`
        inner = jax.make_jaxpr(functools.partial(of.to_lojax, **params))(*(v.aval for v in equation.invars))
    else:
        inner = next(params[key] for key in ("jaxpr", "call_jaxpr", "fun_jaxpr", "call") if key in params)
    return (inner.jaxpr, inner.consts) if hasattr(inner, "consts") else (inner, [])


def consts_and_carry(equation, jaxpr):
    """How many of a scan's inputs are constants and how many are carried, derived from shapes alone.

    Inputs that are scanned over, and outputs that are stacked, have one more axis outside than inside. Versions of JAX
    name the parameters differently.
    """
    carry = sum(v.aval.ndim == inner.ndim for v, inner in zip(equation.outvars, jaxpr.out_avals, strict=True))
    scanned = sum(v.aval.ndim > inner.ndim for v, inner in zip(equation.invars, jaxpr.in_avals, strict=True))
    return len(equation.invars) - carry - scanned, carry
