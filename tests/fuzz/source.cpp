// SPDX-License-Identifier: Apache-2.0
// Any text as a program: messages or a sound graph, in reasonable time; and what parses can be formatted.
#include <cstdint>
#include <string>

#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/format/format.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > dr::fuzz::kMaxInput) return 0;
  dr::dsl::SourceManager sources;
  dr::dsl::DiagnosticList diagnostics;
  const dr::dsl::FileId root = sources.add("input.dr", std::string(reinterpret_cast<const char*>(data), size));
  // Unrolling is what makes small programs large.
  dr::lower::Options options;
  options.max_ops = 10 * dr::fuzz::kMaxOps;
  options.max_expressions = 50'000;
  const auto graph = dr::lower::lower(sources, root, options, diagnostics);
  const std::string messages = dr::dsl::format(diagnostics, sources);
  if (graph.has_value() == diagnostics.has_errors()) DR_ICE("a graph and errors, or neither: " + messages);
  if (graph) dr::fuzz::check_passes(*graph);
  dr::dsl::DiagnosticList ignored;
  const std::string wrong = dr::dsl::format_source(sources, root, ignored).internal_error;
  if (!wrong.empty()) DR_ICE(wrong);
  return 0;
}
