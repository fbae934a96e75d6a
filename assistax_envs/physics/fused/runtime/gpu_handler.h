// The custom call on NVIDIA GPUs: it puts the kernel on the stream that XLA computes on.
typedef int Launch(void* kernel, unsigned, unsigned, unsigned, unsigned, unsigned, unsigned,
                   unsigned shared, void* stream, void** params, void** extra);
typedef int ErrorName(int status, const char** name);
static Launch* launch;
static ErrorName* error_name;
static void* kernel;
static int processors;

// The driver's cuLaunchKernel and cuGetErrorName, the kernel of the cubin, and how many processors
// the GPU has: Python has found all of them.
extern "C" void fused_bind(Launch* driver_launch, ErrorName* driver_error_name, void* loaded, int found) {
  launch = driver_launch;
  error_name = driver_error_name;
  kernel = loaded;
  processors = found;
}

static char* append(char* end, const char* text) {
  while (*text) *end++ = *text++;
  *end = 0;
  return end;
}

// Writes why a launch was refused into `text`, which has room for 512 letters.
extern "C" void fused_refusal(int status, char* text) {
  const char* name = nullptr;
  if (error_name(status, &name) != 0 || name == nullptr) name = "an unknown error";
  char digits[12] = {0};
  int place = 11;
  for (int rest = status; rest > 0 && place > 0; rest /= 10) digits[--place] = (char)('0' + rest % 10);
  char* end = append(text, "fused physics: the CUDA driver refused a launch: ");
  end = append(append(append(append(end, name), " ("), digits + place), ")");
  if (status != 2 && status != 701) return;  // out of memory, out of resources
  append(end, "; each launch needs memory beside what JAX has taken. Give fewer members or simulations, run fewer "
              "processes on this GPU, or set a smaller XLA_PYTHON_CLIENT_MEM_FRACTION: with two processes "
              "0.30 works where 0.44 fails");
}

extern "C" XLA_FFI_Error* fused_step(XLA_FFI_CallFrame* frame) {
  if (answered(frame, 0)) return nullptr;
  XLA_FFI_Stream_Get_Args stream = {sizeof stream, nullptr, frame->ctx, nullptr};
  if (XLA_FFI_Error* error = frame->api->XLA_FFI_Stream_Get(&stream)) return error;
  Arrays a = arrays(frame);
  void* params[] = {&a, &processors};
  Grid grid = grid_of(a.n, processors);
  int status = launch(kernel, grid.blocks, 1, 1, grid.threads, 1, 1, 0, stream.stream, params, nullptr);
  if (status == 0) return nullptr;
  char text[512];
  fused_refusal(status, text);
  return failure(frame, text);
}
