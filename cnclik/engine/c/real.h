/* Operations of floating-point vectors. SIZE is 4 or 8; LIBM(name) is the library's function for one number. */
#if SIZE == 4
#define SIGN 0x80000000
#define SMALL 4194304.0f /* larger numbers are whole */
#define FAR 1e4f
#define PI_LOW -8.742278e-08f
#define WIDE(name) __builtin_ia32_##name##ps512_mask
#else
#define SIGN 0x8000000000000000
#define SMALL 2251799813685248.0
#define FAR 1e4
#define PI_LOW 1.2246467991473532e-16
#define WIDE(name) __builtin_ia32_##name##pd512_mask
#endif

static inline T K(abs)(T x) { return (T)((BITS)x & (BITS_NUMBER)~SIGN); }
#if defined(__AVX512DQ__) && !defined(__clang__) && BYTES == 64 && SIZE == MAIN
/* The instruction gives b if one is NaN; lanes where a is (7: not NaN) stay a. */
#define EXTREME(name, sign, a, b) WIDE(name)(a, b, a, WIDE(cmp)(a, a, 7, -1, 4), 4)
#else
#define EXTREME(name, sign, a, b) K(select)(MASK((a sign b) | (a != a)), a, b)
#endif
/* Of zeros, 0 is larger than -0. */
static inline T K(max)(T a, T b) { return K(select)(MASK(a == b), (T)((BITS)a & (BITS)b), EXTREME(max, >, a, b)); }
static inline T K(min)(T a, T b) { return K(select)(MASK(a == b), (T)((BITS)a | (BITS)b), EXTREME(min, <, a, b)); }
static inline T K(sign)(T x) { return K(select)(MASK(x > 0), K(splat)(1), K(select)(MASK(x < 0), K(splat)(-1), x)); }

EACH(sqrt, LIBM(sqrt)(x[i])) /* compiles to one instruction */

/* To the nearest whole number, halves to the even one. */
static inline T K(round_even)(T x)
{
  const T m = (T)(((BITS)x & (BITS_NUMBER)SIGN) | (BITS)K(splat)(MAGIC));
  const T rounded = (x + m) - m;
  return K(select)(MASK(K(abs)(x) < SMALL), (T)(((BITS)rounded & (BITS_NUMBER)~SIGN) | ((BITS)x & (BITS_NUMBER)SIGN)), x);
}

/* Clamped to low … high; NaN becomes 0. */
static inline T K(held)(T x, N low, N high)
{
  x = K(select)(MASK(x == x), x, K(splat)(0));
  x = K(select)(MASK(x < low), K(splat)(low), x);
  return K(select)(MASK(x > high), K(splat)(high), x);
}

/* Sine and cosine within 2 ulp: |x| = k π/2 + r (Cody and Waite 1980), minimax polynomials of r; the library's beyond
   FAR. */
static inline void K(sincos)(T angle, T *sine, T *cosine)
{
  const T size = K(abs)(angle);
  T x = size;
  const T turned = x * TURNS + MAGIC, k = turned - MAGIC;
  const BITS quadrant = (BITS)turned; /* its last bits are those of k */
  T r, s, t, z;
  REDUCED
  s = r + r * z * s;
  t = (1 - (N)0.5 * z) + z * z * t;
  {
    const BITS swap = (quadrant & 1) != 0;
    const BITS down = (quadrant & 2) << (8 * SIZE - 2), back = ((quadrant + 1) & 2) << (8 * SIZE - 2);
    const T a = (T)((swap & (BITS)t) | (~swap & (BITS)s)), b = (T)((swap & (BITS)s) | (~swap & (BITS)t));
    *sine = (T)((BITS)a ^ down ^ ((BITS)angle & (BITS_NUMBER)SIGN));
    *cosine = (T)((BITS)b ^ back);
  }
  {
    const M far = MASK(~(size <= FAR));
    if (ANY(far)) {
      for (int i = 0; i < W; ++i) {
        if (far[i]) {
          (*sine)[i] = LIBM(sin)(angle[i]);
          (*cosine)[i] = LIBM(cos)(angle[i]);
        }
      }
    }
  }
}

/* The angle of (x, y), within 3 ulp: atan t = t + t z A(z) for t up to tan(π/8), by symmetry beyond. */
static inline T K(atan2)(T y, T x)
{
  const T ax = K(abs)(x), ay = K(abs)(y);
  const M steep = MASK(ay > ax), left = MASK((BITS)x < 0);
  const T small = K(select)(steep, ax, ay), large = K(select)(steep, ay, ax);
  const M endless = MASK((ax == ay) & (ax == K(splat)(INFINITY)));
  const M beyond = MASK(small > large * (N)0.41421356237309503) | endless;
  const T up = K(select)(beyond, small - large, small), down = K(select)(beyond, small + large, large);
  const M nowhere = MASK(down == 0);
  const T t = K(select)(endless | nowhere, K(splat)(0), up / K(select)(nowhere, K(splat)(1), down)), z = t * t;
#if SIZE == 4
  T r = (((-0.06451718869358958f * z + 0.10743668324830098f) * z - 0.14263949753605723f) * z + 0.1999954031495797f) * z
    - 0.33333331760434554f;
#else
  T r = (((((((((-0.019175404711104935 * z + 0.03923044778479309) * z - 0.050854078345894844) * z
    + 0.05858140904866328) * z - 0.06664510525508936) * z + 0.07692183125376892) * z - 0.0909090457530649) * z
    + 0.11111111015187018) * z - 0.14285714284665682) * z + 0.19999999999995516) * z - 0.3333333333333333;
#endif
  r = t + t * z * r;
  r = K(select)(beyond, r + (N)0.78539816339744831, r);
  r = K(select)(steep, ((N)1.5707963267948966 - r) + (N)0.5 * PI_LOW, r);
  r = K(select)(left, ((N)3.1415926535897931 - r) + PI_LOW, r);
  r = K(select)(MASK((x == x) & (y == y)), r, x + y);
  return (T)((BITS)K(abs)(r) | ((BITS)y & (BITS_NUMBER)SIGN));
}
