// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pass_order.h"

#include <map>

namespace dr::backend {

PassOrder::PassOrder(const std::vector<Pass>& passes) : before_(passes.size(), Set((passes.size() + 63) / 64)) {
  std::map<ir::ValueId, size_t> writer;
  for (size_t k = 0; k < passes.size(); ++k) {
    for (ir::ValueId v : passes[k].reads) {
      const auto from = writer.find(v);
      if (from == writer.end()) continue;
      add(before_[k], before_[from->second]);
      before_[k][from->second / 64] |= uint64_t{1} << (from->second % 64);
    }
    for (ir::ValueId v : passes[k].writes) writer[v] = k;
  }
}

bool PassOrder::stand_apart(size_t a, size_t b) const {
  for (size_t k = 0; k < before_.size(); ++k)
    if (k != a && has(before_[b], k) && has(before_[k], a)) return true;
  return false;
}

void PassOrder::merge(size_t a, size_t b) {
  const uint64_t a_bit = uint64_t{1} << (a % 64), b_bit = uint64_t{1} << (b % 64);
  add(before_[b], before_[a]);
  before_[b][a / 64] &= ~a_bit;
  for (Set& set : before_) {
    if (!has(set, a) && !has(set, b)) continue;
    add(set, before_[b]);
    set[a / 64] &= ~a_bit;
    set[b / 64] |= b_bit;
  }
}

}  // namespace dr::backend
