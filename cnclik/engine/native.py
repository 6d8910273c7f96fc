"""native(fn): a function of small arrays as C, for use inside your own JAX program.

It is a JAX primitive. What its CPU lowering calls is decided by `plan`: a C library, by XLA's foreign function
interface, or the function in JAX. Its batching rule widens the batch. Its derivative is another such function, read
from JAX's jvp; it is linear in the tangents, and its transpose is read from JAX's vjp. So `jit`, `vmap`, `jvp`, `grad`
and `lax.scan` work, to any order.
"""

import functools
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir, partial_eval
from jax.sharding import NamedSharding, PartitionSpec

from cnclik import errors
from cnclik.cache import LRU, bounded_jit
from cnclik.engine.graph import SlowError, UnsupportedError
from cnclik.engine.plan import chosen
from cnclik.engine.program import Program, canonical, key_of, lane_avals
from cnclik.engine.reader import Trace, part, trace
from cnclik.engine.to_jax import Derived
from cnclik.engine.tracing import engine, is_read

_registered = {}  # {name of a library: its program}, kept as XLA may call it as long as the process lives


def native(fn: Callable) -> Callable:
    """Return the same function as C, for a JAX program of your own: native(fn)(*args) = fn(*args), to rounding.

    It stays so under `jax.jit`, `vmap`, `jvp`, `grad` and `lax.scan`, in any order and nested: jax.vmap(native(fn)) is
    jax.vmap(fn) on vectors of lanes, and the derivatives of native(fn) are those of fn, as C, too.

    Args:
      fn: a pure function of arrays, or trees of them, to such; of one lane: `jax.vmap` it for many. It is fit for
        arithmetic, loops, branches and small matrices (docs: "How it gets fast"). What is no array, such as a number of
        steps, is bound before: `native(functools.partial(fn, steps=20))`.

    Returns: a function of the same arguments. The first call with arguments of new shapes compiles, for about a second.
      Elsewhere than on a CPU, without a C compiler, or where `fn` does what has no C form, it is `fn` itself.
    Raises: ArgumentError where `fn` is no function; in a call what `fn` raises.
    """
    if not callable(fn):
        raise errors.fail("fn", "be a function of arrays", f"is {fn!r}")
    functions = LRU()

    def of(*args, **named):
        """(`Function` of flat arrays, arrays) of some arguments."""
        leaves, treedef = jax.tree.flatten((args, named))
        function = functions.made(treedef, lambda treedef: Function(of_leaves(fn, treedef)))
        return function, leaves

    @functools.wraps(fn)
    def call(*args, **named):
        function, leaves = of(*args, **named)
        return function(*leaves)

    call.of = of  # type: ignore[attr-defined]
    return call


def of_leaves(fn, treedef):
    """A function of a tree (args, named) as a function of its leaves."""

    def flat(*leaves):
        args, named = jax.tree.unflatten(treedef, leaves)
        return fn(*args, **named)

    return flat


def narrowed(leaves) -> list:
    """Return values as arrays of the types that JAX has: what was made in 64 bits may be used where it has 32."""
    arrays = map(jnp.asarray, leaves)
    return [x if x.dtype == canonical(x.dtype) else x.astype(canonical(x.dtype)) for x in arrays]


def alike(leaves) -> list:
    """Return values that vary over the same devices of a `jax.shard_map`: a derivative by what all share is a sum."""
    kinds = list(map(jax.typeof, leaves))
    axes = [frozenset(a.vma if hasattr(a, "vma") else a.manual_axis_type.varying) for a in kinds]
    every = frozenset().union(*axes)
    return [jax.lax.pcast(x, tuple(every - own), to="varying") for x, own in zip(leaves, axes, strict=True)]


