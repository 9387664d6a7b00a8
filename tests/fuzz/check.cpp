// SPDX-License-Identifier: Apache-2.0
#include "tests/fuzz/check.h"

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "compiler/passes/passes.h"

namespace dr::fuzz {

namespace {

// The text of a graph, which has to parse to itself; `known` is one that does.
std::string check_text(const ir::Graph& graph, const std::string& known = "") {
  std::string text = ir::print(graph);
  if (text == known) return text;
  const auto parsed = ir::parse(text);
  if (const auto* error = std::get_if<ir::ParseError>(&parsed))
    DR_ICE("a printed graph does not parse: line " + std::to_string(error->line) + ": " + error->message + "\n" + text);
  const std::string again = ir::print(std::get<ir::Graph>(parsed));
  if (again != text) DR_ICE("a printed graph parses to another one:\n" + text + "----\n" + again);
  return text;
}

}  // namespace

void check_passes(const ir::Graph& graph) {
  std::string text = check_text(graph);
  if (graph.op_count() > kMaxOps) return;
  DR_ASSERT(passes::verify(graph).empty());
  ir::Graph current = graph;
  for (const passes::Pass& pass : passes::default_passes()) {
    current = passes::run_passes(current, {&pass, 1});  // verifies after
    text = check_text(current, text);                   // most passes leave most graphs as they are
  }
}

}  // namespace dr::fuzz
