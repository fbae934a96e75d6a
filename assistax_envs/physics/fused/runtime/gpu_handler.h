// The custom call on NVIDIA GPUs: it puts the kernel on the stream that XLA computes on.
typedef int Launch(void* kernel, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,
                   unsigned shared, void* stream, void** params, void** extra);
static Launch* launch;
static void* kernel;
static int processors;

// The driver's cuLaunchKernel, the kernel of the cubin, and how many processors the GPU has: Python
// has found all of them.
extern "C" void fused_bind(Launch* driver_launch, void* loaded, int found) {
  launch = driver_launch;
  kernel = loaded;
  processors = found;
}

extern "C" XLA_FFI_Error* fused_step(XLA_FFI_CallFrame* frame) {
  if (answered(frame, 0)) return nullptr;
  XLA_FFI_Stream_Get_Args stream = {sizeof stream, nullptr, frame->ctx, nullptr};
  if (XLA_FFI_Error* error = frame->api->XLA_FFI_Stream_Get(&stream)) return error;
  Arrays a = arrays(frame);
  void* params[] = {&a, &processors};
  Grid grid = grid_of(a.n, processors);
  int status = launch(kernel, grid.blocks, 1, 1, grid.threads, 1, 1, 0, stream.stream, params, nullptr);
  return status == 0 ? nullptr : failure(frame, "fused physics: the CUDA driver refused a launch");
}
