// What one call works on; float32, N simulations first.
struct Arrays {
  const float *qpos, *qvel, *control, *range;
  float *qpos_after, *qvel_after, *sensors;
  long long n;
  int substeps;
};
