/* The entry for XLA: a handler of its foreign function interface. An argument with one axis more than a lane's is a
   batch; one with as many axes is shared by all lanes. XLA's threads help the calling one with parts of a large batch. */
#ifdef XLA_HANDLER
#include <pthread.h>
#include "xla/ffi/api/c_api.h"

typedef struct {
  int64_t all, step, begun, ended, holders; /* numbers of lanes; holders: threads that use this */
  const void *const *in;
  const int64_t *stride;
  void *const *out;
  pthread_mutex_t lock; /* guards the fields that change */
  pthread_cond_t done;
} Batch;

static void leave(Batch *batch) /* called with the lock, and releases it */
{
  const int last = --batch->holders == 0;
  pthread_mutex_unlock(&batch->lock);
  if (last) free(batch);
}

static void run_parts(Batch *batch, void *memory) /* called and left with the lock */
{
  while (batch->begun < batch->all) {
    const int64_t first = batch->begun, last = first + batch->step < batch->all ? first + batch->step : batch->all;
    batch->begun = last;
    pthread_mutex_unlock(&batch->lock);
    run(first, last, batch->in, batch->stride, batch->out, memory);
    pthread_mutex_lock(&batch->lock);
    batch->ended += last - first;
  }
  if (batch->ended == batch->all) pthread_cond_signal(&batch->done);
}

/* A thread that starts when all lanes are begun returns without reading the caller's memory. */
static void help(void *data)
{
  Batch *batch = data;
  void *memory = malloc(work_bytes());
  pthread_mutex_lock(&batch->lock);
  if (memory) run_parts(batch, memory);
  leave(batch);
  free(memory);
}

static int is_done(const XLA_FFI_Api *api, XLA_FFI_Error *error)
{
  XLA_FFI_Error_Destroy_Args args = {XLA_FFI_Error_Destroy_Args_STRUCT_SIZE, NULL, error};
  if (error) api->XLA_FFI_Error_Destroy(&args);
  return !error;
}

/* All lanes, in parallel if there are threads. */
static void run_all(XLA_FFI_CallFrame *frame, Batch now, void *memory)
{
  int64_t threads = 1;
  XLA_FFI_ThreadPool_NumThreads_Args asked = {XLA_FFI_ThreadPool_NumThreads_Args_STRUCT_SIZE, NULL, frame->ctx, &threads};
  Batch *batch = now.all > FEW_TILES * W ? malloc(sizeof(Batch)) : NULL;
  if (!batch || !is_done(frame->api, frame->api->XLA_FFI_ThreadPool_NumThreads(&asked)) || threads < 2) {
    free(batch);
    run(0, now.all, now.in, now.stride, now.out, memory);
    return;
  }
  now.step = (now.all + CALLS * threads * W - 1) / (CALLS * threads * W) * W;
  now.holders = threads;
  *batch = now;
  pthread_mutex_init(&batch->lock, NULL);
  pthread_cond_init(&batch->done, NULL);
  for (int64_t i = 1; i < threads; ++i) {
    XLA_FFI_ThreadPool_Schedule_Args args = {XLA_FFI_ThreadPool_Schedule_Args_STRUCT_SIZE, NULL, frame->ctx, help, batch};
    if (is_done(frame->api, frame->api->XLA_FFI_ThreadPool_Schedule(&args))) continue;
    pthread_mutex_lock(&batch->lock);
    leave(batch);
  }
  pthread_mutex_lock(&batch->lock);
  run_parts(batch, memory);
  while (batch->ended < batch->all) pthread_cond_wait(&batch->done, &batch->lock);
  leave(batch);
}

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
  run_all(frame, (Batch){.all = all, .in = in, .stride = stride, .out = out}, memory);
  free(memory);
  return NULL;
}
#endif
