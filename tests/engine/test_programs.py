"""Programs: loops, branches, stacks, derivatives and odd shapes, by jax.vmap and as C."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

import cnclik as ck
from cnclik.engine import source
from cnclik.engine.graph import Scan, SlowError, UnsupportedError, While
from cnclik.engine.program import Program, lane_avals
from cnclik.engine.reader import read, trace
from cnclik.engine.source import write
from cnclik.engine.tracing import of_the_model
from engine.compare import NEEDS_C, check, in_c, same

SIZE = 19
A = np.random.default_rng(5).normal(size=(3, 3)) / 3


def batch(*shape, seed=0, dtype="float64"):
    return np.random.default_rng(seed).normal(size=(SIZE, *shape)).astype(dtype)


def step(q, p):
    q = q + 0.1 * jnp.tanh(A[: len(q), : len(q)] @ q + p)
    return q, (q, jnp.sum(q * q))


def track(q, path):
    """A loop along a path of this lane's own; all that it passes."""
    end, (qs, sizes) = lax.scan(step, q, path)
    return end, qs, sizes


def smooth(q, path):
    """A number of a whole trajectory: its start, its differences, its end."""
    end, qs, sizes = track(q, path)
    qs = jnp.concatenate([q[None], qs])
    gaps = qs[1:] - qs[:-1]
    return jnp.sum(gaps**2) + jnp.mean(sizes) + jnp.sum(end) + jnp.max(sizes)


def nested(q, path):
    """A loop within a loop, and what both stack up."""

    def outer(q, p):
        own = A[: len(q), : len(q)]
        q, ins = lax.scan(lambda q, k: (q + 0.05 * jnp.sin(own @ q + k * p), jnp.cos(q)), q, jnp.arange(4.0))
        return q, (q, ins)

    q, (qs, ins) = lax.scan(outer, q, path)
    return jnp.sum(q**2) + jnp.sum(jnp.sin(qs)) + jnp.sum(ins[:, 0] * ins[:, 1])


def at_the_counter(q, path):
    """path[k] at the loop's counter, there and at the step before."""

    def one(q, k):
        return q + 0.1 * jnp.sin(path[k]) - 0.01 * path[jnp.maximum(k - 1, 0)], path[k] @ q

    return lax.scan(one, q, jnp.arange(len(path)))


def test_loops_along_a_path():
    def fn(q, short, long):
        return track(q, short), track(q, long), nested(q, long), at_the_counter(q, short)

    check(fn, batch(3), batch(9, 3, seed=1), batch(70, 3, seed=1), ulps=50)


@pytest.mark.parametrize(("reverse", "unroll"), [(False, 1), (True, True)])
def test_a_loop_over_a_known_mask_or_that_asks_for_it_is_written_out(reverse, unroll):
    def one(carry, row):
        x, k = carry
        on, a = row
        return (x + jnp.where(on, a * jnp.sin(x[::-1]), 0.0), k + 1), (x[0], x * k)

    def fn(x):
        mask = x > 0 if unroll is True else np.eye(3, dtype=bool)
        return lax.scan(one, (x, 0), (mask, x), reverse=reverse, unroll=unroll)

    check(fn, batch(3))
    graph = read(trace(fn, [jax.ShapeDtypeStruct((3,), np.float32)]).closed)[0]
    assert not any(isinstance(item, Scan) for item in graph.root.items)


def test_a_function_with_a_batching_rule_of_its_own_is_read():
    @jax.custom_batching.custom_vmap
    def fn(x, y):
        return jnp.sin(x) * y

    @fn.def_vmap
    def _(_, batched, x, y):
        return jnp.sin(x) * y, True

    check(lambda x, y: (fn(x, y), jax.vmap(fn)(x, y)), batch(3), batch(3, seed=1))


@pytest.mark.parametrize(("fn", "kind"), [(smooth, jax.grad), (smooth, jax.jacfwd), (nested, jax.hessian)])
def test_derivatives(fn, kind):
    check(kind(fn, argnums=(0, 1)) if kind is jax.grad else kind(fn), batch(2), batch(7, 2, seed=1), ulps=500)


