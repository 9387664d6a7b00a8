// SPDX-License-Identifier: Apache-2.0
// What a compiled program will do, in numbers: `drc build --report`.
#pragma once

#include <array>
#include <map>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/compile.h"
#include "compiler/backend/cost/lower_bound.h"
#include "compiler/backend/plan/plan_memory.h"
#include "compiler/backend/skips.h"

namespace dr::backend {

// What a run takes.
struct RunReport {
  size_t passes = 0;
  size_t stages = 0;
  double expected_ns = 0;                     // by the profile's costs
  int64_t bytes_read = 0, bytes_written = 0;  // every resource once a command
  LowerBound least;
};

// See lowering/block_loops.h.
struct BlockReport {
  std::string pass;
  std::array<int, 3> each{1, 1, 1};   // elements of an invocation
  std::array<int, 3> group{0, 0, 0};  // invocations that read together, else 0
};

struct StepReport {
  std::string name;
  size_t ops = 0;                        // of the graph that the step computes; constants and leaves do not count
  std::map<std::string, size_t> passes;  // by kind
  size_t commands = 0;                   // of the bundle
  size_t recomputed = 0;                 // ops that stand in a pass although another computes them too
  std::vector<BlockReport> blocks;       // of passes whose invocations compute several elements
  RunReport first;                       // with the prologue
  RunReport steady;                      // later runs, as long as the host binds nothing anew
};

struct Report {
  std::vector<StepReport> steps;
  MemoryUse memory;
  size_t shaders = 0;
  int64_t shader_bytes = 0;
  std::vector<SkipCount> skips;  // of compiling: see docs/explain/skipping.md
};

// `left_out`: what the passes counted that made the graph. The error names a symbol without a value.
std::variant<Report, std::string> report(const ir::Graph& graph, const Compiled& compiled,
                                         const target::Profile& profile, const ir::SymbolValues& symbols,
                                         const passes::Skips::LeftOut& left_out = {});

std::string print(const Report& report);
std::string print_json(const Report& report);

}  // namespace dr::backend
