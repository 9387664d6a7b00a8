// SPDX-License-Identifier: Apache-2.0
// The GLSL functions of the strict profile: own approximations from + - * / sqrt and bit casts, so that every device
// computes the same up to what it does to those. The printer marks every result `precise`.
//
// What they hold to: no fused operation is assumed and none hurts; NaN and Inf are told apart by comparisons that are
// false for NaN, or by bits, never by isnan or isinf; a device may flush subnormal numbers to zero, coming in or going
// out. The coefficients are minimax fits made for these intervals, rounded to float32 one after the other, the rest
// refitted.
//
// They choose, where both sides are cheap, between names and constants, never between expressions: glslang makes a
// select of `c ? a : b` and one operation of `a || b` only then, and else control flow. A loop with some dozens of
// branches takes SwiftShader's compiler a thousand times as long as the same without. `ops_glsl_test` counts them. They
// return once, at their end, so that calls can be replaced by what they do (backend/spirv/inline.cpp).
//
// An entry of the op table lists the texts it needs, what they call first. Scalar functions come apart from their
// component-wise overloads, so that one function may use another without dragging in its vectors.
#pragma once

#include <string_view>

namespace dr::ops::glsl {

// The overloads of a function of one or two operands for vectors of 2, 3 and 4.
// clang-format off
#define DR_VECTORS_1(name)                                                   \
  "vec2 " name "(vec2 x) { return vec2(" name "(x.x), " name "(x.y)); }\n"   \
  "vec3 " name "(vec3 x) { return vec3(" name "(x.xy), " name "(x.z)); }\n"  \
  "vec4 " name "(vec4 x) { return vec4(" name "(x.xy), " name "(x.zw)); }\n"
#define DR_VECTORS_2_OF(v, name)                                                                        \
  v "2 " name "(" v "2 x, " v "2 y) { return " v "2(" name "(x.x, y.x), " name "(x.y, y.y)); }\n"       \
  v "3 " name "(" v "3 x, " v "3 y) { return " v "3(" name "(x.xy, y.xy), " name "(x.z, y.z)); }\n"     \
  v "4 " name "(" v "4 x, " v "4 y) { return " v "4(" name "(x.xy, y.xy), " name "(x.zw, y.zw)); }\n"
#define DR_VECTORS_2(name) DR_VECTORS_2_OF("vec", name)
// clang-format on

// --- numbers ---

inline constexpr std::string_view kIsNan = R"(
bool dr_is_nan(float x) { return (floatBitsToUint(x) & 0x7fffffffu) > 0x7f800000u; }
)";

inline constexpr std::string_view kMin = R"(
// A NaN loses against a number.
float dr_min(float x, float y) {
  bool none = dr_is_nan(x);
  return y < x || none ? y : x;
}
)";
inline constexpr std::string_view kMinVectors = DR_VECTORS_2("dr_min");

inline constexpr std::string_view kMax = R"(
// A NaN loses against a number.
float dr_max(float x, float y) {
  bool none = dr_is_nan(x);
  return y > x || none ? y : x;
}
)";
inline constexpr std::string_view kMaxVectors = DR_VECTORS_2("dr_max");

inline constexpr std::string_view kQuotient = R"(
// x / y. Devices may take a divisor beyond 2^126 for infinite: Vulkan promises quotients by smaller ones only.
float dr_quotient(float x, float y) {
  float scale = abs(y) > 8.5e37 ? 0.25 : 1.0;
  return (x * scale) / (y * scale);
}
)";
inline constexpr std::string_view kQuotientVectors = DR_VECTORS_2("dr_quotient");

inline constexpr std::string_view kMod = R"(
// x - y * floor(x / y), brought into the half-open range from 0 to y where rounding has left it; 0 for y = 0.
float dr_mod(float x, float y) {
  float r = x - y * floor(dr_quotient(x, y));
  bool outside = (r < 0.0) != (y < 0.0);
  float inside = r + y;
  r = r != 0.0 && outside ? inside : r;
  float last = y * 0.99999994;
  r = abs(r) >= abs(y) ? last : r;
  return y == 0.0 ? 0.0 : r;
}
)";
inline constexpr std::string_view kModVectors = DR_VECTORS_2("dr_mod");

inline constexpr std::string_view kFract = R"(
// Less than 1 also for the small negative x whose x - floor(x) rounds to 1.
float dr_fract(float x) {
  float r = x - floor(x);
  return r >= 1.0 ? 0.99999994 : r;
}
)";
inline constexpr std::string_view kFractVectors = DR_VECTORS_1("dr_fract");

