// SPDX-License-Identifier: Apache-2.0
// The catalogue, the list, the formatter and the search for the nearest name.
#include "dsl/diagnostic/diagnostic.h"

#include <set>

#include "tests/catch.h"

using namespace dr::dsl;

namespace {

// The message for the bytes [begin, end) of a text.
std::string formatted(std::string text, uint32_t begin, uint32_t end) {
  SourceManager sources;
  const FileId file = sources.add("a.dr", std::move(text));
  DiagnosticList list;
  list.error(Code::E0101, Span{file, begin, end}, "expected this, found that");
  std::string out = format(list, sources);
  const std::string message = "error[E0101]: expected this, found that\n";
  const size_t at = out.find(message);
  REQUIRE(at != std::string::npos);
  return out.erase(at, message.size());
}

}  // namespace

TEST_CASE("codes are sorted, unique and have a summary") {
  const std::string_view names[] = {
#define DR_DIAGNOSTIC(code, summary) #code,
#include "dsl/diagnostic/diagnostic_codes.def"
#undef DR_DIAGNOSTIC
  };
  std::string_view last;
  for (const std::string_view name : names) {
    INFO(name);
    CHECK(name.size() == 5);
    CHECK(name > last);
    last = name;
  }
  CHECK(code_name(Code::E0101) == "E0101");
  CHECK(code_summary(Code::E0101) == "something else was expected here");
}

TEST_CASE("a message shows its line and marks its span") {
  SourceManager sources;
  const FileId file = sources.add("fit.dr", "let offset = 1;\nlet x = color + offset;\n");
  DiagnosticList list;
  Diagnostic& error = list.error(Code::E0101, Span{file, 24, 38}, "cannot add vec3 and vec4");
  error.notes.push_back({Span{file, 4, 10}, "'offset' declared here"});
  error.notes.push_back({Span{}, "a note without a place"});
  error.help = "write something else";
  CHECK(format(list, sources) ==
        "fit.dr:2:9: error[E0101]: cannot add vec3 and vec4\n"
        "2 | let x = color + offset;\n"
        "  |         ^^^^^^^^^^^^^^\n"
        "fit.dr:1:5: note: 'offset' declared here\n"
        "note: a note without a place\n"
        "help: write something else\n");
}

TEST_CASE("a warning says so, and a message without a span has no source line") {
  SourceManager sources;
  DiagnosticList list;
  list.warning(Code::E0103, Span{}, "something is odd");
  CHECK(format(list, sources) == "warning[E0103]: something is odd\n");
  CHECK_FALSE(list.has_errors());
}

TEST_CASE("a tab takes one column") {
  CHECK(formatted("\t\tlet\tx;", 6, 7) == "a.dr:1:7: 1 |   let x;\n  |       ^\n");
}

TEST_CASE("a span of several lines marks its part of the first") {
  CHECK(formatted("let x = foo(\n  1);\n", 8, 16) == "a.dr:1:9: 1 | let x = foo(\n  |         ^^^^\n");
}

TEST_CASE("an empty span, the end of a line and the end of a file get one mark") {
  CHECK(formatted("let\nx", 1, 1) == "a.dr:1:2: 1 | let\n  |  ^\n");
  CHECK(formatted("let\nx", 3, 4) == "a.dr:1:4: 1 | let\n  |    ^\n");
  CHECK(formatted("let\r\nx", 3, 5) == "a.dr:1:4: 1 | let\n  |    ^\n");
  CHECK(formatted("let\n", 4, 4) == "a.dr:2:1: 2 |\n  | ^\n");
  CHECK(formatted("", 0, 0) == "a.dr:1:1: 1 |\n  | ^\n");
}

TEST_CASE("the gutter is as wide as the line's number") {
  std::string text(99, '\n');
  text += "let x;";
  CHECK(formatted(text, 103, 104) == "a.dr:100:5: 100 | let x;\n    |     ^\n");
}

