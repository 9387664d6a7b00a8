// SPDX-License-Identifier: Apache-2.0
// Hostile programs through checking and the passes: cut off anywhere, nested as deep as the parser lets them, or deep
// by calls alone. They end in messages or in sound graphs. tests/unit/dsl/parser_limit_test.cpp has what the parser
// refuses.
#include <fstream>
#include <sstream>

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/syntax/parser.h"
#include "tests/catch.h"
#include "tests/sanitized.h"

using namespace dr;

namespace {

// The messages of a program; of one without errors, "" once its graph is through all passes.
std::string compile(const std::string& text) {
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph = lower::lower(sources, sources.add("test.dr", text), {}, diagnostics);
  CHECK(graph.has_value() != diagnostics.has_errors());
  if (!graph) return dsl::format(diagnostics, sources);
  const ir::Graph done = passes::run_passes(*graph, passes::default_passes());
  CHECK(std::holds_alternative<ir::Graph>(ir::parse(ir::print(done))));
  return "";
}

std::string repeat(std::string_view text, size_t count) {
  std::string result;
  for (size_t i = 0; i < count; ++i) result += text;
  return result;
}

// A program whose value is nested, and its gradient.
std::string nested(std::string_view open, std::string_view close, size_t count) {
  return "edition 1; param x : float[4]; let y = " + repeat(open, count) + "x" + repeat(close, count) +
         "; step s { output y, g = grad(sum(y), x); }";
}

std::string read(const std::string& file) {
  std::ostringstream text;
  text << std::ifstream(std::string(DR_SOURCE_DIR) + "/" + file, std::ios::binary).rdbuf();
  return std::move(text).str();
}

}  // namespace

TEST_CASE("a program may end at every byte") {
  const std::string text = read("docs/examples/fit_sphere.dr");
  REQUIRE(text.size() > 1000);
  CHECK(compile(text).empty());
  const size_t step = kSanitized ? 7 : 1;  // a minute otherwise
  size_t tried = 0, refused = 0;
  for (size_t length = 0; length < text.size(); length += step) {
    ++tried;
    if (!compile(text.substr(0, length)).empty()) ++refused;
  }
  CHECK(refused > tried / 2);
}

TEST_CASE("every construct may nest as deep as the parser reads") {
  const size_t depth = dsl::kMaxNesting - 2;  // the call at the innermost place and the block around take two
  CHECK(compile(nested("(", ")", depth)).empty());
  CHECK(compile(nested("-", "", depth)).empty());
  CHECK(compile(nested("sin(", ")", depth)).empty());
  CHECK(compile(nested("{", "}", depth)).empty());
  CHECK(compile(nested("{ let z = ", "; z }", depth)).empty());
  CHECK(compile(nested("[", "][0]", depth)).empty());
  CHECK(compile(nested("if x > 0.0 { ", " } else { 2.0 }", depth)).empty());
  CHECK(compile(nested("const if true { ", " } else { 2.0 }", depth)).empty());
  CHECK(compile(nested("reduce(sum, i in 0..2) { ", " }", 20)).empty());
  CHECK_FALSE(compile(nested("(1.0, ", ")", depth)).empty());  // a tuple has no gradient
}

TEST_CASE("calls inside calls are counted") {
  std::string functions = "edition 1; param x : float; fn f0(x) { x }";
  for (int k = 1; k < 200; ++k)
    functions += "fn f" + std::to_string(k) + "(x) { " + repeat("(", 100) + "f" + std::to_string(k - 1) + "(x)" +
                 repeat(")", 100) + " }";
  CHECK(compile(functions + "step s { output y = f19(x); }").empty());
  CHECK(compile(functions + "step s { output y = f199(x); }").find("E0505") != std::string::npos);
}

TEST_CASE("chains as long as the parser reads") {
  CHECK(compile(nested("", " + 1.0", dsl::kMaxHeight - 1)).empty());
  CHECK(compile(nested("", " * x", dsl::kMaxHeight - 1)).empty());
}

TEST_CASE("gradients of gradients do not grow without limit") {
  std::string text = "edition 1; param x : float; let y0 = sin(x) * exp(x);";
  for (int k = 1; k <= 30; ++k) text += "let y" + std::to_string(k) + " = grad(y" + std::to_string(k - 1) + ", x);";
  const std::string messages = compile(text + "step s { output y = y30; }");
  CHECK(messages.find("E0503") != std::string::npos);
}

TEST_CASE("an empty program and bytes that are no text") {
  CHECK_FALSE(compile("").empty());
  CHECK_FALSE(compile("edition 1; let \xff\xfe = 1;").empty());
  CHECK_FALSE(compile(std::string("edition 1;\0", 11)).empty());
  CHECK(compile("edition 1;").empty());
}
