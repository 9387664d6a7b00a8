// SPDX-License-Identifier: Apache-2.0
// The programs of skip_test.cpp, with the counts of what they do and avoid.
#pragma once

#include <cstdint>
#include <map>
#include <ostream>
#include <string>
#include <vector>

#include "compiler/io/array/array.h"

namespace dr::skip_test {

struct Count {
  int64_t done = 0, avoided = 0;
  bool operator==(const Count&) const = default;
};

inline std::ostream& operator<<(std::ostream& out, const Count& c) {
  return out << c.done << " done, " << c.avoided << " avoided";
}

using Bound = std::map<std::string, io::Array>;

struct Case {
  std::string id;
  std::string text;  // with one step, `go`
  Bound bound;
  // What wakes it: a leaf that is bound anew, or a const that gets another value and has the program compiled anew.
  std::string leaf = {}, define = {};
  io::Array data = {};
  Count with = {}, without = {}, woken = {};
  std::string raster = "auto", scatter = "auto";
  std::string only_on = {};                                            // a device
  bool as_gpu = false;                                                 // compiled as for a GPU
  std::map<std::string, std::vector<double>, std::less<>> known = {};  // inputs, when the program is compiled
};

io::Array floats(std::vector<float> values, int64_t width, int64_t height = 1);

std::vector<Case> cases();

}  // namespace dr::skip_test
