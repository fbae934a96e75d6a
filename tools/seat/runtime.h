// What the traced functions call: elementary functions, products, and the fused engine.

union Word {
  float f;
  int i;
  unsigned u;
};
static Word M[WORDS];
extern "C" __attribute__((export_name("memory_at"))) Word* memory_at() { return M; }
extern "C" __attribute__((visibility("hidden"))) void* memset(void* to, int value, size_t n) {
  for (size_t k = 0; k < n; ++k) ((volatile char*)to)[k] = (char)value;
  return to;
}
extern "C" __attribute__((visibility("hidden"))) void* memcpy(void* to, const void* from, size_t n) {
  for (size_t k = 0; k < n; ++k) ((volatile char*)to)[k] = ((const char*)from)[k];
  return to;
}

#define CALLED static __attribute__((noinline))

static int within(int x, int most) { return x < 0 ? 0 : x > most ? most : x; }
static float sign_of(float x) { return x > 0.0f ? 1.0f : x < 0.0f ? -1.0f : x; }
static float rem_of(float x, float y) { return x - y * __builtin_truncf(x / y); }

// 2^k as a double, for whole k between -1022 and 1023.
static double power_of_two(int k) {
  long long bits = (long long)(k + 1023) << 52;
  double x;
  __builtin_memcpy(&x, &bits, sizeof x);
  return x;
}

// In doubles, so that the nearest float comes out but in rare ties.
CALLED double exp_double(double x) {
  if (!(x == x)) return x;
  if (x > 700.0) return __builtin_inf();
  if (x < -700.0) return 0.0;
  double k = __builtin_floor(x * 1.4426950408889634 + 0.5);
  double r = (x - k * 0.693147180369123816490) - k * 1.90821492927058770002e-10;
  double sum = 1.0, term = 1.0;
  for (int n = 1; n < 14; ++n) sum += term *= r / n;
  return sum * power_of_two((int)k);
}
CALLED double log_double(double x) {
  if (!(x > 0.0)) return x == 0.0 ? -__builtin_inf() : __builtin_nan("");
  if (x == __builtin_inf()) return x;
  long long bits;
  __builtin_memcpy(&bits, &x, sizeof bits);
  int k = (int)(bits >> 52) - 1023;
  bits = (bits & 0xfffffffffffffLL) | 0x3ff0000000000000LL;
  double m;
  __builtin_memcpy(&m, &bits, sizeof m);
  if (m > 1.4142135623730951) m *= 0.5, ++k;
  double s = (m - 1.0) / (m + 1.0), z = s * s, sum = 0.0;
  for (int n = 21; n > 0; n -= 2) sum = sum * z + 1.0 / n;
  return 2.0 * s * sum + k * 0.6931471805599453;
}
CALLED float exp_of(float x) { return (float)exp_double(x); }
CALLED float log_of(float x) { return (float)log_double(x); }
CALLED float log1p_of(float x) {
  double u = 1.0 + (double)x;
  return (float)(u == 1.0 ? x : log_double(u));
}
CALLED float tanh_of(float x) {
  if (__builtin_fabsf(x) < 1e-3f) return (float)((double)x - (double)x * x * x / 3.0);
  double e = exp_double(2.0 * x);
  return e == __builtin_inf() ? 1.0f : (float)((e - 1.0) / (e + 1.0));
}
CALLED float logistic_of(float x) { return (float)(1.0 / (1.0 + exp_double(-(double)x))); }
CALLED float pow_of(float x, float y) { return (float)exp_double(y * log_double(x)); }

// Sine of x + quarter * pi / 2, by its series about the nearest multiple of pi / 2.
CALLED float sine(double x, int quarter) {
  double k = __builtin_floor(x * 0.6366197723675814 + 0.5);
  double r = (x - k * 1.57079632673412561417) - k * 6.07710050650619224932e-11, z = r * r;
  int turn = ((int)k + quarter) & 3;
  double term = turn & 1 ? 1.0 : r, sum = term;
  for (int n = turn & 1 ? 1 : 2; n < 18; n += 2) sum += term *= -z / (n * (n + 1));
  return (float)(turn & 2 ? -sum : sum);
}
static float sin_of(float x) { return sine(x, 0); }
static float cos_of(float x) { return sine(x, 1); }

// to [outer] = x [inner] times m [inner, outer].
CALLED void product(float* to, const float* x, const float* m, int inner, int outer) {
  for (int j = 0; j < outer; ++j) to[j] = 0.0f;
  for (int i = 0; i < inner; ++i)
    for (int j = 0; j < outer; ++j) to[j] += x[i] * m[i * outer + j];
}

// Gauss' elimination with the largest pivot of each column.
template <int N>
CALLED void factorise(float* a, int* pivots, int* order, const float* from) {
  for (int k = 0; k < N * N; ++k) a[k] = from[k];
  for (int k = 0; k < N; ++k) order[k] = k;
  for (int k = 0; k < N; ++k) {
    int p = k;
    for (int i = k + 1; i < N; ++i)
      if (__builtin_fabsf(a[i * N + k]) > __builtin_fabsf(a[p * N + k])) p = i;
    pivots[k] = p;
    if (p != k) {
      for (int j = 0; j < N; ++j) {
        float x = a[k * N + j];
        a[k * N + j] = a[p * N + j], a[p * N + j] = x;
      }
      int x = order[k];
      order[k] = order[p], order[p] = x;
    }
    for (int i = k + 1; i < N; ++i) {
      float share = a[i * N + k] /= a[k * N + k];
      for (int j = k + 1; j < N; ++j) a[i * N + j] -= share * a[k * N + j];
    }
  }
}

static int only[1];  // the order of one simulation
extern "C" void advance(
    const float* q, const float* v, const float* w, const float* u, const float* range,
    float* q_after, float* v_after, float* w_after, float* sensors, int substeps);
