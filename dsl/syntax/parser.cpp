// SPDX-License-Identifier: Apache-2.0
// The parser's ground floor: tokens, errors, recovery, and the two entry points. Items and types are in
// parser_decl.cpp, blocks and statements in parser_stmt.cpp, expressions in parser_expr.cpp.
#include "dsl/syntax/parser.h"

#include <utility>

#include "dsl/diagnostic/foreign_words.h"
#include "dsl/syntax/parser_impl.h"

namespace dr::dsl {
namespace {

// Names in messages; a text may hold a name of any length.
std::string shown_part(std::string_view text) {
  constexpr size_t kMaxShown = 40;
  if (text.size() <= kMaxShown) return std::string(text);
  return std::string(text.substr(0, kMaxShown)) + "...";
}

std::string quoted(std::string_view text) { return "'" + shown_part(text) + "'"; }

}  // namespace

Module parse(const SourceManager& sources, FileId file, DiagnosticList& diagnostics) {
  return Parser(sources, file, diagnostics).parse_module();
}

ExprPtr parse_expression(const SourceManager& sources, FileId file, DiagnosticList& diagnostics) {
  return Parser(sources, file, diagnostics).parse_single_expression();
}

Parser::Parser(const SourceManager& sources, FileId file, DiagnosticList& diagnostics)
    : sources_(sources), file_(file), diagnostics_(diagnostics), lexer_(sources, file, diagnostics) {
  token_ = lexer_.next();
  next_ = lexer_.next();
  if (!lexer_.valid_text()) stop();
}

Module Parser::parse_module() {
  Module module;
  module.file = file_;
  if (stopped_) return module;
  parse_edition(module);
  if (panicking_) recover(Place::Item);
  while (!at(TokenKind::End)) {
    parse_item(module);
    if (panicking_) recover(Place::Item);
  }
  return module;
}

ExprPtr Parser::parse_single_expression() {
  ExprPtr expr = parse_expr();
  if (!broken() && !at(TokenKind::End)) {
    fail(Code::E0101, span(token_), "expected the end of the expression, found " + found());
  }
  return expr;
}

// ---- tokens ----

void Parser::advance() {
  if (at(TokenKind::End)) return;
  last_ = token_;
  token_ = next_;
  if (!at(TokenKind::End)) next_ = lexer_.next();
  if (diagnostics_.full()) stop();
}

bool Parser::take(TokenKind kind) {
  if (broken() || !at(kind)) return false;
  advance();
  return true;
}

// Nothing after this place is read: what follows sees the end of the file, and says nothing.
void Parser::stop() {
  stopped_ = true;
  token_.kind = TokenKind::End;
  next_.kind = TokenKind::End;
}

Span Parser::span_from(uint32_t begin) const { return Span{file_, begin, last_.end > begin ? last_.end : begin}; }

Name Parser::take_name_token() {
  Name name{text(token_), span(token_)};
  advance();
  return name;
}

// ---- errors ----

Diagnostic& Parser::report(Code code, const Span& where, std::string message) {
  // The lexer has already said what is wrong with this token.
  if (at(TokenKind::Error)) panicking_ = true;
  if (broken()) return ignored_ = Diagnostic{};
  Diagnostic& diagnostic = diagnostics_.error(code, where, std::move(message));
  // At the end of the file everything that is still open would complain as well.
  if (at(TokenKind::End) || diagnostics_.full()) stop();
  return diagnostic;
}

Diagnostic& Parser::fail(Code code, const Span& where, std::string message) {
  Diagnostic& diagnostic = report(code, where, std::move(message));
  panicking_ = true;
  return diagnostic;
}

Diagnostic& Parser::fail_expected(Code code, std::string_view what, const After& after) {
  if (broken()) return ignored_ = Diagnostic{};
  std::string message = "expected " + std::string(what);
  if (!after.what.empty() || !after.name.empty()) message += " after";
  if (!after.what.empty()) message += ' ' + std::string(after.what);
  if (!after.name.empty()) message += ' ' + quoted(after.name);
  message += ", found " + found();
  Diagnostic& diagnostic = fail(code, span(token_), std::move(message));
  if (at(TokenKind::Name)) {
    if (const char* help = instead_of_operator(lexer_.text(token_))) diagnostic.help = help;
  }
  return diagnostic;
}

bool Parser::expect(TokenKind kind, const After& after) {
  if (broken()) return false;
  if (take(kind)) return true;
  fail_expected(Code::E0101, quoted(token_text(kind)), after);
  return false;
}

bool Parser::expect_word(std::string_view word, const After& after) {
  if (broken()) return false;
  if (at_word(word)) {
    advance();
    return true;
  }
  Diagnostic& diagnostic = fail_expected(Code::E0101, quoted(word), after);
  if (at(TokenKind::Name)) suggest(diagnostic, lexer_.text(token_), {std::string(word)});
  return false;
}

bool Parser::expect_semicolon(const After& after) {
  if (broken()) return false;
  if (take(TokenKind::Semicolon)) return true;
  const bool line_ended = token_.first_on_line || at(TokenKind::RightBrace) || at(TokenKind::End);
  const bool braces_after_name = at(TokenKind::LeftBrace) && !token_.first_on_line && last_.kind == TokenKind::Name;
  const bool matrix_product = at(TokenKind::At);
  Diagnostic& diagnostic = fail_expected(Code::E0101, "';'", after);
  if (matrix_product) diagnostic.help = "the product of matrices is a * b; of images, nn.matmul(a, b) of std.nn";
  if (braces_after_name) diagnostic.help = "a struct is made by a call: Ray(origin = o, direction = d)";
  if (line_ended && !at(TokenKind::Error)) {
    // The statement before is whole, and so is most likely the next one. The mark goes where the
    // semicolon is missing.
    diagnostic.span = Span{file_, last_.end, last_.end};
    panicking_ = false;
  }
  return false;
}

// The `..` of a range.
bool Parser::expect_range() {
  if (broken()) return false;
  if (take(TokenKind::DotDot)) return true;
  fail_expected(Code::E0101, "'..'", {"the start of the range"}).help =
      "a range is 0..N, the numbers from 0 to N - 1; the elements of an image are x.at(k)";
  return false;
}

void Parser::add_open_note(Diagnostic& diagnostic, const Token& open) const {
  if (!diagnostic.span.valid()) return;
  // On the same line the reader sees it without help.
  if (sources_.position(file_, open.begin).line == sources_.position(file_, diagnostic.span.begin).line) return;
  diagnostic.notes.push_back({span(open), quoted(token_text(open.kind)) + " opened here"});
}

bool Parser::expect_close(TokenKind kind, const Token& open, const After& after) {
  if (broken()) return false;
  if (take(kind)) return true;
  add_open_note(fail_expected(Code::E0101, quoted(token_text(kind)), after), open);
  return false;
}

std::optional<Name> Parser::expect_name(std::string_view what, const After& after) {
  if (broken()) return std::nullopt;
  if (at(TokenKind::Name)) return take_name_token();
  fail_expected(Code::E0101, what, after);
  return std::nullopt;
}

std::string Parser::describe(const Token& token) const {
  switch (token.kind) {
    case TokenKind::End: return "the end of the file";
    case TokenKind::Error: return "an unreadable character";
    case TokenKind::String: return "a string";
    default: return quoted(lexer_.text(token));
  }
}

void Parser::suggest(Diagnostic& diagnostic, std::string_view name, const std::vector<std::string>& known) {
  if (const std::optional<std::string> nearest = nearest_name(name, known)) {
    diagnostic.help = "did you mean " + quoted(*nearest) + "?";
  }
}

Parser::Nest::Nest(Parser& parser) : parser_(parser) {
  if (++parser.nesting_ <= kMaxNesting) return;
  // Past this depth there is no telling what belongs to what: the rest of the file is not read.
  parser.fail(Code::E0106, parser.span(parser.token_),
              "expected at most " + std::to_string(kMaxNesting) + " levels of nesting, found more");
  parser.stop();
}

// ---- recovery ----

bool Parser::starts_item() const {
  switch (token_.kind) {
    case TokenKind::Let: return true;
    case TokenKind::Const:
    case TokenKind::At:
    case TokenKind::Fn: return next_at(TokenKind::Name);
    case TokenKind::Name:
      if (at_private()) return true;
      if (at_word("parameters") && next_at(TokenKind::LeftParen) && token_.first_on_line) return true;
      if (!next_at(TokenKind::Name)) return false;
      return at_word("struct") || at_word("optimizer") || at_word("param") || at_word("input") || at_word("state") ||
             at_word("step") || at_word("import");
    default: return false;
  }
}

// An item's first words in the first column: no statement looks like that, so a block that is open
// here has lost its brace.
bool Parser::at_item_boundary() const {
  if (!token_.first_on_line || at(TokenKind::Let) || at(TokenKind::Const)) return false;
  if (token_.begin > 0 && sources_.text(file_)[token_.begin - 1] != '\n') return false;
  return starts_item();
}

bool Parser::starts_statement() const {
  switch (token_.kind) {
    case TokenKind::Let:
    case TokenKind::Var:
    case TokenKind::For:
    case TokenKind::Return:
    case TokenKind::Minimize: return true;
    case TokenKind::Const: return next_at(TokenKind::If);
    case TokenKind::Name:
      return (at_word("output") && next_at(TokenKind::Name)) || (at_word("break") && next_at(TokenKind::If));
    default: return false;
  }
}

// Skips behind the next `;` or `}` of this block, or up to a line that starts something new. Each token
// is looked at once. Stays in panic where an enclosing construct has to go on.
void Parser::recover(Place place) {
  int depth = 0;
  const auto starts_new = [&] { return place == Place::Item ? starts_item() : starts_statement(); };
  while (!at(TokenKind::End)) {
    if (at_item_boundary()) {
      panicking_ = place != Place::Item;
      return;
    }
    if (depth == 0) {
      if (at(TokenKind::Semicolon)) {
        advance();
        break;
      }
      if (at(TokenKind::RightBrace)) {
        if (place == Place::Item) advance();
        break;
      }
      if (token_.first_on_line && starts_new()) break;
    }
    if (at(TokenKind::LeftBrace)) ++depth;
    const bool closes = at(TokenKind::RightBrace) && --depth == 0;
    advance();
    if (closes && !at(TokenKind::Semicolon) && !at(TokenKind::Else) && (token_.first_on_line || starts_new())) {
      break;
    }
  }
  if (at(TokenKind::End)) stop();
  panicking_ = false;
}

}  // namespace dr::dsl
