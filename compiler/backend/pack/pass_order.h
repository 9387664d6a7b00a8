// SPDX-License-Identifier: Apache-2.0
// Which passes wait for which, kept while passes are merged.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

class PassOrder {
 public:
  // `passes` come after what they read. Takes room and time by the square of their number.
  explicit PassOrder(std::span<const Pass> passes);
  // Whether a and b may be one pass, in which a's ops come first: a waits for b in no way, b for a at most directly.
  bool may_merge(size_t a, size_t b) const;
  // Pass a is now part of b.
  void merge(size_t a, size_t b);

 private:
  using Set = std::vector<uint64_t>;  // of passes
  static bool has(const Set& set, size_t k) { return (set[k / 64] >> (k % 64) & 1) != 0; }
  static void put(Set& set, size_t k) { set[k / 64] |= uint64_t{1} << (k % 64); }
  static void take(Set& set, size_t k) { set[k / 64] &= ~(uint64_t{1} << (k % 64)); }
  static void add(Set& set, const Set& more) {
    for (size_t k = 0; k < set.size(); ++k) set[k] |= more[k];
  }
  void merge(std::vector<Set>& sets, size_t a, size_t b);
  std::vector<Set> before_;  // all that a pass waits for, through others too
  std::vector<Set> after_;   // all that wait for a pass
};

}  // namespace dr::backend
