"""Compiler hints, and the one switch that turns them off.

Hints change speed, never the meaning: `with use_hints(False): ...` (or CNCLIK_HINTS=0 in the environment) runs the same
code without them.
"""

import contextlib
import functools
import os
import threading

import jax
import jax.numpy as jnp
from jax.experimental.xla_metadata import set_xla_metadata

from cnclik.cache import bounded_jit
from cnclik.programs import keeping
from cnclik.programs import kept as kept_whole

# All of them are made here, at once: each that JAX gets later makes it compile anew what a user has compiled before.
_context = jax.make_user_context(default_value=os.environ.get("CNCLIK_HINTS", "1") != "0")
FEW = 1024  # lanes, at most, of a loop that is `one_function`; with more of them XLA:CPU may fail, too
_lanes = jax.make_user_context(default_value=0)  # how many are around what is traced; 0: unknown or many
engine = jax.make_user_context(default_value=None)  # of `cnclik.engine.plan`
read = jax.make_user_context(default_value=False)  # of `cnclik.engine.tracing`
SWITCHES = [_context, engine]  # that decide on programs


def use_hints(on: bool) -> contextlib.AbstractContextManager:
    """Context manager: turn every compiler hint and option of cnclik on or off. Part of JAX's cache keys."""
    return _context(bool(on))


def hints_on() -> bool:
    """Whether XLA gets hints: the switch is on and the program is for a CPU."""
    return _context.value and jax.default_backend() == "cpu"


def switched_on() -> bool:
    """Whether the switch is on."""
    return _context.value


def as_here(fn):
    """The function with the caller's switches, precision and device, for another thread to run in."""
    wide, device, values = jax.config.jax_enable_x64, jax.config.jax_default_device, [c.value for c in SWITCHES]

    def there(*args, **named):
        with jax.enable_x64(wide), jax.default_device(device), contextlib.ExitStack() as held:
            for switch, value in zip(SWITCHES, values, strict=True):
                held.enter_context(switch(value))
            return fn(*args, **named)

    return there


# --- options of the compiler --------------------------------------------------------------------------

# A program that runs once is ready sooner with fewer passes over it, and with XLA's older emitters where they
# are still there: a third of the compile time, and hardly slower where one lane is all there is.
QUICK_COMPILE = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
LIGHT_COMPILE = {**QUICK_COMPILE, "xla_backend_optimization_level": 1}  # for one that runs often: a third longer


def known_options(options: dict) -> dict:
    """Those of the compiler options that this version's compiler knows, and none where the switch is off.

    Options are no stable part of XLA, and one that it doesn't know is an error: each is tried once, on a program
    of one number, when it is first asked for.
    """
    if not switched_on():
        return {}
    backend = jax.default_backend()
    with _probing:
        return {name: value for name, value in options.items() if is_known(name, value, backend)}


_probing = threading.Lock()  # two threads that ask at once would both try


@functools.cache
def is_known(name, value, backend) -> bool:
    program = jax.jit(lambda x: x, compiler_options={name: value}).lower(jax.ShapeDtypeStruct((), "int32"))
    try:
        program.compile()
    except (RuntimeError, ValueError, TypeError):  # what a compiler raises for it differs between versions
        return False
    return True


def quick_jit(fn=None, *, compiler=QUICK_COMPILE, **options):
    """`jax.jit` for programs whose compile time is most of what a user waits for. Decorator, with jit's arguments.

    Args:
      compiler: options of the compiler; those that it does not know are left out.
    """
    if fn is None:
        return functools.partial(quick_jit, compiler=compiler, **options)

    made = {}  # with hints and without, per backend

    def now():
        key = switched_on(), jax.default_backend()
        if key not in made:  # threads that come here at once share the first one, or each would compile its own
            made.setdefault(key, bounded_jit(fn, compiler_options=known_options(compiler) or None, **options))
        return made[key]

    plain, static = bounded_jit(fn, **options), options.get("static_argnames", ())
    static = (static,) if isinstance(static, str) else static

    @functools.wraps(fn)
    def call(*args, **kwargs):
        if keeping():
            around = _lanes.value, *(switch.value for switch in SWITCHES)  # what else tracing depends on
            found = kept_whole(fn, around, known_options(compiler), static, args, kwargs)
            if found is not None:
                return found
        try:
            return now()(*args, **kwargs)
        except ValueError as error:
            if "compiler_options" not in str(error):
                raise
            return plain(*args, **kwargs)  # called while another program is traced, which has options of its own

    call._cache_size = lambda: now()._cache_size()
    return call


