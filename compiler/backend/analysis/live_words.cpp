// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/live_words.h"

#include <algorithm>
#include <map>
#include <vector>

#include "compiler/backend/analysis/uses.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

class Lives {
 public:
  explicit Lives(const Graph& graph) : graph_(graph) {}

  void walk(std::span<const OpId> ops) {
    for (const OpId id : ops) {
      const Op& op = graph_.op(id);
      ++now_;
      for (const ValueId v : op.operands) use(v);
      for (const ir::RegionId region : op.regions) {
        const int first = ++now_;
        for (const ValueId v : graph_.region(region).params) lives_[v].begin = now_;
        walk(graph_.region(region).ops);
        ++now_;
        for (const ValueId v : graph_.region(region).yields) use(v);
        if (op.kind != OpKind::If) stays_through(first);
      }
      for (const ValueId v : op.results) lives_[v].begin = now_;
    }
  }

  void use(ValueId v) {
    Life& life = lives_[source(v)];
    if (life.begin < 0) life.begin = now_;
    life.end = std::max(life.end, now_);
  }

  int most() {
    std::vector<int> change(static_cast<size_t>(now_) + 2);
    for (const auto& [v, life] : lives_) {
      if (life.end <= life.begin || is_same(v)) continue;
      change[static_cast<size_t>(life.begin)] += words(v);
      change[static_cast<size_t>(life.end)] -= words(v);
    }
    int now = 0, most = 0;
    for (const int words : change) most = std::max(most, now += words);
    return most;
  }

 private:
  // From where it is known to where it is used last, in the order of ops. What comes from before them is read where it
  // is used first.
  struct Life {
    int begin = -1, end = -1;
  };

  // The next trip of a loop uses what it finds, as this one did.
  void stays_through(int first) {
    for (auto& [v, life] : lives_)
      if (life.begin < first && life.end >= first) life.end = now_;
  }

  // What has another name only.
  ValueId source(ValueId v) const {
    while (graph_.value(v).op.valid()) {
      const Op& op = graph_.op(graph_.value(v).op);
      if (op.kind != OpKind::Detach && op.kind != OpKind::Pin && op.kind != OpKind::Broadcast) break;
      v = op.operands[0];
    }
    return v;
  }

  int words(ValueId v) const {
    const ir::Type& type = graph_.value(v).type;
    return type.scalar == ir::Scalar::Bool ? 0 : type.components();
  }

  // For all elements.
  bool is_same(ValueId v) const {
    const ir::ValueInfo& info = graph_.value(v);
    if (info.op.valid() && is_inline(graph_.op(info.op))) return true;
    return info.extent.is_unit() && info.op.valid() && graph_.op(info.op).parent == graph_.root();
  }

  const Graph& graph_;
  std::map<ValueId, Life> lives_;
  int now_ = 0;
};

}  // namespace

int live_words(const Graph& graph, std::span<const OpId> ops, std::span<const ValueId> until_end) {
  Lives lives(graph);
  lives.walk(ops);
  for (const ValueId v : until_end) lives.use(v);
  return lives.most();
}

}  // namespace dr::backend
