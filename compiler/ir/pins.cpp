// SPDX-License-Identifier: Apache-2.0
#include "compiler/ir/pins.h"

#include <cctype>
#include <set>

namespace dr::ir {

std::map<ValueId, std::string> pin_names(const Graph& graph) {
  std::map<ValueId, std::string> names;
  std::set<std::string> taken;
  for (const OpId id : graph.region(graph.root()).ops) {
    const Op& op = graph.op(id);
    if (op.kind != OpKind::Pin) continue;
    std::string base = graph.value(op.results[0]).name;
    if (base.empty()) base = graph.value(op.operands[0]).name;
    if (base.empty()) base = "pin";
    for (char& c : base) {
      if (std::isalnum(static_cast<unsigned char>(c)) == 0) c = '_';
    }
    std::string name = base;
    for (int n = 2; !taken.insert(name).second; ++n) name = base + "_" + std::to_string(n);
    names[op.results[0]] = name;
  }
  return names;
}

}  // namespace dr::ir
