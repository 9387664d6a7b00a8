// SPDX-License-Identifier: Apache-2.0
// What the parsers of the compiler's own texts, graphs (parse.h) and schedules, share: words, names, numbers, lists,
// types. A text is lines of words; blanks and `//` comments may stand between words. It takes any bytes: texts come
// from files.
#pragma once

#include <charconv>
#include <cstdint>
#include <string>
#include <string_view>
#include <system_error>

#include "compiler/ir/dim.h"
#include "compiler/ir/parse.h"
#include "compiler/ir/type.h"

namespace dr::ir {

// Every rule returns whether it succeeded; the first failure is what error() gives, and the callers unwind.
class TextReader {
 public:
  // `line`: the number of the text's first line.
  explicit TextReader(std::string_view text, uint32_t line = 1) : text_(text), line_(line) {}

  const ParseError& error() const { return error_; }

 protected:
  // Characters and words.

  bool at_end() const { return at_ >= text_.size(); }
  uint32_t line() const { return line_; }
  // The next character of the line; '\n' at its end.
  char peek();
  // Whether this character comes next, without a blank between.
  bool adjoins(char c) const { return at_ < text_.size() && text_[at_] == c; }
  void skip_lines();
  bool fail(std::string message);
  bool expected(std::string_view what);
  bool take(char c);
  bool expect(char c) { return take(c) || expected(std::string{'\'', c, '\''}); }
  bool expect_line_end() { return peek() == '\n' || expected("the end of the line"); }
  std::string_view peek_word();
  bool take_word(std::string_view word);
  bool expect_word(std::string_view word) { return take_word(word) || expected("'" + std::string(word) + "'"); }

  struct Mark {
    size_t at;
    uint32_t line;
  };
  Mark mark() const { return {at_, line_}; }
  void go_back(Mark mark) { at_ = mark.at, line_ = mark.line; }

  // Names, numbers, lists, types.

  // "..." with \" \\ \n \xHH.
  bool quoted(std::string& out);
  // A word or a quoted text.
  bool name(std::string_view what, std::string& out);

  template <class T>
  bool number(std::string_view what, T& out) {
    peek();
    const char* begin = text_.data() + at_;
    const auto [end, error] = std::from_chars(begin, text_.data() + text_.size(), out);
    if (error == std::errc::result_out_of_range)
      return fail(std::string(what) +
                  " out of range: " + std::string(begin, static_cast<size_t>(end - begin) < 40 ? end : begin + 40));
    if (error != std::errc{}) return expected(what);
    at_ += static_cast<size_t>(end - begin);
    return true;
  }

  template <class Item>
  bool comma_list(Item item) {
    do {
      if (!item()) return false;
    } while (take(','));
    return true;
  }

  template <class Item>
  bool bracket_list(Item item) {
    if (!expect('[')) return false;
    if (take(']')) return true;
    return comma_list(item) && (take(']') || expected("',' or ']'"));
  }

  // Up to a comma, a bracket, or the end of the line.
  bool dim(Dim& out);
  bool extent(Extent& out);               // [W, H]
  bool type(Type& type, Extent& extent);  // vec3[W, H]
  // %12 or %name.12
  bool value_name(std::string& name, uint64_t& number);
  // What a message repeats of the text.
  static std::string shown(std::string_view text) { return "'" + std::string(text.substr(0, 40)) + "'"; }

 private:
  std::string_view text_;
  size_t at_ = 0;
  uint32_t line_;
  ParseError error_;
};

// "..." as quoted() takes it, and a name that is quoted where it has to be.
std::string quoted_text(std::string_view text);
std::string written_name(std::string_view name);

}  // namespace dr::ir
