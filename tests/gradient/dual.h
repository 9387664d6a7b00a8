// SPDX-License-Identifier: Apache-2.0
// Forward-mode differentiation of a graph, one element at a time: values and tangents together. It shares nothing with
// the adjoint rules, so that <J v, w> from here and <v, J^T w> from the pass `differentiate` check each other.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "compiler/ir/graph.h"
#include "compiler/reference/evaluate.h"

namespace dr::gradient_test {

struct Number {
  double value = 0;
  double tangent = 0;
};
using Element = std::vector<Number>;  // components

struct DualImage {
  int64_t width = 1, height = 1, layers = 1;
  std::vector<Element> elements;  // [(l * height + y) * width + x]
};

struct LeafData {
  reference::Image value;
  reference::Image tangent;  // empty data: zero
};

// All root values by id index. Extents must be constant; throws std::runtime_error for an op it has no tangent of.
std::vector<DualImage> evaluate_dual(const ir::Graph& graph, const std::map<std::string, LeafData>& leaves);

}  // namespace dr::gradient_test
