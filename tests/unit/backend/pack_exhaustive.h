// SPDX-License-Identifier: Apache-2.0
// The best schedule of a small graph, found by trying: every choice of stored values, every way to share shaders. Only
// the order of stages is pack_stages()'s. What greedy packing is judged by.
#pragma once

#include <optional>

#include "compiler/backend/pack/pack.h"

namespace dr::backend_test {

struct Best {
  double cost = 0;  // step_cost() of the first step
  size_t tried = 0;
  backend::Schedule schedule;
};

// Of the first step, which has no updates and whose outputs are computed by ops. Nullopt when there are more than
// `most` schedules to try. An op that reads other places is computed once, as in greedy packing.
std::optional<Best> pack_exhaustive(const ir::Graph& graph, const target::Profile& profile,
                                    const backend::PackOptions& options, const ir::SymbolValues& symbols, size_t most);

}  // namespace dr::backend_test
