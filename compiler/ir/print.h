// SPDX-License-Identifier: Apache-2.0
// The graph's text form. One op a line, types always shown, user names kept, floats in shortest form:
//
//   leaf position : vec3[V] param = [0, 0, 0]      // `= ...` only where the leaf has an initial value
//   leaf face.edge : ivec2[E] input topology edge face
//   %0 : vec3[V] = leaf text "position"
//   %moved.4 : vec3[V] = add %0, %3
//   %9 : float[W, H] = reduce %1, %2 ints [8] dims [W, H, 1] yields [sum] (%i.7 : int[W, H]) {
//     %8 : float[W, H] = gather %4, %i.7
//     yield %8
//   }
//   step fit {
//     output error %9
//     update position %12
//   }
//
// A line of an op holds its results, its name, its operands, those of its attributes that are not empty (ints, floats,
// dims, yields, text), and then its regions: parameters where there are any, and a body. `accumulation` before a type
// marks ValueInfo::accumulation. The number of a value is what counts; the name before it is the user's.
//
// Value numbers are renumbered in the order in which values are made (an op's results come after its regions), so that
// dumps of equal graphs are equal. Spans are not printed.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ir {

std::string print(const Graph& graph);

// For messages about one op: the numbers that print() gives, by ValueId, and the op's line without the bodies of its
// regions.
std::vector<uint32_t> print_numbers(const Graph& graph);
std::string print_use(const Graph& graph, ValueId value, std::span<const uint32_t> numbers);  // %moved.4
std::string print_op(const Graph& graph, OpId op, std::span<const uint32_t> numbers);

// Words of the text form.
std::string_view yield_name(Yield yield);          // "element", "sum", ...
std::string_view leaf_kind_name(Leaf::Kind kind);  // "param", "input", "state"
bool is_name_char(char c);                         // may stand in a name without quotes

}  // namespace dr::ir