inline constexpr std::string_view kHalf = R"(
// The bits of the nearest float16, of two as near the even one; the largest for what is larger; one NaN for all.
uint dr_half_bits(float x) {
  uint bits = floatBitsToUint(x);
  uint sign = (bits >> 16) & 0x8000u;
  uint a = bits & 0x7fffffffu;
  uint normal = (a - 0x38000000u + 0xfffu + ((a >> 13) & 1u)) >> 13;
  // Subnormal, in units of 2^-24: so many bits of the significand are lost.
  uint lost = clamp(126u - (a >> 23), 1u, 31u);
  uint m = (a & 0x7fffffu) | 0x800000u;
  uint subnormal = (m + (1u << (lost - 1u)) - 1u + ((m >> lost) & 1u)) >> lost;
  uint h = a >= 0x38800000u ? normal : subnormal;
  h = a >= 0x477fe000u ? 0x7bffu : h;
  h = (a < 0x33000000u ? 0u : h) | sign;
  return a > 0x7f800000u ? 0x7e00u : h;
}
// What the low 16 bits mean.
float dr_from_half(uint bits) {
  uint sign = (bits & 0x8000u) << 16;
  uint m = bits & 0x7fffu;
  uint subnormal = floatBitsToUint(float(int(m)) * 5.9604644775390625e-8);
  uint normal = (m << 13) + 0x38000000u;
  uint h = (m < 0x400u ? subnormal : normal) | sign;
  return uintBitsToFloat(m > 0x7c00u ? 0x7fc00000u : h);
}
float dr_half(float x) { return dr_from_half(dr_half_bits(x)); }
)";
inline constexpr std::string_view kHalfVectors = DR_VECTORS_1("dr_half");

// --- integers ---

inline constexpr std::string_view kIntDiv = R"(
// Truncates; 0 for y = 0, and the least integer divided by -1 is itself.
int dr_div(int x, int y) {
  int q = x / (y == 0 || y == -1 ? 1 : y), minus = 0 - x;
  q = y == -1 ? minus : q;
  return y == 0 ? 0 : q;
}
)";
inline constexpr std::string_view kUintDiv = R"(
uint dr_div(uint x, uint y) {
  uint q = x / max(y, 1u);
  return y == 0u ? 0u : q;
}
)";
inline constexpr std::string_view kIntDivVectors = DR_VECTORS_2_OF("ivec", "dr_div");
inline constexpr std::string_view kUintDivVectors = DR_VECTORS_2_OF("uvec", "dr_div");

inline constexpr std::string_view kIntMod = R"(
// Of y's sign; 0 for y = 0.
int dr_mod(int x, int y) {
  int d = y == 0 || y == -1 ? 1 : y;
  int r = x - x / d * d;
  int inside = r + y, signs = r ^ y;
  return r != 0 && signs < 0 ? inside : r;
}
)";
inline constexpr std::string_view kUintMod = R"(
uint dr_mod(uint x, uint y) {
  uint r = x % max(y, 1u);
  return y == 0u ? 0u : r;
}
)";
inline constexpr std::string_view kIntModVectors = DR_VECTORS_2_OF("ivec", "dr_mod");
inline constexpr std::string_view kUintModVectors = DR_VECTORS_2_OF("uvec", "dr_mod");

inline constexpr std::string_view kIntMulHigh = R"(
int dr_mul_high(int x, int y) {
  int high, low;
  imulExtended(x, y, high, low);
  return high;
}
)";
inline constexpr std::string_view kUintMulHigh = R"(
uint dr_mul_high(uint x, uint y) {
  uint high, low;
  umulExtended(x, y, high, low);
  return high;
}
)";
inline constexpr std::string_view kIntMulHighVectors = DR_VECTORS_2_OF("ivec", "dr_mul_high");
inline constexpr std::string_view kUintMulHighVectors = DR_VECTORS_2_OF("uvec", "dr_mul_high");

inline constexpr std::string_view kFloatToInt = R"(
// Truncates and saturates; NaN gives 0.
int dr_to_int(float x) {
  float c = x > -2147483648.0 ? x : 0.0;
  int i = int(c < 2147483648.0 ? c : 0.0);
  i = x >= 2147483648.0 ? 2147483647 : i;
  return x <= -2147483648.0 ? -2147483647 - 1 : i;
}
)";
inline constexpr std::string_view kFloatToIntVectors = R"(
ivec2 dr_to_int(vec2 x) { return ivec2(dr_to_int(x.x), dr_to_int(x.y)); }
ivec3 dr_to_int(vec3 x) { return ivec3(dr_to_int(x.xy), dr_to_int(x.z)); }
ivec4 dr_to_int(vec4 x) { return ivec4(dr_to_int(x.xy), dr_to_int(x.zw)); }
)";

