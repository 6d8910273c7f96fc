/* Lanes first … last of `all`, in tiles of W. Lane i of argument a is at in[a] + i · stride[a]; an argument with a
   stride of 0 is shared by all lanes. */
int64_t width(void) { return W; }
int64_t work_bytes(void) { return WORK + 256; }

void run(int64_t first, int64_t last, const void *const *in, const int64_t *stride, void *const *out, void *memory)
{
  char *work = (char *)(((uintptr_t)memory + 255) & ~(uintptr_t)255);
  for (; first < last; first += W) tile(first, last - first < W ? last - first : W, in, stride, out, work);
}
