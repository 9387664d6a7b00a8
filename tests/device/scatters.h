// SPDX-License-Identifier: Apache-2.0
// What tests of scatters share.
#pragma once

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "compiler/target/profile.h"
#include "runtime/runtime.h"
#include "tests/catch.h"

namespace dr::test {

// Relative L2 of the finite entries; infinite where one is NaN or Inf and the other is not the same.
inline double distance(const io::Array& a, const io::Array& truth) {
  const auto x = a.to_doubles(), y = truth.to_doubles();
  REQUIRE(x.size() == y.size());
  double difference = 0, size = 0;
  for (size_t k = 0; k < x.size(); ++k) {
    if (!std::isfinite(y[k])) {
      if (std::isnan(y[k]) != std::isnan(x[k]) || (!std::isnan(y[k]) && x[k] != y[k])) return INFINITY;
      continue;
    }
    difference += (x[k] - y[k]) * (x[k] - y[k]);
    size += y[k] * y[k];
  }
  return difference == 0 ? 0 : std::sqrt(difference / size);
}

inline bool same_bits(const std::vector<io::Array>& a, const std::vector<io::Array>& b) {
  for (size_t k = 0; k < a.size(); ++k)
    if (a[k].bytes != b[k].bytes) return false;
  return true;
}

// A file with a profile.
inline std::string written(const target::Profile& profile, const std::string& name) {
  auto path = (std::filesystem::path(DR_BUILD_DIR) / (name + "_" + profile.name + ".json")).string();
  std::ofstream(path) << target::write_profile(profile);
  return path;
}

// A profile without 64-bit integers, for devices of either kind: lavapipe lets loops take so many trips.
inline std::string narrow() {
  auto p = std::get<target::Profile>(target::load_profile("swiftshader"));
  p.loop_trips = std::get<target::Profile>(target::load_profile("lavapipe")).loop_trips;
  return written(p, "narrow");
}

struct Data {
  const char* name;
  std::vector<int32_t> index;  // pairs
  std::vector<float> x;        // pairs
};

// What breaks sums over 300 targets: `input index : ivec2[S]`, some out of range, and `input x : vec2[S]`.
inline std::vector<Data> data_sets() {
  std::mt19937 random(7);
  auto uniform = [&](double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); };
  auto target = [&](int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); };
  std::vector<Data> sets;
  auto make = [&](const char* name, size_t sources, auto index, auto value) {
    Data d{name, {}, {}};
    for (size_t k = 0; k < 2 * sources; ++k) {
      d.index.push_back(index(k));
      d.x.push_back(static_cast<float>(value(k)));
    }
    sets.push_back(std::move(d));
  };
  make(
      "a million sources of one target", 1000000, [&](size_t k) { return k % 1000 == 0 ? target(0, 299) : 137; },
      [&](size_t) { return uniform(0, 1); });
  make(
      "magnitudes from 1e-30 to 1e30", 5000, [&](size_t) { return target(0, 299); },
      [&](size_t k) { return (k % 3 == 0 ? -1 : 1) * std::pow(10.0, uniform(-30, 30)); });
  // Four sources of a target: x, -x and twice a little.
  make(
      "sums that cancel", 4 * 280, [&](size_t k) { return static_cast<int>(k / 8); },
      [&](size_t k) {
        const size_t group = k / 8, pair = k / 2 % 4;
        return pair == 0   ? 1.0 + static_cast<double>(k % 2)
               : pair == 1 ? -1.0 - static_cast<double>(k % 2)
                           : 1e-4 * std::sin(static_cast<double>(group));
      });
  make(
      "out of range and empty", 3000, [&](size_t) { return 7 * target(-20, 80); },
      [&](size_t) { return uniform(-1, 1); });
  make(
      "not finite", 2000, [&](size_t) { return target(0, 299); },
      [&](size_t k) {
        return k % 97 == 0 ? INFINITY : k % 89 == 0 ? -INFINITY : k % 211 == 0 ? NAN : uniform(-1, 1);
      });
  make(
      "one source", 1, [](size_t) { return 5; }, [](size_t) { return 1e-37; });
  return sets;
}
}  // namespace dr::test