inline constexpr std::string_view kFloatToUint = R"(
// Truncates and saturates; NaN gives 0.
uint dr_to_uint(float x) {
  float c = x > 0.0 ? x : 0.0;
  uint i = uint(c < 4294967296.0 ? c : 0.0);
  return x >= 4294967296.0 ? 0xffffffffu : i;
}
)";
inline constexpr std::string_view kFloatToUintVectors = R"(
uvec2 dr_to_uint(vec2 x) { return uvec2(dr_to_uint(x.x), dr_to_uint(x.y)); }
uvec3 dr_to_uint(vec3 x) { return uvec3(dr_to_uint(x.xy), dr_to_uint(x.z)); }
uvec4 dr_to_uint(vec4 x) { return uvec4(dr_to_uint(x.xy), dr_to_uint(x.zw)); }
)";

inline constexpr std::string_view kUintToFloat = R"(
// Both halves are exact and their sum is rounded once; what drivers make of float(x) may be off by more.
float dr_to_float(uint x) { return float(x >> 16) * 65536.0 + float(x & 0xffffu); }
)";
inline constexpr std::string_view kUintToFloatVectors = R"(
vec2 dr_to_float(uvec2 x) { return vec2(dr_to_float(x.x), dr_to_float(x.y)); }
vec3 dr_to_float(uvec3 x) { return vec3(dr_to_float(x.xy), dr_to_float(x.z)); }
vec4 dr_to_float(uvec4 x) { return vec4(dr_to_float(x.xy), dr_to_float(x.zw)); }
)";

inline constexpr std::string_view kFloatToBool = R"(
// False for 0 and NaN.
bool dr_to_bool(float x) { return x < 0.0 || x > 0.0; }
)";
inline constexpr std::string_view kFloatToBoolVectors = R"(
bvec2 dr_to_bool(vec2 x) { return bvec2(dr_to_bool(x.x), dr_to_bool(x.y)); }
bvec3 dr_to_bool(vec3 x) { return bvec3(dr_to_bool(x.xy), dr_to_bool(x.z)); }
bvec4 dr_to_bool(vec4 x) { return bvec4(dr_to_bool(x.xy), dr_to_bool(x.zw)); }
)";

// --- exponential ---

inline constexpr std::string_view kExpPart = R"(
// e^r - 1 for |r| <= log(2) / 2.
float dr_expm1_part(float r) {
  return r + r * r * (0.49999997 + r * (0.166665465 + r * (0.041667439 + r * (0.00836625695 + r * 0.00138703093))));
}
// x - n log(2), log(2) in two parts of which the first times n is exact.
float dr_log2_remainder(float x, float n) { return (x - n * 0.693359375) + n * 2.12194440e-4; }
// z * 2^n, in two factors: the result may overflow, the factors do not.
float dr_ldexp(float z, int n) {
  int m = n >> 1;
  return z * intBitsToFloat((m + 127) << 23) * intBitsToFloat((n - m + 127) << 23);
}
)";

inline constexpr std::string_view kExp = R"(
// e^x * 2^k, without overflow on the way.
float dr_exp_scaled(float x, int k) {
  float c = x > 91.0 ? 91.0 : x;
  c = c < -105.0 ? -105.0 : c;
  float n = roundEven(c * 1.44269504);
  return dr_ldexp(1.0 + dr_expm1_part(dr_log2_remainder(c, n)), int(n) + k);
}
float dr_exp(float x) { return dr_exp_scaled(x, 0); }
)";
inline constexpr std::string_view kExpVectors = DR_VECTORS_1("dr_exp");

inline constexpr std::string_view kExp2 = R"(
float dr_exp2(float x) {
  float c = x > 130.0 ? 130.0 : x;
  c = c < -152.0 ? -152.0 : c;
  float n = roundEven(c);
  return dr_ldexp(1.0 + dr_expm1_part((c - n) * 0.693147181), int(n));
}
)";
inline constexpr std::string_view kExp2Vectors = DR_VECTORS_1("dr_exp2");