@NEEDS_C
def test_the_gradient_of_joined_rows_stays_a_loop():
    def fn(q, path):
        end, qs, _ = track(q, path)
        whole = jnp.append(qs[:-1], end[None], 0)
        some = jnp.sum(whole[:, np.array([0, 2])] ** 3)
        return jnp.mean(jnp.sum(whole**2, axis=1)) + jnp.sum(jnp.split(whole, [1, 2], axis=1)[1]) + some

    q, path = batch(3), batch(300, 3, seed=1)
    check(jax.grad(fn), q, path, ulps=64)
    program = Program(jax.grad(fn), lane_avals((q, path)))
    assert program.operations < 300 and program.work < 10 * 300 * 8 * program.lanes  # 9 numbers are kept of a round


def test_the_end_of_a_loop_behind_what_it_stacks_is_no_new_array():
    def fn(q, path):
        end, qs, _ = track(q, path)
        return jnp.append(qs[:-1], end[None], 0), jnp.append(qs[:3], qs[3:9], 0), jnp.append(qs[:3], qs[4:9], 0)

    avals = [jax.ShapeDtypeStruct(shape, float) for shape in ((3,), (300, 3))]
    whole, some, apart = read(trace(fn, avals).closed)[2]
    assert [{cell.op for cell in rows.cells} for rows in (whole, some, apart)] == [{"stacked"}, {"slid"}, {"joined"}]


def test_moves_along_time():
    def fn(x, q):
        y = jnp.cumsum(jnp.sin(x), 0)
        back = lax.scan(lambda q, p: (q * 0.9 + p, q), q, y, reverse=True)[1]
        both = jnp.stack([y, back], 1)
        parts = y[::-1], jnp.flip(y[:, 1]), y[3:40:3], jnp.pad(y, ((2, 1), (0, 0))), y.T[1], y[-1], y[5, 1]
        whole = both[:, 0] + both[:, 1], lax.cummax(x, 0), lax.cumsum(x, 0, reverse=True), jnp.roll(y, 3, 0), y @ A
        some = y[:, np.array([0, -1, 0])], y[:, jnp.array([[2], [0]])], jnp.take(y, jnp.array([1, 7]), 1)
        few = some, jnp.max(y, 1), jnp.any(y > 3, 0), jnp.all(y > -99), jnp.min(back), jnp.where(y[:, :1] > 0, y, q)
        more = jnp.zeros((70, 2)) + q[0], jnp.concatenate([y[1:], y[:1]]) - y, jnp.linspace(0, 1, 70) + x[:, 2]
        return parts, whole, few, more, jnp.arange(70) * q[0]

    check(fn, batch(70, 3), batch(3, seed=1), ulps=200)


@NEEDS_C
@pytest.mark.parametrize("dtype", ["float32", "float64", "uint8"])
def test_results_that_are_rounds_of_a_loop_are_stored_as_they_are_made(dtype):
    def fn(x):
        def one(x, k):
            x = (3 * x + k.astype(x.dtype)) % 7
            return x, (x, x[:3], x[0], jnp.append(2 * x, 5 * x), jnp.full(2, 3, x.dtype))

        end, (xs, three, first, many, same) = lax.scan(one, x, jnp.arange(70))
        back = lax.scan(one, x, jnp.arange(70), reverse=True)[1][0]
        parts = three[:69], first, many[3:60], same, jnp.append(xs[:69], end[None], 0)
        return xs, back, xs[-1], back[0], xs[::2], parts

    x = np.abs(np.round(7 * batch(6))).astype(dtype)  # whole numbers: exact in any type
    with jax.enable_x64(dtype == "float64"):
        same(in_c(fn, x), jax.jit(jax.vmap(fn))(x), ulps=0)


