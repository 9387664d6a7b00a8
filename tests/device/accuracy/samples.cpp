// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/samples.h"

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "compiler/ops/op.h"

namespace dr::accuracy {

namespace {

using reference::Image;

// All pairs of special values of two operands would crowd out the random ones beyond this many elements.
constexpr size_t kMostSpecial = 4096;

double as_float(double x) { return static_cast<double>(static_cast<float>(x)); }

// Sizes of which special values are made; pairs are taken of the first list alone.
constexpr double kFew[] = {0x1p-149,    0x1p-130, 0x1p-126,    1e-30, 0x1p-64, 1e-7,    0.5,
                           1 - 0x1p-24, 1,        1 + 0x1p-23, 1.5,   2,       3,       88.75,
                           1e6,         0x1p24,   0x1p64,      1e30,  FLT_MAX, HUGE_VAL};
// clang-format off
constexpr double kMore[] = {
    0x0.fffffep-126, 0x1p-127, 0x1.000002p-126, 1e-38, 1e-20, 0x1p-24, 0x1p-12, 1e-4, 0.25, 0.29, 0.33, 0.49999997,
    0.6666667, 0.70710678, 0.75, 1.25, 1.3333334, 4, 10, 16, 17, 44, 87.25, 87.5, 88.5, 89, 103.5, 104, 126.5, 127, 128,
    149.5, 150.5, 1000, 8191.5, 8192, 0x1p23, 0x1.000002p23, 1e8, 0x1p31, 0x1p32, 1e10, 1e20, 0x1p127};
// clang-format on

constexpr double kWhole[] = {
    0,     1,     2,        3,        7,        31,           32,           33,           255,          46341,
    65535, 65536, 16777215, 16777216, 16777217, 2147483647.0, 2147483648.0, 2147483649.0, 4294967294.0, 4294967295.0};

std::vector<double> few_floats() {
  std::vector<double> values = {0, NAN};
  for (const double x : kFew) {
    values.push_back(as_float(x));
    values.push_back(-as_float(x));
  }
  return values;
}

class Generator {
 public:
  explicit Generator(uint64_t seed) : engine_(seed) {}

  double uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(engine_() >> 11) * 0x1p-53;
  }
  size_t pick(size_t count) { return static_cast<size_t>(engine_() % count); }

  double sample(const Operand& o) {
    if (o.type.is_bool()) return static_cast<double>(engine_() & 1);
    if (!o.type.is_float()) {
      const auto word = static_cast<uint32_t>(engine_() >> 32) >> (engine_() % 32);
      const double x = o.type.scalar == ir::Scalar::Uint
                           ? static_cast<double>(word)
                           : static_cast<double>(static_cast<int32_t>((engine_() & 1) != 0 ? word : 0u - word));
      if (x >= o.low && x <= o.high) return x;
      return std::floor(uniform(o.low, o.high + 1));
    }
    for (;;) {
      double x = 0;
      if ((engine_() & 1) != 0) {
        x = uniform(std::max(o.low, -8.0), std::min(o.high, 8.0));
      } else {
        const double least = std::max(o.least, 0x1p-149);
        const double most = std::max(std::abs(o.low), std::abs(o.high));
        x = std::exp2(uniform(std::log2(least), std::log2(most)));
        if (o.low < 0 && (o.high <= 0 || (engine_() & 1) != 0)) x = -x;
      }
      x = as_float(x);
      if (x >= o.low && x <= o.high && std::abs(x) >= o.least) return x;
    }
  }

 private:
  std::mt19937_64 engine_;
};

bool within(const Operand& o, double x) {
  return x >= o.low && x <= o.high && (!o.type.is_float() || std::abs(x) >= o.least);
}

}  // namespace

std::vector<double> special_floats() {
  std::vector<double> values = few_floats();
  const auto both = [&](double x) {
    values.push_back(as_float(x));
    values.push_back(-as_float(x));
  };
  for (const double x : kMore) both(x);
  for (const int k : {1, 2, 3, 4, 5, 8, 16, 100, 1001, 5214}) {
    const float x = static_cast<float>(k * std::numbers::pi / 2);
    both(x);
    both(std::nextafterf(x, 0));
    both(std::nextafterf(x, FLT_MAX));
  }
  for (const double x : {std::numbers::pi / 4, std::numbers::ln2, std::numbers::e, std::numbers::ln2 / 2}) both(x);
  for (int e = -120; e <= 120; e += 20) both(std::exp2(e));
  return values;
}

