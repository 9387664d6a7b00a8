// SPDX-License-Identifier: Apache-2.0
// What a step's commands are, and what each reads and writes.
#include <algorithm>
#include <nlohmann/json.hpp>

#include "runtime/c/handles.h"

using namespace dr::c;
using Json = nlohmann::ordered_json;

namespace {

const char* kind_name(dr::bundle::CommandKind kind) {
  switch (kind) {
    case dr::bundle::CommandKind::Dispatch: return "dispatch";
    case dr::bundle::CommandKind::Draw: return "draw";
    case dr::bundle::CommandKind::Fill: return "fill";
    case dr::bundle::CommandKind::Copy: return "copy";
    case dr::bundle::CommandKind::Reduce: return "reduce";
  }
  return "";
}

// Names of resources, each once, in order.
class Names {
 public:
  explicit Names(const dr::bundle::BundleT& bundle) : bundle_(bundle) {}
  void add(int64_t resource) {
    if (resource < 0) return;
    Json name = bundle_.resources.at(static_cast<size_t>(resource))->name;
    if (std::ranges::find(names_, name) == names_.end()) names_.push_back(std::move(name));
  }
  Json take() { return std::move(names_); }

 private:
  const dr::bundle::BundleT& bundle_;
  Json names_ = Json::array();
};

Json command_of(const dr::bundle::BundleT& bundle, const dr::bundle::CommandT& command) {
  using dr::bundle::Access, dr::bundle::CommandKind;
  Names reads(bundle), writes(bundle);
  for (const auto& binding : command.bindings) {
    if (binding->access != Access::Write) reads.add(binding->resource);
    if (binding->access != Access::Read) writes.add(binding->resource);
  }
  for (const uint32_t input : command.inputs) reads.add(input);
  for (const uint32_t color : command.colors) writes.add(color);
  reads.add(command.source);
  reads.add(command.indirect);
  writes.add(command.target);
  writes.add(command.depth);
  Json lines = Json::array();
  for (const auto& line : command.lines)
    if (line.line() > 0) lines.push_back(bundle.files.at(line.file()) + ":" + std::to_string(line.line()));
  return {{"kind", kind_name(command.kind)}, {"label", command.label},  {"ops", command.ops},
          {"lines", std::move(lines)},       {"reads", reads.take()},   {"writes", writes.take()},
          {"joins", command.joins},          {"steady", command.steady}};
}

}  // namespace

const char* dressi_schedule(dressi_bundle* bundle, const char* step) {
  return guarded(static_cast<const char*>(nullptr), [&] {
    auto& here = given(bundle, "the bundle");
    const std::string name = word(step, "the step");
    const auto& steps = here.tables.steps;
    const auto found = std::ranges::find_if(steps, [&](const auto& s) { return s->name == name; });
    if (found == steps.end()) fail("the program has no step '" + name + "'");
    Json out = Json::array();
    for (const auto& command : (*found)->commands) out.push_back(command_of(here.tables, *command));
    here.schedule = out.dump(-1, ' ', false, Json::error_handler_t::replace);
    return here.schedule.c_str();
  });
}
