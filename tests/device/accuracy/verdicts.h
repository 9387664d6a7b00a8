// SPDX-License-Identifier: Apache-2.0
// judge_one of a whole batch of floats, each with one expectation, without branches: a nanosecond or two an element.
#pragma once

#include <array>
#include <cstdint>

#include "tests/device/accuracy/batch.h"
#include "tests/device/accuracy/errors.h"

namespace dr::accuracy {

// Planes of BatchGraph::kBatch elements each, as in Expected: `value` is of the function itself, for a value the same
// plane as `expected`; `except` is 0 where there is no exception. None may be null.
struct Elements {
  const float* found;
  const uint64_t* inside;  // the domain: 1, else 0
  const double *expected, *value, *scale, *bound, *except;
};

struct Verdicts {
  static constexpr size_t kBatch = BatchGraph::kBatch;
  std::array<double, kBatch> error;      // in last places, 0 where it does not count
  std::array<double, kBatch> share;      // of the bound, alike
  std::array<uint64_t, kBatch> counted;  // 1: neither special nor left out
  uint64_t count, special, left_out, not_finite;
  double worst_share, at_share, worst;  // the largest share, the largest error with that share, the largest error

  // For floats: `asked.is_float` must hold.
  void judge(const Asked& asked, const Elements& elements);
};

}  // namespace dr::accuracy
