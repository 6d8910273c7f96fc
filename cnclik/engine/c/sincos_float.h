/* sin x and cos x within 2 ulp: x = k pi/2 + r, then two polynomials of r (Cody & Waite 1980). */
static void sincos(float x, float *sine, float *cosine)
{
  float k, r, s, t, z;
  int32_t quadrant;
  if (!(fabsf(x) <= 10000.0f)) {
    *sine = sinf(x);
    *cosine = cosf(x);
    return;
  }
  k = (x * 0.636619772f + 12582912.0f) - 12582912.0f; /* to the nearest whole number */
  x = x - k * 1.5703125f;
  x = x - k * 0.0004837512969970703f;
  r = x - k * 7.549533620476723e-08f;
  r = r + (((x - r) - k * 7.549533620476723e-08f) - k * 2.5633441e-12f);
  z = r * r;
  s = r + r * z * ((-0.000195172025549268638f * z + 0.00833217745665272256f) * z - 0.166666549331917384f);
  t = (1.0f - 0.5f * z) + z * z * ((0.0000244383434232972141f * z - 0.00138873666071656574f) * z + 0.0416666468486836209f);
  quadrant = (int32_t)k;
  if (quadrant & 1) {
    const float swap = s;
    s = t;
    t = swap;
  }
  *sine = (quadrant & 2) ? -s : s;
  *cosine = ((quadrant + 1) & 2) ? -t : t;
}
