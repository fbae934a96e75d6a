// The custom call on CPUs: the threads of XLA's own pool share out the vectors of a batch.

// Rounding to nearest, and numbers below 1e-38 kept as on a GPU: XLA's threads flush them to zero.
struct FloatMode {
#ifdef __x86_64__
  unsigned before = __builtin_ia32_stmxcsr();
  FloatMode() { __builtin_ia32_ldmxcsr(0x1f80); }
  ~FloatMode() { __builtin_ia32_ldmxcsr(before); }
#else  // ARM; no `asm`, which Warp's clang has no parser for there
  unsigned long before = __builtin_arm_rsr64("fpcr");
  FloatMode() { __builtin_arm_wsr64("fpcr", 0); }
  ~FloatMode() { __builtin_arm_wsr64("fpcr", before); }
#endif
};

#define MOST_EFFORT 1023

static int effort_of(const Arrays& a, long long i) {
  float effort = a.warmstart[i * NV];  // whatever the caller gave, not-a-number too
  return effort > 0.0f ? (effort < MOST_EFFORT ? (int)effort : MOST_EFFORT) : 0;
}

// Lanes iterate together, so that a vector takes as long as its slowest simulation: those that had
// as much to do as one another stand side by side, the hardest first (a counting sort).
static void put_in_order(const Arrays& a, int* order) {
  long long starts[MOST_EFFORT + 2] = {0};
  for (long long i = 0; i < a.n; ++i) ++starts[MOST_EFFORT - effort_of(a, i) + 1];
  for (int k = 0; k < MOST_EFFORT; ++k) starts[k + 1] += starts[k];
  for (long long i = 0; i < a.n; ++i) order[starts[MOST_EFFORT - effort_of(a, i)]++] = (int)i;
}

struct Job {
  Arrays arrays;
  long long vectors, taken, done;
  int holders;  // the caller and the tasks in XLA's queue; the last one frees the job
};

static void release(Job* job) {
  if (__atomic_sub_fetch(&job->holders, 1, __ATOMIC_ACQ_REL) == 0) free(job);
}

static void work(Job* job) {
  FloatMode mode;
  for (;;) {
    long long vector = __atomic_fetch_add(&job->taken, 1, __ATOMIC_RELAXED);
    if (vector >= job->vectors) return;
    simulate(job->arrays, vector * W);
    __atomic_fetch_add(&job->done, 1, __ATOMIC_RELEASE);
  }
}

static void help(void* job) {
  work((Job*)job);
  release((Job*)job);
}

static int64_t pool_size(XLA_FFI_CallFrame* frame) {
  int64_t threads = 1;
  XLA_FFI_ThreadPool_NumThreads_Args args = {sizeof args, nullptr, frame->ctx, &threads};
  if (XLA_FFI_Error* error = frame->api->XLA_FFI_ThreadPool_NumThreads(&args)) {
    forget(frame, error);
    return 1;
  }
  return threads;
}

static void ask_for_help(XLA_FFI_CallFrame* frame, Job* job) {
  __atomic_add_fetch(&job->holders, 1, __ATOMIC_RELAXED);
  XLA_FFI_ThreadPool_Schedule_Args args = {sizeof args, nullptr, frame->ctx, help, job};
  if (XLA_FFI_Error* error = frame->api->XLA_FFI_ThreadPool_Schedule(&args)) {
    forget(frame, error);
    release(job);
  }
}

static inline void pause() {
#ifdef __x86_64__
  __builtin_ia32_pause();
#else
  __builtin_arm_yield();
#endif
}

extern "C" XLA_FFI_Error* fused_step(XLA_FFI_CallFrame* frame) {
  if (answered(frame, 0)) return nullptr;
  Arrays a = arrays(frame);
  Job* job = (Job*)malloc(sizeof(Job) + a.n * sizeof(int));
  if (job == nullptr) return failure(frame, "fused physics: out of memory");
  int* order = (int*)(job + 1);
  put_in_order(a, order);
  a.order = order;
  *job = {a, (a.n + W - 1) / W, 0, 0, 1};
  int64_t threads = pool_size(frame);
  for (int64_t k = 1; k < threads && k < job->vectors; ++k) ask_for_help(frame, job);
  work(job);
  // Only vectors that a thread is at are waited for. Waiting for tasks to begin could be for ever:
  // all threads of the pool may stand here, each in a call of its own.
  while (__atomic_load_n(&job->done, __ATOMIC_ACQUIRE) < job->vectors) pause();
  release(job);
  return nullptr;
}
