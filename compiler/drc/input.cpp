// SPDX-License-Identifier: Apache-2.0
// Reading programs for the commands.
#include "compiler/drc/input.h"

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>

#include "compiler/ir/parse.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/diagnostic.h"
#include "dsl/dump.h"
#include "dsl/parser.h"

namespace dr::drc {

std::string shown_name(const std::string& file) { return file == "-" ? "<stdin>" : file; }

std::optional<std::pair<std::string, std::string>> split_assignment(const std::string& text, std::string_view option) {
  const size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0) {
    print_error("expected name=value after " + std::string(option) + ", found '" + text + "'");
    return std::nullopt;
  }
  return std::pair{text.substr(0, equals), text.substr(equals + 1)};
}

std::optional<std::string> read_text(const std::string& file) {
  std::ostringstream text;
  if (file == "-") {
    text << std::cin.rdbuf();
    return std::move(text).str();
  }
  std::error_code error;
  std::ifstream in;
  if (!std::filesystem::is_directory(file, error)) in.open(file, std::ios::binary);
  if (in.is_open()) text << in.rdbuf();
  if (!in.is_open() || in.bad()) {
    print_error("cannot read '" + file + "'");
    return std::nullopt;
  }
  return std::move(text).str();
}

namespace {

// A graph from the compiler that is unsound is the compiler's mistake; one from a file is the user's.
std::optional<ir::Graph> verified(ir::Graph graph, bool from_text) {
  const std::vector<std::string> violations = passes::verify(graph);
  if (violations.empty()) return graph;
  if (!from_text) {
    std::string message = "lowering gave an unsound graph";
    for (const std::string& violation : violations) message += "\n  " + violation;
    DR_ICE(message);
  }
  for (const std::string& violation : violations) print_error(violation);
  return std::nullopt;
}

std::optional<ir::Graph> parse_graph(const std::string& file, const std::string& text) {
  auto parsed = ir::parse(text);
  if (const auto* error = std::get_if<ir::ParseError>(&parsed)) {
    dsl::SourceManager sources;
    print_line_error(sources, sources.add(shown_name(file), text), error->line, error->message);
    return std::nullopt;
  }
  return verified(std::get<ir::Graph>(std::move(parsed)), true);
}

}  // namespace

std::optional<ir::Graph> load_graph(const InputOptions& options) {
  dsl::SourceManager sources;
  return load_graph(options, sources);
}

std::optional<ir::Graph> load_graph(const InputOptions& options, dsl::SourceManager& sources, bool* has_messages) {
  const auto text = read_text(options.file);
  if (!text) return std::nullopt;
  if (options.file.ends_with(".ir")) return parse_graph(options.file, *text);

  lower::Options lowering;
  lowering.include_dirs = options.include_dirs;
  lowering.plain_gradients = options.plain_gradients;
  for (const std::string& define : options.defines) {
    const auto parts = split_assignment(define, "-D");
    if (!parts) return std::nullopt;
    lowering.defines[parts->first] = parts->second;
  }
  dsl::DiagnosticList diagnostics;
  const dsl::FileId root = sources.add(shown_name(options.file), *text);
  auto graph = lower::lower(sources, root, lowering, diagnostics);
  report(diagnostics, sources);
  if (has_messages) *has_messages = !diagnostics.all().empty();
  if (!graph) return std::nullopt;
  return verified(*std::move(graph), false);
}

std::optional<std::string> load_tree(const InputOptions& options) {
  const auto text = read_text(options.file);
  if (!text) return std::nullopt;
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const dsl::FileId root = sources.add(shown_name(options.file), *text);
  const dsl::Module module = dsl::parse(sources, root, diagnostics);
  report(diagnostics, sources);
  if (diagnostics.has_errors()) return std::nullopt;
  return dsl::dump(module);
}

}  // namespace dr::drc
