// SPDX-License-Identifier: Apache-2.0
// An `if` that both scatters and gives values at its own element becomes two, each with what it needs:
//   %1, %2 = if %c yields [element, scatter] {..}    =>    %1 = if %c yields [element] {..} ; %2 = if %c yields
//   [scatter] {..}
// What goes on at the element then shares a shader with what comes before and after it, and the elements that scatter
// something can be listed (backend/lowering/scatter_active.h). Loops stay whole: to run them twice would cost more.
// Requires: no Grad op. Establishes: nothing.
#include <algorithm>

#include "compiler/ir/yields.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

using namespace ir;

namespace {

// Ops of an `if`, those within its regions too, that may run twice.
constexpr size_t kMostOps = 4096;

class Splitter {
 public:
  explicit Splitter(const Graph& from) : from_(from), map_(from.value_count()) {}

  Graph run() {
    to_.reserve(from_.op_count());
    to_.graph().leaves = from_.leaves;
    for (const OpId id : from_.region(from_.root()).ops) {
      const size_t ops = is_mixed(from_.op(id)) ? ops_without_loops(from_.op(id)) : 0;
      if (ops > 0 && ops <= kMostOps)
        copy_split(from_.op(id));
      else
        copy_op(from_, id, to_, map_);
    }
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  static bool is_mixed(const Op& op) {
    if (op.kind != OpKind::If) return false;
    const auto scatters = std::ranges::count(op.attrs.yields, Yield::Scatter);
    return scatters > 0 && static_cast<size_t>(scatters) < op.attrs.yields.size();
  }

  // How many ops there are in the regions of an op; kMostOps + 1 where one is a loop.
  size_t ops_without_loops(const Op& op) const {
    size_t count = 0;
    for (const RegionId region : op.regions)
      for (const OpId id : from_.region(region).ops) {
        const Op& inner = from_.op(id);
        count += is_loop(inner.kind) ? kMostOps + 1 : 1 + ops_without_loops(inner);
      }
    return std::min(count, kMostOps + 1);
  }

  void copy_split(const Op& op) {
    for (const bool scatters : {false, true})
      copy_part(op, [&](Yield how) { return (how == Yield::Scatter) == scatters; });
  }

  // The op with the results that `wanted` says.
  template <class F>
  void copy_part(const Op& op, const F& wanted) {
    std::vector<RegionId> regions;
    for (const RegionId region : op.regions) regions.push_back(copy_region(op, region, wanted));
    std::vector<ValueId> operands, results;
    for (const ValueId v : op.operands) operands.push_back(map_[v]);
    Attrs attrs = op.attrs;
    std::erase_if(attrs.yields, [&](Yield how) { return !wanted(how); });
    // The domain, and the extents of what is scattered.
    if (!wanted(Yield::Scatter)) attrs.dims.resize(3);
    std::vector<ResultType> types;
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (!wanted(op.attrs.yields[k])) continue;
      const ValueInfo& info = from_.value(op.results[k]);
      results.push_back(op.results[k]);
      types.push_back({info.type, info.extent, info.accumulation});
    }
    const OpId now = to_.add(op.kind, operands, types, std::move(attrs), std::move(regions), op.span);
    for (size_t k = 0; k < results.size(); ++k) {
      const ValueId result = to_.graph().op(now).results[k];
      map_.set(results[k], result);
      to_.set_name(result, from_.value(results[k]).name);
    }
  }

  template <class F>
  RegionId copy_region(const Op& op, RegionId old, const F& wanted) {
    const RegionId now = to_.begin_region({});
    for (const OpId id : from_.region(old).ops)
      if (is_mixed(from_.op(id)))
        copy_split(from_.op(id));
      else
        copy_op(from_, id, to_, map_);
    std::vector<ValueId> yields;
    const std::vector<Yielded> all = yielded(from_, op, old);
    for (size_t k = 0; k < all.size(); ++k) {
      if (!wanted(op.attrs.yields[k])) continue;
      if (all[k].index.valid()) yields.push_back(map_[all[k].index]);
      yields.push_back(map_[all[k].value]);
    }
    to_.end_region(std::move(yields));
    return now;
  }

  const Graph& from_;
  Builder to_;
  ValueMap map_;
};

}  // namespace

Graph split_scatters(const Graph& graph, const Skips& /*skips*/) { return Splitter(graph).run(); }

}  // namespace dr::passes
