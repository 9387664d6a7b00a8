// SPDX-License-Identifier: Apache-2.0
// What tests of scatters share.
#pragma once

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
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

}  // namespace dr::test
