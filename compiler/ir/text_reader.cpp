// SPDX-License-Identifier: Apache-2.0
#include "compiler/ir/text_reader.h"

#include <algorithm>
#include <array>

#include "compiler/ir/print.h"

namespace dr::ir {

char TextReader::peek() {
  while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\t' || text_[at_] == '\r')) ++at_;
  if (text_.substr(at_).starts_with("//")) at_ = std::min(text_.find('\n', at_), text_.size());
  return at_ < text_.size() ? text_[at_] : '\n';
}

void TextReader::skip_lines() {
  while (peek() == '\n' && at_ < text_.size()) {
    ++at_;
    ++line_;
  }
}

bool TextReader::fail(std::string message) {
  error_ = {line_, std::move(message)};
  return false;
}

bool TextReader::expected(std::string_view what) {
  const char c = peek();
  std::string found;
  if (at_ >= text_.size()) {
    found = "the end of the text";
  } else if (c == '\n') {
    found = "the end of the line";
  } else {
    const std::string_view word = peek_word();
    found = shown(word.empty() ? std::string_view(&c, 1) : word);
  }
  return fail("expected " + std::string(what) + ", found " + found);
}

bool TextReader::take(char c) {
  if (peek() != c || at_ >= text_.size()) return false;
  ++at_;
  return true;
}

std::string_view TextReader::peek_word() {
  peek();
  size_t end = at_;
  while (end < text_.size() && is_name_char(text_[end])) ++end;
  return text_.substr(at_, end - at_);
}

bool TextReader::take_word(std::string_view word) {
  if (peek_word() != word) return false;
  at_ += word.size();
  return true;
}

bool TextReader::quoted(std::string& out) {
  if (!expect('"')) return false;
  out.clear();
  while (at_ < text_.size() && text_[at_] != '\n') {
    const char c = text_[at_++];
    if (c == '"') return true;
    if (c != '\\') {
      out += c;
      continue;
    }
    const char escape = at_ < text_.size() ? text_[at_++] : '\n';
    if (escape == '"' || escape == '\\') {
      out += escape;
    } else if (escape == 'n') {
      out += '\n';
    } else if (unsigned byte = 0;
               escape == 'x' && at_ + 2 <= text_.size() &&
               std::from_chars(text_.data() + at_, text_.data() + at_ + 2, byte, 16).ptr == text_.data() + at_ + 2) {
      out += static_cast<char>(byte);
      at_ += 2;
    } else {
      return fail("expected \\\", \\\\, \\n or \\x and two hexadecimal digits in a quoted text");
    }
  }
  return fail("expected '\"' at the end of a quoted text, found the end of the line");
}

bool TextReader::name(std::string_view what, std::string& out) {
  if (peek() == '"') return quoted(out);
  const std::string_view word = peek_word();
  if (word.empty()) return expected(what);
  out = word;
  at_ += word.size();
  return true;
}

bool TextReader::dim(Dim& out) {
  peek();
  const size_t end = std::min(text_.find_first_of(",]\n", at_), text_.size());
  const std::string_view expression = text_.substr(at_, end - at_);
  const auto parsed = Dim::parse(expression);
  if (!parsed) return fail("expected an extent, found " + shown(expression));
  out = *parsed;
  at_ = end;
  return true;
}

bool TextReader::extent(Extent& extent) {
  const std::array<Dim*, 3> axes = {&extent.w, &extent.h, &extent.l};
  size_t count = 0;
  return bracket_list(
      [&] { return count < axes.size() ? dim(*axes[count++]) : fail("expected at most three extents, found more"); });
}

bool TextReader::type(Type& type, Extent& of) {
  const std::string_view word = peek_word();
  const auto parsed = Type::parse(word);
  if (!parsed) return expected("a type");
  type = *parsed;
  at_ += word.size();
  return peek() != '[' || extent(of);
}

bool TextReader::value_name(std::string& name, uint64_t& number) {
  if (!expect('%')) return false;
  name.clear();
  const size_t begin = at_;
  if (at_ < text_.size() && text_[at_] == '"') {
    if (!quoted(name)) return false;
    if (at_ == text_.size() || text_[at_] != '.') return expected("'.' and a number after a value's name");
    ++at_;
  } else if (begin < text_.size() && is_name_char(text_[begin])) {
    const std::string_view word = peek_word();
    if (const size_t dot = word.rfind('.'); dot != std::string_view::npos) {
      name = word.substr(0, dot);
      at_ += dot + 1;
    }
  }
  const char* first = text_.data() + at_;
  const auto [end, error] = std::from_chars(first, text_.data() + text_.size(), number);
  if (error != std::errc{}) return fail("expected a value's number, as in %12 or %name.12");
  at_ += static_cast<size_t>(end - first);
  if (at_ < text_.size() && is_name_char(text_[at_])) return fail("expected a value's number, as in %12 or %name.12");
  return true;
}

std::string quoted_text(std::string_view text) {
  constexpr std::string_view kHex = "0123456789abcdef";
  std::string out = "\"";
  for (char c : text) {
    const auto byte = static_cast<unsigned char>(c);
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (c == '\n') {
      out += "\\n";
    } else if (byte < 0x20 || byte == 0x7f) {
      out += "\\x";
      out += kHex[byte >> 4];
      out += kHex[byte & 15];
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string written_name(std::string_view name) {
  return !name.empty() && std::ranges::all_of(name, is_name_char) ? std::string(name) : quoted_text(name);
}

}  // namespace dr::ir
