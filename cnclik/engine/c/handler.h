/* The entry for XLA: a handler of its foreign function interface. An argument of one axis more than a lane's is a batch,
   one of as many is what all lanes share. */
#ifdef XLA_HANDLER
#include "xla/ffi/api/c_api.h"

XLA_FFI_Error *call(XLA_FFI_CallFrame *frame)
{
  const void *in[ARGUMENTS + 1];
  void *out[RESULTS + 1], *memory;
  int64_t stride[ARGUMENTS + 1], all = 1;
  if (frame->extension_start && frame->extension_start->type == XLA_FFI_Extension_Metadata) {
    XLA_FFI_Metadata *about = ((XLA_FFI_Metadata_Extension *)frame->extension_start)->metadata;
    about->api_version.struct_size = XLA_FFI_Api_Version_STRUCT_SIZE;
    about->api_version.extension_start = NULL;
    about->api_version.major_version = XLA_FFI_API_MAJOR;
    about->api_version.minor_version = XLA_FFI_API_MINOR;
    about->traits = 0;
    return NULL;
  }
  for (int i = 0; i < ARGUMENTS; ++i) {
    const XLA_FFI_Buffer *one = frame->args.args[i];
    in[i] = one->data;
    stride[i] = one->rank > argument_rank[i] ? argument_size[i] : 0;
  }
  for (int i = 0; i < RESULTS; ++i) {
    const XLA_FFI_Buffer *one = frame->rets.rets[i];
    out[i] = one->data;
    if (one->rank > result_rank[i]) all = one->dims[0];
  }
  memory = malloc(work_bytes());
  if (!memory) {
    XLA_FFI_Error_Create_Args failed = {XLA_FFI_Error_Create_Args_STRUCT_SIZE, NULL, "no memory for a tile",
                                        XLA_FFI_Error_Code_RESOURCE_EXHAUSTED};
    return frame->api->XLA_FFI_Error_Create(&failed);
  }
  run(0, all, in, stride, out, memory);
  free(memory);
  return NULL;
}
#endif
