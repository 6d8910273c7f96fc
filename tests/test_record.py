"""Records: what is compiled in, what is a leaf, and that nothing changes on the way through JAX."""

import copy
import dataclasses
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cnclik as ck
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
    for literal in (1, 1.0, True, "x", np.str_("x"), None, print):
        assert is_literal(literal)
    for leaf in (np.float64(1), np.int64(1), np.ones(2), jnp.ones(()), jax.ShapeDtypeStruct((), float)):
        assert not is_literal(leaf)
    assert jax.tree.leaves(outer()) == [3.0]
    assert jax.tree.leaves(outer(extra=np.float64(7))) == [3.0, 7.0]


def test_round_trip():
    tree = outer(extra={"a": (None, jnp.arange(3)), "b": 4})
    back = combine(*partition(tree))
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


def test_frozen_and_keyword_only():
    tree = outer()
    with pytest.raises(dataclasses.FrozenInstanceError):
        tree.extra = 1
    with pytest.raises(TypeError):
        Inner(2.0)
    jax.tree.leaves(tree)  # the flattened form is remembered; a changed copy must not remember its original's
    changed = replace(tree, extra=np.ones(1))
    assert jax.tree.leaves(changed)[-1] == 1 and tree.extra is None


def test_copies_and_pickles_are_equal_and_as_little_written_to():
    mine = np.ones(3)
    tree = replace(outer(), extra=mine)
    jax.tree.leaves(tree)
    for twin in (copy.copy(tree), copy.deepcopy(tree), pickle.loads(pickle.dumps(tree))):
        assert jax.tree.structure(twin) == jax.tree.structure(tree) and twin.numbers == tree.numbers
        with pytest.raises(ValueError, match="read-only"):
            twin.extra[0] = 2.0
    mine[0] = 2.0
    assert tree.extra[0] == 1


def test_stack_keeps_what_agrees_literal():
    """Numbers in which records differ become lanes; the rest is compiled in as before."""
    a, b = outer(), outer(inner=Inner(value=4.0))
    both = stack([a, b])
    assert both.inner.label == "a" and both.numbers[:2] == (1, 2.5) and both.extra is None
    np.testing.assert_array_equal(both.inner.value, [2.0, 4.0])
    np.testing.assert_array_equal(both.numbers[2], [3.0, 3.0])
    doubled = jax.vmap(lambda r: r.inner.value * r.numbers[1] + r.numbers[2])(both)
    np.testing.assert_array_equal(doubled, [8.0, 13.0])


def test_records_print_in_short():
    shown = "Outer(inner=Inner(value=(0, 1, 2, … 9 in all), label='a'), numbers=(1, 2.5, 3), extra=float64[40, 40])"
    assert repr(outer(inner=Inner(value=tuple(range(9))), extra=np.zeros((40, 40)))) == shown
    assert repr(Inner(value=print)) == "Inner(value=print, label='a')"
    seen = []
    jax.jit(lambda r: seen.append(repr(r)) or r.value)(Inner(value=np.ones(3)))
    assert seen == ["Inner(value=float64[3], label='a')"]


def test_what_a_newcomer_prints_is_a_few_lines_and_looks_at_no_traced_value():
    arm = ck.planar_arm(np.ones(2), joint_names=["shoulder", "elbow"])
    law = ck.Law(arm, ck.position("xy"), alpha=5.0, inverse=ck.damped(0.1), error_clamp=(0.1, 0.2))
    run = ck.solve(law, ck.hold([1.0, 0.5]), [0.3, 0.9], 0.1, 4)
    lines = str(run).split("\n")
    assert lines[::2] == ["Trajectory: 4 steps, 2 joints, 2 task coordinates, float64", "  status: OK 4"]
    first, *_, last = size = np.linalg.norm(run.e, axis=1)
    assert lines[1] == f"  ‖e‖ {first:.4g} at first, {last:.4g} at last, at most {size.max():.4g}"
    assert all(part in str(law) for part in ("x, y [m]", "alpha 5 1/s", "damped(damping=0.1)", "clamp [0.1, 0.2]"))
    assert repr(ck.pose("xy", "z", weights=[1, 1, 2])) == "Task: x, y [m], rz [rad], weights [1, 1, 2]"
    assert repr(ck.hold([1.0, 2.0])) == "Reference: Hold(position=[1, 2], rotation=None)"
    assert repr(ck.causal(ck.hold([1.0]))).endswith("future unknown")
    batch = jax.tree.map(lambda v: jnp.stack([v] * 3), run)
    assert str(batch).startswith("Trajectory: 3 lanes, each of 4 steps, 2 joints")
    seen = []
    jax.jit(lambda *args: seen.extend(map(str, args)))(law, run)
    assert "alpha float64[]" in seen[0] and seen[1] == "Trajectory: 4 steps, 2 joints, 2 task coordinates"
    assert "4 steps" in repr(jax.eval_shape(lambda r: r, run))


def test_records_of_the_same_content_are_equal():
    """`ck.Drive(delay=3) == ck.Drive(delay=3)` was False."""
    arm = ck.planar_arm([1.0, 0.8])
    pairs = [
        lambda lag=0.05: ck.Drive(delay=3, lag=np.full(2, lag)),
        lambda alpha=5.0: ck.Law(ck.planar_arm([1.0, 0.8]), ck.position("xy"), alpha=alpha, inverse=ck.damped(0.1)),
        lambda gain=1.0: outer(extra={"alpha": [gain, 2.0]}),
    ]
    for made in pairs:
        one, same, other = made(), made(), made(0.25)
        assert one == same and hash(one) == hash(same) and one != other and one != 3
    assert Inner(value=0.05) != Inner(value=np.array(0.05))  # one is compiled in, the other a parameter
    assert Inner(value=np.array(np.nan)) == Inner(value=np.array(np.nan))
    assert {arm: 1}[ck.planar_arm([1.0, 0.8])] == 1 and arm != ck.replace(arm, joint_names=("a", "b"))
    law = pairs[1](jnp.array(5.0))
    assert not jax.jit(lambda alpha: ck.replace(law, alpha=alpha) == law)(5.0)  # nobody knows what is traced
