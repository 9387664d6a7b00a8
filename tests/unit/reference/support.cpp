// SPDX-License-Identifier: Apache-2.0
// Parsing, binding and running, with failures reported to Catch.
#include "tests/unit/reference/support.h"

#include "compiler/ir/parse.h"
#include "compiler/passes/passes.h"
#include "tests/catch.h"

namespace dr::reference_test {

ir::Graph parse(std::string_view text) {
  auto parsed = ir::parse(text);
  if (const auto* error = std::get_if<ir::ParseError>(&parsed)) FAIL("line " << error->line << ": " << error->message);
  ir::Graph graph = std::get<ir::Graph>(std::move(parsed));
  for (const std::string& violation : passes::verify(graph)) FAIL(violation);
  return graph;
}

Image image(std::string_view type, int64_t width, int64_t height, int64_t layers, std::vector<double> data) {
  Image image{ir::Type::parse(type).value(), width, height, layers, std::move(data)};
  REQUIRE(static_cast<int64_t>(image.data.size()) == image.count() * image.type.components());
  return image;
}

Image row(std::string_view type, std::vector<double> data) {
  const auto width = static_cast<int64_t>(data.size());
  return image(type, width, 1, 1, std::move(data));
}

namespace {

std::variant<reference::StepResult, reference::EvalError> try_run(const ir::Graph& graph, const Images& leaves,
                                                                  const reference::Options& options) {
  reference::Session session(graph);
  for (const auto& [name, data] : leaves) {
    if (const auto message = session.bind(name, data)) FAIL(*message);
  }
  return session.run("s", options);
}

}  // namespace

Images run(const ir::Graph& graph, const Images& leaves, const reference::Options& options) {
  auto result = try_run(graph, leaves, options);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
  return std::get<reference::StepResult>(std::move(result)).outputs;
}

Images run(std::string_view text, const Images& leaves, const reference::Options& options) {
  return run(parse(text), leaves, options);
}

Image result(std::string_view text, const Images& leaves, const reference::Options& options) {
  return run(text, leaves, options).at("r");
}

reference::EvalError error(const ir::Graph& graph, const Images& leaves, const reference::Options& options) {
  auto result = try_run(graph, leaves, options);
  if (!std::holds_alternative<reference::EvalError>(result)) FAIL("the run succeeded");
  return std::get<reference::EvalError>(std::move(result));
}

}  // namespace dr::reference_test
