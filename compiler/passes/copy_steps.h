// SPDX-License-Identifier: Apache-2.0
// What passes that write a graph anew do last.
#pragma once

#include "compiler/ir/graph.h"

namespace dr::passes {

// The steps of a graph, with what each of their values became in the new one.
template <class Map>
std::vector<ir::Step> copy_steps(const ir::Graph& from, const Map& map) {
  std::vector<ir::Step> steps = from.steps;
  for (ir::Step& step : steps) {
    for (ir::Output& output : step.outputs) output.value = map[output.value];
    for (ir::Update& update : step.updates) update.value = map[update.value];
  }
  return steps;
}

}  // namespace dr::passes