inline constexpr std::string_view kExpm1 = R"(
float dr_expm1(float x) {
  float r;
  if (x > 10.0 || x < -18.0) {
    r = dr_exp(x) - 1.0;
  } else {
    float n = roundEven(x * 1.44269504);
    float s = intBitsToFloat((int(n) + 127) << 23);
    r = s * dr_expm1_part(dr_log2_remainder(x, n)) + (s - 1.0);
  }
  return r;
}
)";
inline constexpr std::string_view kExpm1Vectors = DR_VECTORS_1("dr_expm1");

// --- logarithm ---

inline constexpr std::string_view kLogPart = R"(
// log(1 + f) - f for f in [-1/3, 1/3].
float dr_log1p_part(float f) {
  float p = 0.20010443 + f * (-0.16680181 + f * (0.140053749 + f * (-0.121883407 + f * (0.139865175 + f * -0.128745154))));
  float z = f * f;
  return f * z * (0.333332151 + f * (-0.249998048 + f * p)) - 0.5 * z;
}
// e such that x = m * 2^e with m in [2/3, 4/3), for positive normal x; m.
int dr_log_exponent(float x) { return (floatBitsToInt(x) - 0x3f2aaaab) >> 23; }
float dr_log_mantissa(float x, int e) { return intBitsToFloat(floatBitsToInt(x) - (e << 23)); }
// The logarithm of what is no positive normal number: 0, negative, Inf, NaN.
bool dr_log_is_special(float x) { return uint(floatBitsToInt(x) - 0x00800000) >= 0x7f000000u; }
float dr_log_special(float x) {
  uint bits = floatBitsToUint(x);
  bits = x < 0.0 ? 0x7fc00000u : bits;
  return uintBitsToFloat(x == 0.0 ? 0xff800000u : bits);
}
// Subnormal numbers have another exponent, if the device has not made zeros of them.
bool dr_is_tiny(float x) { return abs(x) < 1.17549435e-38; }
)";

inline constexpr std::string_view kLog = R"(
float dr_log(float x) {
  bool tiny = dr_is_tiny(x);
  float y = x * (tiny ? 8388608.0 : 1.0);
  int e = dr_log_exponent(y);
  float f = dr_log_mantissa(y, e) - 1.0;
  float n = float(e - (tiny ? 23 : 0));
  float r = (f + (dr_log1p_part(f) - n * 2.12194440e-4)) + n * 0.693359375, special = dr_log_special(y);
  return dr_log_is_special(y) ? special : r;
}
)";
inline constexpr std::string_view kLogVectors = DR_VECTORS_1("dr_log");

inline constexpr std::string_view kLog2 = R"(
float dr_log2(float x) {
  bool tiny = dr_is_tiny(x);
  float y = x * (tiny ? 8388608.0 : 1.0);
  int e = dr_log_exponent(y);
  float f = dr_log_mantissa(y, e) - 1.0;
  float p = dr_log1p_part(f);
  float r = ((p * 0.442695041 + f * 0.442695041) + p) + f + float(e - (tiny ? 23 : 0)), special = dr_log_special(y);
  return dr_log_is_special(y) ? special : r;
}
)";
inline constexpr std::string_view kLog2Vectors = DR_VECTORS_1("dr_log2");

inline constexpr std::string_view kLog1p = R"(
float dr_log1p(float x) {
  float near = x + dr_log1p_part(x);
  float u = 1.0 + x;
  int e = dr_log_exponent(u);
  float f = dr_log_mantissa(u, e) - 1.0;
  float n = float(e);
  float of_one = 1.0 - (u - x), of_x = x - (u - 1.0);
  float lost = (x > 1.0 ? of_one : of_x) / u;  // by rounding 1 + x
  float r = (f + (dr_log1p_part(f) + (lost - n * 2.12194440e-4))) + n * 0.693359375, special = dr_log_special(u);
  r = dr_log_is_special(u) ? special : r;
  return x > -0.29 && x < 0.33 ? near : r;
}
)";
inline constexpr std::string_view kLog1pVectors = DR_VECTORS_1("dr_log1p");

// --- power ---

