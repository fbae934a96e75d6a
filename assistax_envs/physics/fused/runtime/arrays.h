// What one call works on; float32, N simulations first.
struct Arrays {
  const float *qpos, *qvel, *warmstart, *control, *range;
  float *qpos_after, *qvel_after, *warmstart_after, *sensors;
  const int* order;  // in which simulations are put into vectors: hard ones first, see `effort`
  long long n;
  int substeps;
};
