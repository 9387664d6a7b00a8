// SPDX-License-Identifier: Apache-2.0
// Which block of elements pays for a map pass with loops in which neighbours read the same: see
// lowering/block_loops.h.
#pragma once

#include <memory>
#include <optional>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

class BlockChooser {
 public:
  BlockChooser(const ir::Graph& graph, const target::Profile& profile);
  ~BlockChooser();

  // Nothing where none pays. `share_to_beat`: of what the pass takes now, beside a compute pass element by element.
  std::optional<Block> choose(const Pass& pass, double share_to_beat = 1);

 private:
  struct State;  // facts about the graph, once a pass has a loop

  const ir::Graph& graph_;
  const target::Profile& profile_;
  std::unique_ptr<State> state_;
};

}  // namespace dr::backend
