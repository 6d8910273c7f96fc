"""Compiler hints and options: under one switch, known to the compiler, and in caches of bounded size."""

import functools
import pathlib
import threading
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
from cnclik import cache, hints
from cnclik.engine.plan import in_c as runs_in_c
from cnclik.integrate import lanes as tiles
from cnclik.integrate.lanes import lanes


def test_an_option_the_compiler_does_not_know_is_dropped():
    unknown = {"xla_no_such_option": 7}
    assert hints.known_options(unknown) == {}
    assert hints.known_options(hints.QUICK_COMPILE | unknown) == hints.known_options(hints.QUICK_COMPILE)
    before = hints.is_known.cache_info().misses
    hints.known_options(unknown)
    assert hints.is_known.cache_info().misses == before  # tried once


def test_contexts_are_made_together():
    """A context that JAX gets later becomes part of its keys, and it compiles anew what a user compiled before."""
    package = pathlib.Path(ck.__file__).parent
    makers = [file.name for file in package.rglob("*.py") if "make_user_context(" in file.read_text(encoding="utf-8")]
    assert makers == ["hints.py"]


def test_the_switch_turns_options_off():
    with ck.use_hints(False):
        assert hints.known_options(hints.QUICK_COMPILE) == {}
        assert tiles.options(jax.jit(jnp.sin).trace(1.0)) == {}


def test_programs_run_with_options_nobody_knows(monkeypatch):
    monkeypatch.setattr(hints, "QUICK_COMPILE", {"xla_gone": 1})
    monkeypatch.setattr(tiles, "OPTIONS", {"xla_gone": 1})
    assert hints.quick_jit(lambda x: 2 * x)(3.0) == 6
    np.testing.assert_array_equal(lanes(lambda x: 2 * x)(np.arange(3.0)), [0, 2, 4])


def test_quick_jit_asks_nothing_when_it_is_made(monkeypatch):
    asked = []
    monkeypatch.setattr(hints, "known_options", lambda options: asked.append(options) or {})

    @hints.quick_jit(static_argnames="n")
    def power(x, *, n):
        """A docstring."""
        return x**n

    assert not asked and power.__doc__ == "A docstring."
    assert power(3.0, n=2) == 9 and power(2.0, n=2) == 4 and len(asked) == 1


def test_a_function_takes_its_callers_context_to_another_thread():
    def seen():
        config = jax.config
        return config.jax_enable_x64, config.jax_default_device, hints.switched_on(), runs_in_c()

    device = jax.devices("cpu")[-1]
    with ThreadPoolExecutor(1) as pool:
        with jax.enable_x64(False), jax.default_device(device), ck.use_engine("xla"):
            found = pool.submit(hints.as_here(seen)).result()
        assert found == (False, device, True, False)
        assert pool.submit(hints.as_here(seen)).result()[1] is None


