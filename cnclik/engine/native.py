"""native(fn): a function of small arrays as C, for use inside your own JAX program.

It is a JAX primitive whose CPU lowering calls the C library by XLA's foreign function interface. Its batching rule
widens the batch. Its derivative is another such function, read from JAX's jvp; it is linear in the tangents, and its
transpose is read from JAX's vjp. So `jit`, `vmap`, `jvp`, `grad` and `lax.scan` work, to any order.
"""

import contextlib
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir, partial_eval

from cnclik import errors
from cnclik.cache import LRU, bounded_jit
from cnclik.engine.graph import SlowError
from cnclik.engine.plan import in_c, in_scalars, most_scalars, use_engine
from cnclik.engine.program import Program, Programs, key_of, lane_avals
from cnclik.engine.reader import closes_over_traced
from cnclik.engine.rounds import RoundsError
from cnclik.engine.to_jax import Derived
from cnclik.engine.tracing import is_read, to_be_read
from cnclik.programs import needs

_registered = {}  # {name of a library: its program}, kept as XLA may call it as long as the process lives


def native(fn: Callable) -> Callable:
    """The same function as C, for use inside a JAX program of your own: native(fn)(*args) = fn(*args), to rounding.

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
    return of_rounds(fn)


def of_rounds(fn, whole=None, rounds=0):
    """`native` of a function of so many rounds. Args: whole: the same function of any number of rounds, as `native`."""
    made = LRU()

    def function_of(treedef, args, named):
        return Function(_flattened(fn, treedef), whole=whole and whole.of(*args, **named)[0], rounds=rounds)

    def of(*args, **named):
        """(function of flat arrays, arrays) of some arguments."""
        leaves, treedef = jax.tree.flatten((args, named))
        function = made.made(treedef, lambda treedef: function_of(treedef, args, named))
        return function, list(map(errors.as_jax_takes, leaves))

    @functools.wraps(fn)
    def call(*args, **named):
        function, leaves = of(*args, **named)
        leaves = [jnp.asarray(x) for x in leaves]
        if is_read():  # as a part of what calls it
            return function.fn(*leaves)
        _, tree = function.out([jax.typeof(x) for x in leaves])
        if function.itself:  # it has effects, or closes over values of a surrounding trace
            return function.fn(*leaves)
        return jax.tree.unflatten(tree, native_p.bind(*leaves, function=function, batched=(False,) * len(leaves)))

    call.of = of  # type: ignore[attr-defined]
    return call


def _flattened(fn, treedef):
    """A function of trees as a function of their leaves."""

    def flat(*leaves):
        args, named = jax.tree.unflatten(treedef, leaves)
        return fn(*args, **named)

    return flat


class Function:
    """A function of flat arrays with its programs and the functions of its derivatives.

    `linear` counts the last arguments in which it is linear. For a derivative, `of` is (the function, the arguments it
    is differentiated by, which of its results are real). `whole` is the function of any number of rounds, of which this
    has `rounds`: one program serves all numbers.
    """

    def __init__(self, fn, linear=0, of=None, whole=None, rounds=0):
        self.fn, self.linear, self.of, self.whole, self.rounds = fn, linear, of, whole, rounds
        self.programs, self.scalars = Programs(self._flat), Programs(self._flat, Derived, most_scalars)
        self.single = Programs(self._flat, functools.partial(Program, single=True))  # for a single lane
        self.derivatives, self.shapes, self.trees, self.itself = {}, {}, {}, False
        self.lanes_of_whole = {}  # its program for a single lane, of our number of rounds

    def _flat(self, *leaves):
        results, self.trees[key_of(map(jax.typeof, leaves))] = jax.tree.flatten(self.fn(*leaves))
        return results

    def one_lane(self, avals, *, known=False):
        """The program for a single lane, or the reason why there is none. Args: known: None if it is not yet made."""
        found = self.whole and (self.whole.single.known(avals) if known else self.whole.single.of(avals))
        if found is None or isinstance(found, RoundsError):
            return self.single.known(avals) if known else self.single.of(avals)
        key = key_of(avals)
        if isinstance(found, Program) and key not in self.lanes_of_whole:
            self.trees[key] = self.whole.trees[key]
            self.lanes_of_whole[key] = found.of_rounds(self.rounds)
        return self.lanes_of_whole.get(key, found)

    def out(self, avals) -> tuple:
        """(avals of the results, leaf by leaf, their tree)"""
        key = key_of(avals)
        for program in (self.programs.known(avals), self.one_lane(avals, known=True)):
            if isinstance(program, Program):  # it is already traced
                return program.shapes, self.trees[key]
        if key not in self.shapes:
            given = [_aval(a.shape, a) for a in avals]
            with to_be_read():  # as its programs do, so that JAX caches most of it for them
                closed, shapes = jax.make_jaxpr(self.fn, return_shape=True)(*given)
            self.itself |= bool(closed.effects) or closes_over_traced(closed)
            self.shapes[key] = jax.tree.flatten(shapes)
        return self.shapes[key]

    def jvp(self, by, real):
        """The tangents of the results, as a function of the arguments and of the tangents of the arguments `by`.

        Args: real: which results have tangents.
        """
        key = "jvp", by, real
        if key not in self.derivatives:
            made = functools.partial(_pushed, self._flat, by, real)
            self.derivatives[key] = Function(made, len(by), (self, by, real))
        return self.derivatives[key]

    def only(self, wanted):
        """The same function with the wanted results only, one bool for each result."""
        if all(wanted):
            return self
        if self.of is not None:
            of, by, real = self.of
            kept = iter(wanted)
            return of.jvp(by, tuple(r and next(kept) for r in real))
        if wanted not in self.derivatives:
            self.derivatives[wanted] = Function(
                lambda *args: [x for x, w in zip(self._flat(*args), wanted, strict=True) if w]
            )
        return self.derivatives[wanted]

    def transposed(self):
        """The cotangents of the last, linear arguments, as a function of the others and of the results' cotangents."""
        if "vjp" not in self.derivatives:
            of, by, real = self.of
            self.derivatives["vjp"] = Function(functools.partial(_pulled_back, of._flat, by, real))
        return self.derivatives["vjp"]


