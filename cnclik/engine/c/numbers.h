/* Operations of every vector type T. N is one number, BITS a vector of whole numbers of that size, K(name) a name for T. */
static inline T K(splat)(N x)
{
  const T zero = {0};
  return x - zero; /* -0 stays -0 */
}

static inline T K(select)(M m, T a, T b)
{
  const BITS w = __builtin_convertvector(m, BITS);
  return (T)((w & (BITS)a) | (~w & (BITS)b));
}

static inline T K(load)(const N *p, int64_t stride, int64_t n)
{
  T r = {0};
  if (stride == 0) return K(splat)(*p);
  if (n == W) for (int i = 0; i < W; ++i) r[i] = p[i * stride];
  else for (int i = 0; i < W; ++i) r[i] = p[(i < n ? i : n - 1) * stride];
  return r;
}

/* Four neighbouring numbers in each lane. */
static inline void K(store_four)(N *p, int64_t stride, T a, T b, T c, T d, int64_t n)
{
#if defined(FOUR) && SIZE == MAIN
  if (n == W) {
    store_four((char *)p, stride * SIZE, (S32)a, (S32)b, (S32)c, (S32)d);
    return;
  }
#endif
  const T v[] = {a, b, c, d};
  for (int i = 0; i < n; ++i) for (int k = 0; k < 4; ++k) p[i * stride + k] = v[k][i];
}

static inline void K(store)(N *p, int64_t stride, T v, int64_t n)
{
  if (n == W) for (int i = 0; i < W; ++i) p[i * stride] = v[i];
  else for (int i = 0; i < n; ++i) p[i * stride] = v[i];
}
