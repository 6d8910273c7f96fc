/* The entry for one lane. The first `count` arguments are in `known`, one after the other; the others are in `block`,
   and the results follow them. Each begins at a multiple of 8 bytes. Returns 0, or 1 if there is no memory. */
int of_numbers(int64_t count, const char *known, char *block)
{
  const void *in[ARGUMENTS + 1];
  void *out[RESULTS + 1], *memory = malloc(work_bytes());
  const int64_t stride[ARGUMENTS + 1] = {0};
  if (!memory) return 1;
  for (int64_t i = 0; i < ARGUMENTS; ++i) {
    const char **from = i < count ? &known : (const char **)&block;
    in[i] = *from;
    *from += (argument_bytes[i] + 7) / 8 * 8;
  }
  for (int64_t i = 0; i < RESULTS; ++i) {
    out[i] = block;
    block += (result_bytes[i] + 7) / 8 * 8;
  }
  run(0, 1, in, stride, out, memory);
  free(memory);
  return 0;
}
