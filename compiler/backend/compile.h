// SPDX-License-Identifier: Apache-2.0
// The second half of the compiler in one call: differentiated graph -> bundle.
#pragma once

#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/backend/glsl/source.h"
#include "compiler/backend/options.h"
#include "compiler/backend/schedule/schedule.h"
#include "compiler/backend/spirv/spirv.h"
#include "compiler/ir/graph.h"
#include "compiler/target/profile.h"

namespace dr::backend {

struct Compiled {
  std::optional<ir::Graph> joined;  // what the schedule is of, where packing wrote the program's graph anew
  Schedule schedule;
  std::vector<GlslShader> glsl;  // as in bundle.shaders, in order
  bundle::BundleT bundle;
  size_t shaders_found = 0;  // in the cache; the others were assembled
  AssembleTimes times;       // of all threads together
};

// A limit of the profile that cannot be met, in one sentence a line. The program may be right on another device.
struct Limit {
  std::string text;
};

// `graph` has no Grad ops. `schedule`: a sound one of it that passes have run on already, as its text says.
std::variant<Compiled, Limit> compile(const ir::Graph& graph, const target::Profile& profile,
                                      const CompileOptions& options, Schedule schedule = {});

}  // namespace dr::backend
