// SPDX-License-Identifier: Apache-2.0
// What can be told of an update of elements that get no gradient, as those of Adam's do:
//   m <- 0.9 * m + 0.1 * g               // g and m are zero, so it stays zero
//   x <- x - rate * m / (sqrt(v) + eps)  // the same in every run, whatever `rate` is by then
#pragma once

#include <map>
#include <set>
#include <span>

#include "compiler/ir/graph.h"

namespace dr::backend {

// Of values at an element. What is zero is fixed, too.
struct RestFacts {
  std::set<ir::ValueId> zero;
  std::set<ir::ValueId> fixed;  // it has the same bits in every run of the step, until the host changes a leaf
  std::map<ir::ValueId, ir::ValueId> chosen;  // of a fixed `select` whose condition is known
};

// Of all values of the root region, some of which are known already.
RestFacts facts_at_rest(const ir::Graph& graph, RestFacts known);

}  // namespace dr::backend
