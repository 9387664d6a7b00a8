// SPDX-License-Identifier: Apache-2.0
#include "tests/device/accuracy/library_native.h"

#include <algorithm>

namespace dr::accuracy::library {

namespace {

using ir::OpKind;

// The bounds of a value in both profiles, native over strict (cases_native.cpp, ops.md), where the argument is as large
// as a result that is a float allows, of exp 104, of exp2 150; angles are 32 turns at most.
double times_of(OpKind kind) {
  switch (kind) {
    case OpKind::Exp: return (3 + 2 * 104) / 2.0;
    case OpKind::Exp2: return (3 + 2 * 150) / 2.0;
    case OpKind::Expm1: return (4 + 2 * 104) / 4.0;
    case OpKind::Sigmoid: return (12 + 4 * 104) / 5.0;
    case OpKind::Log:
    case OpKind::Log2: return 4 / 3.0;
    case OpKind::Sin:
    case OpKind::Cos: return (4100 + 200) / 1.7;
    case OpKind::Tan: return 12300 / 8.0;
    case OpKind::Asin:
    case OpKind::Acos: return 4900 / 8.0;
    case OpKind::Atan:
    case OpKind::Atan2: return 4100 / 8.0;
    default: return 1;
  }
}

void look(const ir::Graph& graph, const ir::Op& op, FurtherOff& most) {
  if (const double times = times_of(op.kind); times > most.times) most = {times, op.kind};
  for (const ir::RegionId region : op.regions)
    for (const ir::OpId inner : graph.region(region).ops) look(graph, graph.op(inner), most);
}

}  // namespace

FurtherOff further_off(const ir::Graph& graph, std::span<const ir::ValueId> roots) {
  FurtherOff most;
  const std::vector<bool> live = ir::live_ops(graph, roots);
  for (const ir::OpId id : graph.region(graph.root()).ops)
    if (live[id.index]) look(graph, graph.op(id), most);
  return most;
}

}  // namespace dr::accuracy::library
