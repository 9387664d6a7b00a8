// SPDX-License-Identifier: Apache-2.0
// Which leaves others than the step itself change from run to run. No Vulkan.
#pragma once

#include <cstdint>
#include <vector>

namespace dr::runtime {

class MovingLeaves {
 public:
  // Of a step that reads or changes these leaves. Versions have one for each leaf of the bundle.
  explicit MovingLeaves(std::vector<uint32_t> leaves) : leaves_(std::move(leaves)) {}
  // A run begins; what the step itself changed before it does not count.
  void begin_run(const std::vector<uint64_t>& versions);
  void end_run(const std::vector<uint64_t>& versions) { seen_ = versions; }
  // What changed before the last run, and before how many runs on end it was just that.
  const std::vector<uint32_t>& moving() const { return moving_; }
  int runs() const { return runs_; }

 private:
  std::vector<uint32_t> leaves_, moving_;
  std::vector<uint64_t> seen_;  // empty before the first run
  int runs_ = 0;
};

}  // namespace dr::runtime
