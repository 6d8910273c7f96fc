"""Prelude: vectors of lanes in C, and the operations on them that C itself has not.

By the vector types of GCC and Clang, as wide as the target's registers (SSE, AVX2, AVX-512, NEON, else one number).
"""

import numpy as np

from cnclik.native.operations import OPERATIONS
from cnclik.native.scalar import number
from cnclik.robot.trig import RANGE, TABLES

# atan t = t + t z A(z), z = t², for t ≤ tan(π/8): Chebyshev fits, relative errors 3e-9 and 6e-18.
_ARCTANGENT = {
    24: (-0.33333331760434554, 0.1999954031495797, -0.14263949753605723, 0.10743668324830098, -0.06451718869358958),
    53: (
        *(-0.3333333333333333, 0.19999999999995516, -0.14285714284665682, 0.11111111015187018, -0.0909090457530649),
        *(0.07692183125376892, -0.06664510525508936, 0.05858140904866328, -0.050854078345894844),
        *(0.03923044778479309, -0.019175404711104935),
    ),
}


def prelude(dtype, writers) -> str:
    """The text before functions of vectors, in which @REAL@ stands for a number of a lane.

    Args: writers: those that wrote the functions, and know what they use.
    """
    mapped, used = (set().union(*found) for found in zip(*((w.mapped, w.used) for w in writers), strict=True))
    single = np.dtype(dtype).itemsize == 4
    mantissa, suffix = 24 if single else 53, "f" * single

    def c(x):
        return f"({number(x, 'real', dtype)})"

    def horner(coefficients):
        text = f"SPLAT{c(coefficients[-1])}"
        for a in coefficients[-2::-1]:
            text = f"({text} * z + {c(a)})"
        return text

    table = TABLES[mantissa]
    *exact, part, tail = table.half_pi
    words = {
        "SIZE": "4" if single else "8",
        "WHOLE": "int32_t" if single else "int64_t",
        "SUFFIX": "ps" if single else "pd",
        "EPI": "epi32" if single else "epi64",
        "CAST": "" if single else "d",
        "FF": suffix,
        "SIGN": "0x80000000" if single else "0x8000000000000000",
        "SMALL": c(2.0 ** (mantissa - 2)),
        "MAGIC": c(1.5 * 2.0 ** (mantissa - 1)),
        "RANGE": c(RANGE),
        "PER_TURN": c(2 / np.pi),
        "REDUCE": "\n".join(f"  x = x - k * {c(p)};" for p in exact),
        "PART": c(part),
        "TAIL": c(tail),
        "SINE": horner(table.sine),
        "COSINE": horner(table.cosine),
        "ARCTANGENT": horner(_ARCTANGENT[mantissa]),
        "EIGHTH": c(np.tan(np.pi / 8)),
        "QUARTER_PI": c(np.pi / 4),
        "HALF_PI": c(np.pi / 2),
        "PI_LOW": c(float(1.2246467991473532e-16 if not single else -8.742278e-08)),
        "PI": c(np.pi),
        "ONE": c(1.0),
        "HALF": c(0.5),
        "ZERO": c(0.0),
    }
    text = _PRELUDE + (_SINCOS if "sincos" in used else "")
    for word in sorted(words, key=len, reverse=True):
        text = text.replace(f"@{word}@", words[word])
    for op in sorted(mapped):
        inside = OPERATIONS[op].text.format(*("x[i]", "y[i]"), f=suffix)
        two = "y[i]" in inside
        text += f"static inline V v{op}(V x{', V y' if two else ''})\n{{\n  V r = x;\n"
        text += f"  for (int i = 0; i < W; ++i) r[i] = {inside};\n  return r;\n}}\n\n"
    return text


