"""Sines: sine and cosine together, by one range reduction and two short polynomials, within 2 ulp: for XLA and for C.

XLA's own sine and cosine cost several times more and dominate a kinematics loop. Here |x| = k·π/2 + r with |r| ≤ π/4
(Cody & Waite 1980). π/2 is split into short parts, so that k times each but the last is exact for |x| ≤ 1e4;
contracting a·b + c then changes nothing. sin r and cos r are minimax polynomials with a relative error of 4e-9 in
float32 and 4e-18 in float64. XLA's functions are used beyond this range and for NaN.
"""

import functools
import math
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax

RANGE = 1e4


class Table(NamedTuple):
    """The numbers of `sincos` in one precision, as texts for JAX and for C."""

    half_pi: str  # parts of π/2 whose product with k is exact, then a compensated part, then the tail
    sine: str  # sin r = r + r³ S(r²)
    cosine: str  # cos r = 1 − r²/2 + r⁴ C(r²)
    turns: str  # 2/π
    magic: str  # 1.5 times two to the power of the mantissa's bits: what is added to it becomes whole


TABLES = {  # {bytes of a number: table}
    4: Table(
        half_pi="1.5703125 0.0004837512969970703 7.549533620476723e-08 2.5633441e-12",
        sine="-0.166666549331917384 0.00833217745665272256 -0.000195172025549268638",
        cosine="0.0416666468486836209 -0.00138873666071656574 0.0000244383434232972141",
        turns="0.636619772",
        magic="12582912.0",
    ),
    8: Table(
        half_pi="1.5707963267941523 7.443547480480255e-13 6.36831716351095e-25",
        sine="-0.16666666666666632 0.0083333333333224082 -0.000198412698298032444 2.75573136902666746e-6"
        " -2.50507578467316194e-8 1.58967795431892491e-10",
        cosine="0.0416666666666665994 -0.00138888888888741166 0.000024801587289477352 -2.75573143508751314e-7"
        " 2.08757230672177435e-9 -1.13596367512304589e-11",
        turns="0.6366197723675814",
        magic="6755399441055744.0",
    ),
}


def filled(text, size) -> str:
    """A text in C with its TURNS, MAGIC and REDUCED for numbers of `size` bytes.

    REDUCED makes r and z = r² of x and k, and the polynomials s = S(z) and t = C(z).
    """
    suffix, table = "f" * (size == 4), TABLES[size]
    *exact, part, tail = (word + suffix for word in table.half_pi.split())
    lines = [f"x = x - k * {p};" for p in exact]
    lines += [f"r = x - k * {part};", f"r = r + (((x - r) - k * {part}) - k * {tail});", "z = r * r;"]
    for name, numbers in (("s", table.sine), ("t", table.cosine)):
        words = [word + suffix for word in reversed(numbers.split())]
        lines.append(f"{name} = {functools.reduce(lambda made, c: f'({made} * z + {c})', words)};")
    text = text.replace("REDUCED", "\n  ".join(lines))
    return text.replace("TURNS", table.turns + suffix).replace("MAGIC", table.magic + suffix)


def sincos(angles):
    """Sines and cosines of a tuple of angles [rad]: two tuples."""
    far = [~(jnp.abs(x) <= RANGE) for x in angles]  # true for NaN as well
    near = [_reduced(x) for x in angles]
    # A far lane carries its angle into the loop in place of its sine. If the angle were loop-invariant, XLA would hoist
    # the library calls out of the loop and always execute them.
    state = tuple((jnp.where(f, x, s), c) for f, x, (s, c) in zip(far, angles, near, strict=True))

    def library(carry):
        _, state = carry
        done = tuple(
            (jnp.where(f, jnp.sin(x), x), jnp.where(f, jnp.cos(x), c)) for f, (x, c) in zip(far, state, strict=True)
        )
        return jnp.zeros_like(some), done

    # This loop runs once if some lane needs it, otherwise not at all; unlike lax.cond, also under vmap.
    some = functools.reduce(jnp.logical_or, far)
    _, state = lax.while_loop(lambda carry: jnp.any(carry[0]), library, (some, state))
    return tuple(s for s, _ in state), tuple(c for _, c in state)


def _reduced(x):
    """(sin x, cos x) for |x| ≤ RANGE; meaningless beyond."""
    table, negative, x = TABLES[x.dtype.itemsize], jnp.signbit(x), jnp.abs(x)
    *exact, part, tail = map(float, table.half_pi.split())
    k = lax.round(x * (2 / math.pi), lax.RoundingMethod.TO_NEAREST_EVEN)
    for p in exact:
        x = x - k * p
    r = x - k * part
    r = r + (((x - r) - k * part) - k * tail)  # the rounding error of the subtraction, and the tail
    z = r * r
    s = r + r * z * _polynomial(table.sine, z)
    c = (1 - 0.5 * z) + z * z * _polynomial(table.cosine, z)
    quadrant = k.astype(jnp.int32)
    swap = (quadrant & 1) == 1
    s, c = jnp.where(swap, c, s), jnp.where(swap, s, c)
    return jnp.where(((quadrant & 2) == 2) ^ negative, -s, s), jnp.where(((quadrant + 1) & 2) == 2, -c, c)


def _polynomial(numbers, z):
    *lower, out = map(float, numbers.split())
    for c in reversed(lower):
        out = out * z + c
    return out
