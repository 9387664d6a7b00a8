// SPDX-License-Identifier: Apache-2.0
// The level of an op: how many rounds of passes must have finished before its own. What is of one level and extent can
// share a shader.
#pragma once

#include <functional>
#include <vector>

#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

struct LevelInput {
  const ir::Graph& graph;
  const std::vector<ir::OpId>& order;  // the ops of the step, operands before users
  const std::vector<Uses>& uses;       // by OpId index
  // Elements over which an element-wise op runs; nullptr for an op that is a pass of its own.
  std::function<const ir::Extent*(const ir::Op&)> domain;
  std::function<bool(ir::ValueId, ir::OpId)> recomputed;  // again where this op uses it; for any op: an invalid one
  std::function<bool(ir::ValueId)> loads;                 // to compute it again takes stored values
  std::function<bool(ir::ValueId)> stored;                // whatever its users do
  std::function<bool(ir::ValueId)> absorbed;              // computed by what uses it, at its level
  std::function<bool(ir::ValueId)> ready;                 // before all levels: nothing waits for it
};

// By OpId index. An op waits for values that it reads at other places, stretched, or from a pass of its own. Within
// that, element-wise ops of an extent gather at as few levels as can be, and each at the earliest of these: a pass
// fewer, and what several of them read is read once.
std::vector<int> find_levels(const LevelInput& in);

}  // namespace dr::backend
