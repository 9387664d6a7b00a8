// SPDX-License-Identifier: Apache-2.0
// Where a scatter's contributions come from, one by one, when it is no loop: each has an index and a value, and
// conditions of `if`s around it.
//   if %c yields [scatter] { yield %i, %x } { yield -1, 0 }    =>    at %i, %x where %c
#pragma once

#include <algorithm>
#include <optional>
#include <span>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

struct ScatterLeaf {
  // An `if` around it, from the outermost in, and which of its regions it is in.
  struct Branch {
    ir::OpId op;
    size_t region = 0;
    bool in_table = false;  // rows leave sources out where it is not taken, rather than add zero; see RowsScatter
  };
  std::vector<Branch> path;
  ir::ValueId index, value;

  bool same_place(const ScatterLeaf& other) const {
    return index == other.index && std::ranges::equal(path, other.path, [](const Branch& a, const Branch& b) {
             return a.op == b.op && a.region == b.region;
           });
  }
};

// The contributions of an element of the domain to a result of a root op, ScatterAdd or an `if`, without those that are
// out of range by their text. Nothing where a loop makes them.
std::optional<std::vector<ScatterLeaf>> scatter_leaves(const ir::Graph& graph, ir::ValueId result);

// How often an element of the domain adds to a Scatter result at most; -1 where a loop decides.
int contributions(const ir::Graph& graph, ir::ValueId result);

// The ops that compute `values`, which are seen from where the leaf is, without its conditions, operands before users:
// those of the regions around it, and of `root_ops`, which are in order.
std::vector<ir::OpId> ops_at(const ir::Graph& graph, const ScatterLeaf& leaf, std::span<const ir::OpId> root_ops,
                             std::span<const ir::ValueId> values);

// Values of the root region that `values` are made of, at the leaf.
std::vector<ir::ValueId> root_values_at(const ir::Graph& graph, const ScatterLeaf& leaf,
                                        std::span<const ir::ValueId> values);

}  // namespace dr::backend
