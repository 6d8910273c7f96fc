"""What lies around a law as C: drives, paths, derivatives, long runs; lanes with and without a compiler."""

import time
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import cnclik as ck
from cnclik import errors as ck_errors
from cnclik.engine import compiler, plan
from cnclik.engine.graph import UnsupportedError
from cnclik.engine.plan import in_c as runs_in_c
from cnclik.engine.plan import use_engine
from cnclik.engine.program import Program, lane_avals
from engine.compare import NEEDS_C, in_c, plain, same
from tests import bank

SIZE = 11


@NEEDS_C
def test_a_path_of_many_frames_is_c():
    """Its table is looked up by rows: of knots on another axis 2,048 entries and more have no C form."""
    times = np.linspace(0, 1, 200)
    turned = Rotation.from_rotvec(np.outer(times, [0.3, 2.0, -0.4])).as_matrix()
    path = ck.waypoints(times, np.sin(np.outer(times, [1, 2, 3])), turned)
    paths = jax.tree.map(lambda x: np.repeat(np.asarray(x)[None], SIZE, 0), path)
    at = np.linspace(-0.1, 1.1, SIZE)
    same(in_c(lambda path, t: path.curve(t), paths, at), jax.jit(jax.vmap(path.curve))(at), ulps=20)


def test_without_a_compiler_lanes_are_xlas(monkeypatch):
    monkeypatch.setattr(compiler, "_command", lambda: None)
    assert not runs_in_c()
    x = np.linspace(0, 1, 9)
    same(ck.lanes(jnp.sin)(x), jnp.sin(x))


def test_the_compiler_of_a_package_is_found_where_the_system_has_none(monkeypatch, tmp_path):
    package = tmp_path / "ziglang"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "zig").write_text("")
    (package / "zig").chmod(0o755)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    compiler.of_a_package.cache_clear()
    try:
        assert compiler.command() == [str(package / "zig"), "cc"]
    finally:
        compiler.of_a_package.cache_clear()


@pytest.mark.parametrize(
    "fault",
    [
        "exit 0",
        "while :; do sleep 9; done",
        r"printf >&2 'x.c: error: \351\377'; exit 1",  # in an encoding of its own
        "(trap '' TERM; setsid sleep 20) & exit 1",  # which keeps its output open
        'while [ "$1" != -o ]; do shift; done; echo "int one;" | gcc -x c -shared -o "$2" -',  # without our functions
    ],
)
def test_a_compiler_that_fails_is_no_error(monkeypatch, tmp_path, fault):
    broken = program(tmp_path / "broken cc", fault)
    monkeypatch.setenv("CC", f"'{broken}'")
    monkeypatch.setattr(compiler, "MOST_SECONDS", 1.0)
    x, begun = np.linspace(0, 1, 9), time.monotonic()
    assert runs_in_c()
    with pytest.raises(UnsupportedError, match="the C compiler failed"):
        Program(jnp.cos, lane_avals([x]))
    assert time.monotonic() - begun < 20
    same(ck.lanes(jnp.cos)(x), jnp.cos(x))


TURN, X = np.random.default_rng(3).normal(size=(3, 3)), np.random.default_rng(2).uniform(0.3, 1.2, (SIZE, 3))


def turned(x):
    """Products of arrays, where the engine has products of numbers."""
    return jnp.sum(jax.lax.fori_loop(0, 3, lambda _, x: jnp.tanh(TURN @ x), x) ** 2)


def is_source(fn):
    """Whether lanes of `turned` are lowered as they stand."""
    text = jax.jit(fn).lower(X).as_text()
    return "dot_general" in text and "lanes-" not in text


OF_LANES = pytest.mark.parametrize("of", [ck.lanes, lambda fn: jax.vmap(ck.native(fn))], ids=["lanes", "native"])


@OF_LANES
def test_what_takes_too_long_is_the_source(monkeypatch, of):
    """As C, or as scalars: so many kept XLA busy for longer than anybody waits."""
    monkeypatch.setattr(plan, "MOST_NODES" if runs_in_c() else "MOST_SCALARS", 20)
    made = of(turned)
    assert is_source(made)
    same(made(X), plain(turned, X), ulps=100)
    with use_engine("native" if runs_in_c() else "xla"):
        assert not is_source(made)


@NEEDS_C
@OF_LANES
def test_what_took_too_long_is_the_source_with_what_it_calls(monkeypatch, tmp_path, of):
    calls = tmp_path / "calls"
    monkeypatch.setattr(compiler, "MOST_SECONDS", 0.3)
    monkeypatch.setenv("CC", str(program(tmp_path / "cc", f"echo >>{calls}; sleep 9")))
    assert is_source(of(turned))
    jax.jit(of(lambda x: ck.step(bank.law("planar3"), ck.hold(x[:2]), x, 0.0, 0.01, "EE").q)).lower(X)
    assert calls.read_text().count("\n") == 2


@NEEDS_C
@pytest.mark.parametrize("named", ["/nonexistent -O2", "'"])
def test_a_compiler_that_is_none_is_named(monkeypatch, named):
    monkeypatch.setenv("CC", named)
    with pytest.warns(ck_errors.Remark, match=f"CC is .*{named}.*, which names no program: (cc|gcc|clang) is used"):
        assert compiler.command()[0] != named
    with warnings.catch_warnings(action="error"):  # once
        compiler.command()


def program(path, text):
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


@NEEDS_C
def test_a_library_is_kept_where_jax_keeps_its_programs(tmp_path):
    x = np.linspace(0, 1, 9)
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "new"))
    try:
        first, second = in_c(lambda x: x * 7.25, x), in_c(lambda x: x * 7.25, x)
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert np.array_equal(first, second)
    (library,) = (tmp_path / "new").iterdir()
    assert library.suffix == ".so" and library.name.startswith("lanes-")
