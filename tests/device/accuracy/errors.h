// SPDX-License-Identifier: Apache-2.0
// How far one number that a device found is off, and whether that counts.
#pragma once

#include <algorithm>
#include <bit>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string>

namespace dr::accuracy {

// The bits of a float32 number.
inline std::string hex(double x) {
  char text[16];
  std::snprintf(text, sizeof text, "%08x", std::bit_cast<uint32_t>(static_cast<float>(x)));
  return text;
}

inline bool is_subnormal(double x) { return x != 0 && std::abs(x) < 0x1p-126; }
inline bool finite_float(double x) { return std::isfinite(static_cast<float>(x)); }

// The last place of float32 numbers of that size, 2^-149 for what is below the normal ones.
inline double ulp_of(double size) {
  const uint64_t exponent = std::bit_cast<uint64_t>(std::max(size, 0x1p-126)) & 0x7ff0000000000000u;
  return std::bit_cast<double>(exponent) * 0x1p-23;
}

// In last places of the larger of `expected` and `scale`. Beyond float32's range Inf stands for 2^128; below `least`
// nothing is promised but that the result is there too.
inline double error_of(bool is_float, double found, double expected, double scale, double least) {
  if (std::isnan(found) || std::isnan(expected)) return std::isnan(found) && std::isnan(expected) ? 0 : HUGE_VAL;
  if (!is_float) return found == expected ? 0 : HUGE_VAL;
  const auto bounded = [](double x) { return std::clamp(x, -0x1p128, 0x1p128); };
  found = bounded(found);
  expected = bounded(expected);
  if (std::abs(expected) < least && std::abs(found) <= least) return 0;
  // Terms of a sum may be flushed, four of them at most where they are few.
  if (scale > 0 && std::abs(found - expected) <= 0x1p-124) return 0;
  const double size = std::max(std::abs(expected), std::isfinite(scale) ? std::max(scale, 0.0) : 0.0);
  return std::abs(found - expected) / ulp_of(std::min(size, double{FLT_MAX}));
}

// What the judge says of an element, for its operands as they are or flushed.
struct Expected {
  double value = 0;
  double scale = 0;
  double bound = 0;  // last places
  bool except = false;
  // Of a derivative: of the function's own value.
  bool value_infinite = false, value_subnormal = false;
};

struct Asked {
  bool is_float = true, derivative = false;
  bool exact = false;  // the bound is 0
  // Each element has a bound of its own; where that reaches beyond the largest number, so may the result.
  bool promised = false;
  bool has_scale = false;
};

struct Verdict {
  bool special = false;     // outside: finite, and no more was asked
  bool left_out = false;    // means nothing
  bool not_finite = false;  // where it must be
  double error = HUGE_VAL;  // in last places
  double share = HUGE_VAL;  // of the bound
  size_t twin = 0;          // which expectation it is nearest to
};

// `inside`: in the domain. `twins` of the expectations are given, one where both are equal.
inline Verdict judge_one(const Asked& asked, double found, bool inside, const Expected* expected, size_t twins) {
  Verdict v;
  bool may_be_infinite = false, except = false;
  // A factor of a derivative may leave the range before all of it does.
  const double room = asked.derivative ? 0x1p7 : 1;
  for (size_t t = 0; t < twins; ++t) {
    const Expected& e = expected[t];
    const double error = error_of(asked.is_float, found, e.value, e.scale, room * 0x1p-126);
    const double share = error == 0 ? 0 : error / e.bound;
    except = except || e.except || (!asked.exact && e.value_subnormal);
    const double size = std::abs(e.value), off = asked.promised && std::isfinite(e.bound) ? e.bound * ulp_of(size) : 0;
    may_be_infinite =
        may_be_infinite || !finite_float(room * (size + off)) || !finite_float(e.scale) || e.value_infinite;
    v.share = std::min(v.share, share);
    if (error < v.error) v.error = error, v.twin = t;
  }
  if (asked.is_float && !std::isfinite(found) && !may_be_infinite) {
    v.not_finite = true;
  } else if (!inside || except) {
    v.special = true;
  } else if (may_be_infinite && (asked.derivative || asked.has_scale)) {
    // Where the result itself overflows, the derivative that is made of it means nothing; nor does a sum where its
    // terms do.
    v.left_out = true;
  }
  return v;
}

}  // namespace dr::accuracy