TEST_CASE("a code point takes one column, in a span and before it") {
  // Two bytes, three bytes, four bytes.
  CHECK(formatted("\"\xC3\xA9\xE2\x82\xAC\xF0\x9F\x98\x80\" x", 12, 13) ==
        "a.dr:1:13: 1 | \"\xC3\xA9\xE2\x82\xAC\xF0\x9F\x98\x80\" x\n  |       ^\n");
  CHECK(formatted("\xC3\xA9\xE2\x82\xAC", 0, 5) == "a.dr:1:1: 1 | \xC3\xA9\xE2\x82\xAC\n  | ^^\n");
}

TEST_CASE("bytes that are not UTF-8 take one column each") {
  CHECK(formatted("a\x80\xC3 b", 4, 5) == "a.dr:1:5: 1 | a\x80\xC3 b\n  |     ^\n");
}

TEST_CASE("control characters do not reach the terminal") {
  CHECK(formatted("a\x1B[31m\x7F"
                  "b",
                  1, 2) == "a.dr:1:2: 1 | a?[31m?b\n  |  ^\n");
}

TEST_CASE("a very long line is cut around the mark") {
  const std::string long_text(1000, 'x');
  CHECK(formatted(long_text, 500, 503) ==
        "a.dr:1:501: 1 | ..." + std::string(100, 'x') + "...\n  | " + std::string(43, ' ') + "^^^\n");
  CHECK(formatted(long_text, 0, 1000) ==
        "a.dr:1:1: 1 | " + std::string(100, 'x') + "...\n  | " + std::string(100, '^') + "\n");
  CHECK(formatted(long_text, 999, 1000) ==
        "a.dr:1:1000: 1 | ..." + std::string(100, 'x') + "\n  | " + std::string(102, ' ') + "^\n");
  CHECK(formatted(std::string(100, 'x'), 99, 100) ==
        "a.dr:1:100: 1 | " + std::string(100, 'x') + "\n  | " + std::string(99, ' ') + "^\n");
}

TEST_CASE("a long line of wide characters is cut between them") {
  std::string text;
  for (int i = 0; i < 300; ++i) text += "\xE2\x82\xAC";
  std::string shown;
  for (int i = 0; i < 100; ++i) shown += "\xE2\x82\xAC";
  CHECK(formatted(text, 450, 453) == "a.dr:1:451: 1 | ..." + shown + "...\n  | " + std::string(43, ' ') + "^\n");
}

TEST_CASE("errors past the limit are counted and not kept") {
  SourceManager sources;
  DiagnosticList list;
  for (size_t i = 0; i < 25; ++i) {
    CHECK(list.full() == (i >= DiagnosticList::kMaxErrors));
    list.error(Code::E0101, Span{}, "number " + std::to_string(i)).help = "a place to write to";
  }
  CHECK(list.error_count() == 25);
  REQUIRE(list.all().size() == 20);
  CHECK(list.all().back().message == "number 19");
  const std::string text = format(list, sources);
  CHECK(text.find("stopped after 20 errors\n") != std::string::npos);
  CHECK(text.find("number 20") == std::string::npos);
}

TEST_CASE("the nearest name is found, and only a near one") {
  const std::vector<std::string> names = {"param", "input", "state", "luminance", "let", "fn"};
  CHECK(nearest_name("parm", names) == "param");
  CHECK(nearest_name("pamra", names) == std::nullopt);
  CHECK(nearest_name("apram", names) == "param");
  CHECK(nearest_name("lumiance", names) == "luminance");
  CHECK(nearest_name("Luminance", names) == "luminance");
  CHECK(nearest_name("PARAM", names) == "param");
  CHECK(nearest_name("le", names) == "let");
  CHECK(nearest_name("fm", names) == std::nullopt);
  CHECK(nearest_name("banana", names) == std::nullopt);
  CHECK(nearest_name("", names) == std::nullopt);
  CHECK(nearest_name(std::string(1000000, 'x'), names) == std::nullopt);
  CHECK(nearest_name("let", {}) == std::nullopt);
  // The name itself is no suggestion; of two equally near names the first is taken.
  CHECK(nearest_name("input", names) == std::nullopt);
  CHECK(nearest_name("bat", {"cat", "hat"}) == "cat");
}
