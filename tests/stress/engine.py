"""Programs drawn at random, as C against JAX's own: one lane and many.

Programs are chains of operations, branches, loops, loops of a batch, stacks and places, on numbers that are special or
have few bits, so that nothing is rounded and results are equal to the bit. Functions that round are compared one by
one, by ulps, on special numbers and on all scales.
"""

import os
import zlib

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import cnclik as ck

jax.config.update("jax_enable_x64", True)
LANES, TOGETHER = 37, 8  # lanes of a batch; programs that are compiled as one
QUICK = "-O1 -DBYTES=16"  # for the C of seven in eight: a third of the time
SPECIAL = (0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -2.5, 1.5)
REALS, WHOLE = ("float32", "float64"), ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")


def few_bits(x):
    """A multiple of 1/8 up to 64, which products of two such keep in float32."""
    return jnp.clip(jnp.round(x * 8) / 8, -64.0, 64.0)


# Operations by the kinds of their arguments and result: f real, i whole, b truth.
SIMPLE = {
    "fff": [
        *(jnp.maximum, jnp.minimum, lambda a, b: few_bits(a + b), lambda a, b: few_bits(a - b), jnp.fmod),
        *(lambda a, b: few_bits(a * b), lambda a, b: few_bits(a / jnp.where(b > 0, 2.0, -4.0).astype(a.dtype))),
        *(
            lambda a, b: a * 0 - b,
            lambda a, b: -(a - b),
            lambda a, b: 2 * a + b * 0.5,
            jnp.copysign,
            lambda a, b: 0 - b,
        ),
    ],
    "ff": [
        *(jnp.negative, jnp.abs, jnp.floor, jnp.ceil, jnp.round, jnp.sign, jnp.square, jnp.trunc),
        *(lambda a: few_bits(a**3), lambda a: a - 0.0, lambda a: a / 4),
        lambda a: lax.clamp(a.dtype.type(-1), a, a.dtype.type(2)),
        lambda a: lax.bitcast_convert_type(lax.bitcast_convert_type(a, f"uint{8 * a.dtype.itemsize}"), a.dtype),
    ],
    "iii": [
        *(jnp.add, jnp.subtract, jnp.multiply, lax.div, lax.rem, jnp.maximum, jnp.minimum, jnp.floor_divide, jnp.mod),
        *(lax.bitwise_and, lax.bitwise_or, lax.bitwise_xor),
        *(lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic),
    ],
    "ii": [
        *(jnp.negative, jnp.sign, jnp.invert, lambda a: a**3, lambda a: a + 1, lambda a: a * 109 + 89),
        *(lambda a: a << 3, lambda a: a // 3, lambda a: a % 5, lambda a: a >> 1),
        lambda a: jnp.where(a + 1 > a, a, 0),
    ],
    "ffb": [jnp.less, jnp.less_equal, jnp.equal, jnp.not_equal, jnp.greater],
    "iib": [jnp.less, jnp.less_equal, jnp.equal, jnp.not_equal, jnp.greater_equal],
    "bbb": [jnp.logical_and, jnp.logical_or, jnp.logical_xor],
    "bb": [jnp.logical_not],
    "fb": [jnp.isnan, jnp.isfinite, lambda a: a == a],
}
OVER = [  # of a whole array, with as many entries as before
    *(
        jnp.flip,
        lambda a: jnp.roll(a, 1),
        lambda a: a.at[0].set(a[-1]),
        lambda a: jnp.broadcast_to(a.max(), a.shape),
    ),
    *(
        lambda a: a[::-1] * 1,
        lambda a: jnp.concatenate([a[1:], a[:1]]),
        lambda a: jnp.where(jnp.arange(len(a)) > 0, a, a[0]),
    ),
    lambda a: lax.cummax(a),
    lambda a: jnp.tile(a, 2)[: len(a)],
]


class Maker:
    """Draws a function from (real, whole, truth) arrays of n entries to the same."""

    def __init__(self, rng, n, real, whole):
        self.rng, self.n, self.real, self.whole = rng, n, real, whole

    def chain(self, depth, length=None, *, whole_arrays=True):
        """A chain of operations, as a function of the three arrays."""
        steps = [self.step(depth, whole_arrays) for _ in range(length or self.rng.integers(2, 5))]

        def run(state):
            for step in steps:
                state = step(state)
            return state

        return run

    def step(self, depth, whole_arrays):
        odds = self.rng.random()
        if depth and odds < 0.35:
            return self.region(depth, whole_arrays)
        if whole_arrays and self.n and odds < 0.5:
            return self.over()
        if odds < 0.62:
            return self.mixed()
        kinds = list(SIMPLE)[self.rng.integers(len(SIMPLE))]
        fn = SIMPLE[kinds][self.rng.integers(len(SIMPLE[kinds]))]
        *given, to = ("fib".index(kind) for kind in kinds)
        swap = self.rng.random() < 0.5

        def run(state):
            args = [state[g] for g in given]
            args[1:] = [state[1] > 3 if args[0].dtype == bool else state[3 + g] for g in given[1:]]
            made = fn(*(args[::-1] if swap else args))
            return put(state, to, made.astype(state[to].dtype))

        return run

    def over(self):
        fn, which = OVER[self.rng.integers(len(OVER))], self.rng.integers(2)
        return lambda state: put(state, which, fn(state[which]).astype(state[which].dtype))

    def mixed(self):
        """Conversions, choices and places."""
        number = self.rng.integers(6)

        def run(s):
            f, i, b, *_ = s
            if number == 0:
                return put(s, 0, jnp.where(b, f, s[3]))
            if number == 1:
                return put(s, 0, few_bits((i % 64).astype(f.dtype)))
            if number == 2:
                return put(s, 1, f.astype(i.dtype))  # NaN becomes 0, the rest is held
            if number == 3:
                return put(s, 1, jnp.where(b, i, i + b.astype(i.dtype)))
            if number == 4 or f.ndim == 0 or not self.n:
                return put(s, 2, b ^ (i.astype("int8") > 3))
            at = (i.astype("int64") % self.n + self.n) % self.n
            return put(s, 0, f.at[at].set(s[3][at], unique_indices=False) if self.n == 1 else f[at])

        return run

    def region(self, depth, whole_arrays):
        inner, other = (self.chain(depth - 1, whole_arrays=whole_arrays) for _ in range(2))
        kind, rounds, reverse = self.rng.integers(6), int(self.rng.integers(0, 4)), bool(self.rng.integers(2))
        alone = self.chain(depth - 1, 2, whole_arrays=False)  # of one entry

        def count(s):
            return (jnp.sum(s[1].astype("int32") & 3) & 3) if s[1].size else jnp.int32(rounds)

        def over(s):  # each round with an entry of an array
            def one(s, row):
                s = inner(put(s, 0, jnp.minimum(s[0], row)))
                return s, (s[0], s[1].astype("int32"))

            end, (reals, _) = lax.scan(one, s, jnp.arange(rounds).astype(self.real), reverse=reverse)
            return put(end, 3, reals.max(0, initial=-8.0) if rounds else end[0])

        def each(s):  # as many rounds for each entry as it asks for
            def one(*s):
                return lax.while_loop(
                    lambda c: (c[1] < (s[1].astype("int32") & 3)) & (c[0][0] < 40),
                    lambda c: (alone(c[0]), c[1] + 1),
                    (s, 0),
                )[0]

            return jax.vmap(one)(*s) if s[0].ndim else one(*s)

        def run(s):
            if kind == 0:
                return lax.cond(jnp.any(s[2]), inner, other, s)
            if kind == 1:
                return lax.switch(count(s), [inner, other, lambda s: s], s)
            if kind == 2:
                return lax.fori_loop(0, count(s), lambda _, s: inner(s), s)
            if kind == 3:
                return lax.while_loop(
                    lambda c: (c[1] < count(s)) & ~jnp.any(c[0][0] > 60), lambda c: (inner(c[0]), c[1] + 1), (s, 0)
                )[0]
            return over(s) if kind == 4 else each(s)

        return run


def put(state, which, value):
    """The state with a new value; the one before becomes its neighbour."""
    made = list(state)
    if which < 2:
        made[3 + which] = state[which]
    made[which] = value
    return tuple(made)


def program(seed, number):
    """(function of one lane, n, types) of a number. Those that are compiled as one have the same types."""
    types, rng = np.random.default_rng([seed, number // TOGETHER, 2]), np.random.default_rng([seed, number])
    n, real, whole = int(rng.choice([0, 1, 2, 3, 5])), types.choice(REALS), types.choice(WHOLE)
    return Maker(rng, n, real, whole).chain(2, 5), n, str(real), str(whole)


def inputs(rng, n, real, whole):
    def reals():
        some = np.where(
            rng.random((LANES, n)) < 0.3, rng.choice(SPECIAL, (LANES, n)), rng.integers(-99, 99, (LANES, n)) / 8
        )
        return some.astype(real)

    def wholes():
        about = np.iinfo(whole)
        special = rng.choice(np.array([about.min, about.max, 0, 1, 2, 33], whole), (LANES, n))
        return np.where(rng.random((LANES, n)) < 0.3, special, rng.integers(0, 99, (LANES, n)).astype(whole))

    return reals(), wholes(), rng.random((LANES, n)) < 0.5, reals(), wholes()


def differs(found, wanted):
    """Where two arrays differ: in value, or in being NaN."""
    found, wanted = np.asarray(found), np.asarray(wanted)
    return (found != wanted) & ~((found != found) & (wanted != wanted))


def tried(seed, numbers) -> tuple[list, int]:
    """(numbers of the programs that differ, values compared) of some programs, compiled as one."""
    os.environ["CFLAGS"] = QUICK * bool(numbers[0] // TOGETHER % 8)
    made = [program(seed, k) for k in numbers]
    given = [inputs(np.random.default_rng([seed, k, 1]), *about) for k, (_, *about) in zip(numbers, made, strict=True)]

    def every(*states):
        return [fn(state) for (fn, *_), state in zip(made, states, strict=True)]

    with ck.use_engine("plain"):
        wanted = jax.jit(jax.vmap(every))(*given)
    with ck.use_engine("native"):
        many, one = ck.lanes(every, cores=1)(*given), ck.native(every)
        alone = [one(*jax.tree.map(lambda x, lane=lane: x[lane], given)) for lane in range(3)]
    alone, bad, count = jax.tree.map(lambda *x: np.stack(x), *alone), [], 0
    for k, a, b, c in zip(numbers, many, alone, wanted, strict=True):
        wrong = [differs(x, z).any() or differs(y, np.asarray(z)[:3]).any() for x, y, z in zip(a, b, c, strict=True)]
        bad += [k] * any(wrong)
        count += sum(np.size(x) for x in c)
    return bad, count


ONE = (
    *("exp", "log", "sin", "cos", "tan", "sqrt", "tanh", "log1p", "expm1", "asin", "acos", "atan", "sinh", "cosh"),
    *("cbrt", "erf", "exp2", "logistic", "rsqrt", "floor", "round", "sign"),
)
TWO = ("add", "sub", "mul", "div", "atan2", "pow", "rem", "max", "min", "nextafter")


def values(seed, count) -> tuple[list, int]:
    """(what differs, values compared) of functions of one and of two numbers that round."""
    rng, bad, done = np.random.default_rng([seed, 7]), [], 0
    for real in REALS:
        special = np.array([*SPECIAL, np.pi, 1e-30, -1e30, np.finfo(real).max, np.finfo(real).tiny])
        size = count // (2 * (len(ONE) + len(TWO)))
        x = np.concatenate([special, rng.normal(size=size) * 10.0 ** rng.uniform(-6, 6, size)]).astype(real)
        y = np.concatenate([rng.permutation(special), rng.normal(size=size) * 10.0 ** rng.uniform(-6, 6, size)]).astype(
            real
        )

        def every(x, y):
            return {n: getattr(lax, n)(x) for n in ONE} | {n: getattr(lax, n)(x, y) for n in TWO}

        with ck.use_engine("plain"):
            wanted = jax.jit(jax.vmap(every))(x, y)
        with ck.use_engine("native"):
            found = ck.lanes(every)(x, y)
        for name, b in wanted.items():
            a, b = np.asarray(found[name], float), np.asarray(b, float)
            about = np.finfo(real)  # XLA flushes denormals; its own errors grow with the logarithm of what they are of
            ulps = (40 if real == "float32" else 120) + 2 * np.abs(np.log2(np.maximum(np.abs(b), about.tiny)))
            with np.errstate(invalid="ignore"):
                near = np.abs(a - b) <= ulps * about.eps * np.abs(b) + 4 * about.tiny
            wrong = differs(a, b) & ~near
            bad += [f"{name} of {real} {x[k]!r}, {y[k]!r}: {a[k]!r}, not {b[k]!r}" for k in np.flatnonzero(wrong)[:3]]
            done += len(b)
    return bad, done


def trials(seed, folder):
    """(number, what is wrong or nothing), without end."""
    number = zlib.crc32(str(seed).encode())
    yield "values", "; ".join(values(number, 20_000)[0])
    for start in range(0, 10**9, TOGETHER):
        wrong, _ = tried(number, range(start, start + TOGETHER))
        yield from ((f"program {k}", shown(number, k) if k in wrong else "") for k in range(start, start + TOGETHER))


def shown(seed, number):
    """A program that differs, as its operations."""
    fn, n, real, whole = program(seed, number)
    given = inputs(np.random.default_rng([seed, number, 1]), n, real, whole)
    return str(jax.make_jaxpr(fn)(jax.tree.map(lambda x: x[0], given)))
