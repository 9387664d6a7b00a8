// SPDX-License-Identifier: Apache-2.0
// One edit of a graph, as reducing it tries them.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::test {

// What becomes of a value: another one of its type, or a constant. Of what a region inside another one scatters: the
// constant, scattered to the first place.
struct Instead {
  std::optional<ir::ValueId> value;
  double constant = 0;
};

struct Edit {
  std::set<size_t> without_outputs;       // by their running number
  std::map<size_t, ir::ValueId> outputs;  // these become others
  std::map<ir::ValueId, Instead> values;
  ir::OpId inlined;                // a region op that gives way to the ops of one of its regions, run once
  size_t region = 0;               // which
  ir::OpId narrowed;               // a region op that loses a result
  size_t result = 0;               // which
  ir::OpId constant;               // a Const whose components all become
  double becomes = 0;              // this
  int64_t extent = 0, shrunk = 0;  // all extents that are the one become the other
};

// The graph with the edit and without what no step needs then, or nothing where that is no sound graph.
std::optional<ir::Graph> rewritten(const ir::Graph& graph, const Edit& edit);

// All ops that stand in the graph, those of regions before the ops they belong to.
std::vector<ir::OpId> all_ops(const ir::Graph& graph);

}  // namespace dr::test
