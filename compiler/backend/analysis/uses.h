// SPDX-License-Identifier: Apache-2.0
// How ops of the root region use values, which is what decides where they can be computed.
#pragma once

#include <algorithm>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::backend {

template <typename Values>
bool contains(const Values& values, ir::ValueId v) {
  return std::ranges::find(values, v) != values.end();
}

// Whether an op's value is written down wherever it is used (constants, extents, coordinates) rather than stored.
bool is_inline(const ir::Op& op);
// Whether an op reads memory that is there before the step.
bool is_memory(const ir::Op& op);

// Root values that an op uses at its own element, or at other places (then they must be stored). Regions included.
struct Uses {
  std::vector<ir::ValueId> at_element;
  std::vector<ir::ValueId> elsewhere;
};
Uses uses_of(const ir::Graph& graph, const ir::Op& op);

// Those of `ops`, of the root region and in order, that values are made of.
std::vector<ir::OpId> ops_of(const ir::Graph& graph, std::span<const ir::OpId> ops,
                             std::span<const ir::ValueId> values);

// Those of `ops` that are not among others.
std::vector<ir::OpId> without(std::vector<ir::OpId> ops, std::span<const ir::OpId> others);

// Ops of the root region in its order.
std::vector<ir::OpId> in_order(const ir::Graph& graph, const std::set<ir::OpId>& ops);

// Which ops depend on a leaf that the step updates or that is among the `moving` ones, or on its counter, by OpId
// index; the others are its prologue. `order`: root ops, operands before users; `uses` by OpId index.
std::vector<bool> steady_ops(const ir::Graph& graph, const ir::Step& step, std::span<const ir::OpId> order,
                             std::span<const Uses> uses, std::set<std::string> moving = {});
// The same of all ops of the root region.
std::vector<bool> steady_ops(const ir::Graph& graph, const ir::Step& step);

}  // namespace dr::backend
