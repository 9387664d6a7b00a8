// SPDX-License-Identifier: Apache-2.0
// Any text as a schedule: an error, violations, or a schedule that prints and parses to itself.
#include <cstdint>
#include <string_view>

#include "compiler/backend/schedule/text.h"
#include "compiler/passes/passes.h"
#include "tests/fuzz/check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  namespace backend = dr::backend;
  static const auto profile = std::get<dr::target::Profile>(dr::target::load_profile("lavapipe"));
  if (size > dr::fuzz::kMaxInput) return 0;
  const auto parsed = backend::parse_schedule(std::string_view(reinterpret_cast<const char*>(data), size));
  const auto* found = std::get_if<backend::ParsedSchedule>(&parsed);
  if (found == nullptr) return 0;
  const std::string text = backend::print_whole(found->graph, found->schedule);
  const auto again = backend::parse_schedule(text);
  if (const auto* error = std::get_if<dr::ir::ParseError>(&again))
    DR_ICE("a printed schedule does not parse: line " + std::to_string(error->line) + ": " + error->message + "\n" +
           text);
  const auto& twice = std::get<backend::ParsedSchedule>(again);
  if (backend::print_whole(twice.graph, twice.schedule) != text)
    DR_ICE("a printed schedule parses to another one:\n" + text);
  if (dr::passes::verify(found->graph).empty()) backend::check_schedule(found->graph, found->schedule, profile);
  return 0;
}
