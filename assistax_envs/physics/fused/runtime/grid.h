// How the simulations of a call are shared out to a GPU's threads.
//
// A processor of the GPU has room for eight warps of 32 threads, each with the 255 registers that
// the kernel takes. They are one block, so that they can wait for one another (see `TOGETHER`), and
// a wave is a block for each processor. Few simulations make small blocks, on all processors.
#define WARP 32
#define MOST_THREADS 256

struct Grid {
  unsigned blocks, threads;
};

static Grid grid_of(long long n, int processors) {
  long long wave = (long long)processors * MOST_THREADS, waves = (n + wave - 1) / wave;
  long long warp_of_each = processors * waves * WARP;
  unsigned threads = (unsigned)((n + warp_of_each - 1) / warp_of_each) * WARP;
  return {(unsigned)((n + threads - 1) / threads), threads};
}
