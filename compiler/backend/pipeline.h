// SPDX-License-Identifier: Apache-2.0
// The passes of the back end in the order in which they run, as a table, and the one place that runs them: what a pass
// needs is checked, schedules are verified, and passes are timed here, so that passes hold none of it.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "compiler/backend/compile.h"

namespace dr::backend {

class Generator;

// What a pass may count on.
enum class Fact : uint32_t {
  Packed = 1u << 0,         // every op of a step is in a pass, every pass in a stage
  SumsChosen = 1u << 1,     // every Scatter pass knows how it sums
  PlacesFixed = 1u << 2,    // passes name others by their place: none is added, removed or moved any more
  EntriesKept = 1u << 3,    // rasters that keep entries say so
  Lowered = 1u << 4,        // the schedule is as it will run, within the limits of the profile
  Emitted = 1u << 5,        // the bundle has its commands, and shaders as GLSL
  Dependencies = 1u << 6,   // commands know which leaves they depend on
  CommandsFixed = 1u << 7,  // no command is added or removed any more
  Slots = 1u << 8,          // resources have memory
  Assembled = 1u << 9,      // the bundle has its shaders
  CodeChosen = 1u << 10,    // the schedule says how shaders are written
};
using Facts = uint32_t;
constexpr Facts operator|(Fact a, Fact b) { return static_cast<Facts>(a) | static_cast<Facts>(b); }
constexpr Facts operator|(Facts a, Fact b) { return a | static_cast<Facts>(b); }
std::string_view fact_name(Fact fact);

// A program on its way through the back end.
struct Compilation {
  // `schedule`: that of the graph, where passes have run on it already; see Schedule::after.
  Compilation(const ir::Graph& graph, const target::Profile& profile, const CompileOptions& options,
              Schedule schedule = {});
  ~Compilation();

  const ir::Graph& graph() const { return out.joined ? *out.joined : given_; }

  const target::Profile& profile;
  const CompileOptions& options;
  SourceLines lines;  // of the ops of graph()
  Compiled out;
  std::unique_ptr<Generator> generator;  // of the pass `emit`

 private:
  const ir::Graph& given_;
};

struct BackendPass {
  std::string_view name;
  std::optional<Limit> (*run)(Compilation&);
  Facts needs = 0;
  Facts makes = 0;
  Facts before = 0;  // none of these may hold yet
};
std::span<const BackendPass> backend_passes();

// Runs passes in order, from the one behind Schedule::after on; limits are checked in any case. A pass whose needs do
// not hold, or that leaves an unsound schedule, is an internal error that names it and shows the schedule.
std::optional<Limit> run_backend(Compilation& compilation, std::span<const BackendPass> passes);

}  // namespace dr::backend
