// SPDX-License-Identifier: Apache-2.0
// Any text as a graph: an error, violations, or a graph that the passes can rely on.
#include <cstdint>
#include <string_view>

#include "compiler/ir/parse.h"
#include "compiler/passes/passes.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > dr::fuzz::kMaxInput) return 0;
  const auto parsed = dr::ir::parse(std::string_view(reinterpret_cast<const char*>(data), size));
  const auto* graph = std::get_if<dr::ir::Graph>(&parsed);
  if (graph != nullptr && dr::passes::verify(*graph).empty()) dr::fuzz::check_passes(*graph);
  return 0;
}
