// SPDX-License-Identifier: Apache-2.0
// Comments are found in the gaps between the lexer's tokens, where only they and blanks stand.
#include "dsl/format/tokens.h"

#include <algorithm>

#include "dsl/source/utf8.h"

namespace dr::dsl {
namespace {

// Blanks at the end of a line mean nothing, except in documentation, where two of them are Markdown's line break.
std::string comment_text(std::string_view text) {
  const bool is_doc = text.starts_with("///") && !text.starts_with("////");
  while (text.ends_with('\r') || (!is_doc && (text.ends_with(' ') || text.ends_with('\t')))) text.remove_suffix(1);
  return std::string(text);
}

// Gives the comments of the text between two tokens to the one before (`previous`, may be null) or the one behind.
void take_gap(std::string_view gap, LaidToken* previous, LaidToken& next) {
  size_t newlines = 0;  // since the last token or comment
  bool same_line = previous != nullptr;
  for (size_t at = 0; at < gap.size();) {
    if (gap[at] == '\n') {
      ++newlines;
      same_line = false;
    }
    if (gap[at] != '/') {
      ++at;
      continue;
    }
    const size_t end = std::min(gap.find('\n', at), gap.size());
    std::string text = comment_text(gap.substr(at, end - at));
    if (same_line) {
      previous->trailing = std::move(text);
    } else {
      next.leading.push_back({std::move(text), newlines > 1});
    }
    newlines = 0;
    same_line = false;
    at = end;
  }
  next.newline_before = gap.find('\n') != std::string_view::npos;
  next.blank_before = newlines > 1;
}

}  // namespace

std::vector<LaidToken> laid_tokens(const SourceManager& sources, FileId file) {
  DiagnosticList ignored;
  Lexer lexer(sources, file, ignored);
  const std::string_view text = sources.text(file);
  size_t last_end = text.starts_with("\xEF\xBB\xBF") ? 3 : 0;
  std::vector<LaidToken> tokens;
  do {
    const Token token = lexer.next();
    LaidToken laid{token.kind, lexer.text(token), token.begin, token.end, {}, {}, false, false};
    take_gap(text.substr(last_end, token.begin - last_end), tokens.empty() ? nullptr : &tokens.back(), laid);
    last_end = token.end;
    tokens.push_back(std::move(laid));
  } while (tokens.back().kind != TokenKind::End);
  return tokens;
}

size_t text_width(std::string_view text) {
  size_t width = 0;
  for (size_t at = 0; at < text.size(); at += std::max<size_t>(utf8_length(text, at), 1)) ++width;
  return width;
}

}  // namespace dr::dsl
