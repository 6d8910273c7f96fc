/* Vectors of lanes in the vector types of GCC and Clang. They are as wide as the target's registers (SSE, AVX2, AVX-512,
   NEON, else one number) for the type of most numbers, whose size in bytes is MAIN. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#pragma GCC diagnostic ignored "-Wunused-function"

#ifndef BYTES /* size of a vector of the main type */
#if defined(__AVX512F__)
#define BYTES 64
#elif defined(__AVX__)
#define BYTES 32
#elif defined(__SSE2__) || defined(__ARM_NEON)
#define BYTES 16
#else
#define BYTES MAIN
#endif
#endif
#define W (BYTES / MAIN)

#define VECTOR(name, number) typedef number name __attribute__((vector_size(W * sizeof(number))))
VECTOR(F32, float);
VECTOR(F64, double);
VECTOR(S8, int8_t);
VECTOR(S16, int16_t);
VECTOR(S32, int32_t);
VECTOR(S64, int64_t);
VECTOR(U8, uint8_t);
VECTOR(U16, uint16_t);
VECTOR(U32, uint32_t);
VECTOR(U64, uint64_t);

/* A mask: all bits of a lane or none, as wide as the main type. */
#if MAIN == 4
typedef S32 M;
#else
typedef S64 M;
#endif
#define MASK(compared) __builtin_convertvector((compared), M)
#define ANY(m) any_lane(m)

static inline M splat_M(int x)
{
  const M zero = {0};
  return zero + x;
}

static inline M select_M(M m, M a, M b) { return (m & a) | (~m & b); }

/* Built-in functions: reading the headers of intrinsics takes as long as compiling a small program. */
#ifdef __clang__
#define SHUFFLED __builtin_shufflevector
#else
#define SHUFFLED(a, b, ...) __builtin_shuffle(a, b, __extension__ (S32){__VA_ARGS__})
#endif
#if defined(__clang__) && __clang_major__ >= 15
#define BITS_OF_ANY(m) __builtin_reduce_or(m)
#elif defined(__clang__)
#elif BYTES == 64 && defined(__AVX512F__)
#define BITS_OF_ANY(m) __builtin_ia32_ptestmd512((WORDS)m, (WORDS)m, -1)
typedef int WORDS __attribute__((vector_size(BYTES)));
#elif BYTES == 32 && defined(__AVX__)
#define BITS_OF_ANY(m) __builtin_ia32_movmskps256((float __attribute__((vector_size(BYTES))))m)
#elif BYTES == 16 && defined(__SSE2__)
#define BITS_OF_ANY(m) __builtin_ia32_movmskps((float __attribute__((vector_size(BYTES))))m)
#endif

static inline int any_lane(M m)
{
#ifdef BITS_OF_ANY
  return BITS_OF_ANY(m) != 0;
#else
  int some = 0;
  for (int i = 0; i < W; ++i) some |= m[i] != 0;
  return some;
#endif
}

static inline M load_M(const uint8_t *p, int64_t stride, int64_t n)
{
  M r = {0};
  for (int i = 0; i < W; ++i) r[i] = -(p[(i < n ? i : n - 1) * stride] != 0);
  return r;
}

static inline void store_M(uint8_t *p, int64_t stride, M v, int64_t n)
{
  for (int i = 0; i < n; ++i) p[i * stride] = v[i] != 0;
}

/* Transpose four vectors of 4-byte numbers into W groups of four, and prefetch the lines of memory that follow. */
#if MAIN == 4 && BYTES >= 16
#define FOUR
#define BOTH(i) i, W + (i), (i) + 1, W + (i) + 1
#if W == 16
#define INTERLEAVED(a, b, i) SHUFFLED(a, b, BOTH(i), BOTH(i + 4), BOTH(i + 8), BOTH(i + 12))
#elif W == 8
#define INTERLEAVED(a, b, i) SHUFFLED(a, b, BOTH(i), BOTH(i + 4))
#else
#define INTERLEAVED(a, b, i) SHUFFLED(a, b, BOTH(i))
#endif
typedef int32_t QUARTER __attribute__((vector_size(16), aligned(4), may_alias));

static inline void store_four(char *p, int64_t stride, S32 a, S32 b, S32 c, S32 d)
{
  const S32 ac = INTERLEAVED(a, c, 0), bd = INTERLEAVED(b, d, 0), AC = INTERLEAVED(a, c, 2), BD = INTERLEAVED(b, d, 2);
  const union { S32 whole; QUARTER quarters[W / 4]; } turned[] = {
    {INTERLEAVED(ac, bd, 0)}, {INTERLEAVED(ac, bd, 2)}, {INTERLEAVED(AC, BD, 0)}, {INTERLEAVED(AC, BD, 2)}};
  for (int i = 0; i < W; ++i) __builtin_prefetch(p + i * stride + 128, 1);
#pragma GCC unroll 4
  for (int j = 0; j < W / 4; ++j)
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i) *(QUARTER *)(p + (i + 4 * j) * stride) = turned[i].quarters[j];
}
#endif

/* A function of one vector or of two, lane by lane. */
#define EACH(name, value) \
  static inline T K(name)(T x) { T r = x; for (int i = 0; i < W; ++i) r[i] = value; return r; }
#define EACH_OF_TWO(name, value) \
  static inline T K(name)(T x, T y) { T r = x; for (int i = 0; i < W; ++i) r[i] = value; return r; }

/* A vector T in the work memory, kept between rounds of a loop; `place` counts as if vectors had 64 bytes. */
#define AT(T, place) ((T *)(work + (place) / 64 * BYTES))