std::vector<double> special_integers(ir::Scalar scalar) {
  if (scalar == ir::Scalar::Bool) return {0, 1};
  std::vector<double> values;
  const auto add = [&](double x) {
    const bool fits =
        scalar == ir::Scalar::Uint ? x >= 0 && x <= 4294967295.0 : x >= -2147483648.0 && x <= 2147483647.0;
    if (fits) values.push_back(x);
  };
  for (const double x : kWhole) {
    add(x);
    if (x != 0) add(-x);
  }
  return values;
}

Samples draw(const Case& c, int64_t random, uint64_t seed) {
  Generator generator(seed);
  const size_t arity = c.operands.size();
  // A row of scalars an element: the operands' components in order.
  std::vector<std::vector<double>> rows;
  for (int64_t i = 0; i < random; ++i) {
    std::vector<double> row;
    for (const Operand& o : c.operands)
      for (int k = 0; k < o.type.components(); ++k) row.push_back(generator.sample(o));
    rows.push_back(std::move(row));
  }
  const auto specials = [&](const Operand& o) {
    if (!o.type.is_float()) return special_integers(o.type.scalar);
    return arity == 1 ? special_floats() : few_floats();
  };
  const auto spread = [&](const std::vector<double>& scalars) {
    std::vector<double> row;
    for (size_t k = 0; k < arity; ++k)
      row.insert(row.end(), static_cast<size_t>(c.operands[k].type.components()), scalars[k]);
    rows.push_back(std::move(row));
  };
  for (const ops::TestPoint& point : ops::info(c.kind).singular) {
    if (point.operands.size() < arity) continue;
    std::vector<double> scalars;
    for (size_t k = 0; k < arity; ++k)
      scalars.push_back(c.operands[k].type.is_float()
                            ? as_float(point.operands[k])
                            : std::clamp(std::trunc(point.operands[k]), c.operands[k].low, c.operands[k].high));
    spread(scalars);
  }
  bool vectors = false;
  size_t combinations = 1;
  for (const Operand& o : c.operands) {
    vectors = vectors || !o.type.is_scalar();
    combinations *= specials(o).size();
  }
  if (!vectors && arity > 0 && combinations <= kMostSpecial) {
    for (size_t at = 0; at < combinations; ++at) {
      std::vector<double> scalars;
      size_t rest = at;
      for (const Operand& o : c.operands) {
        const std::vector<double> list = specials(o);
        scalars.push_back(list[rest % list.size()]);
        rest /= list.size();
      }
      spread(scalars);
    }
  } else {
    for (size_t at = 0; arity > 0 && at < kMostSpecial / 2; ++at) {
      std::vector<double> row;
      for (const Operand& o : c.operands) {
        const std::vector<double> list = specials(o);
        // Vectors of one special, and mixtures with what is usual.
        for (int k = 0; k < o.type.components(); ++k)
          row.push_back(generator.pick(4) == 0 ? generator.sample(o) : list[generator.pick(list.size())]);
      }
      rows.push_back(std::move(row));
    }
  }
  while (rows.empty() || rows.size() % static_cast<size_t>(kWidth) != 0) {
    std::vector<double> row;
    for (const Operand& o : c.operands)
      for (int k = 0; k < o.type.components(); ++k) row.push_back(generator.sample(o));
    rows.push_back(std::move(row));
  }
  Samples out;
  out.random = random;
  out.inside.assign(rows.size(), true);
  if (c.mixes) {
    for (std::vector<double>& row : rows) {
      size_t at = 0;
      for (const Operand& o : c.operands)
        for (int k = 0; k < o.type.components(); ++k, ++at)
          if (!within(o, row[at])) row[at] = generator.sample(o);
    }
  }
  size_t first = 0;
  for (const Operand& o : c.operands) {
    const auto components = static_cast<size_t>(o.type.components());
    Image image = reference::zeros(o.type, kWidth, static_cast<int64_t>(rows.size()) / kWidth, 1);
    for (size_t i = 0; i < rows.size(); ++i) {
      for (size_t k = 0; k < components; ++k) {
        const double x = rows[i][first + k];
        image.data[k * rows.size() + i] = x;
        if (!within(o, x)) out.inside[i] = false;
      }
    }
    out.operands.push_back(std::move(image));
    first += components;
  }
  return out;
}

Image draw_weights(ir::Type type, int64_t width, int64_t height, int64_t layers, uint64_t seed) {
  Generator generator(seed ^ 0x5eed);
  Image image = reference::zeros(type, width, height, layers);
  for (double& x : image.data) {
    const size_t choice = generator.pick(16);
    x = choice == 0 ? 0.0 : choice < 4 ? 1.0 : as_float(generator.uniform(0.5, 2));
    if (generator.pick(2) == 0) x = -x;
  }
  return image;
}

}  // namespace dr::accuracy
