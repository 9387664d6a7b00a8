// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pack/rewriter.h"

#include <algorithm>

namespace dr::backend {

using ir::OpId;

void Rewriter::copy(OpId id) {
  ir::copy_op(from_, id, to_, map_);
  match(id, to_.value(map_[from_.op(id).results[0]]).op);
}

void Rewriter::match(OpId old, OpId now) {
  out_.from.resize(std::max<size_t>(out_.from.size(), now.index + 1));
  out_.from[now.index] = old;
  for (size_t r = 0; r < from_.op(old).regions.size(); ++r) {
    const std::vector<OpId>& before = from_.region(from_.op(old).regions[r]).ops;
    const std::vector<OpId>& after = to_.graph().region(to_.graph().op(now).regions[r]).ops;
    for (size_t k = 0; k < before.size(); ++k) match(before[k], after[after.size() - before.size() + k]);
  }
}

Joined Rewriter::finish() {
  to_.graph().steps = from_.steps;
  for (ir::Step& step : to_.graph().steps) {
    for (ir::Output& output : step.outputs) output.value = map_[output.value];
    for (ir::Update& update : step.updates) update.value = map_[update.value];
  }
  out_.from.resize(to_.graph().op_count());
  out_.graph = std::move(to_).finish();
  return std::move(out_);
}

}  // namespace dr::backend
