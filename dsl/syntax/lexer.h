// SPDX-License-Identifier: Apache-2.0
// Bytes of one file -> tokens, one at a time, so that the size of a file is no matter for memory.
// White space and comments vanish; `///` lines are kept and belong to the token that follows them.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"

namespace dr::dsl {

// Words with a meaning only in some places (`param`, `step`, `in`, `over`, ...) are names.
enum class TokenKind : uint8_t {
  End,
  Error,  // a lexical error, already reported
  Name,
  Int,
  Float,
  String,
  // keywords
  Const,
  Else,
  False,
  Fn,
  For,
  If,
  Let,
  Minimize,
  Raster,
  Reduce,
  Return,
  True,
  Var,
  // punctuation
  LeftParen,
  RightParen,
  LeftBracket,
  RightBracket,
  LeftBrace,
  RightBrace,
  Comma,
  Semicolon,
  Colon,
  Dot,
  DotDot,
  At,
  Arrow,  // ->
  Assign,
  Plus,
  Minus,
  Star,
  Slash,
  Percent,
  Tilde,
  Not,
  And,
  AndAnd,
  Or,
  OrOr,
  Xor,
  Less,
  LessEqual,
  ShiftLeft,
  Greater,
  GreaterEqual,
  ShiftRight,
  Equal,
  NotEqual,
};

// The text of a keyword or of punctuation, "" for the other kinds.
std::string_view token_text(TokenKind kind);

struct Token {
  TokenKind kind = TokenKind::End;
  bool first_on_line = false;
  uint32_t begin = 0;
  uint32_t end = 0;
  uint32_t doc = 0;  // for Lexer::doc
};

class Lexer {
 public:
  // Reports a text that is no text at once (not UTF-8, zero bytes, too large); next() then gives End.
  Lexer(const SourceManager& sources, FileId file, DiagnosticList& diagnostics);

  Token next();  // End for ever after the last one

  std::string_view text(const Token& token) const { return text_.substr(token.begin, token.end - token.begin); }
  // The `///` lines above a token without their slashes, joined by newlines.
  const std::string& doc(const Token& token) const { return docs_[token.doc]; }
  bool valid_text() const { return valid_text_; }

 private:
  bool check_text();
  void skip_blanks();
  void skip_block_comment();
  void take_line_comment();
  Token finish(TokenKind kind, size_t end);
  Token lex_word();
  Token lex_number();
  Token lex_string();
  Token lex_punctuation();
  Token lex_stray();
  Token number_error(size_t end, std::string message, std::string help);
  char at(size_t index) const { return index < text_.size() ? text_[index] : '\0'; }
  Span span(size_t begin, size_t end) const {
    return Span{file_, static_cast<uint32_t>(begin), static_cast<uint32_t>(end)};
  }

  std::string_view text_;
  FileId file_;
  DiagnosticList& diagnostics_;
  size_t position_ = 0;
  bool valid_text_ = false;
  bool first_on_line_ = true;
  TokenKind last_ = TokenKind::End;
  std::string pending_doc_;
  bool has_pending_doc_ = false;
  std::vector<std::string> docs_{std::string()};  // 0: no documentation
};

// The value of an Int token's text, a trailing `u` ignored; nothing if it does not fit 64 bits.
std::optional<int64_t> int_value(std::string_view text);

// The value of a Float token's text; nothing if it is past the largest 32-bit float.
std::optional<double> float_value(std::string_view text);

// The content of a String token: without its quotes, escapes replaced.
std::string string_value(std::string_view text);

}  // namespace dr::dsl
