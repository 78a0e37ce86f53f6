// The part of the Metal shading language that naga writes, for clang's CUDA. What it computes is not needed, only what it compiles to.

#define INLINE static inline __attribute__((__always_inline__, __device__))
#define ADD inline __attribute__((__always_inline__, __device__)) void add
#define device
#define constant
#define thread
#define threadgroup
typedef unsigned int uint;

namespace metal {
typedef unsigned int uint;
enum mem_flags { mem_threadgroup, mem_device };
INLINE void threadgroup_barrier(int) { asm volatile("bar.sync 0;" ::: "memory"); }

#define VECTORS(T) \
    typedef T T##2 __attribute__((ext_vector_type(2))); \
    typedef T T##3 __attribute__((ext_vector_type(3))); \
    typedef T T##4 __attribute__((ext_vector_type(4))); \
    typedef T packed_##T##3 __attribute__((ext_vector_type(3))); \
    struct T##_list { \
        T all[4]; \
        int count; \
        ADD(T x) { all[count++] = x; } \
        ADD(T##2 v) { add(v.x); add(v.y); } \
        ADD(T##3 v) { add(v.xy); add(v.z); } \
        ADD(T##4 v) { add(v.xyz); add(v.w); } \
    }; \
    template <class... Parts> INLINE T##4 list_##T(Parts... parts) { \
        T##_list list = {{0, 0, 0, 0}, 0}; \
        (list.add(parts), ...); \
        T##4 vector; \
        vector.x = list.all[0]; vector.y = list.all[1]; vector.z = list.all[2]; vector.w = list.all[3]; \
        return vector; \
    } \
    INLINE T##4 list_##T(T x) { return list_##T(x, x, x, x); } \
    template <class... Parts> INLINE T##2 make_##T##2(Parts... parts) { return list_##T(parts...).xy; } \
    template <class... Parts> INLINE T##3 make_##T##3(Parts... parts) { return list_##T(parts...).xyz; } \
    template <class... Parts> INLINE T##4 make_##T##4(Parts... parts) { return list_##T(parts...); } \
    INLINE T select(T a, T b, bool c) { return c ? b : a; } \
    INLINE T##2 select(T##2 a, T##2 b, int2 c) { return make_##T##2(c.x ? b.x : a.x, c.y ? b.y : a.y); } \
    INLINE T##3 select(T##3 a, T##3 b, int3 c) { return make_##T##3(c.x ? b.x : a.x, c.y ? b.y : a.y, c.z ? b.z : a.z); } \
    INLINE T##4 select(T##4 a, T##4 b, int4 c) { return make_##T##4(c.x ? b.x : a.x, c.y ? b.y : a.y, c.z ? b.z : a.z, c.w ? b.w : a.w); }

typedef int int2 __attribute__((ext_vector_type(2)));
typedef int int3 __attribute__((ext_vector_type(3)));
typedef int int4 __attribute__((ext_vector_type(4)));
VECTORS(float)
VECTORS(uint)
VECTORS(int)

#define OF_ONE(NAME, FUNCTION) \
    INLINE float NAME(float x) { return FUNCTION(x); } \
    INLINE float2 NAME(float2 v) { return make_float2(NAME(v.x), NAME(v.y)); } \
    INLINE float3 NAME(float3 v) { return make_float3(NAME(v.x), NAME(v.y), NAME(v.z)); } \
    INLINE float4 NAME(float4 v) { return make_float4(NAME(v.x), NAME(v.y), NAME(v.z), NAME(v.w)); }
#define OF_TWO(NAME, FUNCTION) \
    INLINE float NAME(float x, float y) { return FUNCTION(x, y); } \
    INLINE float2 NAME(float2 v, float2 w) { return make_float2(NAME(v.x, w.x), NAME(v.y, w.y)); } \
    INLINE float3 NAME(float3 v, float3 w) { return make_float3(NAME(v.x, w.x), NAME(v.y, w.y), NAME(v.z, w.z)); } \
    INLINE float4 NAME(float4 v, float4 w) { return make_float4(NAME(v.x, w.x), NAME(v.y, w.y), NAME(v.z, w.z), NAME(v.w, w.w)); }
INLINE float natural_exp(float x) { return __nvvm_ex2_approx_f(1.442695f * x); }
INLINE float natural_log(float x) { return 0.6931472f * __nvvm_lg2_approx_f(x); }
INLINE float power(float x, float y) { return __nvvm_ex2_approx_f(y * __nvvm_lg2_approx_f(x)); }
OF_ONE(sqrt, __nvvm_sqrt_approx_f)
OF_ONE(rsqrt, __nvvm_rsqrt_approx_f)
OF_ONE(cos, __nvvm_cos_approx_f)
OF_ONE(sin, __nvvm_sin_approx_f)
OF_ONE(exp, natural_exp)
OF_ONE(log, natural_log)
OF_ONE(abs, __builtin_fabsf)
OF_ONE(rint, __builtin_rintf)
OF_ONE(floor, __builtin_floorf)
OF_ONE(ceil, __builtin_ceilf)
OF_TWO(max, __builtin_fmaxf)
OF_TWO(min, __builtin_fminf)
OF_TWO(pow, power)

template <class T> INLINE T least(T a, T b) { return a < b ? a : b; }
template <class T> INLINE T largest(T a, T b) { return a < b ? b : a; }
INLINE uint min(uint a, uint b) { return least(a, b); }
INLINE uint max(uint a, uint b) { return largest(a, b); }
INLINE int min(int a, int b) { return least(a, b); }
INLINE int max(int a, int b) { return largest(a, b); }
INLINE uint2 min(uint2 a, uint2 b) { return make_uint2(min(a.x, b.x), min(a.y, b.y)); }
INLINE uint2 max(uint2 a, uint2 b) { return make_uint2(max(a.x, b.x), max(a.y, b.y)); }
INLINE float clamp(float x, float a, float b) { return min(max(x, a), b); }
INLINE float2 clamp(float2 x, float2 a, float2 b) { return min(max(x, a), b); }
INLINE float3 clamp(float3 x, float3 a, float3 b) { return min(max(x, a), b); }
INLINE uint clamp(uint x, uint a, uint b) { return min(max(x, a), b); }
INLINE int clamp(int x, int a, int b) { return min(max(x, a), b); }
INLINE float fma(float a, float b, float c) { return __builtin_fmaf(a, b, c); }
INLINE float2 fma(float2 a, float2 b, float2 c) { return make_float2(fma(a.x, b.x, c.x), fma(a.y, b.y, c.y)); }
INLINE float3 fma(float3 a, float3 b, float3 c) { return make_float3(fma(a.xy, b.xy, c.xy), fma(a.z, b.z, c.z)); }
INLINE float4 fma(float4 a, float4 b, float4 c) { return make_float4(fma(a.xy, b.xy, c.xy), fma(a.zw, b.zw, c.zw)); }
INLINE float dot(float2 a, float2 b) { return a.x * b.x + a.y * b.y; }
INLINE float dot(float3 a, float3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE float dot(float4 a, float4 b) { return a.x * b.x + a.y * b.y + a.z * b.z + a.w * b.w; }
INLINE float3 cross(float3 a, float3 b) { return make_float3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x); }
template <class T> INLINE T normalize(T a) { return a * rsqrt(dot(a, a)); }
template <class T, class S> INLINE T mix(T a, T b, S t) { return a + (b - a) * t; }
template <class T> INLINE float length(T a) { return sqrt(dot(a, a)); }
INLINE bool all(int2 a) { return a.x && a.y; }
INLINE bool all(int3 a) { return all(a.xy) && a.z; }
INLINE bool any(int2 a) { return a.x || a.y; }
INLINE bool any(int3 a) { return any(a.xy) || a.z; }
}

template <class T, class S> INLINE T bits_as(S x) { return __builtin_bit_cast(T, x); }
template <class T, class S> INLINE T converted(S x) { return __builtin_convertvector(x, T); }
