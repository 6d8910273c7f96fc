"""Caches in memory are bounded: a process meets new numbers of steps, literals and lambdas all day."""

import functools

import jax
import jax.numpy as jnp

import cnclik as ck
from cnclik import cache
from cnclik.engine.native import compiled


def test_a_cache_keeps_a_bounded_number_of_entries(monkeypatch):
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
    few, many = held(range(4)), held(range(4, 16))
    assert many < few + 12
    assert others(1.0) == 2 and len(again) == 1


def test_programs_of_a_function_are_few_and_right(monkeypatch):
    """As in a process that meets new numbers of steps, literals and lambdas all day."""
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 3)
    sizes = []

    @cache.bounded_jit(static_argnames="power")
    def raised(x, *, power):
        return x**power

    for k in (*range(1, 9), 8, 8, 1):
        assert raised(2.0, power=k) == 2.0**k
        sizes.append(raised._cache_size())
    assert sizes[:10] == [1, 2, 3, 0, 1, 2, 3, 0, 1, 1]  # the fourth makes room, and what is asked for again is there


def test_solve_with_ever_new_numbers_of_steps_stays_flat(monkeypatch):
    monkeypatch.setattr(cache, "MOST_PROGRAMS", 3)
    law = ck.Law(ck.planar_arm([0.5]), ck.position("x"), alpha=1.0)
    for N in range(1, 6):
        with ck.use_engine("plain"):
            assert len(ck.solve(law, ck.hold([0.1]), [0.3], 0.1, N, "EE").status) == N
        assert compiled._cache_size() <= 3
