// SPDX-License-Identifier: Apache-2.0
// Reads directives, strictly: a misspelt one would be a test that checks nothing.

#include "tests/golden/directive.h"

#include <algorithm>
#include <cctype>
#include <charconv>

namespace dr::golden {
namespace {

std::string_view trim(std::string_view text) {
  constexpr std::string_view kBlank = " \t\r\n";
  const size_t first = text.find_first_not_of(kBlank);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlank) - first + 1);
}

std::vector<std::string_view> lines_of(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    lines.push_back(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

bool is_error_directive(std::string_view line) { return trim(line).starts_with("//ERROR"); }

// Splits at blanks; '...' and "..." hold blanks together. Nothing on an open quote.
std::optional<std::vector<std::string>> split_arguments(std::string_view text) {
  std::vector<std::string> arguments;
  bool in_argument = false;
  char quote = 0;
  for (const char c : text) {
    if (quote == 0 && (c == ' ' || c == '\t')) {
      in_argument = false;
      continue;
    }
    if (!in_argument) arguments.emplace_back();
    in_argument = true;
    if (quote == 0 && (c == '\'' || c == '"')) {
      quote = c;
    } else if (c == quote) {
      quote = 0;
    } else {
      arguments.back() += c;
    }
  }
  if (quote != 0) return std::nullopt;
  return arguments;
}

bool is_tag(std::string_view tag) {
  return !tag.empty() && std::all_of(tag.begin(), tag.end(), [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '-';
  });
}

// As the name of a directive is written.
bool is_capital(std::string_view name) {
  return name.size() > 1 && std::ranges::all_of(name, [](char c) { return (c >= 'A' && c <= 'Z') || c == '-'; });
}

bool is_error_code(std::string_view code) {
  return code.size() >= 2 && code[0] == 'E' && std::all_of(code.begin() + 1, code.end(), [](char c) {
           return std::isdigit(static_cast<unsigned char>(c)) != 0;
         });
}

class Parser {
 public:
  explicit Parser(std::string_view text) : lines_(lines_of(text)) {}

  Directives run() {
    for (size_t i = 0; i < lines_.size(); ++i) parse_line(i);
    if (result_.tests.empty() && !result_.checks.empty()) problem(result_.checks[0].line, "//CHECK without a //TEST");
    return std::move(result_);
  }

 private:
  void problem(size_t line, const std::string& message) {
    result_.problems.push_back(std::to_string(line) + ": " + message);
  }

  void parse_line(size_t index) {
    const size_t line = index + 1;
    const std::string_view text = trim(lines_[index]);
    if (!text.starts_with("//")) {
      if (text.find("//ERROR") != std::string_view::npos) {
        problem(line, "//ERROR stands on a line of its own, below the code");
      }
      return;
    }
    const std::string_view body = text.substr(2);
    const size_t name_end = std::min(body.find_first_of(":[ \t"), body.size());
    const std::string_view name = body.substr(0, name_end);
    const bool is_directive =
        name == "TEST" || name == "EXIT" || name == "ERROR" || name == "SKIP" || name == "COMPARE";
    if (!is_directive && !name.starts_with("CHECK")) {
      if (is_capital(name) && body.substr(name_end).starts_with(':'))
        problem(line, "unknown directive //" + std::string(name) + "; a comment has a blank behind its //");
      return;
    }

    std::string_view rest = body.substr(name_end);
    std::string tag;
    if (name == "TEST" && rest.starts_with("[")) {
      const size_t close = std::min(rest.find(']'), rest.size());
      tag = std::string(rest.substr(1, close - 1));
      rest.remove_prefix(std::min(close + 1, rest.size()));
      if (!is_tag(tag)) return problem(line, "the tag of //TEST[tag] is letters, digits, '_' or '-'");
    }
    if (!rest.starts_with(":")) return problem(line, "expected ':' after //" + std::string(name));
    const std::string value(trim(rest.substr(1)));

    if (name == "TEST") {
      parse_test(line, tag, value);
    } else if (name == "EXIT") {
      const auto [end, status] = std::from_chars(value.data(), value.data() + value.size(), result_.exit_code);
      if (status != std::errc{} || end != value.data() + value.size()) problem(line, "//EXIT takes a number");
    } else if (name == "COMPARE") {
      if (value != "stderr") problem(line, "//COMPARE takes 'stderr'");
      result_.compare_stderr = true;
    } else if (name == "SKIP") {
      if (value.empty()) problem(line, "//SKIP takes a reason");
      result_.skip = value;
    } else if (name == "ERROR") {
      parse_error(index, value);
    } else if (name == "CHECK" || name == "CHECK-NOT") {
      if (value.empty()) problem(line, "//" + std::string(name) + " takes a text");
      result_.checks.push_back({line, name == "CHECK-NOT", value});
    } else {
      problem(line, "unknown directive //" + std::string(name));
    }
  }

  void parse_test(size_t line, const std::string& tag, const std::string& value) {
    const bool is_taken =
        std::any_of(result_.tests.begin(), result_.tests.end(), [&](const TestRun& test) { return test.tag == tag; });
    if (is_taken) problem(line, tag.empty() ? "a second //TEST needs a tag" : "tag '" + tag + "' is used twice");
    const auto arguments = split_arguments(value);
    if (!arguments) return problem(line, "a quote is not closed");
    result_.tests.push_back({line, tag, *arguments});
  }

  void parse_error(size_t index, const std::string& value) {
    const size_t code_end = std::min(value.find_first_of(" \t"), value.size());
    const std::string code = value.substr(0, code_end);
    if (!is_error_code(code))
      return problem(index + 1, "//ERROR takes a code such as E0312, then a part of the message");
    size_t above = index;  // one-based number of the line above
    while (above > 0 && is_error_directive(lines_[above - 1])) --above;
    if (above == 0) return problem(index + 1, "//ERROR has no code above it");
    result_.errors.push_back({index + 1, above, code, std::string(trim(value.substr(code_end)))});
  }

  std::vector<std::string_view> lines_;
  Directives result_;
};

}  // namespace

Directives parse_directives(std::string_view text) { return Parser(text).run(); }

std::string expectation_name(const std::string& stem, const TestRun& test) {
  return stem + (test.tag.empty() ? "" : "." + test.tag) + ".expected";
}

size_t code_line_of(std::string_view text, size_t line) {
  const std::vector<std::string_view> lines = lines_of(text);
  size_t end = lines.size();  // the last line that is neither blank nor a directive
  while (end > 0 && (trim(lines[end - 1]).empty() || is_error_directive(lines[end - 1]))) --end;
  if (line > end) return end;
  while (line > 1 && is_error_directive(lines[line - 1])) --line;
  return line;
}

}  // namespace dr::golden
