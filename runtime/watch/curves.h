// SPDX-License-Identifier: Apache-2.0
// A number over the runs, thinned out so that a long fit takes no more room than a short one.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace dr::watch {

class Curve {
 public:
  static constexpr size_t kMostPoints = 512;
  struct Point {
    int64_t run;
    double value;
  };
  void add(int64_t run, double value);
  // In the order of runs; the last one added is the last.
  std::vector<Point> points() const;

 private:
  std::vector<Point> kept_;
  Point last_{};
  int64_t every_ = 1, count_ = 0;  // every so many added ones are kept
};

}  // namespace dr::watch
