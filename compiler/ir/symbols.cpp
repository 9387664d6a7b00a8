// SPDX-License-Identifier: Apache-2.0
#include "compiler/ir/symbols.h"

#include <set>

namespace dr::ir {

std::vector<std::string> symbols_of(const Graph& graph) {
  std::set<std::string> symbols;
  const auto add = [&](const Dim& dim) {
    for (std::string& s : dim.symbols()) symbols.insert(std::move(s));
  };
  const auto add_extent = [&](const Extent& e) {
    for (const Dim* d : {&e.w, &e.h, &e.l}) add(*d);
  };
  for (const Leaf& leaf : graph.leaves) add_extent(leaf.extent);
  for (uint32_t k = 0; k < graph.op_count(); ++k)
    for (const Dim& d : graph.op(OpId{k}).attrs.dims) add(d);
  for (uint32_t k = 0; k < graph.value_count(); ++k) add_extent(graph.value(ValueId{k}).extent);
  return {symbols.begin(), symbols.end()};
}

}  // namespace dr::ir
