// SPDX-License-Identifier: Apache-2.0
// The reactive cache: which commands of a step must run, from the versions of the leaves that they depend on. No
// Vulkan.
#pragma once

#include <cstdint>
#include <vector>

#include "compiler/backend/bundle/bundle.h"

namespace dr::runtime {

// Commands that depend on the same leaves run together; a step has few such groups.
class RunList {
 public:
  // Of a step that has not run yet: everything must run.
  explicit RunList(const bundle::StepT& step);

  // By group, whether it must run: whether it is steady, or a leaf has another version than when it last ran.
  // `versions` has one for each leaf of the bundle, above 0.
  const std::vector<bool>& dirty(const std::vector<uint64_t>& versions);
  const std::vector<bool>& everything() const { return all_; }
  // The groups of `dirty` have run, and saw these versions. The step's own changes come after that.
  void ran(const std::vector<bool>& dirty, const std::vector<uint64_t>& versions);
  size_t group_of(size_t command) const { return group_of_[command]; }

 private:
  struct Group {
    bool steady;
    bool foresees;
    std::vector<uint32_t> leaves;
    std::vector<uint64_t> seen;  // versions of the leaves in the last run, or, foreseen, behind it
    bool has_run = false;
  };
  std::vector<Group> groups_;
  std::vector<size_t> group_of_;
  std::vector<uint32_t> changes_;
  std::vector<bool> dirty_, all_;
};

}  // namespace dr::runtime