inline constexpr std::string_view kCbrt = R"(
// A third of the bits is a root within 4%; each step cubes what it is off by. Large and small numbers are scaled by
// powers of 8: a cube must neither overflow nor vanish.
float dr_cbrt(float x) {
  float a = abs(x);
  bool small = a < 1e-30, large = a > 1e30;
  float up = small ? 16777216.0 : 1.0, down = small ? 0.00390625 : 1.0;
  up = large ? 5.96046448e-8 : up;
  down = large ? 256.0 : down;
  float y = a * up;
  float r = uintBitsToFloat(floatBitsToUint(y) / 3u + 0x2a514067u);
  float cube = r * r * r;
  r = r + r * ((y - cube) / (2.0 * cube + y));
  cube = r * r * r;
  r = (r + r * ((y - cube) / (2.0 * cube + y))) * down;
  float minus = -r, same = x * up;
  r = x < 0.0 ? minus : r;
  bool special = uint(floatBitsToInt(y) - 1) >= 0x7f7fffffu;  // 0, Inf, NaN
  return special ? same : r;
}
)";
inline constexpr std::string_view kCbrtVectors = DR_VECTORS_1("dr_cbrt");

inline constexpr std::string_view kPow = R"(
// The 12 high bits of x: products of two such numbers are exact.
float dr_high(float x) { return uintBitsToFloat(floatBitsToUint(x) & 0xfffff000u); }
// x^y for positive normal x. y log2(x) is carried in two floats: its error becomes the result's relative error.
float dr_pow_positive(float x, int shift, float y) {
  int e = (floatBitsToInt(x) - 0x3f3504f3) >> 23;
  float f = dr_log_mantissa(x, e) - 1.0;  // in [sqrt(1/2) - 1, sqrt(2) - 1]
  // log2(1 + f) = 2 / log(2) atanh(s), s = f / (2 + f) = sh + sl
  float s = f / (2.0 + f);
  float sh = dr_high(s);
  float fh = dr_high(f);
  float sl = (((f - 2.0 * sh) - sh * fh) - sh * (f - fh)) / (2.0 + f);
  float w = s * s;
  float odd = s * w * (0.33333388 + w * (0.199887887 + w * 0.149355307));
  float hi = 2.88476562 * sh;
  float lo = 6.24456778e-4 * sh + 2.88539008 * (sl + odd);
  float n = float(e - shift);
  float th = dr_high(n + (hi + lo));
  float tl = ((n - th) + hi) + lo;
  float c = y > 1e12 ? 1e12 : y;
  c = c < -1e12 ? -1e12 : c;
  float yh = dr_high(c);
  float ph = yh * th;
  float pl = (c - yh) * th + c * tl;
  float p = ph + pl;
  float q = p > 130.0 ? 130.0 : p;
  q = q < -152.0 ? -152.0 : q;
  float k = roundEven(q);
  float r = dr_ldexp(1.0 + dr_expm1_part(((ph - k) + pl) * 0.693147181), int(k)), high = uintBitsToFloat(0x7f800000u);
  r = p > 130.0 ? high : r;
  return p < -152.0 ? 0.0 : r;
}
float dr_pow(float x, float y) {
  float a = abs(x), r;
  bool tiny = dr_is_tiny(a);
  if (tiny) a *= 8388608.0;
  if (x == 1.0 || y == 0.0) {
    r = 1.0;
  } else if (a == 0.0) {
    r = y > 0.0 ? 0.0 : (y < 0.0 ? uintBitsToFloat(0x7f800000u) : y);
  } else {
    if (dr_log_is_special(a)) {
      r = y > 0.0 ? a : (y < 0.0 ? (1.0 / a) : y);  // Inf, NaN
    } else {
      r = dr_pow_positive(a, tiny ? 23 : 0, y);
    }
    if (!(x >= 0.0)) {
      // Negative: whole exponents have a power.
      float half_y = 0.5 * y, minus = -r, none = uintBitsToFloat(0x7fc00000u);
      r = floor(half_y) != half_y ? minus : r;
      r = floor(y) != y ? none : r;
    }
  }
  return r;
}
)";
inline constexpr std::string_view kPowVectors = DR_VECTORS_2("dr_pow");

// --- angles ---