def test_branches():
    def heavy(x):
        return lax.fori_loop(0, 5, lambda i, x: jnp.exp(jnp.sin(x)) + i, x)

    def fn(x, k):
        one = lax.cond(x[0] > 0, heavy, lambda x: -x, x)
        several = lax.switch(k, [lambda x: x, heavy, lambda x: x * 2, lambda x: jnp.flip(x)], x)
        known = lax.cond(True, lambda x: x + 1, heavy, x)
        within = lax.fori_loop(0, 6, lambda _, c: lax.cond(c.sum() > 1, lambda c: c * 0.5, lambda c: c + 0.7, c), x)
        return one, several, known, within

    check(fn, batch(3), np.arange(SIZE, dtype=np.int32) - 2, ulps=20)


def test_loops_that_count_compute_once_what_does_not_change_in_them():
    """As many rounds as each lane asks for, none among them, also within a loop and in a branch."""

    def counted(k, x, y):
        return lax.fori_loop(0, k, lambda i, c: c + jnp.exp(y) * i, x)

    def fn(k, x, y):
        twice = lax.fori_loop(0, k, lambda i, c: counted(i, c, jnp.sin(y)), x)
        return counted(k, x, y), twice, lax.cond(x > 0, lambda: counted(k, y, x), lambda: x)

    check(fn, np.arange(SIZE, dtype=np.int32) % 5 - 1, batch(), batch(seed=1), ulps=50)
    g, _, outs = read(trace(counted, [jax.ShapeDtypeStruct((), d) for d in ("int64", "float64", "float64")]).closed)
    (at,) = [i for i, item in enumerate(g.root.items) if isinstance(item, While)]
    assert "exp" in [n.op for n in g.root.items[:at]] and outs[0].item().value[0] is g.root.items[at]


def test_what_commutes_is_computed_once():
    graph, *_ = read(trace(lambda x, y: (x * y, jnp.sin(y * x)), [jax.ShapeDtypeStruct((), "float64")] * 2).closed)
    assert [item.op for item in graph.root.items] == ["mul", "sin"]


def test_while_loops_of_a_batch_within_a_lane():
    def halved(x, least):
        return lax.while_loop(lambda s: jnp.sum(s[0]) > least, lambda s: (s[0] / 2, s[1] + 1), (x, 0))

    def fn(x, least, counts):
        several = jax.vmap(halved, (0, None))(jnp.abs(x) + 1, 0.7)
        inner = jax.vmap(lambda v, k: lax.fori_loop(0, k, lambda i, c: c * 1.1 + i, v))(x[:, 0], counts)
        return several, jax.vmap(halved)(jnp.abs(x), 0.5 + jnp.abs(least)), inner

    check(fn, batch(4, 2), batch(4, seed=1), np.arange(4 * SIZE, dtype=np.int32).reshape(SIZE, 4) % 5 - 1)


def test_whole_numbers_wrap_in_loops(monkeypatch):
    """As optimised as users have it: C compilers take for granted that nothing overflows."""
    monkeypatch.setenv("CFLAGS", "-O2")

    def of(x):
        dtype = x.dtype
        one, high = np.array(1, dtype), np.array(np.iinfo(dtype).max - 99, dtype) + x
        grows = lax.while_loop(
            lambda s: (s[0] + one > s[0]) & (s[1] < 200), lambda s: (s[0] + one, s[1] + 1), (high, 0)
        )
        drawn = lax.fori_loop(0, 99, lambda i, c: c * np.array(109, dtype) + np.array(89, dtype), x)
        return grows, drawn, abs(drawn) < 0

    def fn(*several):
        return [of(x) for x in several]

    each = [np.arange(1, SIZE + 1, dtype=dtype) for dtype in ("int8", "int32", "int64")]
    wanted, one = check(fn, *each), [x[4] for x in each]
    same(ck.native(fn)(*one), jax.tree.map(lambda x: x[4], wanted))


