// What XLA's C interface takes from the C library's headers, which Warp's bundled clang comes without.
typedef __SIZE_TYPE__ size_t;
typedef __INT64_TYPE__ int64_t;
typedef __INT32_TYPE__ int32_t;
typedef __UINT32_TYPE__ uint32_t;
#define offsetof __builtin_offsetof
extern "C" void* malloc(size_t);
extern "C" void free(void*);