inline constexpr std::string_view kSinPart = R"(
// sin(r) and cos(r) for |r| <= pi / 4.
float dr_sin_part(float r) {
  float z = r * r;
  return r + r * z * (-0.166666552 + z * (0.0083321901 + z * -0.000195183937));
}
float dr_cos_part(float r) {
  float z = r * r;
  return (1.0 - 0.5 * z) + z * z * (0.0416666456 + z * (-0.00138873013 + z * 2.44306666e-05));
}
float dr_quarter_turns(float x) { return roundEven(x * 0.636619772); }
// x - n pi / 2, pi / 2 in four parts of which the first three times n are exact up to |x| = 8192: near the zeros of sin and
// cos the remainder is what they are. That of larger x means nothing; it is kept in range, so that sin and cos are.
float dr_turn_remainder(float x, float n) {
  float r = (((x - n * 1.5703125) - n * 4.837512969970703e-4) - n * 7.549533620476723e-8) - n * 2.563344151594519e-12;
  r = r > 0.8 ? 0.8 : r;
  return r < -0.8 ? -0.8 : r;
}
// sin(x + quarter pi / 2)
float dr_sin_turned(float x, float quarter) {
  float n = dr_quarter_turns(x);
  float r = dr_turn_remainder(x, n);
  float m = n + quarter;
  m = m - 4.0 * floor(0.25 * m);  // 0 .. 3
  float s = dr_sin_part(r), c = dr_cos_part(r);
  s = m == 1.0 || m == 3.0 ? c : s;
  float minus = -s;
  return m >= 2.0 ? minus : s;
}
)";

inline constexpr std::string_view kSin = R"(
float dr_sin(float x) { return dr_sin_turned(x, 0.0); }
)";
inline constexpr std::string_view kSinVectors = DR_VECTORS_1("dr_sin");

inline constexpr std::string_view kCos = R"(
float dr_cos(float x) { return dr_sin_turned(x, 1.0); }
)";
inline constexpr std::string_view kCosVectors = DR_VECTORS_1("dr_cos");

inline constexpr std::string_view kTan = R"(
float dr_tan(float x) {
  float n = dr_quarter_turns(x);
  float r = dr_turn_remainder(x, n);
  float s = dr_sin_part(r);
  float c = dr_cos_part(r);
  float minus = -c, even = 2.0 * floor(0.5 * n);
  return (n != even ? minus : s) / (n != even ? s : c);
}
)";
inline constexpr std::string_view kTanVectors = DR_VECTORS_1("dr_tan");

inline constexpr std::string_view kAsinPart = R"(
// asin(s) for 0 <= s <= 1/2, z = s * s.
float dr_asin_part(float s, float z) {
  return s + s * z * (0.166667536 + z * (0.0749525279 + z * (0.0454759076 + z * (0.0241528545 + z * 0.042210415))));
}
)";

inline constexpr std::string_view kAsin = R"(
float dr_asin(float x) {
  float a = abs(x);
  a = a > 1.0 ? 1.0 : a;
  float high = 0.5 * (1.0 - a), low = a * a;
  float z = a > 0.5 ? high : low, root = sqrt(z);
  float p = dr_asin_part(a > 0.5 ? root : a, z);
  float rest = 1.57079633 - 2.0 * p;
  float r = a > 0.5 ? rest : p, minus = -r;
  return x < 0.0 ? minus : r;
}
)";
inline constexpr std::string_view kAsinVectors = DR_VECTORS_1("dr_asin");

inline constexpr std::string_view kAcos = R"(
float dr_acos(float x) {
  float a = abs(x);
  a = a > 1.0 ? 1.0 : a;
  float high = 0.5 * (1.0 - a), low = a * a;
  float z = a > 0.5 ? high : low, root = sqrt(z);
  float p = dr_asin_part(a > 0.5 ? root : a, z);
  float near = 2.0 * p, far = 3.14159265 - 2.0 * p, minus = -p;
  float ends = x < 0.0 ? far : near;
  float middle = 1.57079633 - (x < 0.0 ? minus : p);
  return a > 0.5 ? ends : middle;
}
)";
inline constexpr std::string_view kAcosVectors = DR_VECTORS_1("dr_acos");

inline constexpr std::string_view kAtanPart = R"(
// atan(t) for 0 <= t <= 1.
float dr_atan_part(float t) {
  float z = t * t;
  float p = -0.0840055645 + z * (0.0579083823 + z * (-0.0311292186 + z * (0.0108887283 + z * -0.00178788661)));
  return t + t * z * (-0.333332986 + z * (0.19998531 + z * (-0.142640531 + z * (0.109511927 + z * p))));
}
)";

inline constexpr std::string_view kAtan = R"(
float dr_atan(float x) {
  float a = abs(x);
  float inverse = 1.0 / a;
  float p = dr_atan_part(a > 1.0 ? inverse : a), rest = 1.57079633 - p;
  float r = a > 1.0 ? rest : p, minus = -r;
  return x < 0.0 ? minus : r;
}
)";
inline constexpr std::string_view kAtanVectors = DR_VECTORS_1("dr_atan");

