// The arithmetic of the engine's text: a `real` is one number of each of W simulations.
//
// W is 1 on a GPU, where each thread has a simulation; on a CPU `real` is a vector of W floats.
// Only operations that IEEE 754 rounds correctly are used (+ - * / sqrt), never contracted into
// fused multiply-adds: the same numbers come out on every processor and for every W. Compile with
// -ffp-contract=off (g++, clang) or --fmad=false (NVRTC), and never with fast math.
#ifndef W
#define W 1
#endif

#if defined(__CUDACC__)
#define FN static __device__ __forceinline__
#define FN_CALLED FN  // a call costs a thread its registers: inlined, it is a tenth faster
#define TABLE static __device__ const
#define UNROLL _Pragma("unroll")
#define KEEP_LOOP _Pragma("unroll 1")
#define READ_AHEAD _Pragma("unroll 4")  // of a sum that waits for each term to be read
#define ALIGNED
// Warps that drift apart each fetch the straight-line part for themselves, from far: it is more code
// than a processor keeps. So a block goes through it together, and fetches it once.
#define TOGETHER __syncthreads();
#else
#define FN static inline __attribute__((always_inline))
#define FN_CALLED static __attribute__((noinline))
#define TABLE static const
#define KEEP_LOOP
#define READ_AHEAD
#define TOGETHER
#define ALIGNED alignas(64)
#if defined(__clang__)
#pragma clang fp contract(off)
#define UNROLL _Pragma("clang loop unroll(full)")
#else
#define UNROLL _Pragma("GCC unroll 64")
#endif
#endif

#if W == 1
typedef float real;
typedef int integer;
typedef bool mask;
FN real splat(float x) { return x; }
FN int splat(int x) { return x; }
FN bool any(mask m) { return m; }
FN mask both(mask a, mask b) { return a && b; }
FN mask invert(mask a) { return !a; }
FN mask either(mask a, mask b) { return a || b; }
FN mask differ(mask a, mask b) { return a != b; }
FN bool lane_is_set(mask m, int) { return m; }
#else
typedef float real __attribute__((vector_size(4 * W)));
typedef int integer __attribute__((vector_size(4 * W)));
typedef integer mask;  // all bits of a lane, or none
FN real splat(float x) { return x + real{}; }
FN integer splat(int x) { return x + integer{}; }
FN bool any(mask m) {
  long long words[W / 2], found = 0;
  __builtin_memcpy(words, &m, sizeof m);
  for (int i = 0; i < W / 2; ++i) found |= words[i];
  return found != 0;
}
FN mask both(mask a, mask b) { return a & b; }
FN mask invert(mask a) { return ~a; }
FN mask either(mask a, mask b) { return a | b; }
FN mask differ(mask a, mask b) { return a ^ b; }
FN bool lane_is_set(mask m, int l) { return m[l] != 0; }
#endif

#define LANES(l) for (int l = 0; l < W; ++l)
FN float& lane(real& x, int l) { return ((float*)&x)[l]; }
FN float lane(const real& x, int l) { return ((const float*)&x)[l]; }
FN int lane(const integer& x, int l) { return ((const int*)&x)[l]; }

// Numbers that are filled in lane by lane and then used together.
struct Gathered {
  ALIGNED float at[W];
};
struct GatheredBits {
  ALIGNED int at[W];
};

#if W == 1
FN real all(const Gathered& g) { return g.at[0]; }
FN integer all(const GatheredBits& g) { return g.at[0]; }
FN real to_real(integer x) { return (float)x; }
FN integer where(mask m, int bits) { return m ? bits : 0; }
#if defined(__CUDACC__)
FN integer bits_of(real x) { return __float_as_int(x); }
#else
FN integer bits_of(real x) {
  integer bits;
  __builtin_memcpy(&bits, &x, sizeof bits);
  return bits;
}
#endif
#else
FN real all(const Gathered& g) {
  real x;
  __builtin_memcpy(&x, g.at, sizeof x);
  return x;
}
FN integer all(const GatheredBits& g) {
  integer x;
  __builtin_memcpy(&x, g.at, sizeof x);
  return x;
}
FN real to_real(integer x) { return __builtin_convertvector(x, real); }
FN integer where(mask m, int bits) { return m & bits; }
FN integer bits_of(real x) { return (integer)x; }
#endif

FN real select(mask m, real a, real b) { return m ? a : b; }
FN real minimum(real a, real b) { return a < b ? a : b; }
FN real maximum(real a, real b) { return a > b ? a : b; }
#if W > 1
FN real minimum(real a, float b) { return minimum(a, splat(b)); }
FN real maximum(real a, float b) { return maximum(a, splat(b)); }
#endif
FN real absolute(real x) { return maximum(x, -x); }
FN real clip(real x) { return maximum(minimum(x, 1.0f), -1.0f); }

FN real square_root(real x) {
#if defined(__CUDACC__)
  return __fsqrt_rn(x);
#elif W == 1
  return __builtin_sqrtf(x);
#elif defined(__has_builtin) && __has_builtin(__builtin_elementwise_sqrt)
  return __builtin_elementwise_sqrt(x);
#else
  LANES(l) lane(x, l) = __builtin_sqrtf(lane(x, l));
  return x;
#endif
}

FN int first_bit(unsigned x) {
#if defined(__CUDACC__)
  return __ffs(x) - 1;
#else
  return __builtin_ctz(x);
#endif
}

struct SinCos {
  real sine, cosine;
};

// Sine and cosine of x / 2, by polynomials on [-pi/4, pi/4] after Cephes' sinf and cosf.
FN SinCos half_sincos(real x) {
  const float shift = 12582912.0f;  // 1.5 * 2^23: adding it leaves an integer in the lowest bits
  real shifted = x * 0.3183098861837907f + shift;  // x / 2 in units of pi / 2
  integer quadrant = bits_of(shifted);
  real k = shifted - shift;
  // pi / 2 in three parts, of which k times the first two is exact
  real r = x * 0.5f - k * 1.5703125f;
  r = r - k * 4.837512969970703125e-4f;
  r = r - k * 7.54978995489188e-8f;
  real z = r * r;
  real sine = -1.9515295891e-4f * z + 8.3321608736e-3f;
  sine = (sine * z - 1.6666654611e-1f) * z * r + r;
  real cosine = 2.443315711809948e-5f * z - 1.388731625493765e-3f;
  cosine = (cosine * z + 4.166664568298827e-2f) * z * z - 0.5f * z + 1.0f;
  mask odd = (quadrant & 1) != 0;
  real a = select(odd, cosine, sine), b = select(odd, sine, cosine);
  return {select((quadrant & 2) != 0, -a, a), select(((quadrant + 1) & 2) != 0, -b, b)};
}
