// SPDX-License-Identifier: Apache-2.0
// Exact sums that the workgroups of a map join what they add to (emit/group_sums.cpp), and how much of their memory
// that takes.
#pragma once

#include <span>
#include <vector>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Sums that an element adds to at the same places, as those of a mesh's positions and normals: the three corners of the
// face that a pixel sees.
struct JoinedSums {
  std::vector<size_t> sums;  // by number, in order
  int elements = 0;          // a workgroup has room for so many, a power of two: those beyond are added to memory
};

// All of `sums`, each in one of these, for workgroups of `group` invocations. Empty: more than one should have.
std::vector<JoinedSums> joined_sums(const ir::Graph& graph, std::span<const ScatterSum* const> sums, int group);

// What the workgroups of a map join.
std::vector<const ScatterSum*> joined_in_groups(const StepSchedule& step, PassId map);

// Whether the workgroups of a device may be so large, and have the memory for them.
bool groups_have_room(const ir::Graph& graph, const target::Profile& profile, std::span<const ScatterSum* const> sums,
                      int group = kJoiningGroup);

}  // namespace dr::backend
