// SPDX-License-Identifier: Apache-2.0
// The lexer. It is exact about numbers, because `2.px`, `0..K` and `pair.0.1` differ from floats only
// by what stands beside the dot, and it never reads a byte twice but for the check of the encoding.
#include "dsl/syntax/lexer.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <charconv>
#include <cstring>
#include <iterator>
#include <limits>
#include <system_error>
#include <utility>

#include "dsl/source/utf8.h"

namespace dr::dsl {
namespace {

// No program is that large; spans, which have 32 bits, could hold 64 times as much.
constexpr size_t kMaxFileSize = size_t{64} << 20;

constexpr bool is_digit(char c) { return c >= '0' && c <= '9'; }
constexpr bool is_word_start(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_'; }
constexpr bool is_word(char c) { return is_word_start(c) || is_digit(c); }

TokenKind word_kind(std::string_view word) {
  static constexpr TokenKind kKeywords[] = {
      TokenKind::Const,  TokenKind::Else, TokenKind::False,    TokenKind::Fn,     TokenKind::For,
      TokenKind::If,     TokenKind::Let,  TokenKind::Minimize, TokenKind::Raster, TokenKind::Reduce,
      TokenKind::Return, TokenKind::True, TokenKind::Var};
  static const auto texts = [] {
    std::array<std::string_view, std::size(kKeywords)> all;
    std::ranges::transform(kKeywords, all.begin(), token_text);
    return all;
  }();
  if (word.size() < 2 || word.size() > 8) return TokenKind::Name;
  for (size_t i = 0; i < texts.size(); ++i) {
    if (texts[i] == word) return kKeywords[i];
  }
  return TokenKind::Name;
}

char32_t decode(std::string_view text, size_t at, size_t length) {
  constexpr uint8_t kMask[] = {0, 0x7F, 0x1F, 0x0F, 0x07};
  char32_t value = static_cast<uint8_t>(text[at]) & kMask[length];
  for (size_t i = 1; i < length; ++i) value = value << 6 | (static_cast<uint8_t>(text[at + i]) & 0x3F);
  return value;
}

std::string code_point_name(char32_t value) {
  std::array<char, 8> digits{};
  const auto result = std::to_chars(digits.data(), digits.data() + digits.size(), static_cast<uint32_t>(value), 16);
  std::string name(digits.data(), result.ptr);
  for (char& c : name) {
    if (c >= 'a') c = static_cast<char>(c - 'a' + 'A');
  }
  return "U+" + (name.size() < 4 ? std::string(4 - name.size(), '0') : std::string()) + name;
}

// The first byte at or after `begin` that is not plain ASCII text, eight bytes at a time.
size_t skip_ascii(std::string_view text, size_t begin) {
  size_t at = begin;
  for (; at + 8 <= text.size(); at += 8) {
    uint64_t bytes = 0;
    std::memcpy(&bytes, text.data() + at, 8);
    const uint64_t zero = (bytes - 0x0101010101010101u) & ~bytes;
    if (((bytes | zero) & 0x8080808080808080u) != 0) break;
  }
  while (at < text.size() && static_cast<uint8_t>(text[at]) < 0x80 && text[at] != '\0') ++at;
  return at;
}

std::string shortened(std::string_view text) {
  constexpr size_t kMaxShown = 40;
  if (text.size() <= kMaxShown) return std::string(text);
  return std::string(text.substr(0, kMaxShown)) + "...";
}

}  // namespace

std::string_view token_text(TokenKind kind) {
  switch (kind) {
    case TokenKind::End:
    case TokenKind::Error:
    case TokenKind::Name:
    case TokenKind::Int:
    case TokenKind::Float:
    case TokenKind::String: return "";
    case TokenKind::Const: return "const";
    case TokenKind::Else: return "else";
    case TokenKind::False: return "false";
    case TokenKind::Fn: return "fn";
    case TokenKind::For: return "for";
    case TokenKind::If: return "if";
    case TokenKind::Let: return "let";
    case TokenKind::Minimize: return "minimize";
    case TokenKind::Raster: return "raster";
    case TokenKind::Reduce: return "reduce";
    case TokenKind::Return: return "return";
    case TokenKind::True: return "true";
    case TokenKind::Var: return "var";
    case TokenKind::LeftParen: return "(";
    case TokenKind::RightParen: return ")";
    case TokenKind::LeftBracket: return "[";
    case TokenKind::RightBracket: return "]";
    case TokenKind::LeftBrace: return "{";
    case TokenKind::RightBrace: return "}";
    case TokenKind::Comma: return ",";
    case TokenKind::Semicolon: return ";";
    case TokenKind::Colon: return ":";
    case TokenKind::Dot: return ".";
    case TokenKind::DotDot: return "..";
    case TokenKind::At: return "@";
    case TokenKind::Arrow: return "->";
    case TokenKind::Assign: return "=";
    case TokenKind::Plus: return "+";
    case TokenKind::Minus: return "-";
    case TokenKind::Star: return "*";
    case TokenKind::Slash: return "/";
    case TokenKind::Percent: return "%";
    case TokenKind::Tilde: return "~";
    case TokenKind::Not: return "!";
    case TokenKind::And: return "&";
    case TokenKind::AndAnd: return "&&";
    case TokenKind::Or: return "|";
    case TokenKind::OrOr: return "||";
    case TokenKind::Xor: return "^";
    case TokenKind::Less: return "<";
    case TokenKind::LessEqual: return "<=";
    case TokenKind::ShiftLeft: return "<<";
    case TokenKind::Greater: return ">";
    case TokenKind::GreaterEqual: return ">=";
    case TokenKind::ShiftRight: return ">>";
    case TokenKind::Equal: return "==";
    case TokenKind::NotEqual: return "!=";
  }
  return "";
}

Lexer::Lexer(const SourceManager& sources, FileId file, DiagnosticList& diagnostics)
    : text_(sources.text(file)), file_(file), diagnostics_(diagnostics) {
  valid_text_ = check_text();
  if (!valid_text_) text_ = {};
  // Some editors put a byte order mark in front of UTF-8 text.
  if (text_.starts_with("\xEF\xBB\xBF")) position_ = 3;
}

bool Lexer::check_text() {
  if (text_.size() > kMaxFileSize) {
    diagnostics_.error(
        Code::E0003, span(0, 0),
        "expected a file of at most " + std::to_string(kMaxFileSize) + " bytes, found " + std::to_string(text_.size()));
    return false;
  }
  for (size_t at = skip_ascii(text_, 0); at < text_.size(); at = skip_ascii(text_, at)) {
    if (text_[at] == '\0') {
      diagnostics_.error(Code::E0002, span(at, at + 1), "expected text, found a zero byte");
      return false;
    }
    const size_t length = utf8_length(text_, at);
    if (length == 0) {
      std::array<char, 2> digits{};
      std::to_chars(digits.data(), digits.data() + 2, static_cast<uint32_t>(static_cast<uint8_t>(text_[at])), 16);
      diagnostics_.error(Code::E0001, span(at, at + 1),
                         "expected UTF-8 text, found the byte 0x" + std::string(digits.data(), 2));
      return false;
    }
    at += length;
  }
  return true;
}

Token Lexer::finish(TokenKind kind, size_t end) {
  Token token{kind, first_on_line_, static_cast<uint32_t>(position_), static_cast<uint32_t>(end), 0};
  if (has_pending_doc_) {
    token.doc = static_cast<uint32_t>(docs_.size());
    docs_.push_back(std::exchange(pending_doc_, {}));
    has_pending_doc_ = false;
  }
  position_ = end;
  first_on_line_ = false;
  last_ = kind;
  return token;
}

void Lexer::take_line_comment() {
  const void* newline = std::memchr(text_.data() + position_, '\n', text_.size() - position_);
  const size_t end =
      newline == nullptr ? text_.size() : static_cast<size_t>(static_cast<const char*>(newline) - text_.data());
  std::string_view comment = text_.substr(position_, end - position_);
  position_ = end;
  // Four slashes draw a line between sections; they document nothing.
  if (!comment.starts_with("///") || comment.starts_with("////")) return;
  comment.remove_prefix(3);
  if (comment.starts_with(' ')) comment.remove_prefix(1);
  if (comment.ends_with('\r')) comment.remove_suffix(1);
  if (has_pending_doc_) pending_doc_ += '\n';
  pending_doc_ += comment;
  has_pending_doc_ = true;
}

// There are none, but whoever writes one expects its content to vanish.
void Lexer::skip_block_comment() {
  diagnostics_.error(Code::E0004, span(position_, position_ + 2), "expected code, found '/*'").help =
      "write '//' in front of each line of a comment";
  const size_t end = text_.find("*/", position_ + 2);
  position_ = end == std::string_view::npos ? text_.size() : end + 2;
}

void Lexer::skip_blanks() {
  while (position_ < text_.size()) {
    const char c = text_[position_];
    if (c == '\n') {
      first_on_line_ = true;
      ++position_;
    } else if (c == ' ' || c == '\t' || c == '\r') {
      ++position_;
    } else if (c == '/' && at(position_ + 1) == '/') {
      take_line_comment();
    } else if (c == '/' && at(position_ + 1) == '*') {
      skip_block_comment();
    } else {
      return;
    }
  }
}

Token Lexer::next() {
  skip_blanks();
  if (position_ >= text_.size()) return finish(TokenKind::End, text_.size());
  const char c = text_[position_];
  if (is_word_start(c)) return lex_word();
  if (is_digit(c)) return lex_number();
  if (c == '"') return lex_string();
  return lex_punctuation();
}

Token Lexer::lex_word() {
  size_t end = position_ + 1;
  while (end < text_.size() && is_word(text_[end])) ++end;
  constexpr size_t kLongest = 100;
  if (end - position_ > kLongest) {
    diagnostics_.error(Code::E0009, span(position_, end),
                       "expected a name of at most " + std::to_string(kLongest) + " letters, found " +
                           std::to_string(end - position_));
    return finish(TokenKind::Error, end);
  }
  TokenKind kind = word_kind(text_.substr(position_, end - position_));
  // Beside a dot it is the library's module `std.raster`, which keeps its name.
  size_t next = end;
  while (at(next) == ' ' || at(next) == '\n' || at(next) == '\r') ++next;
  if (kind == TokenKind::Raster && (last_ == TokenKind::Dot || at(next) == '.')) kind = TokenKind::Name;
  return finish(kind, end);
}

Token Lexer::number_error(size_t end, std::string message, std::string help) {
  diagnostics_.error(Code::E0007, span(position_, end), std::move(message)).help = std::move(help);
  return finish(TokenKind::Error, end);
}

Token Lexer::lex_number() {
  const auto skip_digits = [&](size_t from) {
    while (from < text_.size() && is_digit(text_[from])) ++from;
    return from;
  };
  size_t end = skip_digits(position_);
  TokenKind kind = TokenKind::Int;
  // After a dot only digits count: `pair.0.1` is item 1 of item 0.
  if (last_ != TokenKind::Dot) {
    if (at(end) == '.' && is_digit(at(end + 1))) {
      end = skip_digits(end + 1);
      kind = TokenKind::Float;
    } else if (at(end) == '.' && at(end + 1) != '.' && !is_word_start(at(end + 1))) {
      const std::string number(shortened(text_.substr(position_, end - position_)));
      return number_error(end + 1, "expected a digit after '" + number + ".'", "write '" + number + ".0'");
    }
    if (at(end) == 'e' || at(end) == 'E') {
      const size_t sign = at(end + 1) == '+' || at(end + 1) == '-' ? 1 : 0;
      if (!is_digit(at(end + 1 + sign))) {
        const size_t shown = end + 1 + sign;
        return number_error(
            shown,
            "expected the digits of an exponent after '" + shortened(text_.substr(position_, shown - position_)) + "'",
            "");
      }
      end = skip_digits(end + 1 + sign);
      kind = TokenKind::Float;
    } else if (at(end) == 'u' && kind == TokenKind::Int) {
      ++end;
    }
  }
  if (is_word(at(end))) {
    const std::string number(shortened(text_.substr(position_, end - position_)));
    size_t word_end = end + 1;
    while (word_end < text_.size() && is_word(text_[word_end])) ++word_end;
    const std::string_view word = text_.substr(end, word_end - end);
    std::string help;
    if (word == "px") help = "write '" + number + ".px'";
    if (kind == TokenKind::Float && (word == "f" || word == "F")) help = "write '" + number + "'";
    return number_error(word_end, "expected an operator after '" + number + "', found '" + shortened(word) + "'",
                        std::move(help));
  }
  return finish(kind, end);
}

Token Lexer::lex_string() {
  size_t end = position_ + 1;
  bool good = true;
  while (at(end) != '"') {
    if (end >= text_.size() || text_[end] == '\n') {
      while (text_[end - 1] == '\r') --end;
      diagnostics_.error(Code::E0005, span(position_, end),
                         "expected '\"' at the end of the string, found the end of " +
                             std::string(at(end) == '\0' ? "the file" : "the line"));
      return finish(TokenKind::Error, end);
    }
    if (text_[end] == '\\' && end + 1 < text_.size() && text_[end + 1] != '\n' && text_[end + 1] != '\r') {
      if (std::strchr("\"\\nt", text_[end + 1]) == nullptr) {
        const size_t length = utf8_length(text_, end + 1);
        diagnostics_.error(
            Code::E0006, span(end, end + 1 + length),
            "expected '\\n', '\\t', '\\\"' or '\\\\', found '" + std::string(text_.substr(end, 1 + length)) + "'");
        good = false;
      }
      ++end;
    }
    ++end;
  }
  return finish(good ? TokenKind::String : TokenKind::Error, end + 1);
}

Token Lexer::lex_punctuation() {
  const char second = at(position_ + 1);
  const auto one = [&](TokenKind kind) { return finish(kind, position_ + 1); };
  const auto two = [&](TokenKind kind) { return finish(kind, position_ + 2); };
  switch (text_[position_]) {
    case '(': return one(TokenKind::LeftParen);
    case ')': return one(TokenKind::RightParen);
    case '[': return one(TokenKind::LeftBracket);
    case ']': return one(TokenKind::RightBracket);
    case '{': return one(TokenKind::LeftBrace);
    case '}': return one(TokenKind::RightBrace);
    case ',': return one(TokenKind::Comma);
    case ';': return one(TokenKind::Semicolon);
    case ':': return one(TokenKind::Colon);
    case '@': return one(TokenKind::At);
    case '+': return one(TokenKind::Plus);
    case '*': return one(TokenKind::Star);
    case '/': return one(TokenKind::Slash);
    case '%': return one(TokenKind::Percent);
    case '~': return one(TokenKind::Tilde);
    case '^': return one(TokenKind::Xor);
    case '.': return second == '.' ? two(TokenKind::DotDot) : one(TokenKind::Dot);
    case '-': return second == '>' ? two(TokenKind::Arrow) : one(TokenKind::Minus);
    case '=': return second == '=' ? two(TokenKind::Equal) : one(TokenKind::Assign);
    case '!': return second == '=' ? two(TokenKind::NotEqual) : one(TokenKind::Not);
    case '&': return second == '&' ? two(TokenKind::AndAnd) : one(TokenKind::And);
    case '|': return second == '|' ? two(TokenKind::OrOr) : one(TokenKind::Or);
    case '<':
      // `<-` stays two tokens: only the parser knows an update from `a <-1.0`.
      if (second == '<') return two(TokenKind::ShiftLeft);
      return second == '=' ? two(TokenKind::LessEqual) : one(TokenKind::Less);
    case '>':
      if (second == '>') return two(TokenKind::ShiftRight);
      return second == '=' ? two(TokenKind::GreaterEqual) : one(TokenKind::Greater);
    default: return lex_stray();
  }
}

Token Lexer::lex_stray() {
  const size_t length = utf8_length(text_, position_);
  const char32_t value = decode(text_, position_, length);
  std::string found = code_point_name(value);
  if (value > 0x20 && value < 0x7F) {
    found = "'" + std::string(1, text_[position_]) + "'";
  } else if (value >= 0xA0) {
    found = "'" + std::string(text_.substr(position_, length)) + "' (" + found + ")";
  }
  Diagnostic& diagnostic =
      diagnostics_.error(Code::E0004, span(position_, position_ + length), "expected code, found " + found);
  if (value == '?') diagnostic.help = "write 'if condition { a } else { b }'";
  // A word in another script is one mistake, not one a letter.
  size_t end = position_ + length;
  while (end < text_.size() && static_cast<uint8_t>(text_[end]) >= 0x80) end += utf8_length(text_, end);
  return finish(TokenKind::Error, end);
}

std::optional<int64_t> int_value(std::string_view text) {
  if (text.ends_with('u')) text.remove_suffix(1);
  int64_t value = 0;
  const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
  if (result.ec != std::errc()) return std::nullopt;
  return value;
}

std::optional<double> float_value(std::string_view text) {
  double value = 0;
  const auto result = std::from_chars(text.data(), text.data() + text.size(), value);
  if (result.ec == std::errc()) {
    // Half a step past the largest float: from there on it would round to infinity.
    if (value >= 0x1.ffffffp127) return std::nullopt;
    return value;
  }
  assert(result.ec == std::errc::result_out_of_range);
  // Too small and too large look the same to from_chars: ask for the first digit's decimal place.
  const size_t exponent_at = text.find_first_of("eE");
  const std::string_view digits = text.substr(0, exponent_at);
  const size_t point = std::min(digits.find('.'), digits.size());
  const size_t first = digits.find_first_of("123456789");
  if (first == std::string_view::npos) return 0.0;
  int64_t place = first < point ? static_cast<int64_t>(point - first) - 1 : -static_cast<int64_t>(first - point);
  if (exponent_at != std::string_view::npos) {
    std::string_view exponent = text.substr(exponent_at + 1);
    const bool negative = exponent.starts_with('-');
    if (negative || exponent.starts_with('+')) exponent.remove_prefix(1);
    const int64_t size = int_value(exponent).value_or(std::numeric_limits<int64_t>::max() / 2);
    // Saturates: no text is long enough to bring the place back from there.
    place += std::min(size, std::numeric_limits<int64_t>::max() / 2) * (negative ? -1 : 1);
  }
  if (place > 0) return std::nullopt;
  return 0.0;
}

std::string string_value(std::string_view text) {
  assert(text.size() >= 2);
  text = text.substr(1, text.size() - 2);
  std::string value;
  value.reserve(text.size());
  for (size_t i = 0; i < text.size(); ++i) {
    if (text[i] != '\\') {
      value += text[i];
      continue;
    }
    ++i;
    value += text[i] == 'n' ? '\n' : text[i] == 't' ? '\t' : text[i];
  }
  return value;
}

}  // namespace dr::dsl
