"""Each primitive, in each type of number, by JAX and as C, with NaN and infinity among the numbers."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from jax import lax
from jax.extend.core import Primitive

from cnclik.engine.reader import ELEMENTWISE
from engine.compare import NEEDS_C, check, in_c, in_scalar_c

SIZE = 37  # no multiple of any vector's lanes
SPECIAL = (0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -0.5, 1.5, 2.5, -2.5, 3e4, -7e5)
REALS, WHOLE = ("float32", "float64"), ("int32", "uint8", "int64")

_ONE = """
    abs acosh acos asinh asin atanh atan cbrt ceil cos cosh erf exp exp2 expm1 floor is_finite log log1p logistic neg
    rsqrt sign sin sinh sqrt square tan tanh
"""
_TWO = "add sub mul div max min atan2 pow rem nextafter eq ne lt le gt ge"
ONE, TWO = _ONE.split(), _TWO.split()


def numbers(dtype, seed=0):
    """A batch: what is special first."""
    rng = np.random.default_rng(seed)
    if np.dtype(dtype).kind == "f":
        many = np.concatenate([SPECIAL, rng.normal(size=SIZE - len(SPECIAL)) * 3])
        return rng.permutation(many).astype(dtype) if seed else many.astype(dtype)
    about = np.iinfo(dtype)
    special = [0, 1, 2, about.min, about.max, 31, 33, 5, 7]
    many = np.concatenate([np.array(special, dtype), rng.integers(0, 9, SIZE - len(special)).astype(dtype)])
    return rng.permutation(many) if seed else many


def of_each(fn):
    """fn(x, ...) of the numbers of each type."""
    return lambda *given: {dtype: fn(*(x[dtype] for x in given)) for dtype in given[0]}


def each_of(dtypes, seed=0):
    """`numbers` of each type."""
    return {dtype: numbers(dtype, seed) for dtype in dtypes}


@pytest.mark.parametrize("dtype", REALS)
def test_functions_of_one_number(dtype):
    ulps = 40 if dtype == "float64" else 8  # XLA's log1p and sinh are off by 20 and 2 (jaxlib 0.10): C's are not
    check(lambda x: {n: getattr(lax, n)(x) for n in ONE}, numbers(dtype), ulps=ulps, each=True)


def test_a_function_that_older_versions_of_jax_do_not_have():
    """jax 0.11 has it in derivatives of tanh, asin and acos."""
    made = getattr(lax, "one_minus_square_p", None)
    if made is None:
        made = Primitive("one_minus_square")
        made.def_abstract_eval(lambda x: x)
    check(of_each(made.bind), each_of(REALS), by=of_each(lambda x: (1 + x) * (1 - x)), ulps=8, each=True)


@NEEDS_C
@pytest.mark.parametrize("by", [in_c, in_scalar_c])
@pytest.mark.parametrize("dtype", REALS)
def test_sines_and_angles_are_exact_to_a_few_ulp(dtype, by):
    """Against 60 digits: all over the range, beyond it, on the axes, at 0, infinity and NaN."""
    random, eps = np.random.default_rng(0), np.finfo(dtype).eps
    special = [0.0, -0.0, 1.0, -1.0, 1e-30, -1e-30, 1e30, np.inf, -np.inf, np.nan, 0.5, 2.0]
    y, x = (np.concatenate([random.normal(size=400) * 10.0 ** random.uniform(-3, 5, 400)]) for _ in range(2))
    y = np.concatenate([y, np.arange(-8, 9) * np.pi / 2, np.repeat(special, len(special))]).astype(dtype)
    x = np.concatenate([x, random.normal(size=17), np.tile(special, len(special))]).astype(dtype)
    found = by(lambda y, x: (jnp.sin(y), jnp.cos(y), jnp.arctan2(y, x), jnp.log(y), jnp.log1p(y)), y, x)
    mpmath.mp.dps = 60
    for a, b, sine, cosine, angle, *logs in zip(y.tolist(), x.tolist(), *(v.tolist() for v in found), strict=True):
        if np.isfinite(a):
            assert abs(sine - float(mpmath.sin(a))) <= 1.5 * eps and abs(cosine - float(mpmath.cos(a))) <= 1.5 * eps
        else:
            assert np.isnan(sine) and np.isnan(cosine)
        for made, low, of in zip(logs, (0, -1), (mpmath.log, mpmath.log1p), strict=True):
            wanted = float(of(a)) if low < a < np.inf else {low: -np.inf, np.inf: np.inf}.get(a, np.nan)
            np.testing.assert_allclose(made, wanted, rtol=eps, atol=np.finfo(dtype).tiny, err_msg=str(a))
        wanted = np.arctan2(a, b)
        near = 3 * eps * abs(wanted)
        if np.isfinite(a) and np.isfinite(b) and a * b != 0:
            wanted = float(mpmath.atan2(a, b)) or wanted
        assert np.isnan(angle) if np.isnan(wanted) else abs(angle - wanted) <= near + np.finfo(dtype).tiny, (a, b)
        assert np.isnan(wanted) or np.signbit(angle) == np.signbit(a)


def test_functions_of_two_numbers():
    fn = of_each(lambda x, y: {n: getattr(lax, n)(x, y) for n in TWO})
    check(fn, each_of(REALS), each_of(REALS, 1), ulps=8, each=True)


def test_functions_of_whole_numbers():
    two = ["add", "sub", "mul", "div", "rem", "max", "min", "eq", "ne", "lt", "le", "gt", "ge"]
    two += ["bitwise_and", "bitwise_or", "bitwise_xor", "shift_left", "shift_right_logical", "shift_right_arithmetic"]

    def fn(x, y):
        found = {n: getattr(lax, n)(x, y) for n in two}
        found |= {f"{n} {by}": getattr(lax, n)(x, np.array(by, x.dtype)) for n in two[-3:] for by in (1, 5, 64)}
        found |= {n: getattr(lax, n)(x) for n in ("abs", "sign", "bitwise_not") if n != "abs" or x.dtype.kind == "i"}
        found |= {f"{n} of none": getattr(lax, f"reduce_{n}")(x[None][:0], (0,)) | x for n in ("and", "or", "xor")}
        return found | {"neg": -x, "power": lax.integer_pow(x, 3), "large": lax.integer_pow(x, 7)}

    check(of_each(fn), each_of(WHOLE), each_of(WHOLE, 1))


@NEEDS_C
def test_known_numbers_are_worked_out_as_they_would_be():
    two = ["add", "sub", "mul", "div", "rem", "bitwise_and", "shift_left", "shift_right_logical"]
    two += ["shift_right_arithmetic", "lt", "max"]

    @of_each
    def all_of(x, y):
        if x.dtype in REALS:
            return {n: getattr(lax, n)(jnp.asarray(x)) for n in ONE} | {n: getattr(lax, n)(x, y) for n in TWO}
        return {n: getattr(lax, n)(jnp.asarray(x), jnp.asarray(y)) for n in two}

    # XLA itself, told the numbers, dies of one over 0, and of the least one over -1 (jaxlib 0.10).
    x, y = ({dtype: np.roll(numbers(dtype)[:9], by) for dtype in (*WHOLE, *REALS)} for by in (0, 1))
    given = jax.tree.map(lambda v: np.broadcast_to(v, (3, *v.shape)), (x, y))
    check(lambda *_: all_of(x, y), *given, by=all_of, derived_too=False, ulps=40, each=True)


def test_functions_of_truths():
    def fn(x, y):
        return x & y, x | y, x ^ y, ~x, x == y, x != y, jnp.where(x, y, ~y), x < y, x <= y, x.astype(int), x * 1.5

    check(fn, np.arange(SIZE) % 2 == 0, np.arange(SIZE) % 3 == 0)


def test_conversions(monkeypatch):
    monkeypatch.setenv("CFLAGS", "-Og")  # at -O0 GCC 12 ends with "unrecognizable insn"
    wide = ["float32", "float64", "int32", "int64", "uint32", "uint64", "bool"]
    short = ["int8", "int16", "uint8", "uint16"]

    def fn(x):  # by XLA a float that doesn't fit is the nearest for 32 bits and more, and undefined below
        return {old: [v.astype(k) for k in wide + short * (old not in REALS)] for old, v in x.items()}

    check(fn, {old: numbers(old) for old in wide[:-1] + short} | {"bool": np.arange(SIZE) % 3 == 0})


def test_other_elementwise_operations():
    k = np.arange(SIZE, dtype=np.int32) % 4

    def fn(x, y, k):
        powers = [lax.integer_pow(x, n) for n in (-5, -2, -1, 0, 1, 2, 3, 5, 9)]
        rounded = [lax.round(x, method) for method in lax.RoundingMethod]
        return powers, rounded, lax.clamp(jnp.asarray(-1, x.dtype), x, y), lax.select_n(k, x, y, x + y, x - y), x**k

    check(of_each(fn), each_of(REALS), each_of(REALS, 1), dict.fromkeys(REALS, k), ulps=8, each=True)


def test_reductions():
    def rows(dtype):
        x = np.stack([numbers(dtype, s) for s in range(1, 7)], 1).reshape(SIZE, 2, 3)
        return np.where(np.abs(x) > 1e4, 3, x) if dtype == "int32" else x

    def fn(x):
        found = [jnp.max(x, 0), jnp.min(x, 1), jnp.any(x > 1, 0), jnp.all(x > 0)]
        found += [jnp.cumsum(x, 1), lax.cumsum(x, 1, reverse=True), lax.cummax(x, 0), lax.cummin(x, 1)]
        return [*found, jnp.sum(x, 1), jnp.prod(x, 0), x @ x.T]

    check(of_each(fn), {dtype: rows(dtype) for dtype in (*REALS, "int32")}, ulps=8)


def test_moves():
    def fn(x):
        y = x.reshape(3, 2).T
        found = [y, y[::-1], jnp.concatenate([x, y[0]]), jnp.stack([x, x]), jnp.pad(x, (1, 2)), x[1:5:2], x[None]]
        found += [lax.pad(x, 0.0, [(-1, 2, 1)]), jnp.broadcast_to(x, (2, 6)), jnp.squeeze(x[:1]), jnp.roll(x, 2)]
        return [*found, *jnp.split(x, 3), jnp.tril(jnp.outer(x, x)), jnp.eye(3) * x[0], jnp.arange(4) + x[1]]

    check(fn, np.random.default_rng(0).normal(size=(5, 6)))


def test_places_that_each_lane_has_for_itself():
    rng, n = np.random.default_rng(5), 6
    x, k = rng.normal(size=(SIZE, n)), rng.integers(-n - 3, n + 3, (SIZE, 2)).astype(np.int32)

    def fn(x, k):
        taken = [x[k[0]], lax.dynamic_slice(x, (k[0],), (3,)), jnp.take(x, k), jnp.take(x, k, mode="clip")]
        put = [x.at[k[0]].set(7.0), x.at[k].add(2.0), lax.dynamic_update_slice(x, x[:2], (k[1],)), x.at[k].max(0.5)]
        put += [x.at[:].set(3.0 * x), x.at[jnp.array([1, 3])].mul(2.0)]
        return taken, put, x.reshape(-1, 3)[k[0] % 2, k[1] % 3], x[jnp.array([2, 0])], x.at[:].get()

    def beyond(x, k):
        """The nearest place; what is written there does nothing."""
        y = x.reshape(-1, 3)
        taken = [x[k], y[:, k], y[k, k[::-1]], x[jnp.array([n + 2, -n - 2])]]
        return taken, x.at[k].add(2.0, mode="promise_in_bounds"), y.at[k[0], k[1]].set(7.0, mode="promise_in_bounds")

    check(lambda x, k: (fn(x, k), beyond(x, 4 * k)), x, k)


def test_whole_numbers_beyond_an_array_are_the_least_or_largest():
    rng = np.random.default_rng(6)
    x, k = rng.integers(0, 2, (SIZE, 4)), rng.integers(-9, 9, (SIZE, 2)).astype(np.int32)
    check(lambda x, k: [jnp.take(v, k) for v in x], [x.astype(dtype) for dtype in (*WHOLE, bool)], k)


def test_places_in_sorted_numbers_have_nan_last():
    x = np.broadcast_to([-np.inf, 1.0, 3.0, np.inf, np.nan, np.nan], (6, 6))
    v = np.array([np.nan, np.inf, 2.0, 9.0, -np.inf, -0.0])

    def fn(x, v):
        return [jnp.searchsorted(x, v, side) for side in ("left", "right")]

    check(fn, x, v)


@pytest.mark.parametrize("dtype", REALS)
def test_matrices(dtype):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(SIZE, 3, 3)).astype(dtype), rng.normal(size=(SIZE, 3, 2)).astype(dtype)
    singular = a.copy()
    singular[0] = 0

    def fn(singular, a, b):
        others = jnp.linalg.solve(a, b), jnp.linalg.det(a), jnp.linalg.inv(a)
        a = singular
        spd = a @ a.T + 0.1 * jnp.eye(3, dtype=a.dtype)
        lower = jnp.linalg.cholesky(spd)
        solved = [jax.scipy.linalg.solve_triangular(lower, b, lower=True, trans=t) for t in (0, 1)]
        return lower, jax.scipy.linalg.cho_solve((lower, True), b), solved, jnp.linalg.cholesky(a)[1, 0], others

    check(fn, singular, a, b, ulps=2e4, scalar_too=dtype == "float64")


@NEEDS_C
def test_a_long_mask_of_many_rows():
    """Of 201 rows of 84 entries, as a humanoid's errors over 200 steps: too many to become scalars."""
    mask, x = np.arange(84) % 3 == 0, np.random.default_rng(0).normal(size=(2, 201, 84))

    def squares(x):
        return jnp.sum(jnp.where(mask, 0.0, x) ** 2, axis=1)

    check(squares, x, derived_too=False)