def test_zeros_keep_their_signs():
    """The angle of (0, −1) and of (−0, −1) are a turn apart."""

    def of(x):
        one = lax.optimization_barrier(jnp.ones_like(x))
        zeros = 0 - x, -(x - one), -(one - x), jnp.sin(x), jnp.sin(x - one), x * 0.5, -x, -(x * 2), jnp.tan(x), x - 0.0
        for least in (jnp.minimum, jnp.maximum):
            zeros += least(x, -x), least(-x, x), least(x, jnp.zeros_like(x)), least(-0.0, x)
        zeros += (lax.clamp(jnp.zeros_like(x), x, jnp.ones_like(x)),)
        return [*zeros, *(jnp.arctan2(v, -1.0) for v in zeros)]

    both = [np.array([0.0, -0.0, 1.0, -1.0, 0.5, -2.0], dtype) for dtype in ("float32", "float64")]
    check(lambda *both: [of(x) for x in both], *both, signs=True, ulps=8, each=True)


def test_while_loops_end_for_each_lane_at_its_own_time():
    def halved(x):
        return lax.while_loop(lambda s: s[0] > 1, lambda s: (s[0] / 2, s[1] + 1), (x, jnp.int32(0)))

    def fn(x, y, guard=True):
        def body(s):
            inner, count = halved(s[0] + 5)
            return inner + s[1], s[1] + 1, s[2] + count

        def up(y):  # never ends where y < 0: jax.vmap runs it there too, C does not
            return lax.while_loop(lambda v: (v < 3) & (guard | (y > 0)), lambda v: v + jnp.maximum(y, -1), 0.0)

        def down(a):  # the inner loop never ends for lanes that are through with the outer one
            return up(a - 0.5) * 0 + a / 2

        whole = lax.while_loop(lambda s: (s[0] < y) & (s[1] < 9), body, (x, 0.0, jnp.int32(0)))
        deep = lax.while_loop(lambda a: a > 0.5, down, jnp.abs(x) + 0.6)
        return deep, halved(jnp.abs(x) * 100), whole, lax.cond(y > 0, up, lambda y: y, y)

    check(fn, batch(), np.where(np.abs(y := batch(seed=1)) < 0.1, 0.1, y), by=lambda x, y: fn(x, y, False))


def test_odd_arguments_and_results():
    def fn(case, flags, single):
        x, k = case["x"], case["k"]
        known = {"known": jnp.arange(3), "none": x[:0], "p": 2.0}
        return known | {"same": x, "k": k + 1, "on": ~flags, "sum": x.sum() * k}, (single, (single > 0, None))

    case = {"x": batch(2, 2), "k": np.arange(SIZE, dtype=np.int64) - 3}
    check(fn, case, batch(4) > 0, batch(dtype="float32"))


@NEEDS_C
@pytest.mark.parametrize(("size", "cores"), [(1, 1), (17, 3), (130, 3)])
def test_any_number_of_lanes_on_any_number_of_cores(size, cores):
    rng = np.random.default_rng(size)
    given = q, path = rng.normal(size=(size, 3)), rng.normal(size=(size, 9, 3))
    wanted = jax.jit(jax.vmap(track))(*given)
    same(in_c(track, *given, cores=cores), wanted, ulps=50)
    program = Program(track, lane_avals(given))
    shared, own = (program([q, of], size, cores) for of in (path[0], np.repeat(path[:1], size, 0)))
    jax.tree.map(np.testing.assert_array_equal, shared, own)


def test_long_bodies_are_written_in_pieces(monkeypatch):
    """And rows that are results read scalars of any piece."""

    def fn(x, k):
        def body(x, i):
            for j in range(4):
                x = jnp.sin(A @ x) + x[k] * 0.1 + j
                x = lax.cond(x[0] > 5, lambda x: x * 0.5, lambda x: x, x)
            return x, x * i

        end, rows = lax.scan(body, x, jnp.arange(6.0))
        return end, rows, x * 2, rows[1:] - rows[:-1] > 0.1 * rows[:-1] + jnp.sqrt(x @ x)

    monkeypatch.setattr(source, "LONG", 50)
    monkeypatch.setattr(source, "PIECE", 20)
    check(fn, batch(3), np.arange(SIZE, dtype=np.int32) % 3, ulps=50)


