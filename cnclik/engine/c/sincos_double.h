/* sin x and cos x within 2 ulp: x = k pi/2 + r, then two polynomials of r (Cody & Waite 1980). */
static void sincos(double x, double *sine, double *cosine)
{
  double k, r, s, t, z;
  int32_t quadrant;
  if (!(fabs(x) <= 10000.0)) {
    *sine = sin(x);
    *cosine = cos(x);
    return;
  }
  k = (x * 0.6366197723675814 + 6755399441055744.0) - 6755399441055744.0; /* to the nearest whole number */
  x = x - k * 1.5707963267941523;
  r = x - k * 7.443547480480255e-13;
  r = r + (((x - r) - k * 7.443547480480255e-13) - k * 6.36831716351095e-25);
  z = r * r;
  s = r + r * z * (((((1.58967795431892491e-10 * z - 2.50507578467316194e-8) * z + 2.75573136902666746e-6) * z
    - 0.000198412698298032444) * z + 0.0083333333333224082) * z - 0.16666666666666632);
  t = (1.0 - 0.5 * z) + z * z * (((((-1.13596367512304589e-11 * z + 2.08757230672177435e-9) * z - 2.75573143508751314e-7) * z
    + 0.000024801587289477352) * z - 0.00138888888888741166) * z + 0.0416666666666665994);
  quadrant = (int32_t)k;
  if (quadrant & 1) {
    const double swap = s;
    s = t;
    t = swap;
  }
  *sine = (quadrant & 2) ? -s : s;
  *cosine = ((quadrant + 1) & 2) ? -t : t;
}
