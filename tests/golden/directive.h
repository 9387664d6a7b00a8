// SPDX-License-Identifier: Apache-2.0
// The directives of a golden file: comment lines that say how to run drc on it and what to expect.
//
//   //TEST: <drc arguments>        stdout equals name.expected; {file} is the file's name, appended if not mentioned
//   //TEST[tag]: <drc arguments>   stdout equals name.tag.expected
//   //COMPARE: stderr              the tests of this file look at stderr instead of stdout
//   //EXIT: n                      exit code of this file's tests, 0 by default
//   //CHECK: text                  text is in the first test's stdout, after the previous CHECK's ...
//   //CHECK-NOT: text              ... or is not, between its neighbours; such a test has no .expected file
//   //ERROR: E0312 text            `drc check` reports this for the line above; no error may go without a directive
//   //SKIP: reason                 the file is known to fail, and fails once it passes
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace dr::golden {

struct TestRun {
  size_t line = 0;
  std::string tag;  // empty for //TEST:
  std::vector<std::string> arguments;
};

struct Check {
  size_t line = 0;
  bool negative = false;  // CHECK-NOT
  std::string text;
};

struct ExpectedError {
  size_t line = 0;       // of the directive
  size_t code_line = 0;  // of the code above it
  std::string code;
  std::string text;  // a part of the message, may be empty
};

struct Directives {
  std::vector<TestRun> tests;
  std::vector<Check> checks;
  std::vector<ExpectedError> errors;
  int exit_code = 0;
  bool compare_stderr = false;
  std::optional<std::string> skip;
  std::vector<std::string> problems;  // directives that make no sense, as `line: message`

  bool any() const { return !tests.empty() || !errors.empty() || !problems.empty(); }
};

Directives parse_directives(std::string_view text);

// The expectation file of a test of `stem`: "stem.expected" or "stem.tag.expected".
std::string expectation_name(const std::string& stem, const TestRun& test);

// The line of code that an error reported at `line` belongs to: directives, and the blank end of the file, count to the
// code above them, since a parser that runs out of text reports where the text ends.
size_t code_line_of(std::string_view text, size_t line);

}  // namespace dr::golden