_PRELUDE = """#include <math.h>
#include <stddef.h>
#include <stdint.h>
#if defined(__AVX__)
#include <immintrin.h>
#elif defined(__SSE2__)
#include <emmintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#pragma GCC diagnostic ignored "-Wunused-function"

#ifndef BYTES /* of a vector */
#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#elif defined(__SSE2__) || defined(__ARM_NEON)
#define BYTES 16
#else
#define BYTES @SIZE@
#endif
#endif
#define W (BYTES / @SIZE@)

typedef @REAL@ V __attribute__((vector_size(BYTES)));
typedef @WHOLE@ I __attribute__((vector_size(BYTES)));

static inline V vzero(void)
{
  const V zero = {0};
  return zero;
}

#define SPLAT(x) ((@REAL@)(x) - vzero())
#define SPLATI(x) ((@WHOLE@)(x) + (I)vzero())
#define SELI(m, a, b) (((m) & (a)) | (~(m) & (b)))
#define SEL(m, a, b) vsel(m, a, b)
#define ANY(m) vany(m)

static inline V vsel(I m, V a, V b) { return (V)((m & (I)a) | (~m & (I)b)); }

static inline int vany(I m)
{
#if BYTES == 64 && defined(__AVX512F__)
  return _mm512_test_@EPI@_mask((__m512i)m, (__m512i)m) != 0;
#elif BYTES == 32 && defined(__AVX__)
  return _mm256_movemask_@SUFFIX@((__m256@CAST@)m) != 0;
#elif BYTES == 16 && defined(__SSE2__)
  return _mm_movemask_@SUFFIX@((__m128@CAST@)m) != 0;
#else
  @WHOLE@ some = 0;
  for (int i = 0; i < W; ++i) some |= m[i];
  return some != 0;
#endif
}

static inline V vabs(V x) { return (V)((I)x & (@WHOLE@)~@SIGN@); }

static inline V vsqrt(V x)
{
#if BYTES == 64 && defined(__AVX512F__)
  return (V)_mm512_sqrt_@SUFFIX@((__m512@CAST@)x);
#elif BYTES == 32 && defined(__AVX__)
  return (V)_mm256_sqrt_@SUFFIX@((__m256@CAST@)x);
#elif BYTES == 16 && defined(__SSE2__)
  return (V)_mm_sqrt_@SUFFIX@((__m128@CAST@)x);
#elif BYTES == 16 && defined(__aarch64__) && @SIZE@ == 4
  return (V)vsqrtq_f32((float32x4_t)x);
#elif BYTES == 16 && defined(__aarch64__)
  return (V)vsqrtq_f64((float64x2_t)x);
#else
  V r = x;
  for (int i = 0; i < W; ++i) r[i] = sqrt@FF@(x[i]);
  return r;
#endif
}

static inline V vround(V x)
{
  const V m = (V)(((I)x & (@WHOLE@)@SIGN@) | (I)SPLAT(@MAGIC@));
  return vsel(vabs(x) < @SMALL@, (x + m) - m, x);
}

/* Towards 0; what is too large for 32 bits to the nearest, NaN to 0. */
static inline I vint(V x)
{
  const V top = SPLAT(2147483520.0@FF@), bottom = SPLAT(-2147483648.0@FF@);
  x = vsel(x == x, x, vzero());
  return __builtin_convertvector(vsel(x < top, vsel(x > bottom, x, bottom), top), I);
}

/* The angle of (x, y), within 3 ulp: atan t = t + t z A(z) for t up to tan(pi/8), by symmetry beyond. */
static inline V vatan2(V y, V x)
{
  const V ax = vabs(x), ay = vabs(y);
  const I steep = ay > ax, left = (I)x < (@WHOLE@)0;
  const V small = vsel(steep, ax, ay), large = vsel(steep, ay, ax);
  const I endless = (ax == ay) & (ax == SPLAT(INFINITY));
  const I beyond = (small > large * @EIGHTH@) | endless;
  const V up = vsel(beyond, small - large, small), down = vsel(beyond, small + large, large);
  const I nowhere = down == @ZERO@;
  const V t = vsel(endless | nowhere, vzero(), up / vsel(nowhere, SPLAT(@ONE@), down)), z = t * t;
  V r = t + t * z * @ARCTANGENT@;
  r = vsel(beyond, r + @QUARTER_PI@, r);
  r = vsel(steep, (@HALF_PI@ - r) + @HALF@ * @PI_LOW@, r);
  r = vsel(left, (@PI@ - r) + @PI_LOW@, r);
  r = vsel((x == x) & (y == y), r, x + y);
  return (V)((I)vabs(r) | ((I)y & (@WHOLE@)@SIGN@));
}

"""

_SINCOS = """/* Both within 2 ulp, as the library's own; beyond its range, lane by lane, libm's. */
static inline void vsincos(V x, V *sine, V *cosine)
{
  const V angle = x;
  const V turned = x * @PER_TURN@ + @MAGIC@, k = turned - @MAGIC@;
  const I quadrant = (I)turned; /* the last bits are k's */
  V r, s, t, z;
@REDUCE@
  r = x - k * @PART@;
  r = r + (((x - r) - k * @PART@) - k * @TAIL@);
  z = r * r;
  s = r + r * z * @SINE@;
  t = (@ONE@ - @HALF@ * z) + z * z * @COSINE@;
  {
    const I swap = (quadrant & 1) != 0;
    const I down = (quadrant & 2) << (8 * @SIZE@ - 2), back = ((quadrant + 1) & 2) << (8 * @SIZE@ - 2);
    const V a = vsel(swap, t, s), b = vsel(swap, s, t);
    *sine = (V)((I)a ^ down);
    *cosine = (V)((I)b ^ back);
  }
  {
    const I far = ~(vabs(angle) <= @RANGE@);
    if (ANY(far)) {
      for (int i = 0; i < W; ++i) {
        if (far[i]) {
          (*sine)[i] = sin@FF@(angle[i]);
          (*cosine)[i] = cos@FF@(angle[i]);
        }
      }
    }
  }
}

"""