def few_lanes(count: int):
    """Context manager: what is traced inside runs for `count` lanes, so few that a loop may be `one_function`."""
    return _lanes(count)


# What may be compiled with 512-bit vectors: what is tested to give the same numbers. With them XLA (jax 0.10.2) gives
# 0 for most arctangents, and might do so with others that nobody has looked at.
_WIDE_NAMES = """
    abs acos acosh add add_any and argmax argmin asin asinh atan2 atanh broadcast_in_dim cbrt ceil checkpoint
    clamp closed_call concatenate cond convert_element_type copy copy_p copysign core_call cos cosh cumsum
    custom_jvp_call custom_vjp_call custom_vjp_call_jaxpr div dot_general dynamic_slice dynamic_update_slice eq
    erf exp exp2 expand_dims expm1 floor gather ge gt integer_pow iota is_finite jit le log log1p
    logistic lt lt_to max min mul ne neg nextafter not optimization_barrier or pad pjit population_count pow real
    reduce_and reduce_max reduce_min reduce_or reduce_prod reduce_sum rem remat remat2 reshape rev round rsqrt scan
    scatter scatter-add select_n shift_left shift_right_arithmetic shift_right_logical sign sin sinh slice split sqrt
    square squeeze stack stop_gradient sub tan tanh transpose unstack while xor zeros_like
"""
_WIDE = frozenset(_WIDE_NAMES.split())


def equations(jaxpr):
    """All equations of a traced program, those inside its calls and loops too."""
    for equation in jaxpr.eqns:
        yield equation
        for value in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda v: hasattr(v, "eqns")):
            if hasattr(value, "eqns") or hasattr(value, "jaxpr"):
                yield from equations(getattr(value, "jaxpr", value))


_LAPACK_NAMES = "cholesky eig eigh geqp3 geqrf hessenberg householder_product lu qr schur svd triangular_solve"
_LAPACK = frozenset(_LAPACK_NAMES.split())


def shares_threads(jaxpr) -> bool:
    """Whether a traced program calls LAPACK, which hands a batch out to XLA's threads and waits for them on one.

    Where as many such calls run side by side as there are threads, each waits for the others, for ever (jaxlib 0.10).
    """
    return any(equation.primitive.name in _LAPACK for equation in equations(jaxpr))


def is_wide(jaxpr) -> bool:
    """Whether a traced program may be compiled with 512-bit vectors."""
    return all(equation.primitive.name in _WIDE for equation in equations(jaxpr))


def one_function(loop):
    """Compile a call of `loop`, elementwise operations and loops of them, into one function where few lanes are around.

    XLA:CPU otherwise runs each kernel of a loop through the runtime's dispatcher: a quarter of the speed. It fails
    where such a function has a single, large result, which several threads would compute (jaxlib 0.10). So there is a
    second result.
    """

    def plain(*args):  # the hint is for this call, not for those inside it
        with set_xla_metadata(xla_cpu_small_call=None, inlineable=None):
            return [*loop(*args), jax.lax.optimization_barrier(jnp.bool_(True))]

    jitted = jax.jit(plain, inline=False)

    @functools.wraps(loop)
    def call(*args):
        if not (hints_on() and 0 < _lanes.value <= FEW):
            return loop(*args)
        with set_xla_metadata(xla_cpu_small_call="true", inlineable="false"):
            *found, sure = jitted(*args)
        return found if len(found) > 1 else [jnp.where(sure, x, jnp.zeros_like(x)) for x in found]

    return call
