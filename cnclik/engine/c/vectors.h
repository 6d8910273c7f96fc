/* Vectors of lanes, by the vector types of GCC and Clang, as wide as the target's registers for the type of most numbers:
   SSE, AVX2, AVX-512, NEON, else one number. MAIN is the size of that type, in bytes. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
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

#ifndef BYTES /* of a vector of the main type */
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

static inline int any_lane(M m)
{
#if BYTES == 64 && defined(__AVX512F__) && MAIN == 4
  return _mm512_test_epi32_mask((__m512i)m, (__m512i)m) != 0;
#elif BYTES == 64 && defined(__AVX512F__)
  return _mm512_test_epi64_mask((__m512i)m, (__m512i)m) != 0;
#elif BYTES == 32 && defined(__AVX__) && MAIN == 4
  return _mm256_movemask_ps((__m256)m) != 0;
#elif BYTES == 32 && defined(__AVX__)
  return _mm256_movemask_pd((__m256d)m) != 0;
#elif BYTES == 16 && defined(__SSE2__) && MAIN == 4
  return _mm_movemask_ps((__m128)m) != 0;
#elif BYTES == 16 && defined(__SSE2__)
  return _mm_movemask_pd((__m128d)m) != 0;
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

/* Four vectors of numbers of 4 bytes turned into W places of four; the lines of memory that follow are asked for. */
#if MAIN == 4 && BYTES == 64 && defined(__AVX512F__)
#define FOUR
typedef __m512 REGISTER;
#define OF_REGISTER(name) _mm512_##name
#define QUARTER(r, j) _mm512_extractf32x4_ps(r, j)
#elif MAIN == 4 && BYTES == 32 && defined(__AVX__)
#define FOUR
typedef __m256 REGISTER;
#define OF_REGISTER(name) _mm256_##name
#define QUARTER(r, j) _mm256_extractf128_ps(r, (j) & 1)
#endif
#ifdef FOUR
static inline void store_four(char *p, int64_t stride, REGISTER a, REGISTER b, REGISTER c, REGISTER d)
{
  const REGISTER ab = OF_REGISTER(unpacklo_ps)(a, b), cd = OF_REGISTER(unpacklo_ps)(c, d);
  const REGISTER AB = OF_REGISTER(unpackhi_ps)(a, b), CD = OF_REGISTER(unpackhi_ps)(c, d);
  const REGISTER turned[] = {
    OF_REGISTER(shuffle_ps)(ab, cd, 0x44), OF_REGISTER(shuffle_ps)(ab, cd, 0xee),
    OF_REGISTER(shuffle_ps)(AB, CD, 0x44), OF_REGISTER(shuffle_ps)(AB, CD, 0xee)};
  for (int i = 0; i < W; ++i) __builtin_prefetch(p + i * stride + 128, 1);
  for (int i = 0; i < 4; ++i) {
    _mm_storeu_ps((float *)(p + i * stride), QUARTER(turned[i], 0));
    _mm_storeu_ps((float *)(p + (i + 4) * stride), QUARTER(turned[i], 1));
#if BYTES == 64
    _mm_storeu_ps((float *)(p + (i + 8) * stride), QUARTER(turned[i], 2));
    _mm_storeu_ps((float *)(p + (i + 12) * stride), QUARTER(turned[i], 3));
#endif
  }
}
#endif

/* What is kept between the rounds of loops: T's at a place of the work memory. */
#define AT(T, place) ((T *)(work + (place)))
