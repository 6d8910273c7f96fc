/* Sine and cosine within 2 ulp: |x| = k pi/2 + r, then two polynomials of r (Cody & Waite 1980). */
static void SINCOS(REAL angle, REAL *sine, REAL *cosine)
{
  REAL x = LIBM(fabs)(angle), k, r, s, t, z;
  int32_t quadrant;
  if (!(x <= 10000)) {
    *sine = LIBM(sin)(angle);
    *cosine = LIBM(cos)(angle);
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
  *sine = !(quadrant & 2) == !signbit(angle) ? s : -s;
  *cosine = ((quadrant + 1) & 2) ? -t : t;
}
