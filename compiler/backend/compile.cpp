// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/compile.h"

#include "compiler/backend/pipeline.h"

namespace dr::backend {

std::variant<Compiled, Limit> compile(const ir::Graph& graph, const target::Profile& profile,
                                      const CompileOptions& options, Schedule schedule) {
  Compilation compilation(graph, profile, options, std::move(schedule));
  if (auto limit = run_backend(compilation, backend_passes())) return *std::move(limit);
  return std::move(compilation.out);
}

}  // namespace dr::backend
