// SPDX-License-Identifier: Apache-2.0
// A graph written anew before it is packed, and of which op each of its ops is.
#pragma once

#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

struct Joined {
  ir::Graph graph;
  std::vector<ir::OpId> from;  // by op of `graph`: the op that it was; invalid for new ones
};

// What those who write a graph anew do alike.
class Rewriter {
 protected:
  explicit Rewriter(const ir::Graph& from) : from_(from), map_(from.value_count()) { to_.graph().leaves = from.leaves; }

  // As it is, regions and all.
  void copy(ir::OpId id);
  // Says of an op, and of those inside it, what they were: regions may begin with what is new.
  void match(ir::OpId old, ir::OpId now);
  // Says so of what was added since.
  void match_rest(ir::OpId old) { out_.from.resize(to_.graph().op_count(), old); }
  // The steps, when all ops are there.
  Joined finish();

  const ir::Graph& from_;
  ir::ValueMap map_;
  ir::Builder to_;

 private:
  Joined out_;
};

}  // namespace dr::backend
