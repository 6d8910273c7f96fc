/* Operations of floating-point vectors. SIZE is 4 or 8; LIBM(name) is the library's function for one number. */
#if SIZE == 4
#define SIGN 0x80000000
#define SMALL 4194304.0f /* larger numbers are whole */
#define FAR 1e4f
#define PI_LOW -8.742278e-08f
#define FRACTION 23 /* bits */
#define WIDE(name) __builtin_ia32_##name##ps512_mask
#define ROOT_HALF 0x3f3504f3
#define LN_2 0.69313812256f
#define LN_2_LOW 9.0580006145e-06f
#define LEAST 1.17549435e-38f
#define EPSILON 2.38418579e-07f
#else
#define SIGN 0x8000000000000000
#define SMALL 2251799813685248.0
#define FAR 1e4
#define PI_LOW 1.2246467991473532e-16
#define FRACTION 52
#define WIDE(name) __builtin_ia32_##name##pd512_mask
#define ROOT_HALF 0x3fe6a09e667f3bcd
#define LN_2 0.6931471803691238
#define LN_2_LOW 1.9082149292705877e-10
#define LEAST 2.2250738585072014e-308
#define EPSILON 4.440892098500626e-16
#endif

static inline T K(abs)(T x) { return (T)((BITS)x & (BITS_NUMBER)~SIGN); }
#if defined(__AVX512DQ__) && !defined(__clang__) && BYTES == 64 && SIZE == MAIN
/* The instruction gives b if one is NaN; lanes where a is (7: not NaN) stay a. */
static inline T K(max)(T a, T b) { return WIDE(max)(a, b, a, WIDE(cmp)(a, a, 7, -1, 4), 4); }
static inline T K(min)(T a, T b) { return WIDE(min)(a, b, a, WIDE(cmp)(a, a, 7, -1, 4), 4); }
#else
static inline T K(max)(T a, T b) { return K(select)(MASK((a > b) | (a != a)), a, b); }
static inline T K(min)(T a, T b) { return K(select)(MASK((a < b) | (a != a)), a, b); }
#endif
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

/* log (x + lost) within 2 ulp, for x not denormal and lost far smaller: x = 2^k (1 + f), √½ ≤ 1 + f < √2, and
   log (1 + f) = f - f²/2 + s (f²/2 + R(s²)), s = f/(2 + f) (fdlibm, Sun Microsystems 1993). */
static inline T K(log_of)(T x, T lost)
{
  const BITS at = (BITS)x - ROOT_HALF, k = at >> FRACTION;
  const T f = (T)((BITS)x - (k << FRACTION)) - 1, n = __builtin_convertvector(k, T);
  const T s = f / (2 + f), z = s * s, h = (N)0.5 * f * f;
#if SIZE == 4
  const T r = z * (((0.24279078841f * z + 0.28498786688f) * z + 0.40000972152f) * z + 0.66666662693f);
#else
  const T r = z * ((((((0.1479819860511659 * z + 0.1531383769920937) * z + 0.1818357216161805) * z
    + 0.22222198432149784) * z + 0.2857142874366239) * z + 0.3999999999940942) * z + 0.6666666666666735);
#endif
  const T found = (s * (h + r) + (n * LN_2_LOW + lost / x) - h) + f + n * LN_2;
  const T ends = K(select)(MASK(x == 0), K(splat)(-INFINITY), K(select)(MASK(x > 0), x, K(splat)(NAN)));
  return K(select)(MASK((x > 0) & (x < K(splat)(INFINITY))), found, ends);
}

static inline T K(log)(T x)
{
  const M small = MASK((x > 0) & (x < LEAST));
  const T n = K(select)(small, K(splat)(FRACTION), K(splat)(0));
  return K(log_of)(K(select)(small, x * ((N)2 / EPSILON), x), K(splat)(0)) - n * (N)0.69314718055994531;
}

static inline T K(log1p)(T x)
{
  const T u = 1 + x;
  return K(select)(MASK(x == 0), x, K(log_of)(u, K(select)(MASK(u > 2), 1 - (u - x), x - (u - 1))));
}
