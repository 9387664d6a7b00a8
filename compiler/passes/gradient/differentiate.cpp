// SPDX-License-Identifier: Apache-2.0
// Replace each Grad op by the ops that compute it, reverse mode.
//   %2 = mul %0, %0
//   %3 = grad %2, %1, %0      =>    %3 = mul %1, %0    %4 = mul %1, %0    %5 = add %3, %4
// Requires: verified graph, Grad ops in the root region only.  Establishes: no Grad, Vjp or Cotangent ops.
// Every value keeps a value of its own, so that a Grad's target is exactly what the program named: two equal values are
// two values. Ops before a Grad op are already expanded when it is reached, so gradients of gradients need no extra
// rule.
#include "compiler/passes/gradient/differentiate.h"

#include <algorithm>
#include <ranges>
#include <utility>

#include "compiler/ir/yields.h"
#include "compiler/ops/emit.h"
#include "compiler/ops/op.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"

namespace dr::passes {

using ir::Builder;
using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::ValueId;
using ir::ValueInfo;
using ir::ValueMap;
using ir::yielded;

namespace {

void mark_states(const Graph& graph, const Op& op, std::vector<bool>& active);

// Marks, in order, what depends on values already marked. A region op's result depends on what its regions yield for
// it.
void mark_active(const Graph& graph, std::span<const OpId> list, std::vector<bool>& active) {
  const auto is_active = [&](ValueId id) { return static_cast<bool>(active[id.index]); };
  for (const OpId id : list) {
    const Op& op = graph.op(id);
    if (!ops::info(op.kind).differentiable) continue;
    if (op.kind == OpKind::Fold) mark_states(graph, op, active);
    for (const RegionId inner : op.regions) mark_active(graph, graph.region(inner).ops, active);
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (!graph.value(op.results[k]).type.is_float()) continue;
      const bool carried = op.kind == OpKind::Fold && k < ir::fold_states(op, op.regions.size() - 1) &&
                           is_active(ir::fold_params(graph, op, op.regions.size() - 1, op.regions.size() - 1)[k]);
      const bool depends =
          carried || (op.regions.empty() ? std::ranges::any_of(op.operands, is_active)
                                         : std::ranges::any_of(ir::yielding_regions(op), [&](RegionId inner) {
                                             return is_active(yielded(graph, op, inner)[k].value);
                                           }));
      if (depends) active[op.results[k].index] = true;
    }
  }
}

// The states of a Fold that are active at some trip. Marks grow, so walking the sweeps again until none comes does it.
void mark_states(const Graph& graph, const Op& op, std::vector<bool>& active) {
  const size_t sweeps = ir::fold_sweeps(op);
  for (bool grows = true; grows;) {
    grows = false;
    for (size_t sweep = 0; sweep < sweeps; ++sweep) {
      const std::span<const ValueId> starts = ir::fold_starts(op, sweep), next = ir::fold_next(graph, op, sweep);
      mark_active(graph, graph.region(op.regions[sweep]).ops, active);
      for (size_t k = 0; k < starts.size(); ++k) {
        const ValueId own = ir::fold_params(graph, op, sweep, sweep)[k];
        if (active[own.index] || !graph.value(own).type.is_float()) continue;
        if (!active[starts[k].index] && !active[next[k].index]) continue;
        for (size_t in = sweep; in < sweeps; ++in) active[ir::fold_params(graph, op, in, sweep)[k].index] = true;
        grows = true;
      }
    }
  }
}

// An op whose rule stands in the op table.
void differentiate_op(Sweep& sweep, Frame& frame, const Op& op) {
  const auto found = frame.adjoints.find(op.results[0]);
  if (found == frame.adjoints.end()) return;
  // A target may be the end of the road: nothing behind it was asked for, or nothing gets through.
  const ops::OpInfo& info = ops::info(op.kind);
  if (!info.differentiable) return;
  if (std::ranges::none_of(op.operands, [&](ValueId id) { return static_cast<bool>(sweep.active[id.index]); })) return;

  Builder& b = sweep.builder;
  const Extent& extent = sweep.source.value(op.results[0]).extent;
  const bool elementwise = info.shape == ops::Shape::Elementwise;
  // An adjoint that is the same for all elements stays small on its way through element-wise ops.
  ValueId adjoint = found->second;
  if (frame.root && !elementwise) adjoint = ops::broadcast(b, adjoint, extent);

  std::vector<ValueId> operands;
  for (const ValueId id : op.operands) operands.push_back(sweep.now[id]);
  const ops::AdjointOutput terms = info.adjoint(
      {.builder = b, .attrs = op.attrs, .operands = operands, .result = sweep.now[op.results[0]], .adjoint = adjoint});
  DR_ASSERT(terms.size() == operands.size());
  for (size_t k = 0; k < terms.size(); ++k) {
    if (!terms[k].valid() || !sweep.active[op.operands[k].index]) continue;
    ValueId term = terms[k];
    const Extent& wanted = sweep.source.value(op.operands[k]).extent;
    // Inside a region everything is one element's: sums over stretched operands are taken outside.
    if (frame.root && wanted != extent && !is_zero(b.graph(), term)) {
      if (elementwise) term = ops::broadcast(b, term, extent);
      term = ops::reduce_to(b, term, wanted);
    }
    sweep.add(frame, op.operands[k], term);
  }
}

// A read inside a region: its adjoint leaves the region as a scatter, and the image's adjoint is made outside.
void differentiate_gather(Sweep& sweep, Frame& frame, const Op& op) {
  const ValueId image = op.operands[0];
  const auto found = frame.adjoints.find(op.results[0]);
  if (found == frame.adjoints.end() || !sweep.active[image.index]) return;
  frame.scatters.push_back({.image = image, .index = sweep.now[op.operands[1]], .value = found->second});
}

// The ops of the root region that can lie between targets and y: those from the first target's to y's.
std::span<const OpId> between(const Graph& graph, std::span<const ValueId> targets, ValueId y) {
  const std::vector<OpId>& list = graph.region(graph.root()).ops;  // in the order of their ids
  OpId first = graph.value(targets[0]).op;
  for (const ValueId x : targets) first = std::min(first, graph.value(x).op);
  const auto begin = std::ranges::lower_bound(list, first);
  const auto end = std::ranges::upper_bound(list, graph.value(y).op);
  return begin < end ? std::span(begin, end) : std::span<const OpId>{};
}

// The adjoints of `targets`, values of the source as y is; `seed` is the builder's, as the results are.
std::vector<ValueId> expand(const Graph& source, ValueMap now, Builder& b, ValueId y, ValueId seed,
                            std::span<const ValueId> targets, const Skips& skips) {
  const std::span<const OpId> list = between(source, targets, y);
  Sweep sweep{source, b, std::move(now), std::vector<bool>(source.value_count(), false), skips};
  for (const ValueId x : targets) sweep.active[x.index] = source.value(x).type.is_float();
  mark_active(source, list, sweep.active);
  Frame frame{.root = true, .domain = {}, .adjoints = {}, .accumulated = {}, .scatters = {}};
  sweep.add(frame, y, seed);
  sweep.run(frame, list);

  std::vector<ValueId> results;
  for (const ValueId x : targets) {
    const ValueInfo& info = source.value(x);
    const auto found = frame.adjoints.find(x);
    const ValueId adjoint = found != frame.adjoints.end() ? found->second : ops::constant(b, info.type, 0.0);
    results.push_back(ops::broadcast(b, adjoint, info.extent));
  }
  return results;
}

}  // namespace

