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

EACH_OF_TWO(div, y[i] == 0 ? (N)-1 : SIGNED && y[i] == (N)-1 ? (N)(0 - (uint64_t)x[i]) : x[i] / y[i])
EACH_OF_TWO(rem, y[i] == 0 ? x[i] : SIGNED && y[i] == (N)-1 ? 0 : x[i] % y[i])
EACH_OF_TWO(shift_left, (uint64_t)y[i] < ALL_BITS ? (N)((uint64_t)x[i] << y[i]) : 0)
EACH_OF_TWO(shift_right_logical,
            (uint64_t)y[i] < ALL_BITS ? (N)(((uint64_t)x[i] & (~(uint64_t)0 >> (64 - ALL_BITS))) >> y[i]) : 0)
EACH_OF_TWO(shift_right_arithmetic,
            (N)((int64_t)((uint64_t)x[i] << (64 - ALL_BITS)) >> (64 - ALL_BITS) >> ((uint64_t)y[i] < ALL_BITS ? (int)y[i] : 63)))

#undef ALL_BITS
