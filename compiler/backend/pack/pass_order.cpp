// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pack/pass_order.h"

#include <map>

namespace dr::backend {

PassOrder::PassOrder(std::span<const Pass> passes)
    : before_(passes.size(), Set((passes.size() + 63) / 64)), after_(before_) {
  std::map<ir::ValueId, size_t> writer;
  std::vector<std::vector<size_t>> waits(passes.size());
  for (size_t k = 0; k < passes.size(); ++k) {
    for (ir::ValueId v : passes[k].reads)
      if (const auto from = writer.find(v); from != writer.end()) waits[k].push_back(from->second);
    for (ir::ValueId v : passes[k].writes) writer[v] = k;
  }
  for (size_t k = 0; k < passes.size(); ++k)
    for (size_t from : waits[k]) {
      add(before_[k], before_[from]);
      put(before_[k], from);
    }
  for (size_t k = passes.size(); k-- > 0;)
    for (size_t from : waits[k]) {
      add(after_[from], after_[k]);
      put(after_[from], k);
    }
}

bool PassOrder::may_merge(size_t a, size_t b) const {
  if (has(before_[a], b)) return false;
  for (size_t k = 0; k < before_[b].size(); ++k)
    if ((before_[b][k] & after_[a][k]) != 0) return false;
  return true;
}

void PassOrder::merge(size_t a, size_t b) {
  merge(before_, a, b);
  merge(after_, a, b);
}

void PassOrder::merge(std::vector<Set>& sets, size_t a, size_t b) {
  add(sets[b], sets[a]);
  take(sets[b], a);
  take(sets[b], b);
  for (Set& set : sets) {
    if (!has(set, a) && !has(set, b)) continue;
    add(set, sets[b]);
    take(set, a);
    put(set, b);
  }
}

}  // namespace dr::backend