inline constexpr std::string_view kAtan2 = R"(
// 0 at the origin; a zero counts as positive.
float dr_atan2(float y, float x) {
  float a = abs(x);
  float b = abs(y);
  float high = a > b ? a : b;
  float low = a > b ? b : a;
  // Devices divide well by what is neither huge nor tiny.
  float scale = high < 1e-18 ? 1e20 : 1.0;
  scale = high > 1e30 ? 1e-20 : scale;
  float t = low * scale / (high * scale);
  float p = dr_atan_part(low == high ? 1.0 : t), rest = 1.57079633 - p;
  float r = b > a ? rest : p, other = 3.14159265 - r;
  r = x < 0.0 ? other : r;
  float minus = -r;
  r = y < 0.0 ? minus : r;
  return high == 0.0 && low == 0.0 ? 0.0 : r;
}
)";
inline constexpr std::string_view kAtan2Vectors = DR_VECTORS_2("dr_atan2");

// --- hyperbolic functions and what is made of exponentials ---

inline constexpr std::string_view kSinh = R"(
float dr_sinh(float x) {
  float a = abs(x);
  float r;
  if (a < 1.0) {
    float t = dr_expm1(a);
    r = 0.5 * (t + t / (1.0 + t));
  } else {
    float half_exp = dr_exp_scaled(a, -1);
    r = half_exp - 0.25 / half_exp;
  }
  return x < 0.0 ? -r : r;
}
)";
inline constexpr std::string_view kSinhVectors = DR_VECTORS_1("dr_sinh");

inline constexpr std::string_view kCosh = R"(
float dr_cosh(float x) {
  float half_exp = dr_exp_scaled(abs(x), -1);
  return half_exp + 0.25 / half_exp;
}
)";
inline constexpr std::string_view kCoshVectors = DR_VECTORS_1("dr_cosh");

inline constexpr std::string_view kTanh = R"(
float dr_tanh(float x) {
  float t = dr_expm1(-2.0 * abs(x));
  float r = -t / (2.0 + t), minus = -r;
  return x < 0.0 ? minus : r;
}
)";
inline constexpr std::string_view kTanhVectors = DR_VECTORS_1("dr_tanh");

inline constexpr std::string_view kAsinh = R"(
// log(a + sqrt(1 + a^2)) without the cancellation near 0 and without the square of what is large.
float dr_asinh(float x) {
  float a = abs(x);
  float z = a * a;
  float far = dr_log(a) + 0.693147181, near = dr_log1p(a + z / (1.0 + sqrt(1.0 + z)));
  float r = a > 1e8 ? far : near, minus = -r;
  return x < 0.0 ? minus : r;
}
)";
inline constexpr std::string_view kAsinhVectors = DR_VECTORS_1("dr_asinh");

inline constexpr std::string_view kAcosh = R"(
// log(x + sqrt(x^2 - 1)) from x - 1, which is exact near 1; NaN below 1.
float dr_acosh(float x) {
  float t = x - 1.0, none = uintBitsToFloat(0x7fc00000u);
  float far = dr_log(x) + 0.693147181, near = dr_log1p(t + sqrt(t * (2.0 + t)));
  float r = x > 1e8 ? far : near;
  return x < 1.0 ? none : r;
}
)";
inline constexpr std::string_view kAcoshVectors = DR_VECTORS_1("dr_acosh");

inline constexpr std::string_view kAtanh = R"(
// log((1 + a) / (1 - a)) / 2; Inf at 1, NaN beyond.
float dr_atanh(float x) {
  float a = abs(x);
  float r = 0.5 * dr_log1p((a + a) / (1.0 - a)), infinite = uintBitsToFloat(0x7f800000u);
  r = a == 1.0 ? infinite : r;
  float minus = -r, none = uintBitsToFloat(0x7fc00000u);
  r = x < 0.0 ? minus : r;
  return a > 1.0 ? none : r;
}
)";
inline constexpr std::string_view kAtanhVectors = DR_VECTORS_1("dr_atanh");

inline constexpr std::string_view kSigmoid = R"(
// Relative accuracy on both sides: sigmoid(-x) is 1 - sigmoid(x) to the last bits.
float dr_sigmoid(float x) {
  float z = dr_exp(-abs(x));
  return (x < 0.0 ? z : 1.0) / (1.0 + z);
}
)";
inline constexpr std::string_view kSigmoidVectors = DR_VECTORS_1("dr_sigmoid");

