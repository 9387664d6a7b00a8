// SPDX-License-Identifier: Apache-2.0
// The formatter's view of a text: tokens with the comments and the line breaks around them, which the lexer leaves out.
// Private to dsl/format*.cpp.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/source/source.h"
#include "dsl/syntax/lexer.h"

namespace dr::dsl {

struct Comment {
  std::string text;  // from its slashes to the end of the line
  bool blank_before = false;
};

struct LaidToken {
  TokenKind kind = TokenKind::End;
  std::string_view text;
  uint32_t begin = 0;
  uint32_t end = 0;
  std::vector<Comment> leading;  // on lines of their own, above the token
  std::string trailing;          // on the token's line, behind it
  bool newline_before = false;
  bool blank_before = false;  // between the token, or its leading comments' last, and what stands above

  bool has_comments() const { return !leading.empty() || !trailing.empty(); }
};

// All tokens of a file that lexes without errors, End included.
std::vector<LaidToken> laid_tokens(const SourceManager& sources, FileId file);

// Columns that a text takes: one a code point.
size_t text_width(std::string_view text);

}  // namespace dr::dsl
