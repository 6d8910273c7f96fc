"""One GPU kernel per solve: a function of one lane as the body of a Pallas kernel.

A kernel's values are vectors of lanes in registers; it has no small arrays to slice, stack or index. So the traced
function is read once more with every array of it as a NumPy array of cells: moving data about happens while
reading and costs nothing, arithmetic becomes arithmetic on vectors of lanes, and a `lax.scan` a loop that carries its
cells in registers. What a scan stacks up over time has no place there: a function that returns or uses more of a
loop than its end has no kernel, and `UnsupportedError` says so. `cnclik.integrate.lanes` then takes XLA's own path.
"""

import functools

import jax
import numpy as np
from jax import lax

from cnclik.engine.cells import CALLS, array_of, called, consts_and_carry, each, known, moved, walk
from cnclik.hints import in_kernel

TILE = 128  # lanes per program, four warps


class UnsupportedError(Exception):
    """The function does what a kernel can't; the message says what."""


class _History:
    """Stands for a cell of a loop's history, which no kernel keeps."""

    def __repr__(self):
        return "history"


HISTORY = _History()


def batched(fn, *, tile: int = TILE, interpret: bool = False):
    """`jax.vmap(fn)` as one kernel; every argument a tree of arrays with one leading batch axis.

    Args:
      tile: lanes per program, a power of 2.
      interpret: run it without a GPU, slowly, as a test of its meaning.
    Raises (when called): UnsupportedError.
    """

    def call(*args):
        leaves, treedef = jax.tree.flatten(args)
        size = leaves[0].shape[0]
        lane = [jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype) for leaf in leaves]

        def flat(*leaves):
            return fn(*jax.tree.unflatten(treedef, leaves))

        with in_kernel():
            traced, shapes = jax.make_jaxpr(flat, return_shape=True)(*lane)
        outs, out_treedef = jax.tree.flatten(shapes)

        def body(*refs):
            inputs, results = refs[: len(lane)], refs[len(lane) :]
            reader = _Reader(tile)
            values = [
                array_of([ref[c, :] for c in range(ref.shape[0])], a.shape) for ref, a in zip(inputs, lane, strict=True)
            ]
            found = reader.run(traced.jaxpr, [known(c) for c in traced.consts], values)
            for ref, value, out in zip(results, found, outs, strict=True):
                for c, cell in enumerate(value.flat):
                    ref[c, :] = reader.lift(cell, out.dtype)

        programs = -(-size // tile)
        whole = programs * tile
        columns = [_columns(leaf, whole) for leaf in leaves]
        found = _pallas(body, tile, programs, columns, outs, interpret)
        back = [x[:, :size].T.reshape(size, *out.shape) for x, out in zip(found, outs, strict=True)]
        return jax.tree.unflatten(out_treedef, back)

    return call


def _columns(leaf, whole):
    """(batch, ...) as (cells, whole): neighbouring lanes next to each other, the last one repeated."""
    flat = leaf.reshape(leaf.shape[0], -1).T
    return jax.numpy.pad(flat, ((0, 0), (0, whole - leaf.shape[0])), mode="edge")


def _pallas(body, tile, programs, columns, outs, interpret):
    from jax.experimental import pallas as pl
    from jax.experimental.pallas import triton

    def block(cells):
        return pl.BlockSpec((cells, tile), lambda i: (0, i))

    shapes = [jax.ShapeDtypeStruct((max(int(np.prod(o.shape)), 1), programs * tile), o.dtype) for o in outs]
    return pl.pallas_call(
        body,
        out_shape=shapes,
        grid=(programs,),
        in_specs=[block(c.shape[0]) for c in columns],
        out_specs=[block(s.shape[0]) for s in shapes],
        compiler_params=None if interpret else triton.CompilerParams(num_warps=max(tile // 32, 1), num_stages=1),
        interpret=interpret,
    )(*columns)


# --- cells --------------------------------------------------------------------------------------------


def _is_known(cell):
    return isinstance(cell, (bool, int, float))


def _all_known(arrays):
    return all(_is_known(cell) for a in arrays for cell in a.flat)


_ELEMENTWISE_NAMES = """
    abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp convert_element_type cos cosh div eq
    erf exp exp2 expm1 floor ge gt integer_pow is_finite le log log1p logistic lt max min mul ne neg nextafter not or
    pow rem rsqrt select_n shift_left shift_right_arithmetic shift_right_logical sign sin sinh sqrt square sub tan
    tanh xor
"""
_ELEMENTWISE = frozenset(_ELEMENTWISE_NAMES.split())

_REDUCTIONS = {
    "reduce_sum": lax.add_p,
    "reduce_prod": lax.mul_p,
    "reduce_max": lax.max_p,
    "reduce_min": lax.min_p,
    "reduce_and": lax.and_p,
    "reduce_or": lax.or_p,
}


class _Reader:
    """Reads a jaxpr of one lane with vectors of `tile` lanes in the place of scalars."""

    def __init__(self, tile):
        self.tile = tile

    def lift(self, cell, dtype):
        """The cell as a vector of lanes."""
        if cell is HISTORY:
            raise UnsupportedError("it needs more of a loop than its end")
        if _is_known(cell):
            return lax.full((self.tile,), cell, dtype)
        return cell if cell.shape else lax.broadcast(cell, (self.tile,))

    def run(self, jaxpr, consts, values):
        """Results of an open jaxpr."""
        return walk(jaxpr, consts, values, lambda v: known(v.val), self.equation)

    def equation(self, equation, inputs) -> list:
        name, params = equation.primitive.name, equation.params
        if name in CALLS:
            return self.call(params, inputs)
        if name == "scan":
            return self.scan(equation, inputs, **params)
        if name == "cond":
            return self.cond(equation, *inputs, branches=params["branches"])
        if (found := moved(equation, inputs)) is not None:
            return found
        if _all_known(inputs):
            return _fold(equation, inputs)
        if name in _ELEMENTWISE:
            return [self.elementwise(equation, inputs)]
        if name in _REDUCTIONS:
            return [self.reduction(equation, _REDUCTIONS[name], *inputs, params["axes"])]
        if name in ("dynamic_slice", "gather") and _all_known(inputs[1:]):
            return [_picked(equation, inputs)]
        if name == "dot_general":
            return [self.contraction(equation, *inputs, **params)]
        raise UnsupportedError(f"a kernel has no {name}")

    def call(self, params, inputs):
        jaxpr, consts = called(params)
        return self.run(jaxpr, [known(c) for c in consts], inputs)

    def elementwise(self, equation, inputs):
        dtypes = [v.aval.dtype for v in equation.invars]

        def one(*cells):
            if any(cell is HISTORY for cell in cells):
                return HISTORY
            lifted = map(self.lift, cells, dtypes)
            return equation.primitive.bind(*lifted, **equation.params)

        return each(one, *inputs)

    def reduction(self, equation, primitive, x, axes):
        dtype = equation.invars[0].aval.dtype
        kept = [a for a in range(x.ndim) if a not in axes]
        rows = x.transpose(*kept, *axes).reshape(int(np.prod([x.shape[a] for a in kept])), -1)

        def join(a, b):
            return HISTORY if a is HISTORY or b is HISTORY else primitive.bind(self.lift(a, dtype), self.lift(b, dtype))

        return array_of([functools.reduce(join, row) for row in rows], [x.shape[a] for a in kept])

    def contraction(self, equation, x, y, dimension_numbers, **_):
        (left, right), (batch, _) = dimension_numbers
        if batch:
            raise UnsupportedError("a kernel has no batched dot_general")
        x, y = (
            array_of([self.lift(c, v.aval.dtype) for c in a.flat], a.shape)
            for a, v in zip((x, y), equation.invars, strict=True)
        )
        return np.asarray(np.tensordot(x, y, (left, right)), object)

    def cond(self, equation, index, *inputs, branches):
        """All branches, the lane's own chosen: as vmap does."""
        made = [self.run(b.jaxpr, [known(c) for c in b.consts], inputs) for b in branches]
        (chosen,) = index.flat
        if _is_known(chosen):
            return made[int(min(max(chosen, 0), len(branches) - 1))]
        out = []
        for var, *results in zip(equation.outvars, *made, strict=True):
            cells = []
            for several in zip(*(r.flat for r in results), strict=True):
                cell, *others = (self.lift(c, var.aval.dtype) for c in several)
                for i, other in enumerate(others, 1):
                    here = chosen == i if chosen.dtype != bool else chosen
                    cell = lax.select_n(here, cell, other)
                cells.append(cell)
            out.append(array_of(cells, var.aval.shape))
        return out

    def scan(self, equation, inputs, *, jaxpr, length, reverse, **_):
        """A loop in registers; what it stacks up over time is HISTORY."""
        num_consts, num_carry = consts_and_carry(equation, jaxpr)
        consts, start, xs = inputs[:num_consts], inputs[num_consts:][:num_carry], inputs[num_consts + num_carry :]
        counters = [_counter(x, v.aval) for x, v in zip(xs, equation.invars[num_consts + num_carry :], strict=True)]
        avals = [v.aval for v in equation.invars[num_consts:][:num_carry]]
        live = [[cell is not HISTORY for cell in value.flat] for value in start]

        def flat(values):
            found = []
            for value, aval, lives in zip(values, avals, live, strict=True):
                for cell, lives_on in zip(value.flat, lives, strict=True):
                    if lives_on:
                        found.append(lax.convert_element_type(self.lift(cell, aval.dtype), aval.dtype))
            return found

        def whole(cells):
            cells = iter(cells)
            return [
                array_of([next(cells) if lives_on else HISTORY for lives_on in lives], aval.shape)
                for aval, lives in zip(avals, live, strict=True)
            ]

        def once(i, cells):
            i = length - 1 - i if reverse else i
            rows = [counter(i) for counter in counters]
            found = self.run(jaxpr.jaxpr, [known(c) for c in jaxpr.consts], [*consts, *whole(cells), *rows])
            return flat(found[:num_carry])

        ended = whole(lax.fori_loop(0, length, once, flat(start)))
        lost = [array_of([HISTORY] * int(np.prod(v.aval.shape)), v.aval.shape) for v in equation.outvars[num_carry:]]
        return [*ended, *lost]


def _fold(equation, inputs):
    """An equation between known numbers, worked out now."""
    arrays = [np.array(x.tolist(), v.aval.dtype).reshape(x.shape) for x, v in zip(inputs, equation.invars, strict=True)]
    with jax.ensure_compile_time_eval():
        found = equation.primitive.bind(*arrays, **equation.params)
    return [known(x) for x in (found if equation.primitive.multiple_results else [found])]


def _picked(equation, inputs):
    """dynamic_slice and gather at known places: the same picking, done with the cells' numbers."""
    x, *places = inputs
    numbers = np.arange(x.size, dtype=np.int32).reshape(x.shape)
    at = [np.array(p.tolist(), v.aval.dtype).reshape(p.shape) for p, v in zip(places, equation.invars[1:], strict=True)]
    with jax.ensure_compile_time_eval():
        found = np.asarray(equation.primitive.bind(numbers, *at, **equation.params))
    if found.size and not (found.min() >= 0 and found.max() < x.size):
        raise UnsupportedError(f"{equation.primitive.name} reaches out of its array")
    return x.reshape(-1)[found]


def _counter(x, aval):
    """A scanned-over input as a function of the step's number: only whole numbers with equal gaps have one."""
    if x.ndim != 1 or not _all_known([x]):
        raise UnsupportedError("a loop scans over an array")
    values = np.array(x.tolist(), float)
    first, gap = (values[0] if values.size else 0.0), (values[1] - values[0] if values.size > 1 else 0.0)
    whole = first + gap * np.arange(values.size)
    if not (np.array_equal(values, whole) and float(first).is_integer() and float(gap).is_integer()):
        raise UnsupportedError("a loop scans over an array")

    def at(i):
        number = lax.convert_element_type(int(first) + int(gap) * i, aval.dtype)
        return array_of([number], ())

    return at
