"""Records: what is compiled in, what is a leaf, and that nothing changes on the way through JAX."""

import copy
import dataclasses
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cnclik.record import combine, is_literal, partition, record, replace, stack


@record
class Inner:
    value: object
    label: str = "a"


@record
class Outer:
    inner: Inner
    numbers: tuple
    extra: object = None


def outer(**changes):
    return Outer(**{"inner": Inner(value=2.0), "numbers": (1, 2.5, jnp.asarray(3.0)), **changes})


def test_python_numbers_are_literal_and_everything_else_is_a_leaf():
    for literal in (1, 1.0, True, "x", None, print):
        assert is_literal(literal)
    for leaf in (np.float64(1), np.int64(1), np.ones(2), jnp.ones(()), jax.ShapeDtypeStruct((), float)):
        assert not is_literal(leaf)
    assert jax.tree.leaves(outer()) == [3.0]
    assert jax.tree.leaves(outer(extra=np.float64(7))) == [3.0, 7.0]


def test_round_trip():
    tree = outer(extra={"a": (None, jnp.arange(3)), "b": 4})
    arrays, literals = partition(tree)
    back = combine(arrays, literals)
    assert back.numbers == tree.numbers and back.inner.value == tree.inner.value
    assert back.extra["b"] == 4 and back.extra["a"][0] is None
    doubled = jax.tree.map(lambda v: 2 * v, tree)
    assert doubled.numbers == (1, 2.5, 6.0) and doubled.inner.label == "a"
    np.testing.assert_array_equal(doubled.extra["a"][1], [0, 2, 4])


def test_literals_key_the_compilation():
    """The same literals: no new trace. Another literal: a new one. Another array: none."""
    traces = []

    @jax.jit
    def fn(tree):
        traces.append(None)
        assert type(tree.inner.value) is float
        return tree.numbers[2] * tree.inner.value

    assert fn(outer()) == 6
    assert fn(outer()) == 6
    assert fn(outer(numbers=(1, 2.5, jnp.asarray(5.0)))) == 10
    assert len(traces) == 1
    assert fn(outer(inner=Inner(value=3.0))) == 9
    assert len(traces) == 2


def test_transformations():
    tree = outer()
    assert jax.grad(lambda t: t.numbers[2] ** 2 * t.inner.value)(tree).numbers[2] == 12
    many = replace(tree, numbers=(1, 2.5, jnp.arange(3.0)))
    np.testing.assert_array_equal(jax.vmap(lambda t: t.numbers[2] + t.numbers[1])(many), [2.5, 3.5, 4.5])


def test_frozen_and_keyword_only():
    with pytest.raises(dataclasses.FrozenInstanceError):
        outer().extra = 1
    with pytest.raises(TypeError):
        Inner(2.0)
    changed = replace(outer(), extra=1)
    assert changed.extra == 1 and outer().extra is None


def test_replace_after_flattening_is_seen():
    """The flattened form is remembered; a changed copy must not remember its original's."""
    tree = outer()
    jax.tree.leaves(tree)
    assert jax.tree.leaves(replace(tree, extra=np.ones(1)))[-1] == 1


def test_copies_and_pickles():
    tree = outer()
    jax.tree.leaves(tree)
    for twin in (copy.copy(tree), copy.deepcopy(tree), pickle.loads(pickle.dumps(tree))):
        assert jax.tree.leaves(twin) == jax.tree.leaves(tree)
        assert jax.tree.structure(twin) == jax.tree.structure(tree)
        assert twin.numbers == tree.numbers


def test_stack_keeps_what_agrees_literal():
    """Numbers in which records differ become lanes; the rest is compiled in as before."""
    a, b = outer(), outer(inner=Inner(value=4.0))
    both = stack([a, b])
    assert both.inner.label == "a" and both.numbers[:2] == (1, 2.5) and both.extra is None
    np.testing.assert_array_equal(both.inner.value, [2.0, 4.0])
    np.testing.assert_array_equal(both.numbers[2], [3.0, 3.0])
    doubled = jax.vmap(lambda r: r.inner.value * r.numbers[1] + r.numbers[2])(both)
    np.testing.assert_array_equal(doubled, [8.0, 13.0])
