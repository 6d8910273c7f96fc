/* Operations of whole-number vectors; SIGNED and SIZE are those of a number. As in XLA, division by 0 is −1. */
#define ALL_BITS (8 * (int)SIZE)

static inline T K(max)(T a, T b) { return K(select)(MASK(a > b), a, b); }
static inline T K(min)(T a, T b) { return K(select)(MASK(a < b), a, b); }

#if SIGNED
static inline T K(abs)(T x) { return K(select)(MASK(x < 0), -x, x); }
static inline T K(sign)(T x) { return (x < 0) - (x > 0); }
#else
static inline T K(abs)(T x) { return x; }
static inline T K(sign)(T x) { return (T)-(x > 0); }
#endif

static inline T K(div)(T a, T b)
{
  T r = a;
  for (int i = 0; i < W; ++i) r[i] = b[i] == 0 ? (N)-1 : SIGNED && b[i] == (N)-1 ? (N)(0 - (uint64_t)a[i]) : a[i] / b[i];
  return r;
}

static inline T K(rem)(T a, T b)
{
  T r = a;
  for (int i = 0; i < W; ++i) r[i] = b[i] == 0 ? a[i] : SIGNED && b[i] == (N)-1 ? 0 : a[i] % b[i];
  return r;
}

static inline T K(shift_left)(T a, T b)
{
  T r = a;
  for (int i = 0; i < W; ++i) r[i] = (uint64_t)b[i] < ALL_BITS ? (N)((uint64_t)a[i] << b[i]) : 0;
  return r;
}

static inline T K(shift_right_logical)(T a, T b)
{
  T r = a;
  const uint64_t all = ~(uint64_t)0 >> (64 - ALL_BITS);
  for (int i = 0; i < W; ++i) r[i] = (uint64_t)b[i] < ALL_BITS ? (N)(((uint64_t)a[i] & all) >> b[i]) : 0;
  return r;
}

static inline T K(shift_right_arithmetic)(T a, T b)
{
  T r = a;
  for (int i = 0; i < W; ++i) {
    const int far = (uint64_t)b[i] >= ALL_BITS;
    const int64_t x = (int64_t)((uint64_t)a[i] << (64 - ALL_BITS)) >> (64 - ALL_BITS);
    r[i] = (N)(x >> (far ? 63 : (int)b[i]));
  }
  return r;
}

#undef ALL_BITS
