// One control step of W simulations, from arrays [N, field] to arrays [N, field], on a CPU or a GPU.

// The simulations of a vector; the last one of an odd batch repeats the last simulation.
struct Places {
  long long of[W];
  int count;
};

FN Places places(const Arrays& a, long long first) {
  Places at;
  at.count = a.n - first < W ? (int)(a.n - first) : W;
  LANES(l) at.of[l] = a.order[first + (l < at.count ? l : at.count - 1)];
  return at;
}

FN void load(real* to, const float* from, const Places& at, int width) {
  for (int k = 0; k < width; ++k) LANES(l) lane(to[k], l) = from[at.of[l] * width + k];
}

FN void store(float* to, const real* from, const Places& at, int width) {
  for (int k = 0; k < width; ++k)
    LANES(l) if (l < at.count) to[at.of[l] * width + k] = lane(from[k], l);
}

// A simulation that the solver could not solve must never pass for one that it could: it becomes
// not-a-number, which the environment counts and freezes like any other divergence.
FN void spoil(real* values, const int* flags, int width) {
  for (int k = 0; k < width; ++k)
    LANES(l) if (flags[l]) lane(values[k], l) = 0.0f / 0.0f;
}

// How hard the control step was is all that the next one may know of it: it decides which
// simulations share a vector, and no number depends on that.
FN void store_effort(float* to, const Report& report, const Places& at) {
  LANES(l) if (l < at.count) for (int k = 0; k < NV; ++k)
    to[at.of[l] * NV + k] = k == 0 ? (float)report.effort[l] : 0.0f;
}

FN void simulate(const Arrays& a, long long first) {
  Places at = places(a, first);
  real q[NV], qd[NV], u[NU], range[2 * NV], lo[NV], hi[NV], sensors[NSENS + NPEAK];
  load(q, a.qpos, at, NV);
  load(qd, a.qvel, at, NV);
  load(u, a.control, at, NU);
  load(range, a.range, at, 2 * NV);
  for (int k = 0; k < NV; ++k) lo[k] = range[2 * k], hi[k] = range[2 * k + 1];
  unsigned warm[NWARM * W] = {0};
  Report report;
  for (int k = 0; k < NPEAK; ++k) LANES(l) lane(sensors[NSENS + k], l) = 0.0f;
  for (int s = 0; s < a.substeps; ++s)
    substep(q, qd, u, lo, hi, sensors, sensors + NSENS, s == a.substeps - 1, warm, report);
  spoil(qd, report.flags, NV);
  store(a.qpos_after, q, at, NV);
  store(a.qvel_after, qd, at, NV);
  store(a.sensors, sensors, at, NSENS + NPEAK);
  store_effort(a.warmstart_after, report, at);
}
