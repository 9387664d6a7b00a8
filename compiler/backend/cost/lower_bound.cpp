// SPDX-License-Identifier: Apache-2.0
// The bound only knows what ops demand: it does without extents, limits and costs, as if all maps could be computed
// again wherever they are used at their own element.
#include "compiler/backend/cost/lower_bound.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/schedule.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

class Bound {
 public:
  Bound(const ir::Graph& graph, const ir::Step& step, const ir::SymbolValues& symbols, bool steady)
      : graph_(graph), step_(step), symbols_(symbols), only_steady_(steady), made_(graph.value_count()) {}

  std::optional<LowerBound> process() {
    std::vector<ValueId> roots;
    for (const ir::Output& o : step_.outputs) roots.push_back(o.value);
    for (const ir::Update& u : step_.updates) roots.push_back(u.value);
    const std::vector<bool> live = ir::live_ops(graph_, roots);
    std::vector<OpId> order;
    std::vector<Uses> uses(graph_.op_count());
    for (OpId id : graph_.region(graph_.root()).ops) {
      if (!live[id.index]) continue;
      order.push_back(id);
      uses[id.index] = uses_of(graph_, graph_.op(id));
    }
    counts_.assign(graph_.op_count(), true);
    if (only_steady_) counts_ = steady_ops(graph_, step_, order, uses);

    LowerBound out;
    for (OpId id : order)
      if (const Op& op = graph_.op(id); counts_[id.index] && !is_memory(op) && !is_inline(op))
        out.stages = std::max(out.stages, static_cast<size_t>(place(id, uses[id.index])) + 1);
    for (ValueId v : roots)
      if (counts_[maker(v).index] && !is_memory(graph_.op(maker(v)))) written_.insert(v);
    bool known = true;
    const auto add = [&](const std::set<ValueId>& values) {
      for (ValueId v : values) {
        const ir::ValueInfo& info = graph_.value(v);
        const auto elements = (info.extent.w * info.extent.h * info.extent.l).evaluate(symbols_);
        known = known && elements.has_value();
        out.bytes += (is_packed(graph_, v) ? 2 : 4) * info.type.components() * elements.value_or(0);
      }
    };
    add(written_);
    add(read_);
    return known ? std::optional(out) : std::nullopt;
  }

 private:
  OpId maker(ValueId v) const { return graph_.value(v).op; }

  // Where a value is made: in which stage, and whether it can go on in a register there.
  struct Made {
    enum class How : uint8_t { Before, Map, Sum, Pass } how = How::Before;
    int stage = 0;
  };

  // The first stage of an op, from those of what it uses.
  int place(OpId id, const Uses& uses) {
    const Op& op = graph_.op(id);
    const ResultKind kind = result_kind(op);
    Made made{kind == ResultKind::Map       ? Made::How::Map
              : kind == ResultKind::Scatter ? Made::How::Sum
                                            : Made::How::Pass};
    const auto store = [&](ValueId v) {
      if (counts_[maker(v).index] && !is_memory(graph_.op(maker(v)))) written_.insert(v);
      read_.insert(v);
    };
    for (ValueId v : uses.at_element) {
      const Op& from = graph_.op(maker(v));
      const Made& of = made_[v.index];
      if (is_inline(from)) continue;
      if (is_memory(from)) {
        read_.insert(v);
      } else if (!counts_[maker(v).index]) {
        if (result_kind(from) != ResultKind::Map) read_.insert(v);
      } else if (of.how == Made::How::Sum && op.kind == OpKind::Add) {
        made.how = Made::How::Sum;  // one pass may scatter into a sum of several
        made.stage = std::max(made.stage, of.stage);
      } else if (of.how == Made::How::Map) {
        made.stage = std::max(made.stage, of.stage);
      } else {
        store(v);
        made.stage = std::max(made.stage, of.stage + 1);
      }
    }
    const bool folds = ops::info(op.kind).runs_as == ops::RunsAs::Reduce;
    for (ValueId v : uses.elsewhere) {
      const Op& from = graph_.op(maker(v));
      if (folds && !is_memory(from) && counts_[maker(v).index] && made_[v.index].how == Made::How::Map) {
        made.stage = std::max(made.stage, made_[v.index].stage);  // it may compute what it folds
        continue;
      }
      store(v);
      if (!is_memory(from) && counts_[maker(v).index]) made.stage = std::max(made.stage, made_[v.index].stage + 1);
    }
    for (ValueId v : op.results) made_[v.index] = made;
    return made.stage;
  }

  enum class ResultKind : uint8_t { Map, Scatter, Pass };
  static ResultKind result_kind(const Op& op) {
    switch (ops::info(op.kind).runs_as.value_or(ops::RunsAs::Map)) {
      case ops::RunsAs::Reduce:
      case ops::RunsAs::Raster: return ResultKind::Pass;
      case ops::RunsAs::Scatter: return op.kind == OpKind::ScatterMax ? ResultKind::Pass : ResultKind::Scatter;
      case ops::RunsAs::Map: break;
    }
    const auto& yields = op.attrs.yields;
    return std::ranges::find(yields, ir::Yield::Scatter) != yields.end() ? ResultKind::Scatter : ResultKind::Map;
  }

  const ir::Graph& graph_;
  const ir::Step& step_;
  const ir::SymbolValues& symbols_;
  bool only_steady_;
  std::vector<Made> made_;    // by ValueId index
  std::vector<bool> counts_;  // by OpId index; the others are done before
  std::set<ValueId> written_, read_;
};

}  // namespace

std::optional<LowerBound> lower_bound(const ir::Graph& graph, const ir::Step& step, const ir::SymbolValues& symbols,
                                      bool steady) {
  return Bound(graph, step, symbols, steady).process();
}

}  // namespace dr::backend
