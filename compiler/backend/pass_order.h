// SPDX-License-Identifier: Apache-2.0
// Which passes wait for which, kept while passes are merged.
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/backend/schedule.h"

namespace dr::backend {

class PassOrder {
 public:
  // `passes` come after what they read.
  explicit PassOrder(const std::vector<Pass>& passes);
  // Whether b waits for a third pass that waits for a.
  bool stand_apart(size_t a, size_t b) const;
  // Pass a, which stands apart from b in neither direction, is now part of b.
  void merge(size_t a, size_t b);

 private:
  using Set = std::vector<uint64_t>;  // of passes
  static bool has(const Set& set, size_t k) { return (set[k / 64] >> (k % 64) & 1) != 0; }
  static void add(Set& set, const Set& more) {
    for (size_t k = 0; k < set.size(); ++k) set[k] |= more[k];
  }
  std::vector<Set> before_;  // all that a pass waits for, through others too
};

}  // namespace dr::backend
