// SPDX-License-Identifier: Apache-2.0
// Reads the graph's text form back: print(parse(print(g))) == print(g). The form is described in print.h; besides what
// is printed, blank lines and `//` comments may stand anywhere between lines, and uses may leave out a value's name.
// The parser knows no op's meaning: what it accepts may still fail verification.
#pragma once

#include <string>
#include <string_view>
#include <unordered_map>
#include <variant>

#include "compiler/ir/graph.h"

namespace dr::ir {

struct ParseError {
  uint32_t line = 0;
  std::string message;
};

std::variant<Graph, ParseError> parse(std::string_view text);

// The same, with the values by the numbers that the text gives them.
struct NumberedGraph {
  Graph graph;
  std::unordered_map<uint64_t, ValueId> values;
};
std::variant<NumberedGraph, ParseError> parse_numbered(std::string_view text);

}  // namespace dr::ir