def test_numbers_as_their_bits():
    def fn(x):
        bits = {"float32": "uint32", "float64": "int64"}[str(x.dtype)]
        found = lax.bitcast_convert_type(x, bits)
        return found, lax.bitcast_convert_type(found + np.array(1, bits), x.dtype)

    finite = {dtype: x[np.isfinite(x)] for dtype, x in each_of(REALS).items()}
    check(of_each(fn), finite, scalar_too=False)


def test_mixed_precision():
    x, y = numbers("float32")[7:], numbers("float64", 1)[7:]
    check(lambda x, y: (x * y, x + jnp.float32(1), y.astype("float32") * x, (x > y) & (y > 0)), x, y)


def test_a_zero_of_no_model_keeps_what_is_not_a_number():
    check(lambda x: (x * 0.0, jnp.zeros(2) @ jnp.stack([x, x]), 0.0 / x), numbers("float64"))


def test_every_elementwise_primitive_has_a_test():
    tested = {*ONE, *TWO, "and", "or", "xor", "not", "shift_left", "shift_right_logical", "shift_right_arithmetic"}
    tested |= {"integer_pow", "round", "clamp", "select_n", "convert_element_type", "add_any", "lt_to", "le_to"}
    tested |= {"one_minus_square", "bitcast_convert_type"}
    assert tested == ELEMENTWISE