bool is_zero(const Graph& graph, ValueId id) {
  if (!graph.value(id).op.valid()) return false;  // a region's parameter
  const Op& op = graph.op(graph.value(id).op);
  return op.kind == OpKind::Const && std::ranges::all_of(op.attrs.floats, [](double x) { return x == 0; });
}

void Sweep::add(Frame& frame, ValueId value, ValueId term) {
  if (!active[value.index]) return;
  if (skips.zero && is_zero(builder.graph(), term)) {
    if (skips.left_out) ++skips.left_out->zero;
    return;
  }
  const auto [entry, first] = frame.adjoints.try_emplace(value, term);
  if (!first) entry->second = ops::add(builder, entry->second, term);
}

void Sweep::run(Frame& frame, std::span<const OpId> list) {
  for (const OpId id : std::views::reverse(list)) {
    const Op& op = source.op(id);
    builder.set_span(op.span);
    if (op.kind == OpKind::If) {
      differentiate_if(*this, frame, id);
    } else if (op.kind == OpKind::Reduce) {
      differentiate_reduce(*this, frame, id);
    } else if (op.kind == OpKind::Fold) {
      differentiate_fold(*this, frame, id);
    } else if (op.kind == OpKind::Gather && !frame.root) {
      differentiate_gather(*this, frame, op);
    } else if (op.kind == OpKind::Vjp) {
      differentiate_vjp(*this, frame, op);
    } else if (op.results.size() == 1) {
      differentiate_op(*this, frame, op);
    }
  }
}

