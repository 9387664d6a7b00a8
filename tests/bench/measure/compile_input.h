// SPDX-License-Identifier: Apache-2.0
// What the benchmark `compile` compiles: generated, so that it has any size, and the same in every run.
#pragma once

#include <cstddef>
#include <string>

#include "compiler/ir/graph.h"

namespace dr::bench {

// A graph of about `ops` ops, those in regions counted: element-wise arithmetic, indexed reads, scatters, shifts,
// broadcasts, reductions, If and Reduce over lists, pictures and stacks of pictures, a loss over all of it, and its
// gradient with respect to all float leaves.
ir::Graph generated_graph(size_t ops);

// A program of about `lines` lines in the style of the library and the examples.
std::string generated_source(size_t lines);

}  // namespace dr::bench
