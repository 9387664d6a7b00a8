// SPDX-License-Identifier: Apache-2.0
// One pass over the root of a graph.
#pragma once

#include <span>
#include <variant>
#include <vector>

#include "compiler/reference/evaluate.h"

namespace dr::reference {

// What an evaluation reads besides the graph.
struct Given {
  const ir::SymbolValues& symbols;
  std::span<const std::optional<Image>> leaves;  // by Graph::leaves index, all there
  int64_t step_index = 0;
};

struct Evaluated {
  std::vector<Image> images;
  std::vector<EvalError> warnings;
};

// The images of root values, in their order.
std::variant<Evaluated, EvalError> evaluate_values(const ir::Graph& graph, std::span<const ir::ValueId> values,
                                                   const Given& given, const Options& options);

// "input 'photo'"
std::string describe(const ir::Leaf& leaf);

}  // namespace dr::reference