# Every elementwise function that may be compiled with wide vectors: XLA:CPU gave 0 for most arctangents.
WIDE = {
    "acos": jnp.arccos,
    "acosh": lambda x: jnp.arccosh(1.1 + x * x),
    "asin": jnp.arcsin,
    "asinh": jnp.arcsinh,
    "atan2": lambda x: jnp.arctan2(x, x[::-1] + 0.3),
    "atanh": jnp.arctanh,
    "cbrt": jnp.cbrt,
    "cos": jnp.cos,
    "cosh": jnp.cosh,
    "erf": jax.scipy.special.erf,
    "exp": jnp.exp,
    "exp2": jnp.exp2,
    "expm1": jnp.expm1,
    "floor": lambda x: jnp.floor(9 * x),
    "log": lambda x: jnp.log(1.1 + x),
    "log1p": jnp.log1p,
    "logistic": jax.nn.sigmoid,
    "pow": lambda x: (1.1 + x) ** x,
    "rem": lambda x: jnp.fmod(x, 0.3),
    "round": lambda x: jnp.round(9 * x),
    "rsqrt": lambda x: jax.lax.rsqrt(1.1 + x),
    "sign": jnp.sign,
    "sin": jnp.sin,
    "sinh": jnp.sinh,
    "sqrt": lambda x: jnp.sqrt(1.1 + x),
    "tan": jnp.tan,
    "tanh": jnp.tanh,
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_what_may_have_wide_vectors_is_right_with_them(dtype):
    """Against the same functions one number at a time; and the arctangent goes without."""
    x = np.linspace(-0.99, 0.99, 199).astype(dtype)  # not 0

    def all_of(x):
        return {name: fn(x) for name, fn in WIDE.items()}

    traced = jax.jit(all_of).trace(x)
    assert hints.is_wide(traced.jaxpr)
    found = traced.lower().compile(hints.known_options(tiles.OPTIONS))(x)
    with jax.disable_jit():
        plain = {name: fn(x) for name, fn in WIDE.items()}
    for name, values in found.items():
        np.testing.assert_allclose(values, plain[name], rtol=20 * np.finfo(dtype).eps, atol=1e-30, err_msg=name)
    for other in (jnp.arctan, jnp.sort, jnp.linalg.inv):
        assert not hints.is_wide(jax.jit(other).trace(jnp.eye(3)).jaxpr)


# --- caches -------------------------------------------------------------------------------------------


def test_lanes_keep_a_bounded_number_of_signatures(monkeypatch):
    monkeypatch.setattr(cache, "KEPT_PROGRAMS", 3)
    recent = cache.LRU()
    for i in range(5):
        recent[i] = str(i)
        recent.get(0)  # in use all the time: it stays
    assert list(recent) == [3, 4, 0] and recent.get(2) is None
    assert recent.get(3) == "3" and list(recent) == [4, 0, 3]


def test_what_jax_traced_does_not_pile_up_and_what_is_compiled_stays(monkeypatch):
    from jax._src import util

    monkeypatch.setattr(cache, "KEPT_TRACES", 3)
    again = []

    @jax.jit
    def others(x):
        again.append(None)
        return 2 * x

    @functools.partial(cache.bounded_jit, static_argnames="n")
    def power(x, *, n):
        return jax.vmap(jax.jit(lambda v: v**n))(x)

    def held(numbers):
        for n in numbers:
            power(jnp.ones(2), n=n)
        return sum(cache.cache_info().currsize for cache in list(util._caches) if hasattr(cache, "cache_info"))

    others(1.0)
    few, many = held(range(4)), held(range(4, 24))
    assert many < few + 20
    assert others(1.0) == 2 and len(again) == 1


@pytest.mark.parametrize("jit", [cache.bounded_jit, hints.quick_jit])
def test_programs_of_a_function_are_few_and_right(jit, monkeypatch):
    """As in a process that meets new numbers of steps, literals and lambdas all day."""
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 3)
    sizes = []

    @jit(static_argnames="power")
    def raised(x, *, power):
        return x**power

    for k in (*range(1, 9), 8, 8, 1):
        assert raised(2.0, power=k) == 2.0**k
        sizes.append(raised._cache_size())
    assert sizes[:10] == [1, 2, 3, 0, 1, 2, 3, 0, 1, 1]  # the fourth makes room, and what is asked for again is there


def test_the_function_used_longest_ago_makes_room(monkeypatch):
    """Never one that has just been used: what alternates with a new one would be made again and again."""
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 4)
    old, used, new = (cache.bounded_jit(lambda x, *, k: k * x, static_argnames="k") for _ in range(3))
    for k in range(2):
        old(1.0, k=k), used(1.0, k=k)
    used(1.0, k=0)
    for k in range(2):
        new(1.0, k=k), used(1.0, k=0)
        assert [one._cache_size() for one in (old, used, new)] == [0, 2, k + 1]


def test_threads_that_ask_first_at_once_share_one_program(monkeypatch):
    at_once, traced = threading.Barrier(2), []
    known = hints.known_options

    def slowly(options):
        at_once.wait(10)  # both are here before either has made anything
        return known(options)

    monkeypatch.setattr(hints, "known_options", slowly)

    @hints.quick_jit
    def twice(x):
        traced.append(None)
        return 2 * x

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(twice, (1.0, 1.0))) == [2.0, 2.0]
    assert len(traced) == 1 and twice._cache_size() == 1


def test_solve_with_ever_new_numbers_of_steps_stays_flat(monkeypatch):
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 4)
    law = ck.Law(ck.planar_arm([0.5]), ck.position("x"), alpha=1.0)
    from cnclik.integrate import solve as solving

    for N in range(1, 8):
        with ck.use_engine("plain"):
            assert len(ck.solve(law, ck.hold([0.1]), [0.3], 0.1, N, "EE").status) == N
        assert solving.solve_soon._cache_size() <= 8
