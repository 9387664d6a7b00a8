// SPDX-License-Identifier: Apache-2.0
// Why a gradient is what it is: along which values it flows from a loss to what it is taken for, and where it is cut.
// An analysis of the graph as lowered, before differentiate; no number is computed.
#pragma once

#include <span>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::passes {

// A place where a dependency carries no gradient: the op nearest to the target that ends it.
struct GradientCut {
  ir::OpId op;
  std::string reason;  // "'floor' is constant between its jumps"
};

// One value on the way that has a name of the user's (or the loss, or the target), and the ops that lead from it to
// the next stop, nearest first, each once.
struct GradientStop {
  ir::ValueId value;
  std::vector<ir::OpKind> through;
};

struct GradientExplanation {
  enum class Verdict : uint8_t {
    Flows,
    Cut,          // the loss depends on the target, but only across cuts
    Independent,  // the loss does not depend on the target at all
    NotFloat,     // one of the two is made of integers or Bools
  };
  Verdict verdict = Verdict::Independent;
  std::vector<std::vector<GradientStop>> paths;  // of Flows: the few shortest, loss first
  size_t more_paths = 0;                         // found beside those; counting stops at some number
  std::vector<GradientCut> cuts;                 // dependencies that carry nothing, also where others flow
  std::vector<ir::OpId> clamps;                  // of Flows: ops on the paths that stop it outside their limits
};

// The gradient of `loss` with respect to any of `targets`, all values of the root; precondition: no target is empty.
GradientExplanation explain_gradient(const ir::Graph& graph, ir::ValueId loss, std::span<const ir::ValueId> targets);

}  // namespace dr::passes
