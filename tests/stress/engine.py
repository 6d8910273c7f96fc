"""Programs drawn at random, as C against JAX's own: one lane and many.

Programs are chains of operations, branches, loops, stacks and places, on numbers that are special or have few bits: so
nothing is rounded, and results are equal to the bit. tests/engine compares what rounds.
"""

import os
import zlib

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false")

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

import cnclik as ck

LANES, TOGETHER = 37, 8  # lanes of a batch; programs that are compiled as one
SPECIAL = (0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 0.5, -2.5, 1.5)
REALS, WHOLE = ("float32", "float64"), ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64")


def few_bits(x):
    """A multiple of 1/8 up to 64, which products of two such keep in float32."""
    return jnp.clip(jnp.round(x * 8) / 8, -64.0, 64.0)


# Operations by the kinds of their arguments and result: f real, i whole, b truth.
SIMPLE = {
    "fff": (
        *(jnp.maximum, jnp.minimum, jnp.fmod, lambda a, b: a * 0 - b, lambda a, b: -(a - b)),
        lambda a, b: jnp.copysign(a, jnp.where(b == b, b, 0)),  # a NaN has any sign
        *(lambda a, b: 2 * a + b * 0.5, lambda a, b: 0 - b, lambda a, b: few_bits(a + b)),
        *(lambda a, b: few_bits(a - b), lambda a, b: few_bits(a * b)),
        lambda a, b: few_bits(a / jnp.where(b > 0, 2.0, -4.0).astype(a.dtype)),
    ),
    "ff": (
        *(jnp.negative, jnp.abs, jnp.floor, jnp.ceil, jnp.round, jnp.sign, jnp.square, jnp.trunc),
        *(lambda a: few_bits(a**3), lambda a: a - 0.0, lambda a: a / 4),
        lambda a: lax.clamp(a.dtype.type(-1), a, a.dtype.type(2)),
        lambda a: lax.bitcast_convert_type(lax.bitcast_convert_type(a, f"uint{8 * a.dtype.itemsize}"), a.dtype),
    ),
    "iii": (
        *(jnp.add, jnp.subtract, jnp.multiply, lax.div, lax.rem, jnp.maximum, jnp.minimum, jnp.floor_divide, jnp.mod),
        *(lax.bitwise_and, lax.bitwise_or, lax.bitwise_xor),
        *(lax.shift_left, lax.shift_right_logical, lax.shift_right_arithmetic),
    ),
    "ii": (
        *(jnp.negative, jnp.sign, jnp.invert, lambda a: a**3, lambda a: a + 1, lambda a: a * 109 + 89),
        *(lambda a: a << 3, lambda a: a // 3, lambda a: a % 5, lambda a: a >> 1),
        lambda a: jnp.where(a + 1 > a, a, 0),
    ),
    "ffb": (jnp.less, jnp.less_equal, jnp.equal, jnp.not_equal, jnp.greater),
    "iib": (jnp.less, jnp.less_equal, jnp.equal, jnp.not_equal, jnp.greater_equal),
    "bbb": (jnp.logical_and, jnp.logical_or, jnp.logical_xor),
    "bb": (jnp.logical_not,),
    "fb": (jnp.isnan, jnp.isfinite, lambda a: a == a),
}
OVER = (  # of a whole array, with as many entries as before
    *(jnp.flip, lambda a: jnp.roll(a, 1), lambda a: a.at[0].set(a[-1]), lambda a: a[::-1] * 1),
    *(lambda a: jnp.broadcast_to(a.max(), a.shape), lambda a: jnp.concatenate([a[1:], a[:1]])),
    *(lambda a: jnp.where(jnp.arange(len(a)) > 0, a, a[0]), lax.cummax, lambda a: jnp.tile(a, 2)[: len(a)]),
)


def taken(s):
    """Entries of an array at places that the program works out."""
    f, i, *_ = s
    if not f.size or not f.ndim:
        return f
    at = (i.astype("int64") % len(f) + len(f)) % len(f)
    return f.at[at].set(s[3][at], unique_indices=False) if len(f) == 1 else f[at]


MIXED = (  # conversions, choices and places: the entry of the state, of a state (real, whole, truth, real, whole)
    (0, lambda s: jnp.where(s[2], s[0], s[3])),
    (0, lambda s: few_bits((s[1] % 64).astype(s[0].dtype))),
    (1, lambda s: s[0].astype(s[1].dtype)),  # NaN becomes 0, the rest is held
    (1, lambda s: jnp.where(s[2], s[1], s[1] + s[2].astype(s[1].dtype))),
    (2, lambda s: s[2] ^ (s[1].astype("int8") > 3)),
    (0, taken),
)


def put(state, which, value):
    """The state with a new value; the one before becomes its neighbour."""
    state = list(state)
    if which < 2:
        state[3 + which] = state[which]
    state[which] = value.astype(state[which].dtype)
    return tuple(state)


def chain(rng, depth, length=None):
    """A chain of operations, as a function of the state."""
    steps = [step(rng, depth) for _ in range(length or rng.integers(2, 5))]

    def run(state):
        for one in steps:
            state = one(state)
        return state

    return run


def step(rng, depth):
    odds = rng.random()
    if depth and odds < 0.35:
        return region(rng, depth)
    if odds < 0.5:
        fn, which = OVER[rng.integers(len(OVER))], rng.integers(2)
        return lambda s: put(s, which, fn(s[which])) if s[which].ndim and s[which].size else s
    if odds < 0.62:
        which, fn = MIXED[rng.integers(len(MIXED))]
        return lambda s: put(s, which, fn(s))
    kinds = list(SIMPLE)[rng.integers(len(SIMPLE))]
    fn, swap = SIMPLE[kinds][rng.integers(len(SIMPLE[kinds]))], rng.random() < 0.5
    *given, to = ("fib".index(kind) for kind in kinds)

    def run(state):
        args = [state[g] for g in given]
        args[1:] = [state[1] > 3 if args[0].dtype == bool else state[3 + g] for g in given[1:]]
        return put(state, to, fn(*(args[::-1] if swap else args)))

    return run


def region(rng, depth):
    """A branch or a loop."""
    inner, other, alone = chain(rng, depth - 1), chain(rng, depth - 1), chain(rng, depth - 1, 2)
    rounds, reverse = int(rng.integers(0, 4)), bool(rng.integers(2))

    def count(s):
        return (jnp.sum(s[1].astype("int32") & 3) & 3) if s[1].size else jnp.int32(rounds)

    def repeated(s, fn, goes_on):
        return lax.while_loop(lambda c: goes_on(*c), lambda c: (fn(c[0]), c[1] + 1), (s, 0))[0]

    def over(s):  # each round with an entry of an array
        def one(s, row):
            s = inner(put(s, 0, jnp.minimum(s[0], row)))
            return s, (s[0], s[1].astype("int32"))

        end, (reals, _) = lax.scan(one, s, jnp.arange(rounds).astype(s[0].dtype), reverse=reverse)
        return put(end, 3, reals.max(0, initial=-8.0) if rounds else end[0])

    def each(s):  # as many rounds for each entry as it asks for
        def one(*s):
            return repeated(s, alone, lambda now, k: (k < (s[1].astype("int32") & 3)) & (now[0] < 40))

        return jax.vmap(one)(*s) if s[0].ndim else one(*s)

    kinds = (
        lambda s: lax.cond(jnp.any(s[2]), inner, other, s),
        lambda s: lax.switch(count(s), [inner, other, lambda s: s], s),
        lambda s: lax.fori_loop(0, count(s), lambda _, s: inner(s), s),
        lambda s: repeated(s, inner, lambda now, k: (k < count(s)) & ~jnp.any(now[0] > 60)),
        *(over, each),
    )
    return kinds[rng.integers(len(kinds))]


def program(seed, number):
    """(function of one lane, its inputs). Programs that are compiled as one have the same types."""
    types, rng = np.random.default_rng([seed, number // TOGETHER, 2]), np.random.default_rng([seed, number])
    shape, real, whole = (LANES, int(rng.choice([0, 1, 2, 3, 5]))), types.choice(REALS), str(types.choice(WHOLE))
    fn, about = chain(rng, 2, 5), np.iinfo(whole)

    def mostly(values, special):
        return np.where(rng.random(shape) < 0.3, rng.choice(special, shape), values)

    def pair():
        special = np.array([about.min, about.max, 0, 1, 2, 33], whole)
        reals = mostly(rng.integers(-99, 99, shape) / 8, SPECIAL).astype(real)
        return reals, mostly(rng.integers(0, 99, shape).astype(whole), special)

    return fn, (*pair(), rng.random(shape) < 0.5, *pair())


def differs(found, wanted):
    """Where two arrays differ: in value, or in being NaN."""
    return (found != wanted) & ~((found != found) & (wanted != wanted))


def wrong(seed, numbers) -> list:
    """Numbers of the programs that differ, of some that are compiled as one."""
    os.environ["CFLAGS"] = "-O1 -DBYTES=16" * bool(numbers[0] // TOGETHER % 8)  # of seven in eight: a third of the time
    programs, given = zip(*(program(seed, k) for k in numbers), strict=True)

    def every(*states):
        return [fn(state) for fn, state in zip(programs, states, strict=True)]

    with ck.use_engine("plain"):
        wanted = jax.tree.map(np.asarray, jax.jit(jax.vmap(every))(*given))
    with ck.use_engine("native"):
        many, one = jax.tree.map(np.asarray, ck.lanes(every, cores=1)(*given)), ck.native(every)
        alone = [one(*jax.tree.map(lambda x, lane=lane: x[lane], given)) for lane in range(3)]
    alone = jax.tree.map(lambda *x: np.stack(x), *alone)
    bad = jax.tree.map(lambda a, b, c: bool(differs(a, c).any() or differs(b, c[:3]).any()), many, alone, wanted)
    return [k for k, of in zip(numbers, bad, strict=True) if any(of)]


def trials(seed, folder):
    """(number, what is wrong or nothing), without end."""
    number = zlib.crc32(str(seed).encode())
    for start in range(0, 10**9, TOGETHER):
        bad = wrong(number, range(start, start + TOGETHER))
        for k in range(start, start + TOGETHER):
            fn, given = program(number, k)
            yield f"program {k}", f"{jax.make_jaxpr(jax.vmap(fn))(given)}" * (k in bad)