class Function:
    """A function of flat arrays with its forms and the functions of its derivatives.

    For a derivative, `of` is (the function, the arguments it is differentiated by, which of its results are real). It
    is linear in its last arguments, the tangents of these. For a part, `whole` is (the function, which of its results).
    """

    def __init__(self, fn, of=None, whole=None):
        self.fn, self.of, self.whole = fn, of, whole
        self.traces, self.forms, self.derivatives = LRU(), LRU(), LRU()

    def __call__(self, *leaves):
        """Return the tree of its results, as part of a JAX program or by one of its own."""
        leaves = narrowed(leaves)
        if is_read():  # as a part of what calls it
            return self.fn(*leaves)
        traced = self.trace(lane_avals(leaves, batched=False))
        if traced.stays:
            return self.fn(*leaves)
        return traced.tree.unflatten(native_p.bind(*alike(leaves), function=self, batched=(False,) * len(leaves)))

    def flat(self, *leaves) -> list:
        """Return its results, leaf by leaf."""
        return jax.tree.leaves(self.fn(*leaves))

    def trace(self, avals) -> Trace:
        """Return its trace for arguments of these avals. What is read already may be without its jaxpr."""
        return self.traces.made(key_of(avals), lambda _: self._traced(avals))

    def _traced(self, avals):
        whole = self.whole and self.whole[0].trace(avals)
        traced = part(whole, self.whole[1]) if whole and whole.closed is not None else trace(self.fn, avals)
        return traced._replace(closed=None) if traced.stays else traced  # tracers are not to be kept

    def shapes(self, avals) -> list:
        """Return the shapes of its results. A derivative is not traced for them: one that nobody runs never is."""
        if self.of is None:
            return self.trace(avals).shapes
        of, by, real = self.of
        return [*itertools.compress(of.shapes(avals[: -len(by)]), real)]

    def form(self, kind, avals, most):
        """Return its C for "lanes" or one "lane", or its "scalars" for JAX; or the reason why there is none.

        Args: most: nodes of its graph.
        """
        return self.forms.made((kind, most, key_of(avals)), lambda _: self._made(kind, avals, most))

    def _made(self, kind, avals, most):
        try:
            traced = self.trace(avals)
            if traced.closed is None:
                traced = trace(self.fn, avals)
            if kind == "scalars":
                return Derived(traced, avals, most=most)
            form = Program(traced, avals, single=kind == "lane", most=most)
        except UnsupportedError as error:
            return error.with_traceback(None)  # whose frames would keep the graph
        self.traces[key_of(avals)] = traced._replace(closed=None)  # not needed again
        return form

    def jvp(self, by, real):
        """Return the tangents of the results, as a function of the arguments and of tangents of the arguments `by`.

        Args: real: which results have tangents.
        """
        fn = functools.partial(_pushed, self.flat, by, real)
        return self.derivatives.made((by, real), lambda _: Function(fn, (self, by, real)))

    def transposed(self):
        """Return the cotangents of the last, linear arguments, as a function of the others and of the results'."""
        fn = functools.partial(_pulled_back, self.of[0].flat, *self.of[1:])
        return self.derivatives.made("transposed", lambda _: Function(fn))

    def only(self, wanted):
        """Return the same function with the wanted results only, one bool for each result."""
        if all(wanted):
            return self
        if self.of is not None:
            (of, by, real), kept = self.of, iter(wanted)
            return of.jvp(by, tuple(r and next(kept) for r in real))
        return self.derivatives.made(
            wanted,
            lambda _: Function(lambda *args: [*itertools.compress(self.flat(*args), wanted)], whole=(self, wanted)),
        )


def _restricted(fn, by, real, args):
    """(fn as a function of the arguments `by` to its real results, with the others fixed; those arguments)"""

    def of_some(*some):
        full = list(args)
        for i, x in zip(by, some, strict=True):
            full[i] = x
        return [*itertools.compress(fn(*full), real)]

    return of_some, [args[i] for i in by]


def _pushed(fn, by, real, *args):
    first = len(args) - len(by)
    return jax.jvp(*_restricted(fn, by, real, args[:first]), list(args[first:]))[1]


def _pulled_back(fn, by, real, *args):
    first = len(args) - sum(real)
    of_some, some = _restricted(fn, by, real, args[:first])
    return jax.vjp(of_some, *some)[1](list(args[first:]))


# --- the primitive ------------------------------------------------------------------------------------

native_p = Primitive("cnclik_native")
native_p.multiple_results = True


def _lanes(avals, batched):
    """(avals of one lane's arguments, number of lanes or None if there is no lane axis)"""
    size = next((a.shape[0] for a, b in zip(avals, batched, strict=True) if b), None)
    each = zip(avals, batched, strict=True)
    return [jax.ShapeDtypeStruct(a.shape[b:], a.dtype, weak_type=a.weak_type) for a, b in each], size


@native_p.def_abstract_eval
def _abstract(*avals, function, batched):
    lane, size = _lanes(avals, batched)
    shape = () if size is None else (size,)
    like = avals[0] if avals else jax.core.ShapedArray((), bool)  # it varies over the same devices
    new = {"weak_type": False, "sharding": NamedSharding(like.sharding.mesh, PartitionSpec())}
    return [like.update(shape=(*shape, *o.shape), dtype=o.dtype, **new) for o in function.shapes(lane)]


def _lowered(ctx, *args, function, batched, platform):
    """Its lowering: what `plan` has chosen, for one lane or a batch."""
    lane, size = _lanes(ctx.avals_in, batched)
    batch = size is not None
    form = chosen(function, lane, batch=batch, platform=platform) if size != 0 else None
    fn = form if isinstance(form, Derived) else function.flat
    if isinstance(form, Program):
        fn = functools.partial(_called, form, size)
    elif batch:
        fn = jax.vmap(fn, [0 if b else None for b in batched])
    ctx = ctx.replace(avals_in=[jax.core.ShapedArray(a.shape, a.dtype, a.weak_type) for a in ctx.avals_in])
    with engine("plain" if isinstance(form, SlowError) else engine.value):
        return mlir.lower_fun(fn, multiple_results=True)(ctx, *args)