namespace {

class Differentiate {
 public:
  Differentiate(const Graph& graph, const Skips& skips)
      : from_(graph),
        skips_(skips),
        map_(graph.value_count()),
        is_target_(graph.value_count()),
        by_gradient_(graph.value_count()) {}

  Graph run() {
    b_.reserve(2 * from_.op_count());  // about as many adjoints
    b_.graph().leaves = from_.leaves;
    const std::vector<OpId>& list = from_.region(from_.root()).ops;
    for (const OpId id : list) {
      const Op& op = from_.op(id);
      if (op.kind != OpKind::Grad) continue;
      for (const ValueId x : std::span(op.operands).subspan(2)) is_target_[x.index] = true;
    }
    for (const OpId id : list) {
      const Op& op = from_.op(id);
      if (op.kind == OpKind::Grad) {
        rebuild_grad(op);
      } else {
        ir::copy_op(from_, id, b_, map_);
      }
      if (op.kind != OpKind::Grad && !depends_on_gradient(op)) continue;
      for (const ValueId result : op.results) by_gradient_[result.index] = true;
    }
    b_.graph().steps = copy_steps(from_, map_);
    return std::move(b_).finish();
  }

 private:
  bool depends_on_gradient(const Op& op) const {
    const auto is_so = [&](ValueId id) { return static_cast<bool>(by_gradient_[id.index]); };
    return std::ranges::any_of(op.operands, is_so) || std::ranges::any_of(op.regions, [&](RegionId region) {
             return std::ranges::any_of(ir::captures(from_, region), is_so);
           });
  }

  std::vector<ValueId> adjoints(const Op& op) {
    const ValueId y = op.operands[0];
    const ValueId seed = map_[op.operands[1]];
    const std::span<const ValueId> targets = std::span(op.operands).subspan(2);
    // What y comes of is the same in the graph as it was, but for Grad ops.
    if (!by_gradient_[y.index]) return expand(from_, map_, b_, y, seed, targets, skips_);
    const Graph expanded = b_.graph();
    ValueMap itself(expanded.value_count());
    for (uint32_t k = 0; k < expanded.value_count(); ++k) itself.set({k}, {k});
    std::vector<ValueId> now;
    for (const ValueId x : targets) now.push_back(map_[x]);
    return expand(expanded, std::move(itself), b_, map_[y], seed, now, skips_);
  }

  void rebuild_grad(const Op& op) {
    const std::vector<ValueId> results = adjoints(op);
    b_.set_span(op.span);
    for (size_t k = 0; k < results.size(); ++k) {
      ValueId adjoint = results[k];
      // An adjoint may be the seed, or lead to another adjoint of the same sweep. A later Grad that names it as its
      // target means this result alone, so it gets a value that nothing else uses.
      if (is_target_[op.results[k].index]) {
        const Extent& e = from_.value(op.results[k]).extent;
        adjoint = ops::emit(b_, OpKind::Broadcast, {adjoint},
                            {.ints = {}, .floats = {}, .dims = {e.w, e.h, e.l}, .yields = {}, .text = {}});
      }
      map_.set(op.results[k], adjoint);
      const std::string& name = from_.value(op.results[k]).name;
      if (!name.empty() && b_.value(adjoint).name.empty()) b_.set_name(adjoint, name);
    }
  }

  const Graph& from_;
  const Skips& skips_;
  Builder b_;
  ValueMap map_;
  std::vector<bool> is_target_;
  std::vector<bool> by_gradient_;  // values that a Grad op has to do with
};

}  // namespace

Graph differentiate(const Graph& graph, const Skips& skips) { return drop_vjps(Differentiate(graph, skips).run()); }

}  // namespace dr::passes
