// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/pack/loop_over_layers.h"

#include <algorithm>
#include <functional>
#include <map>
#include <utility>

#include "compiler/ops/emit.h"

namespace dr::backend {

using ir::Dim;
using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

// What a node of the tree of a reduction folds, and the layers of the largest nodes that have a loop: these are added
// up one after the other, as in the tree while there are 8^8 layers at most.
constexpr int64_t kFolds = 8, kLargest = 1 << 18;
// Sums that share a loop: their lanes hold them all.
constexpr uint32_t kMostTogether = 8;
// A lane goes over all layers, which takes longer than a reduction where they are known to be many.
constexpr int64_t kMostLayers = 512;

bool is_over_layers(const Graph& graph, const Op& op) {
  if (op.kind != OpKind::ReduceSum || op.attrs.ints != std::vector<int64_t>{0, 0, 1}) return false;
  const Extent& from = graph.value(op.operands[0]).extent;
  const bool many = from.l.is_constant() && from.l.constant() > kMostLayers;
  return from.h.is_one() && !from.w.is_one() && !from.l.is_one() && !many;
}

class LoopWriter : Rewriter {
 public:
  LoopWriter(const Graph& from, size_t together) : Rewriter(from), together_(together) {}

  // Reductions of one extent are put off until something uses one of them: some share their loops.
  Joined run() {
    for (const OpId id : from_.region(from_.root()).ops) {
      const Op& op = from_.op(id);
      if (is_over_layers(from_, op)) {
        const Extent& extent = from_.value(op.operands[0]).extent;
        waiting_[extent].push_back(id);
        if (waiting_[extent].size() == together_) write(extent);
        continue;
      }
      for (const ValueId v : op.operands) write_for(v);
      for (const ir::RegionId region : op.regions)
        for (const ValueId v : ir::captures(from_, region)) write_for(v);
      copy(id);
    }
    while (!waiting_.empty()) write(waiting_.begin()->first);
    return finish();
  }

 private:
  void write_for(ValueId v) {
    const Op& op = from_.op(from_.value(v).op);
    if (map_.has(v) || !is_over_layers(from_, op)) return;
    write(from_.value(op.operands[0]).extent);
  }

  void write(const Extent& of) {
    const auto waiting = waiting_.extract(of);
    const Extent& extent = waiting.key();
    const std::vector<OpId>& ids = waiting.mapped();
    to_.set_span(from_.op(ids[0]).span);
    Loops loops{{}, {extent.w, 1, 1}, ops::dim_value(to_, extent.l)};
    for (const OpId id : ids) loops.sources.push_back(map_[from_.op(id).operands[0]]);
    const std::vector<ValueId> sums = few_or_many(loops, extent.l);
    for (size_t k = 0; k < ids.size(); ++k) {
      const ValueId result = from_.op(ids[k]).results[0];
      to_.set_name(sums[k], from_.value(result).name);
      map_.set(result, sums[k]);
    }
    match_rest(ids[0]);
    to_.set_span({});
  }

  struct Loops {
    std::vector<ValueId> sources;
    Extent domain;
    ValueId count;
  };

  // Few layers, as those of views are, have a loop that drivers write out.
  std::vector<ValueId> few_or_many(const Loops& loops, const Dim& layers) {
    const ValueId zero = number(0);
    if (layers.is_constant() && layers.constant() <= kFolds) return layers_of(loops, zero, loops.count);
    const ValueId few = ops::emit(to_, OpKind::LessEqual, {loops.count, number(kFolds)});
    const ir::RegionId then = to_.begin_region({});
    to_.end_region(layers_of(loops, zero, loops.count));
    const ir::RegionId otherwise = to_.begin_region({});
    to_.end_region(nodes(loops, zero, loops.count, kLargest));
    return ops::emit_multi(to_, OpKind::If, {few}, attrs(loops, {}, ir::Yield::Element), {then, otherwise});
  }

  // The sums of the layers from `begin` to `end`, in nodes of `size` layers, a power of eight, the last one of fewer.
  std::vector<ValueId> nodes(const Loops& loops, ValueId begin, ValueId end, int64_t size) {
    const ValueId first = ops::div(to_, begin, number(size));
    const ValueId behind = ops::div(to_, ops::add(to_, end, number(size - 1)), number(size));
    return loop(loops, first, behind, [&](ValueId k) {
      const ValueId from = ops::mul(to_, k, number(size));
      const ValueId to = ops::emit(to_, OpKind::Min, {ops::add(to_, from, number(size)), end});
      return size == kFolds ? layers_of(loops, from, to) : nodes(loops, from, to, size / kFolds);
    });
  }

  // Those of the layers one after the other.
  std::vector<ValueId> layers_of(const Loops& loops, ValueId begin, ValueId end) {
    return loop(loops, begin, end, [&](ValueId k) {
      const ValueId here = ops::coord(to_, 0, loops.domain);
      const ValueId at = ops::compose(to_, {here, number(0), k}, ir::vec(3, ir::Scalar::Int));
      std::vector<ValueId> out;
      for (const ValueId source : loops.sources) out.push_back(ops::emit(to_, OpKind::Gather, {source, at}));
      return out;
    });
  }

  std::vector<ValueId> loop(const Loops& loops, ValueId begin, ValueId end,
                            const std::function<std::vector<ValueId>(ValueId)>& body_of) {
    const ir::ResultType trip{ir::kInt, loops.domain};
    const ir::RegionId body = to_.begin_region({&trip, 1});
    to_.end_region(body_of(to_.graph().region(body).params[0]));
    return ops::emit_multi(to_, OpKind::Reduce, {begin, end}, attrs(loops, {-1}, ir::Yield::Sum), {body});
  }

  ValueId number(int64_t n) { return ops::constant(to_, ir::kInt, static_cast<double>(n)); }

  static ir::Attrs attrs(const Loops& loops, std::vector<int64_t> ints, ir::Yield yield) {
    return {.ints = std::move(ints),
            .dims = {loops.domain.w, loops.domain.h, loops.domain.l},
            .yields = std::vector<ir::Yield>(loops.sources.size(), yield)};
  }

  const size_t together_;
  std::map<Extent, std::vector<OpId>> waiting_;
};

}  // namespace

std::optional<Joined> loop_over_layers(const Graph& graph, const target::Profile& profile) {
  if (!profile.is_gpu()) return std::nullopt;
  const std::vector<OpId>& ops = graph.region(graph.root()).ops;
  if (std::ranges::none_of(ops, [&](OpId id) { return is_over_layers(graph, graph.op(id)); })) return std::nullopt;
  // A loop binds a buffer for each sum that it reads, and maybe one for each that it leaves.
  const uint32_t buffers = profile.max_per_stage_descriptor_storage_buffers;
  return LoopWriter(graph, std::clamp(buffers / 4, 1u, kMostTogether)).run();
}

}  // namespace dr::backend