def _called(program, size, *args):
    """Calls a library from XLA."""
    if program.path not in _registered:
        jax.ffi.register_ffi_target(program.path, jax.ffi.pycapsule(program.library.call), platform="cpu")
        _registered[program.path] = program
    shape = () if size is None else (size,)
    outs = [jax.ShapeDtypeStruct((*shape, *s.shape), s.dtype) for s in program.shapes]
    return jax.ffi.ffi_call(program.path, outs)(*args)


mlir.register_lowering(native_p, functools.partial(_lowered, platform="other"))
mlir.register_lowering(native_p, functools.partial(_lowered, platform="cpu"), platform="cpu")


@native_p.def_impl
def _now(*args, function, batched):
    if jax.config.jax_disable_jit:
        axes = [0 if b else None for b in batched]
        return jax.vmap(function.flat, axes)(*args) if any(batched) else function.flat(*args)
    return compiled(*args, function=function, batched=batched)


@functools.partial(bounded_jit, static_argnames=("function", "batched"))
def compiled(*args, function, batched):
    """Its results, by a program of its own."""
    return native_p.bind(*narrowed(args), function=function, batched=batched)


def _batch(args, dims, *, function, batched):
    size = next(x.shape[d] for x, d in zip(args, dims, strict=True) if d is not None)
    args = [x if d is None else jnp.moveaxis(x, d, 0) for x, d in zip(args, dims, strict=True)]
    if not any(batched):
        made = native_p.bind(*args, function=function, batched=tuple(d is not None for d in dims))
        return made, [0] * len(made)
    inner = next(x.shape[1 if d is not None else 0] for x, d, b in zip(args, dims, batched, strict=True) if b)

    def widened(x, d, b):  # merges both batch axes
        if d is None and not b:
            return x
        lane = x.shape[(d is not None) + b :]
        x = x if d is not None else x[None]
        x = x if b else x[:, None]
        return jnp.broadcast_to(x, (size, inner, *lane)).reshape(size * inner, *lane)

    wide = [widened(*one) for one in zip(args, dims, batched, strict=True)]
    both = tuple(d is not None or b for d, b in zip(dims, batched, strict=True))
    made = native_p.bind(*wide, function=function, batched=both)
    return [x.reshape(size, inner, *x.shape[1:]) for x in made], [0] * len(made)


def _jvp(primals, tangents, *, function, batched):
    made = native_p.bind(*primals, function=function, batched=batched)
    tangents = [jnp.asarray(t) if isinstance(t, float) else t for t in tangents]  # as given to `jax.jvp`
    by = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero))
    real = tuple(jnp.issubdtype(x.dtype, jnp.inexact) for x in made)
    nothing = [ad.Zero(jax.typeof(x).to_tangent_aval()) for x in made]
    if not by or not any(real):
        return made, nothing
    given, wide = [*primals, *(tangents[i] for i in by)], (*batched, *(batched[i] for i in by))
    found = iter(native_p.bind(*given, function=function.jvp(by, real), batched=wide))
    return made, [next(found) if r else zero for zero, r in zip(nothing, real, strict=True)]


def _transpose(cotangents, *args, function, batched):
    first = len(args) - len(function.of[1])
    avals = [x.aval if ad.is_undefined_primal(x) else jax.typeof(x) for x in args]
    known, size = args[:first], _lanes(avals, batched)[1]
    function = function.only(tuple(not isinstance(c, ad.Zero) for c in cotangents))
    given = [c for c in cotangents if not isinstance(c, ad.Zero)]
    wide = (*batched[:first], *(size is not None for _ in given))
    found = native_p.bind(*known, *given, function=function.transposed(), batched=wide)
    out = [None] * first
    for x, b, aval in zip(found, batched[first:], avals[first:], strict=True):
        out.append(x if b or size is None else jnp.sum(x, 0).astype(aval.dtype))
    return out


def _used(used, *rest):
    """A call without the results that nobody uses."""
    eqn = rest[-1]  # from JAX 0.12 on after which inputs are read later
    if not any(used):
        return [False] * len(eqn.invars), None
    function = eqn.params["function"].only(tuple(used))
    outs = [v for v, u in zip(eqn.outvars, used, strict=True) if u]
    return [True] * len(eqn.invars), eqn.replace(outvars=outs, params=dict(eqn.params, function=function))


batching.primitive_batchers[native_p] = _batch
partial_eval.dce_rules[native_p] = _used
ad.primitive_jvps[native_p] = _jvp
ad.primitive_transposes[native_p] = _transpose
