// SPDX-License-Identifier: Apache-2.0
// The formatter's tree: all tokens of a file, grouped by where lines may break. Unlike the syntax tree it keeps every
// token and comment. Private to dsl/format*.cpp.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dsl/format/tokens.h"

namespace dr::dsl {

inline constexpr size_t kNoToken = SIZE_MAX;
inline constexpr size_t kNeverFlat = size_t{1} << 40;  // the width of what cannot stand on one line

struct LayoutNode;
using LayoutPtr = std::unique_ptr<LayoutNode>;

// A part of a node, with what stands around it.
struct LayoutPart {
  LayoutPtr node;
  bool space_before = false;     // Sequence
  bool break_before = false;     // List, Chain, If: the source goes on on a new line here
  size_t separator = kNoToken;   // List, Chain: the comma or operator behind it
  std::vector<Comment> leading;  // above it, on lines of their own
  std::string trailing;          // behind it and its separator
  bool blank_before = false;     // Block
  size_t colon = 0;              // Block: for a leaf with a type, how many parts of its sequence stand before the colon
};

struct LayoutNode {
  enum class Kind : uint8_t {
    Token,
    Sequence,  // parts one after the other
    List,      // open part, part close; without open and close in `output a, b;`
    Block,     // { statements }; without braces for the whole file
    Chain,     // a + b - c: operands of operators of one precedence
    If,        // a sequence a branch, each ending in a Block
  };
  Kind kind = Kind::Token;
  size_t token = kNoToken;  // Token
  size_t open = kNoToken;   // List, Block
  size_t close = kNoToken;
  std::vector<LayoutPart> parts;
  size_t width = 0;  // on one line, or kNeverFlat or more
};

// The tree of a file that parses. Comments are moved out of `tokens` where a node has a place for them. Nothing if the
// tokens do not fit the grammar as the formatter knows it.
LayoutPtr layout_tree(std::vector<LaidToken>& tokens);

}  // namespace dr::dsl