def _restricted(fn, by, real, args):
    """(fn as a function of the arguments `by` to its real results, with the others fixed; those arguments)"""

    def of_some(*some):
        full = list(args)
        for i, x in zip(by, some, strict=True):
            full[i] = x
        return [x for x, wanted in zip(fn(*full), real, strict=True) if wanted]

    return of_some, [args[i] for i in by]


def _pushed(fn, by, real, *args):
    first = len(args) - len(by)
    return jax.jvp(*_restricted(fn, by, real, args[:first]), list(args[first:]))[1]


def _pulled_back(fn, by, real, *args):
    first = len(args) - sum(real)
    of_some, some = _restricted(fn, by, real, args[:first])
    return jax.vjp(of_some, *some)[1](list(args[first:]))


native_p = Primitive("cnclik_native")
native_p.multiple_results = True


def _lanes(avals, batched):
    """(avals of one lane's arguments, number of lanes or None if there is no lane axis)"""
    size = next((a.shape[0] for a, b in zip(avals, batched, strict=True) if b), None)
    return [_aval(a.shape[1:] if b else a.shape, a) for a, b in zip(avals, batched, strict=True)], size


def _aval(shape, like):
    return jax.ShapeDtypeStruct(shape, like.dtype, weak_type=getattr(like, "weak_type", False))


@native_p.def_abstract_eval
def _abstract(*avals, function, batched):
    lane, size = _lanes(avals, batched)
    outs, _ = function.out(lane)
    shape = () if size is None else (size,)
    return [jax.core.ShapedArray((*shape, *o.shape), o.dtype) for o in outs]