@NEEDS_C
def test_zeros_of_a_model_vanish_and_others_stay():
    eye = np.eye(3)

    def unmarked(x, eye=eye):
        return jnp.asarray(eye) @ x

    def marked(x):
        return unmarked(x, of_the_model(eye))

    x = batch(3)
    check(marked, x, by=unmarked)
    x[0, 0] = np.inf
    assert np.isnan(check(unmarked, x)[0, 1:]).all() and np.array_equal(in_c(marked, x), x)
    check(jax.jacfwd(marked), x, by=lambda x: jnp.asarray(eye))
    np.testing.assert_array_equal(jax.jit(jax.vmap(of_the_model))(x), x)


@NEEDS_C
@pytest.mark.parametrize(
    ("fn", "name"),
    [
        (lambda x: jnp.linalg.svd(x.reshape(2, 2))[1], "svd"),
        (lambda x: jax.random.normal(jax.random.key(x[0].astype(int)), (4,)) + x, "key<fry>"),
        (lambda x: x.view("uint32"), "bitcast_convert_type"),
        (lambda x: (jax.debug.print("here"), x)[1], "effects"),
        (lambda x: x + 1j, "complex"),
        (jnp.sort, "sort"),
        (lambda x: jnp.take(np.eye(16 * 64).reshape(-1, 64, 64), x.astype(int), axis=0), "gather"),
        (lambda x: jnp.broadcast_to(x, (200, 100, 4)).swapaxes(0, 1)[3], "entries"),
    ],
)
def test_what_has_no_c_form_is_named(fn, name):
    with pytest.raises(UnsupportedError, match=name):
        in_c(fn, batch(4))


def text_of(fn, avals):
    """The C of a function."""
    traced = trace(fn, avals)
    return write(*read(traced.closed), traced.shapes)[0]


@NEEDS_C
def test_a_program_is_as_large_as_its_c_if_that_is_longer_than_its_graph():
    """A clip of 14 frames has 98,552 nodes and 133,351 lines, for which GCC took two minutes."""

    def fn(x, *places):
        for k in range(30):
            x = jnp.sqrt(x + k)  # a row that is computed wherever one of its entries is taken
        return sum(jnp.take(x, i) for i in places)

    avals = [jax.ShapeDtypeStruct((100,), "float64"), *[jax.ShapeDtypeStruct((), "int64")] * 9]
    traced = trace(fn, avals)
    nodes = read(traced.closed)[0].count
    with pytest.raises(SlowError):
        Program(traced, avals, most=2 * nodes)


def test_cells_that_many_pick_from_are_listed_once():
    """A path through 30 points, looked up at a time of each lane's own, was 38,000 lines of C."""
    avals = [jax.ShapeDtypeStruct((60,), "float64"), jax.ShapeDtypeStruct((40,), "int64")]
    text = text_of(lambda x, i: x[i] + x[i // 2], avals)
    assert text.count("[60] = {") == 1


@NEEDS_C
def test_what_a_loop_leaves_as_it_was_is_no_part_of_it():
    """What is carried as the number it was at first, or comes from outside: known before the loop, or after it."""

    def fn(x, y):
        def body(carry, k):
            x, turned, still, late = carry
            return (x + jnp.sin(still + turned) * k + late, turned, jnp.zeros(()), y), x

        (end, turned, still, late), stack = lax.scan(body, (x, y, jnp.zeros(()), x), jnp.arange(6.0))
        return end, turned + still, late, stack

    given = batch(), batch(seed=2)
    slopes = jax.grad(lambda x, y: sum(map(jnp.sum, fn(x, y))), (0, 1))
    check(lambda x, y: (fn(x, y), slopes(x, y)), *given)
    text = text_of(fn, lane_avals(given))
    assert 0 < text.index("sincos_F64(t") < text.rindex("< 6; ++j")
