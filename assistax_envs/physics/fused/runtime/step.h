// One control step of W simulations, from arrays [N, field] to arrays [N, field], on a CPU or a GPU.

// The last vector of an odd batch repeats the last simulation, and stores it once.
FN void load(real* to, const float* from, long long row, long long n, int width) {
  for (int k = 0; k < width; ++k) LANES(l) {
    long long i = row + l < n ? row + l : n - 1;
    lane(to[k], l) = from[i * width + k];
  }
}

FN void store(float* to, const real* from, long long row, long long n, int width) {
  for (int k = 0; k < width; ++k)
    LANES(l) if (row + l < n) to[(row + l) * width + k] = lane(from[k], l);
}

// A simulation that the solver could not solve must never pass for one that it could: it becomes
// not-a-number, which the environment counts and freezes like any other divergence.
FN void spoil(real* values, const int* flags, int width) {
  for (int k = 0; k < width; ++k)
    LANES(l) if (flags[l]) lane(values[k], l) = 0.0f / 0.0f;
}

FN void simulate(const Arrays& a, long long row) {
  real q[NV], qd[NV], u[NU], range[2 * NV], lo[NV], hi[NV], sensors[NSENS];
  load(q, a.qpos, row, a.n, NV);
  load(qd, a.qvel, row, a.n, NV);
  load(u, a.control, row, a.n, NU);
  load(range, a.range, row, a.n, 2 * NV);
  for (int k = 0; k < NV; ++k) lo[k] = range[2 * k], hi[k] = range[2 * k + 1];
  unsigned warm[NWARM * W] = {0};
  int flags[W] = {0};
  for (int s = 0; s < a.substeps; ++s)
    substep(q, qd, u, lo, hi, sensors, s == a.substeps - 1, warm, flags);
  spoil(qd, flags, NV);
  store(a.qpos_after, q, row, a.n, NV);
  store(a.qvel_after, qd, row, a.n, NV);
  store(a.sensors, sensors, row, a.n, NSENS);
}
