// SPDX-License-Identifier: Apache-2.0
#include "compiler/ir/yields.h"

namespace dr::ir {

std::vector<Yielded> yielded(const Graph& graph, const Op& op, RegionId region) {
  const std::vector<ValueId>& values = graph.region(region).yields;
  std::vector<Yielded> result;
  size_t at = 0;
  for (const Yield how : op.attrs.yields) {
    const bool pair = how == Yield::Scatter && !graph.value(values[at]).accumulation;
    const ValueId index = pair ? values[at++] : ValueId{};
    result.push_back({.index = index, .value = values[at++]});
  }
  DR_ASSERT(at == values.size());
  return result;
}

}  // namespace dr::ir
