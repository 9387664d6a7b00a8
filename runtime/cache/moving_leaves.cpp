// SPDX-License-Identifier: Apache-2.0
#include "runtime/cache/moving_leaves.h"

#include <algorithm>
#include <utility>

namespace dr::runtime {

void MovingLeaves::begin_run(const std::vector<uint64_t>& versions) {
  if (seen_.empty()) return;
  std::vector<uint32_t> now;
  std::copy_if(leaves_.begin(), leaves_.end(), std::back_inserter(now),
               [&](uint32_t leaf) { return versions[leaf] != seen_[leaf]; });
  runs_ = now == moving_ ? runs_ + 1 : 1;
  moving_ = std::move(now);
}

}  // namespace dr::runtime
