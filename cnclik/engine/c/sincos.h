/* sin x and cos x within 2 ulp: x = k pi/2 + r, then two polynomials of r (Cody & Waite 1980). */
static void SINCOS(REAL x, REAL *sine, REAL *cosine)
{
  REAL k, r, s, t, z;
  int32_t quadrant;
  if (!(LIBM(fabs)(x) <= 10000)) {
    *sine = LIBM(sin)(x);
    *cosine = LIBM(cos)(x);
    return;
  }
  k = (x * TURNS + MAGIC) - MAGIC; /* to the nearest whole number */
  REDUCED
  s = r + r * z * s;
  t = (1 - (REAL)0.5 * z) + z * z * t;
  quadrant = (int32_t)k;
  if (quadrant & 1) {
    const REAL swap = s;
    s = t;
    t = swap;
  }
  *sine = (quadrant & 2) ? -s : s;
  *cosine = ((quadrant + 1) & 2) ? -t : t;
}
