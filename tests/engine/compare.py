"""The same function by JAX, as it stands and derived, and as C: on vectors of lanes, and in C99 one after the other."""

import ctypes
import subprocess
import tempfile

import jax
import numpy as np
import pytest

from cnclik.engine.compiler import can_build, command
from cnclik.engine.operations import scalar
from cnclik.engine.plan import use_engine
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.reader import read, trace
from cnclik.engine.scalar import ScalarWriter, helpers
from cnclik.engine.to_jax import Derived

NEEDS_C = pytest.mark.skipif(not can_build(), reason="no C compiler")
STRICT = "-std=c99 -O1 -pedantic -Wall -Wextra -Werror -fPIC -shared"


def of_leaves(fn, treedef):
    """A function of trees as one of their leaves."""
    return lambda *leaves: fn(*jax.tree.unflatten(treedef, leaves))


def in_c(fn, *args, cores=1):
    """Results of the function as C, of a batch."""
    leaves, treedef = jax.tree.flatten(args)
    made = Program(of_leaves(fn, treedef), lane_avals(leaves))
    return jax.tree.unflatten(made.tree, made(leaves, len(leaves[0]), cores))


def in_scalar_c(fn, *args):
    """Results of the function as C99 without a warning, of a batch lane by lane."""
    leaves, treedef = jax.tree.flatten(args)
    leaves = [np.ascontiguousarray(x) for x in leaves]
    given = lane_avals(leaves)
    closed, shapes, tree, _ = trace(of_leaves(fn, treedef), given)
    graph, nodes, outs = read(closed)
    names = [scalar(np.dtype(s.dtype)) for s in (*given, *shapes)]
    size = [int(np.prod(s.shape)) for s in (*given, *shapes)]

    def entry(i, at):
        return f"(({names[i]} *)of[{i}])[b * {size[i]} + {at}]"

    reads = [lambda at, i=i: entry(i, at) for i in range(len(given))]
    writes = [lambda at, x, i=i: f"{entry(i, at)} = {x};" for i in range(len(given), len(names))]
    writer = ScalarWriter(graph, nodes, outs, reads, writes)
    lines = "\n".join(writer.statements())
    text = f"#include <math.h>\n#include <stdint.h>\n{helpers(writer.functions)}\nvoid run(int64_t size, void **of);\n"
    text += f"void run(int64_t size, void **of)\n{{\nfor (int64_t b = 0; b < size; ++b) {{\n{lines}\n}}\n}}\n"
    made = [np.empty((len(leaves[0]), *s.shape), s.dtype) for s in shapes]
    with tempfile.NamedTemporaryFile(suffix=".so") as library:
        words = [*command(), *STRICT.split(), "-x", "c", "-", "-o", library.name, "-lm"]
        done = subprocess.run(words, input=text, capture_output=True, text=True, check=False)
        assert not done.returncode, done.stderr[:2000]
        pointers = (ctypes.c_void_p * len(names))(*(x.ctypes.data for x in (*leaves, *made)))
        ctypes.CDLL(library.name).run(ctypes.c_int64(len(leaves[0])), pointers)
    return jax.tree.unflatten(tree, made)


def derived(fn, *args):
    """Results of the function as the engine writes it for JAX, of a batch."""
    leaves, treedef = jax.tree.flatten(args)
    made = Derived(of_leaves(fn, treedef), lane_avals(leaves))
    return jax.tree.unflatten(made.tree, jax.jit(jax.vmap(made))(*leaves))


def plain(fn, *args):
    """Results of the function as it stands, of a batch; `ck.solve` inside it runs as it stands, too."""
    one, (leaves, treedef) = jax.jit(fn), jax.tree.flatten(args)  # a batch compiles for up to three times as long
    with use_engine("plain"):
        rows = [one(*jax.tree.unflatten(treedef, row)) for row in zip(*leaves, strict=True)]
    return jax.tree.map(lambda *each: np.stack(each), *rows)


def check(fn, *args, ulps=4.0, each=False, signs=False, by=None, scalar_too=True, derived_too=True):
    """Raises AssertionError where the engine's programs and JAX's of it, or of `by`, lane by lane, differ.

    Without a C compiler only the program that the engine writes for JAX is checked.

    Whole numbers and truths have to be equal, and infinity and NaN where they are in JAX. Other numbers may differ by
    some ulps: each by its own, or all by those of the largest one in their array. Zeros have their signs if asked.
    """
    found = wanted = plain(by or fn, *args)
    if derived_too or not can_build():
        same(found := derived(fn, *args), wanted, ulps=ulps, each=each, signs=signs)
    if can_build():
        same(found := in_c(fn, *args), wanted, ulps=ulps, each=each, signs=signs)
    if can_build() and scalar_too:
        same(in_scalar_c(fn, *args), wanted, ulps=ulps, each=each, signs=signs)
    return found


def same(found, wanted, *, ulps=4.0, each=False, signs=False):
    """What `check` asserts, of two trees of arrays."""
    assert jax.tree.structure(found) == jax.tree.structure(wanted)
    for (place, a), b in zip(jax.tree.leaves_with_path(found), jax.tree.leaves(wanted), strict=True):
        a, b, which = np.asarray(a), np.asarray(b), jax.tree_util.keystr(place)
        assert a.shape == b.shape and a.dtype == b.dtype, (which, a.shape, a.dtype, b.shape, b.dtype)
        if a.dtype.kind != "f":
            np.testing.assert_array_equal(a, b, which)
            continue
        good = np.isfinite(b)
        if signs:
            np.testing.assert_array_equal(np.signbit(a[b == 0]), np.signbit(b[b == 0]), which)
        np.testing.assert_array_equal(np.where(good, 0, a), np.where(good, 0, b), which)
        size = np.abs(b[good]) if each else np.abs(b[good]).max(initial=0)
        off = np.abs(a[good] - b[good]) - ulps * np.finfo(a.dtype).eps * size - 2 * np.finfo(a.dtype).tiny
        near = np.isfinite(a[good]).all() and (off <= 0).all()
        assert near, (which, a[good][off.argmax()], b[good][off.argmax()])