inline constexpr std::string_view kSoftplus = R"(
float dr_softplus(float x) { return (x > 0.0 ? x : 0.0) + dr_log1p(dr_exp(-abs(x))); }
)";
inline constexpr std::string_view kSoftplusVectors = DR_VECTORS_1("dr_softplus");

inline constexpr std::string_view kLogAddExp = R"(
// Of equal operands, infinite ones too, the difference is 0.
float dr_logaddexp(float x, float y) {
  float high = x > y ? x : y;
  float apart = abs(x - y);
  apart = x == y ? 0.0 : apart;
  return high + dr_log1p(dr_exp(-apart));
}
)";
inline constexpr std::string_view kLogAddExpVectors = DR_VECTORS_2("dr_logaddexp");

inline constexpr std::string_view kErf = R"(
float dr_erf(float x) {
  float a = abs(x);
  float r;
  if (a < 1.0) {
    float z = a * a;
    float p = 0.112835787 + z * (-0.0268533546 + z * (0.00518720085 + z * (-0.000799847476 + z * 7.81008421e-05)));
    r = a * (1.0 + (0.128379166 + z * (-0.37612626 + z * p)));
  } else {
    // erfc(a) = exp(-polynomial(a - 1)) up to 4, where it is below the last bit
    float t = a > 4.0 ? 3.0 : a - 1.0;
    float p = 0.0412607566 + t * (-0.00945074297 + t * (0.00148070056 + t * -9.03976033e-05));
    r = 1.0 - dr_exp(-(1.84960556 + t * (2.63896275 + t * (0.84317261 + t * p))));
  }
  return x < 0.0 ? -r : r;
}
)";
inline constexpr std::string_view kErfVectors = DR_VECTORS_1("dr_erf");

// --- vectors ---

inline constexpr std::string_view kDot = R"(
float dr_dot(float x, float y) { return x * y; }
float dr_dot(vec2 x, vec2 y) { return x.x * y.x + x.y * y.y; }
float dr_dot(vec3 x, vec3 y) { return x.x * y.x + x.y * y.y + x.z * y.z; }
float dr_dot(vec4 x, vec4 y) { return (x.x * y.x + x.y * y.y) + (x.z * y.z + x.w * y.w); }
)";

inline constexpr std::string_view kLargest = R"(
// The largest component's absolute value.
float dr_largest(vec2 v) { return max(abs(v.x), abs(v.y)); }
float dr_largest(vec3 v) { return max(max(abs(v.x), abs(v.y)), abs(v.z)); }
float dr_largest(vec4 v) { return max(max(abs(v.x), abs(v.y)), max(abs(v.z), abs(v.w))); }
// The exponent field of m, so that 2^(127 - e) and 2^(e - 127) both exist.
int dr_scale_exponent(float m) { return clamp((floatBitsToInt(m) >> 23) & 255, 1, 253); }
// Scaling by a power of two loses nothing and keeps squares in range.
float dr_scale_down(int e) { return intBitsToFloat((254 - e) << 23); }
float dr_scale_up(int e) { return intBitsToFloat(e << 23); }
)";

// clang-format off
#define DR_LENGTH(vec)                                  \
  "float dr_length(" vec " v) {\n"                      \
  "  int e = dr_scale_exponent(dr_largest(v));\n"       \
  "  " vec " s = v * dr_scale_down(e);\n"               \
  "  return sqrt(dr_dot(s, s)) * dr_scale_up(e);\n"     \
  "}\n"
inline constexpr std::string_view kLength =
    "float dr_length(float v) { return abs(v); }\n"
    DR_LENGTH("vec2") DR_LENGTH("vec3") DR_LENGTH("vec4");
#undef DR_LENGTH

// 0 for 0.
#define DR_NORMALIZE(vec)                                                \
  vec " dr_normalize(" vec " v) {\n"                                     \
  "  " vec " s = v * dr_scale_down(dr_scale_exponent(dr_largest(v)));\n" \
  "  float d = dr_dot(s, s);\n"                                          \
  "  " vec " unit = s / sqrt(d);\n"                                      \
  "  return d == 0.0 ? " vec "(0.0) : unit;\n"                           \
  "}\n"
inline constexpr std::string_view kNormalize =
    "float dr_normalize(float v) { return sign(v); }\n"
    DR_NORMALIZE("vec2") DR_NORMALIZE("vec3") DR_NORMALIZE("vec4");
#undef DR_NORMALIZE
// clang-format on

#undef DR_VECTORS_1
#undef DR_VECTORS_2
#undef DR_VECTORS_2_OF

}  // namespace dr::ops::glsl