def _plain(*args, function, batched):
    """The function by JAX: scalar by scalar, or the source itself if it cannot be read."""
    axes = [0 if b else None for b in batched]
    lane, _ = _lanes([jax.typeof(x) for x in args], batched)
    found = function.scalars.of(lane) if in_scalars() and not jax.config.jax_disable_jit else None
    fn = found if isinstance(found, Derived) else function._flat
    return jax.vmap(fn, axes)(*args) if any(batched) else fn(*args)


def _on_a_cpu(ctx, *args, function, batched):
    """Its lowering: C; or by JAX, and then the source of what it calls, too, if C takes too long to compile."""
    lane, size = _lanes(ctx.avals_in, batched)
    program = None
    if in_c() and size != 0:
        program = function.one_lane(lane) if size is None else function.programs.of(lane)
    if isinstance(program, Program):
        return _lowered(functools.partial(_called, program, size))(ctx, *args)
    with contextlib.nullcontext() if not isinstance(program, SlowError) else use_engine("plain"):
        return _lowered(_plain)(ctx, *args, function=function, batched=batched)


def _called(program, size, *args):
    if program.path not in _registered:
        _register(program)
    needs(_ready, program.path)
    shape = () if size is None else (size,)
    outs = [jax.ShapeDtypeStruct((*shape, *s.shape), s.dtype) for s in program.shapes]
    return jax.ffi.ffi_call(program.path, outs)(*args, *[np.int32(program.rounds)] * (program.rounds > 0))


def _register(program):
    jax.ffi.register_ffi_target(program.path, jax.ffi.pycapsule(program.library.call), platform="cpu")
    _registered[program.path] = program


def _ready(path):
    """Registers with XLA a library that another process has built."""
    if path not in _registered:
        _register(Program.kept((), path, ()))


_lowered = functools.partial(mlir.lower_fun, multiple_results=True)
mlir.register_lowering(native_p, _lowered(_plain))
mlir.register_lowering(native_p, _on_a_cpu, platform="cpu")


@native_p.def_impl
def _now(*args, function, batched):
    if jax.config.jax_disable_jit:
        return _plain(*args, function=function, batched=batched)
    return called(*args, function=function, batched=batched)


@functools.partial(bounded_jit, static_argnames=("function", "batched"))
def called(*args, function, batched):
    return native_p.bind(*args, function=function, batched=batched)


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


def _nothing(primal):
    return ad.Zero(jax.typeof(primal).to_tangent_aval())


def _jvp(primals, tangents, *, function, batched):
    made = native_p.bind(*primals, function=function, batched=batched)
    tangents = [jnp.asarray(t) if isinstance(t, float) else t for t in tangents]  # as given to `jax.jvp`
    by = tuple(i for i, t in enumerate(tangents) if not isinstance(t, ad.Zero) and t.dtype != jax.dtypes.float0)
    real = tuple(jnp.issubdtype(x.dtype, jnp.inexact) for x in made)
    if not by or not any(real):
        return made, list(map(_nothing, made))
    given, wide = [*primals, *(tangents[i] for i in by)], (*batched, *(batched[i] for i in by))
    found = iter(native_p.bind(*given, function=function.jvp(by, real), batched=wide))
    return made, [next(found) if r else _nothing(x) for x, r in zip(made, real, strict=True)]


def _transpose(cotangents, *args, function, batched):
    first = len(args) - function.linear
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


def scalars(fn):
    """The function of one lane with one JAX operation per scalar; unchanged if it cannot be read.

    Its derivatives are those of the original function.
    """
    as_c = fn if hasattr(fn, "of") else native(fn)

    @functools.wraps(fn)
    def call(*args):
        function, leaves = as_c.of(*args)
        lane = lane_avals(leaves, batched=False)
        made = function.scalars.of(lane) if in_scalars() else None
        if not isinstance(made, Derived):
            return fn(*args)
        flat = jax.custom_jvp(made)
        flat.defjvp(lambda primals, tangents: jax.jvp(function._flat, primals, tangents))
        return jax.tree.unflatten(function.trees[key_of(lane)], flat(*leaves))

    return call
