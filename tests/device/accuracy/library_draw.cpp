// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/library_draw.h"

#include <algorithm>
#include <cfloat>
#include <cmath>

namespace dr::accuracy::library {

namespace {

double as_float(double x) { return static_cast<double>(static_cast<float>(x)); }

bool inside(const Operand& o, double x) {
  return x >= o.low && x <= o.high && (x == 0 ? o.low <= 0 : std::abs(x) >= o.least);
}

}  // namespace

double Draw::uniform(double low, double high) {
  return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
}

double Draw::number(const Operand& o, const ir::Type& type) {
  if (type.is_bool()) return static_cast<double>(engine_() & 1);
  if (!type.is_float()) {
    // Every width alike.
    const double x = std::floor(uniform(0, 1) * std::exp2(uniform(0, 32)));
    return std::clamp((engine_() & 1) != 0 && o.low < 0 ? -x : x, o.low, o.high);
  }
  const double special[] = {o.low,   o.high,   0,   1, -1, 1 - 0x1p-24, 1 + 0x1p-23,
                            o.least, -o.least, 0.5, 2, -2, 0x1p-12,     0x1p12};
  const double most = std::max(std::abs(o.low), std::abs(o.high));
  for (;;) {
    double x = 0;
    const size_t way = pick(16);
    if (way == 0) {
      x = special[pick(std::size(special))];
    } else if (way < 9) {
      x = uniform(std::max(o.low, -8.0), std::min(o.high, 8.0));
    } else {
      x = std::exp2(uniform(std::log2(std::max(o.least, 0x1p-100)), std::log2(most)));
      if (o.low < 0 && (o.high <= 0 || (engine_() & 1) != 0)) x = -x;
    }
    x = as_float(x);
    if (inside(o, x)) return x;
  }
}

std::vector<double> Draw::element(const Operand& o, const ir::Type& type) {
  std::vector<double> values;
  for (int k = 0; k < type.components(); ++k) values.push_back(number(o, type));
  // Axes and diagonals.
  if (values.size() > 1 && pick(16) == 0) {
    const bool axis = pick(2) == 0 && o.low <= 0 && o.high >= 0;
    for (size_t k = 1; k < values.size(); ++k) values[k] = axis ? 0 : values[0];
    if (axis) std::swap(values[0], values[pick(values.size())]);
  }
  return values;
}

std::vector<double> Draw::adjoint(const ir::Type& type, bool all) {
  std::vector<double> values(static_cast<size_t>(type.components()));
  const size_t chosen = pick(values.size());
  for (size_t k = 0; k < values.size(); ++k)
    if (all || k == chosen) values[k] = as_float(uniform(0.5, 2)) * (pick(2) == 0 ? 1 : -1);
  return values;
}

double Draw::near(const Operand& o, const ir::Type& type, double x) {
  if (!type.is_float()) return pick(4) == 0 ? number(o, type) : x;
  for (int tries = 0; tries < 4; ++tries) {
    double y = x;
    if (pick(2) == 0) {
      float f = static_cast<float>(x);
      const float to = pick(2) == 0 ? FLT_MAX : -FLT_MAX;
      for (size_t k = pick(4) + 1; k > 0; --k) f = std::nextafterf(f, to);
      y = f;
    } else {
      y = as_float(x * (1 + (pick(2) == 0 ? 1 : -1) * std::exp2(-uniform(1, 23))));
    }
    if (inside(o, y)) return y;
  }
  return x;
}

}  // namespace dr::accuracy::library
