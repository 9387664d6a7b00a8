// SPDX-License-Identifier: Apache-2.0
#include "compiler/ops/native.h"

#include "compiler/ops/prelude.h"

namespace dr::ops {

namespace {

struct Pair {
  std::string_view strict, native;
};

constexpr Pair kPairs[] = {
    {glsl::kExp, R"(
float dr_exp(float x) { return exp(x); }
)"},
    {glsl::kExp2, R"(
float dr_exp2(float x) { return exp2(x); }
)"},
    {glsl::kLog, R"(
float dr_log(float x) { return log(x); }
)"},
    {glsl::kLog2, R"(
float dr_log2(float x) { return log2(x); }
)"},
    {glsl::kPow, R"(
// GLSL's is undefined below 0, and at 0 for y <= 0; some drivers take powers of subnormal numbers for others.
float dr_pow(float x, float y) {
  float a = abs(x);
  float r;
  if (x == 1.0 || y == 0.0) r = 1.0;
  else if (a == 0.0) r = y > 0.0 ? 0.0 : (y < 0.0 ? uintBitsToFloat(0x7f800000u) : y);
  else if (a == 1.0) r = 1.0;
  else r = a < 1.17549435e-38 ? pow(a * 8388608.0, y) * exp2(-23.0 * y) : pow(a, y);
  if (!(x >= 0.0) && y != 0.0) {
    float half_y = 0.5 * y, minus = -r, none = uintBitsToFloat(0x7fc00000u);
    r = floor(half_y) != half_y ? minus : r;
    r = floor(y) != y ? none : r;
  }
  return r;
}
)"},
    {glsl::kSinPart, R"(
// x less whole turns: GLSL's sine and cosine are bounded on [-pi, pi] alone, and 6.283185 is the last float below 2 pi. The angle is
// off by (3 + |x|) 2^-23 at most, for |x| to 2000 less than the built-ins themselves.
float dr_in_turn(float x) {
  float t = x * 0.159154943;
  return (t - roundEven(t)) * 6.283185;
}
)"},
    {glsl::kSin, R"(
float dr_sin(float x) { return sin(dr_in_turn(x)); }
)"},
    {glsl::kCos, R"(
float dr_cos(float x) { return cos(dr_in_turn(x)); }
)"},
    {glsl::kTan, R"(
// GLSL's is a quotient of these, and may be one by 0.
float dr_tan(float x) {
  float r = dr_in_turn(x), c = cos(r);
  return sin(r) / (abs(c) < 1e-8 ? 1e-8 : c);
}
)"},
    {glsl::kAsinPart, ""},
    {glsl::kAsin, R"(
float dr_asin(float x) {
  float c = x > 1.0 ? 1.0 : x;
  return asin(c < -1.0 ? -1.0 : c);
}
)"},
    {glsl::kAcos, R"(
float dr_acos(float x) {
  float c = x > 1.0 ? 1.0 : x;
  return acos(c < -1.0 ? -1.0 : c);
}
)"},
    {glsl::kAtanPart, ""},
    {glsl::kAtan, R"(
float dr_atan(float x) { return atan(x); }
)"},
    {glsl::kAtan2, R"(
// 0 at the origin; a zero counts as positive, also one that y becomes when scaled.
float dr_atan2(float y, float x) {
  float high = max(abs(x), abs(y));
  float scale = high < 1e-18 ? 1e20 : 1.0;
  scale = high > 1e30 ? 1e-20 : scale;
  float r = atan(abs(y) * scale, x * scale), minus = -r, axis = x >= 0.0 ? 0.0 : x;
  r = y < 0.0 ? minus : r;
  axis = x < 0.0 ? 3.14159265 : axis;
  return y == 0.0 ? axis : r;
}
)"},
    {glsl::kSinh, R"(
// exp(a) overflows before the function does.
float dr_sinh(float x) {
  float a = abs(x);
  float r;
  if (a <= 80.0) {
    r = sinh(x);
  } else {
    float root = exp(0.5 * a);
    r = 0.5 * root * root;
    float minus = -r;
    r = x < 0.0 ? minus : r;
  }
  return r;
}
)"},
    {glsl::kCosh, R"(
float dr_cosh(float x) {
  float a = abs(x);
  float r;
  if (a <= 80.0) {
    r = cosh(x);
  } else {
    float root = exp(0.5 * a);
    r = 0.5 * root * root;
  }
  return r;
}
)"},
    {glsl::kTanh, R"(
// A quotient of two that overflow, where it is 1 already.
float dr_tanh(float x) {
  float c = x > 10.0 ? 10.0 : x;
  return tanh(c < -10.0 ? -10.0 : c);
}
)"},
    {glsl::kAsinh, R"(
// By way of x^2, and for negative x of a difference.
float dr_asinh(float x) {
  float a = abs(x);
  float r = a > 1e8 ? log(a) + 0.693147181 : asinh(a);
  return x < 0.0 ? -r : r;
}
)"},
    {glsl::kAcosh, R"(
float dr_acosh(float x) {
  float r = uintBitsToFloat(0x7fc00000u);
  if (!(x < 1.0)) r = x > 1e8 ? log(x) + 0.693147181 : acosh(x);
  return r;
}
)"},
    {glsl::kAtanh, R"(
float dr_atanh(float x) {
  float a = abs(x);
  float r = uintBitsToFloat(0x7fc00000u);
  if (!(a > 1.0)) {
    r = a == 1.0 ? uintBitsToFloat(0x7f800000u) : atanh(a);
    float minus = -r;
    r = x < 0.0 ? minus : r;
  }
  return r;
}
)"},
};

}  // namespace

std::string_view native_prelude(std::string_view strict) {
  for (const Pair& pair : kPairs)
    if (pair.strict == strict) return pair.native;
  return strict;
}

std::optional<std::string> native_glsl(ir::OpKind kind, const GlslInput& in) {
  const auto own = info(kind).native;
  return own != nullptr ? own(in) : std::nullopt;
}

}  // namespace dr::ops
