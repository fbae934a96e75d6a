// The hardest simulations are first in `order`. A warp takes its neighbours there; a wave deals its
// warps to its blocks in turn, so that none has all the hard ones, and later waves are easier.
FN long long place_of(unsigned block, unsigned thread, Grid grid, int processors) {
  unsigned first = block / processors * processors, left = grid.blocks - first;
  unsigned blocks = left < (unsigned)processors ? left : processors;
  unsigned warp = thread / WARP * blocks + (block - first);
  return (long long)first * grid.threads + warp * WARP + thread % WARP;
}

// The kernel on NVIDIA GPUs: a thread for each simulation. Nothing is shared, so nothing is ordered
// by chance, and results are the same in every run. Threads beyond the last simulation repeat it:
// all of a block go through `TOGETHER`.
extern "C" __global__ void __launch_bounds__(MOST_THREADS)
    fused_kernel(Arrays arrays, int processors) {
  Grid grid = {gridDim.x, blockDim.x};
  long long place = place_of(blockIdx.x, threadIdx.x, grid, processors);
  simulate(arrays, place < arrays.n ? place : arrays.n - 1);
}
