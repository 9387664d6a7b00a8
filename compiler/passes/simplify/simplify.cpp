// SPDX-License-Identifier: Apache-2.0
// Constant folding, common subexpressions, dead code, and algebra that changes no bit of any result but the sign of a
// zero (the list stands in simplify_identities.cpp).
//   %3 = mul %0, %1      with %1 = const 1
//   %4 = add %3, %2
//   %5 = add %2, %0                          =>    %4 = add %0, %2    (%5 is %4, the rest is gone)
// Requires: verified graph.  Establishes: every op is needed by a step; no If has a constant condition, unless it
// scatters through an inner op of a smaller domain. Leaves alone: values that a Grad names as targets. A gradient with
// respect to a value asks how the program as written uses it, so such a value is merged with no equal one, replaced by
// no simpler one, and rules do not look through it.
//
// A round walks the graph once backwards for what is needed and once forwards, rebuilding it in simplest form. What
// that leaves unused, the next round drops: two Ifs may be equal then. Rules do not look at uses, so a round that has
// nothing to drop has nothing to do.
#include "compiler/passes/simplify/simplify.h"

#include <algorithm>
#include <map>

#include "compiler/ir/raster.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"
#include "compiler/passes/simplify/fold_use.h"

namespace dr::passes {

using namespace ir;

namespace {

bool has_gradients(const Graph& graph) {
  return std::ranges::any_of(graph.region(graph.root()).ops,
                             [&](OpId id) { return graph.op(id).kind == OpKind::Grad; });
}

class Round {
 public:
  Round(const Graph& from, const Skips& skips)
      : from_(from),
        differentiates_(has_gradients(from)),
        emitter_(to_, skips, !differentiates_),
        map_(from.value_count()),
        needed_(from.value_count(), !skips.dead),
        target_(from.value_count()) {
    for (const Step& step : from.steps) {
      for (const Output& output : step.outputs) need(output.value);
      for (const Update& update : step.updates) need(update.value);
    }
    find_needed(from.root());
    for (const OpId id : from.region(from.root()).ops)
      if (const Op& op = from.op(id); op.kind == OpKind::Vjp) rules_.emplace(op.operands[1], id);
  }

  bool is_unfinished() const { return is_unfinished_; }
  // Ops that no step needs, those of their regions too.
  size_t dead() const { return dead_; }

  Graph run() {
    to_.reserve(from_.op_count());
    to_.graph().leaves = from_.leaves;
    for (OpId op : from_.region(from_.root()).ops) rebuild(op);
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  // --- what is needed ---

  void need(ValueId id) { needed_[id.index] = true; }

  size_t needed_results(const Op& op) const {
    const auto is_needed = [&](ValueId id) { return static_cast<bool>(needed_[id.index]); };
    return static_cast<size_t>(std::count_if(op.results.begin(), op.results.end(), is_needed));
  }

  // Backwards, so that all uses of a value come before the op that makes it. A region gives what its op's needed
  // results take.
  void find_needed(RegionId region) {
    const std::vector<OpId>& ops = from_.region(region).ops;
    for (auto it = ops.rbegin(); it != ops.rend(); ++it) {
      const Op& op = from_.op(*it);
      const size_t count = needed_results(op);
      const bool by_result = combines_yields(op.kind) && op.kind != OpKind::Fold;
      if (count < (by_result ? op.results.size() : 1) || selects(op)) is_unfinished_ = true;
      if (count == 0) dead_ += ops_in(*it);
      if (count == 0) continue;
      if (op.kind == OpKind::Fold) {
        find_needed_of_fold(op);
        continue;
      }
      if (op.kind == OpKind::Raster) {
        find_needed_of_raster(op);
        continue;
      }
      for (ValueId operand : op.operands) need(operand);
      if (op.kind == OpKind::Grad) {
        for (size_t k = 2; k < op.operands.size(); ++k) target_[op.operands[k].index] = true;
      }
      for (RegionId inner : op.regions) {
        if (combines_yields(op.kind)) {
          const std::vector<Yielded> parts = yielded(from_, op, inner);
          for (size_t k = 0; k < parts.size(); ++k) {
            if (!needed_[op.results[k].index]) continue;
            if (parts[k].index.valid()) need(parts[k].index);
            need(parts[k].value);
          }
        } else {
          for (ValueId yield : from_.region(inner).yields) need(yield);
        }
        find_needed(inner);
      }
    }
  }

  // A field of a face is needed where one of the closures is made of it.
  void find_needed_of_raster(const Op& op) {
    for (RegionId inner : op.regions) {
      for (ValueId yield : from_.region(inner).yields) need(yield);
      find_needed(inner);
    }
    const std::vector<bool> fields = needed_fields(op);
    if (std::ranges::count(fields, false) > 0 || drops_orders(op)) is_unfinished_ = true;
    for (size_t k = 0; k < op.operands.size(); ++k)
      if (k >= fields.size() || fields[k]) need(op.operands[k]);
  }

  // Whether nobody needs what a raster says of the order of its faces.
  bool drops_orders(const Op& op) const {
    const size_t each = ir::results_a_rank(op.attrs);
    if (each < 3) return false;
    for (size_t k = 2; k < op.results.size(); k += each)
      if (needed_[op.results[k].index]) return false;
    return true;
  }

  std::vector<bool> needed_fields(const Op& op) const {
    std::vector<bool> fields(static_cast<size_t>(op.attrs.ints[1]), false);
    for (size_t k = 0; k < fields.size(); ++k)
      fields[k] = std::ranges::any_of(
          op.regions, [&](RegionId inner) { return static_cast<bool>(needed_[from_.region(inner).params[k].index]); });
    return fields;
  }

  // A state is needed where a result that it becomes is, or where what is needed is made of it.
  void find_needed_of_fold(const Op& op) {
    const FoldUse use = fold_use(from_, op, [&](ValueId id) { return static_cast<bool>(needed_[id.index]); });
    if (use.drops(op) || hands_on(op) || keeps_a_state(op)) is_unfinished_ = true;
    need(op.operands[0]);
    need(op.operands[1]);
    for (size_t sweep = 0; sweep < fold_sweeps(op); ++sweep) {
      for (size_t k = 0; k < use.states[sweep].size(); ++k)
        if (use.states[sweep][k]) need(fold_starts(op, sweep)[k]);
      for (ValueId yield : use.yields[sweep]) need(yield);
      find_needed(op.regions[sweep]);
    }
  }

  size_t ops_in(OpId id) const {
    size_t count = 1;
    for (RegionId region : from_.op(id).regions)
      for (OpId inner : from_.region(region).ops) count += ops_in(inner);
    return count;
  }

  // --- rebuilding ---

  std::vector<ValueId> mapped(const std::vector<ValueId>& ids) const {
    std::vector<ValueId> out;
    out.reserve(ids.size());
    for (ValueId id : ids) {
      DR_ASSERT(map_.has(id));
      out.push_back(map_[id]);
    }
    return out;
  }

  // A constant stands for many values of a program: it keeps the name it was made with, if any.
  void enter(ValueId old, ValueId now, bool fresh) {
    map_.set(old, now);
    const std::string& name = from_.value(old).name;
    if (name.empty() || !to_.value(now).name.empty()) return;
    if (fresh || !emitter_.constant(now)) to_.set_name(now, name);
  }

  void rebuild(OpId id) {
    const Op& op = from_.op(id);
    if (needed_results(op) == 0) return;
    if (op.kind == OpKind::Grad) {
      rebuild_grad(op);
    } else if (op.regions.empty()) {
      rebuild_plain(op);
    } else if (!inline_if(op) && !select_if(op)) {
      rebuild_structured(op);
    }
  }

  // Two Vjps of one value and for the same targets have one cotangent: where their adjoints are alike, too, they are
  // one, and what flows into both is added up before the rule sees it. Gives the number of the first.
  int64_t number_of_cotangent(const Op& op) {
    const int64_t own = op.attrs.ints[2];
    const auto rule = rules_.find(op.results[0]);
    if (rule == rules_.end() || !emitter_.in_root()) return own;
    const std::vector<ValueId>& operands = from_.op(rule->second).operands;
    std::vector<ValueId> call{operands[0]};
    call.insert(call.end(), operands.begin() + 2,
                operands.begin() + 2 + static_cast<ptrdiff_t>((operands.size() - 2) / 2));
    for (ValueId& id : call) {
      if (!map_.has(id)) return own;
      id = map_[id];
    }
    return cotangents_.try_emplace(std::move(call), own).first->second;
  }

  void rebuild_plain(const Op& op) {
    const ValueInfo& old = from_.value(op.results[0]);
    Candidate candidate{op.kind, mapped(op.operands), op.attrs, old.type, old.extent, op.span};
    if (op.kind == OpKind::Cotangent) candidate.attrs.ints[2] = number_of_cotangent(op);
    if (target_[op.results[0].index]) return enter(op.results[0], emitter_.emit_opaque(std::move(candidate)), true);
    // Inside regions a rule may have left an operand with a smaller extent, which makes this one smaller.
    if (!emitter_.in_root() &&
        !std::equal(op.operands.begin(), op.operands.end(), candidate.operands.begin(),
                    [&](ValueId x, ValueId y) { return from_.value(x).extent == to_.value(y).extent; }))
      candidate.extent = extent_of(candidate);
    const size_t before = to_.graph().value_count();
    const ValueId now = emitter_.emit(std::move(candidate));
    enter(op.results[0], now, now.index >= before);
  }

  // As its operands have it.
  Extent extent_of(const Candidate& candidate) {
    const ops::InferResult inferred = ops::infer(to_.graph(), candidate.kind, candidate.operands, candidate.attrs, {});
    if (const auto* message = std::get_if<std::string>(&inferred))
      DR_ICE("simplify broke " + std::string(op_name(candidate.kind)) + ": " + *message);
    return std::get<std::vector<ResultType>>(inferred)[0].extent;
  }

  void rebuild_grad(const Op& op) {
    std::vector<ResultType> types;
    for (ValueId result : op.results) types.push_back({from_.value(result).type, from_.value(result).extent});
    finish(op.results, to_.add(op.kind, mapped(op.operands), types, op.attrs, {}, op.span));
  }

  // The results from number `first` on.
  void finish(const std::vector<ValueId>& results, OpId now, size_t first = 0) {
    for (size_t k = 0; k < results.size(); ++k) {
      enter(results[k], to_.graph().op(now).results[first + k], true);
      if (target_[results[k].index]) emitter_.set_opaque(map_[results[k]]);
    }
  }

  // A Raster without the fields and orders that nobody needs.
  void rebuild_raster(const Op& op) {
    std::vector<bool> params = needed_fields(op);
    Attrs attrs = op.attrs;
    attrs.ints[1] = std::ranges::count(params, true);
    std::vector<ValueId> operands;
    for (size_t k = 0; k < op.operands.size(); ++k)
      if (k >= params.size() || params[k]) operands.push_back(map_[op.operands[k]]);
    params.push_back(true);  // the point
    std::vector<RegionId> regions;
    for (RegionId region : op.regions) regions.push_back(rebuild_region(op, region, {}, params));
    std::vector<ResultType> types;
    std::vector<ValueId> results = op.results;
    if (drops_orders(op)) {
      attrs.ints.pop_back();
      for (size_t k = 2; k < results.size(); k += 2) results.erase(results.begin() + static_cast<ptrdiff_t>(k));
    }
    bool shared = true;
    for (const ValueId result : results) {
      types.push_back({from_.value(result).type, from_.value(result).extent});
      if (target_[result.index]) shared = false;
    }
    const OpId now = to_.add(op.kind, std::move(operands), types, std::move(attrs), std::move(regions), op.span);
    finish(results, shared ? emitter_.share(now) : now);
  }

  // If and Reduce, without the results that nobody needs.
  void rebuild_structured(const Op& op) {
    if (op.kind == OpKind::Fold) return rebuild_fold(op);
    if (op.kind == OpKind::Raster) return rebuild_raster(op);
    std::vector<bool> kept(op.results.size(), true);
    Attrs attrs = op.attrs;
    if (combines_yields(op.kind)) {
      attrs.yields.clear();
      attrs.dims.resize(3);
      size_t scatters = 0;
      for (size_t k = 0; k < op.results.size(); ++k) {
        kept[k] = needed_[op.results[k].index];
        const bool scatter = op.attrs.yields[k] == Yield::Scatter;
        const auto extent = op.attrs.dims.begin() + static_cast<std::ptrdiff_t>(3 + 3 * scatters);
        if (scatter) ++scatters;
        if (!kept[k]) continue;
        attrs.yields.push_back(op.attrs.yields[k]);
        if (scatter) attrs.dims.insert(attrs.dims.end(), extent, extent + 3);
      }
    }

    std::vector<RegionId> regions;
    for (RegionId region : op.regions) regions.push_back(rebuild_region(op, region, kept));

    std::vector<ResultType> types;
    std::vector<ValueId> results;
    bool shared = true;
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (!kept[k]) continue;
      const ValueInfo& old = from_.value(op.results[k]);
      const bool scatter = combines_yields(op.kind) && op.attrs.yields[k] == Yield::Scatter;
      types.push_back({old.type, old.extent, scatter && !emitter_.in_root()});
      results.push_back(op.results[k]);
      if (target_[op.results[k].index]) shared = false;
    }
    const OpId now = to_.add(op.kind, mapped(op.operands), types, std::move(attrs), std::move(regions), op.span);
    finish(results, shared ? emitter_.share(now) : now);
  }

  // Whether each result of a Fold that is needed is what it starts from, since no trip makes another value of it.
  bool hands_on(const Op& op) const {
    if (fold_sweeps(op) > 1) return false;
    const std::span<const ValueId> params = fold_params(from_, op, 0, 0), next = fold_next(from_, op, 0),
                                   starts = fold_starts(op, 0);
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (!needed_[op.results[k].index]) continue;
      if (k >= next.size() || next[k] != params[k] || target_[op.results[k].index]) return false;
      const ValueInfo &start = from_.value(starts[k]), &result = from_.value(op.results[k]);
      if (start.type != result.type || start.extent != result.extent) return false;
    }
    return true;
  }

  // Whether no trip changes a state, which then is what it starts from, for what is within the loop and for its result.
  // An adjoint that loops hand on is such a state:  fold(x = g) { ... x * y ...; x }  =>  ... g * y ... Gradients that
  // are still to come would add up in another order.
  bool is_kept(const Op& op, size_t sweep, size_t k) const {
    const ValueId start = fold_starts(op, sweep)[k], param = fold_params(from_, op, sweep, sweep)[k];
    const auto alike = [&](ValueId v) {
      return from_.value(v).type == from_.value(start).type && from_.value(v).extent == from_.value(start).extent;
    };
    if (differentiates_ || fold_next(from_, op, sweep)[k] != param || !alike(param)) return false;
    return sweep + 1 < fold_sweeps(op) || alike(op.results[k]);
  }
  bool keeps_a_state(const Op& op) const {
    for (size_t sweep = 0; sweep < fold_sweeps(op); ++sweep)
      for (size_t k = 0; k < fold_starts(op, sweep).size(); ++k)
        if (is_kept(op, sweep, k)) return true;
    return false;
  }

  // A Fold without the states and results that nobody needs. Sweeps that are left in one direction, where the one
  // between them carries nothing, become one: its region does at each trip what theirs do.
  void rebuild_fold(const Op& op) {
    if (hands_on(op)) {
      for (size_t k = 0; k < op.results.size(); ++k)
        if (needed_[op.results[k].index]) enter(op.results[k], map_[fold_starts(op, 0)[k]], false);
      return;
    }
    const FoldUse use = fold_use(from_, op, [&](ValueId id) { return static_cast<bool>(needed_[id.index]); });
    Attrs attrs = op.attrs;
    attrs.ints.resize(2);
    std::vector<ValueId> operands{map_[op.operands[0]], map_[op.operands[1]]};
    std::vector<RegionId> regions;
    std::vector<size_t> before;
    for (const std::vector<size_t>& group : use.groups) {
      attrs.ints.push_back(0);
      for (const size_t sweep : group) {
        const std::span<const ValueId> starts = fold_starts(op, sweep);
        for (size_t k = 0; k < starts.size(); ++k)
          if (use.states[sweep][k]) operands.push_back(map_[starts[k]]);
        attrs.ints.back() += std::ranges::count(use.states[sweep], true);
      }
      before.insert(before.end(), group.begin(), group.end());
      regions.push_back(rebuild_sweeps(op, group, before, use));
    }
    // The states of sweeps that have joined the last one are results that nobody had.
    std::vector<ResultType> types;
    for (const size_t sweep : std::span(use.groups.back()).first(use.groups.back().size() - 1)) {
      for (size_t k = 0; k < use.states[sweep].size(); ++k)
        if (use.states[sweep][k]) types.push_back({from_.value(fold_starts(op, sweep)[k]).type, domain_of(op)});
    }
    const size_t joined = types.size();
    attrs.yields.assign(joined, Yield::Element);
    attrs.dims.resize(3);
    std::vector<ValueId> results;
    bool shared = true;
    size_t scatters = 0;
    for (size_t k = 0; k < op.results.size(); ++k) {
      const bool scatter = op.attrs.yields[k] == Yield::Scatter;
      const auto extent = op.attrs.dims.begin() + static_cast<std::ptrdiff_t>(3 + 3 * scatters);
      if (scatter) ++scatters;
      if (!use.results[k]) continue;
      const ValueInfo& old = from_.value(op.results[k]);
      attrs.yields.push_back(op.attrs.yields[k]);
      if (scatter) attrs.dims.insert(attrs.dims.end(), extent, extent + 3);
      types.push_back({old.type, old.extent, scatter && !emitter_.in_root()});
      results.push_back(op.results[k]);
      if (target_[op.results[k].index]) shared = false;
    }
    const OpId now = to_.add(op.kind, std::move(operands), types, std::move(attrs), std::move(regions), op.span);
    finish(results, shared ? emitter_.share(now) : now, joined);
    const size_t last = fold_sweeps(op) - 1;
    for (size_t k = 0; k < fold_states(op, last); ++k)
      if (use.results[k] && is_kept(op, last, k)) map_.set(op.results[k], map_[fold_starts(op, last)[k]]);
  }

  // The region of sweeps that are one now; `before` are all sweeps up to them that are left.
  RegionId rebuild_sweeps(const Op& op, const std::vector<size_t>& group, const std::vector<size_t>& before,
                          const FoldUse& use) {
    std::vector<ResultType> types;
    const ValueInfo& trip = from_.value(from_.region(op.regions[group[0]]).params[0]);
    types.push_back({trip.type, trip.extent});
    for (const size_t of : before) {
      const std::span<const ValueId> states = fold_params(from_, op, group.back(), of);
      for (size_t k = 0; k < states.size(); ++k)
        if (use.states[of][k]) types.push_back({from_.value(states[k]).type, from_.value(states[k]).extent});
    }
    const RegionId now = to_.begin_region(types);
    emitter_.open_scope();
    std::vector<ValueId> yields;
    for (const size_t sweep : group) {
      enter(from_.region(op.regions[sweep]).params[0], to_.graph().region(now).params[0], true);
      size_t at = 1;
      for (const size_t of : before) {
        if (of > sweep) break;
        const std::span<const ValueId> states = fold_params(from_, op, sweep, of);
        for (size_t k = 0; k < states.size(); ++k) {
          if (!use.states[of][k]) continue;
          enter(states[k], to_.graph().region(now).params[at++], true);
          if (is_kept(op, of, k)) map_.set(states[k], map_[fold_starts(op, of)[k]]);
        }
      }
      for (OpId inner : from_.region(op.regions[sweep]).ops) rebuild(inner);
      for (ValueId yield : use.yields[sweep]) append_yield(yield, yields);
    }
    emitter_.close_scope();
    to_.end_region(std::move(yields));
    return now;
  }

  // With the results `kept`, where the op combines yields, and the parameters `params`; empty: all of them.
  RegionId rebuild_region(const Op& op, RegionId old, const std::vector<bool>& kept,
                          const std::vector<bool>& params = {}) {
    const Region& region = from_.region(old);
    std::vector<ValueId> left;
    for (size_t i = 0; i < region.params.size(); ++i)
      if (params.empty() || params[i]) left.push_back(region.params[i]);
    std::vector<ResultType> types;
    for (ValueId param : left) types.push_back({from_.value(param).type, from_.value(param).extent});
    const RegionId now = to_.begin_region(types);
    emitter_.open_scope();
    for (size_t i = 0; i < left.size(); ++i) enter(left[i], to_.graph().region(now).params[i], true);
    for (OpId inner : region.ops) rebuild(inner);

    std::vector<ValueId> yields;
    if (combines_yields(op.kind)) {
      const std::vector<Yielded> parts = yielded(from_, op, old);
      for (size_t k = 0; k < parts.size(); ++k) {
        if (!kept[k]) continue;
        if (parts[k].index.valid()) append_yield(parts[k].index, yields);
        append_yield(parts[k].value, yields);
      }
    } else {
      yields = mapped(region.yields);
    }
    emitter_.close_scope();
    to_.end_region(std::move(yields));
    return now;
  }

  void append_yield(ValueId old, std::vector<ValueId>& yields) {
    if (const auto pair = pairs_.find(old); pair != pairs_.end()) {
      yields.insert(yields.end(), {pair->second.index, pair->second.value});
    } else {
      DR_ASSERT(map_.has(old));
      yields.push_back(map_[old]);
    }
  }

  // --- an If with a constant condition is its branch ---

  // if (true) {a} {b} => a. What the branch scatters in the root becomes a scatter_add over the If's domain; inside a
  // region it is handed on to the outer op as a pair.
  bool inline_if(const Op& op) {
    if (op.kind != OpKind::If) return false;
    const std::vector<double>* condition = emitter_.constant(map_[op.operands[0]]);
    if (!condition) return false;
    const RegionId branch = op.regions[condition->at(0) != 0 ? 0 : 1];
    const std::vector<Yielded> parts = yielded(from_, op, branch);
    for (size_t k = 0; k < parts.size(); ++k) {
      if (!needed_[op.results[k].index]) continue;
      // The result is the target, so there must be one.
      if (target_[op.results[k].index]) return false;
      // In the root an inner op runs over its own domain, not once for each element of the If's: it would scatter less
      // often.
      const ValueInfo& value = from_.value(parts[k].value);
      if (emitter_.in_root() && value.accumulation && domain_of(from_.op(value.op)) != domain_of(op)) return false;
    }

    for (OpId inner : from_.region(branch).ops) rebuild(inner);
    size_t scatters = 0;
    for (size_t k = 0; k < parts.size(); ++k) {
      const bool scatter = op.attrs.yields[k] == Yield::Scatter;
      if (scatter) ++scatters;
      const ValueId result = op.results[k];
      if (!needed_[result.index]) continue;
      const auto& [index, value] = parts[k];
      if (!scatter) {
        enter(result, emitter_.stretched(map_[value], from_.value(result).extent), false);
      } else if (index.valid()) {
        hand_on(op, scatters, result, {map_[index], map_[value]});
      } else if (const auto pair = pairs_.find(value); pair != pairs_.end()) {
        hand_on(op, scatters, result, pair->second);
      } else {
        enter(result, map_[value], false);
      }
    }
    return true;
  }

  bool selects(const Op& op) const {
    if (op.kind != OpKind::If) return false;
    bool integers = true;
    for (size_t k = 0; k < op.results.size(); ++k) {
      const Type& type = from_.value(op.results[k]).type;
      integers = integers && !type.is_float();
      if (op.attrs.yields[k] != Yield::Element || target_[op.results[k].index] || type.is_matrix()) return false;
    }
    // Gradients flow through what moves floats.
    for (RegionId region : op.regions)
      for (OpId inner : from_.region(region).ops)
        if (const OpKind kind = from_.op(inner).kind;
            kind != OpKind::Const && !(integers && ops::info(kind).moves && from_.op(inner).regions.empty()))
          return false;
    return true;
  }

  // if (c) {a} {b} => select(c, a, b), where neither branch computes anything, but for integers that it moves: no
  // branch in the shader, and element-wise ops are free to share passes.
  bool select_if(const Op& op) {
    if (!selects(op)) return false;
    for (RegionId region : op.regions)
      for (OpId inner : from_.region(region).ops) rebuild(inner);
    for (size_t k = 0; k < op.results.size(); ++k) {
      if (!needed_[op.results[k].index]) continue;
      const ValueInfo& old = from_.value(op.results[k]);
      Candidate candidate{OpKind::Select, {map_[op.operands[0]]}, {}, old.type, old.extent, op.span};
      for (RegionId region : op.regions) candidate.operands.push_back(map_[yielded(from_, op, region)[k].value]);
      candidate.extent = extent_of(candidate);
      enter(op.results[k], emitter_.stretched(emitter_.emit(std::move(candidate)), old.extent), false);
    }
    return true;
  }

  struct ScatterPair {
    ValueId index, value;  // new
  };

  // `scatters`: the running number of the result among the If's scatters, from 1.
  void hand_on(const Op& op, size_t scatters, ValueId result, ScatterPair pair) {
    if (!emitter_.in_root()) {
      pairs_.insert_or_assign(result, pair);
      return;
    }
    const Extent domain = domain_of(op);
    if (broadcast(to_.value(pair.index).extent, to_.value(pair.value).extent) != domain)
      pair.value = emitter_.stretched(pair.value, domain);
    const auto extent = op.attrs.dims.begin() + static_cast<std::ptrdiff_t>(3 * scatters);
    const ValueInfo& info = from_.value(result);
    enter(result,
          emitter_.emit({.kind = OpKind::ScatterAdd,
                         .operands = {pair.index, pair.value},
                         .attrs = {.dims = {extent, extent + 3}},
                         .type = info.type,
                         .extent = info.extent,
                         .span = op.span}),
          false);
  }

  const Graph& from_;
  const bool differentiates_;  // there are gradients to come
  Builder to_;
  Emitter emitter_;
  ValueMap map_;
  std::vector<bool> needed_;
  std::vector<bool> target_;
  std::map<ValueId, OpId> rules_;                       // the Vjp of a cotangent, both of the root
  std::map<std::vector<ValueId>, int64_t> cotangents_;  // their numbers by value and targets, new ones
  size_t dead_ = 0;
  bool is_unfinished_ = false;            // an op or a result that nobody needs
  std::map<ValueId, ScatterPair> pairs_;  // accumulations of inlined Ifs, by old value
};

}  // namespace

Graph simplify(const Graph& graph, const Skips& given) {
  // What is shared before it is differentiated has one adjoint, the sum of those of its uses: that is how gradients add
  // up, and not for a switch to change. Nor is it counted then.
  Skips skips = given;
  const size_t shared_before = skips.left_out ? skips.left_out->share : 0;
  const bool differentiates = has_gradients(graph);
  if (differentiates) skips.share = true;
  // Each round but the first drops an op or a result, or makes an If a selection.
  size_t bound = 16 + graph.op_count() + graph.value_count();
  Round first(graph, skips);
  // What later rounds drop is what rewriting left behind.
  if (skips.left_out) skips.left_out->dead += first.dead();
  Graph current = first.run();
  for (;;) {
    Round next(current, skips);
    if (!next.is_unfinished()) break;
    if (bound-- == 0) DR_ICE("simplify does not end: two rules undo each other");
    current = next.run();
  }
  if (differentiates && skips.left_out) skips.left_out->share = shared_before;
  return current;
}

}  // namespace dr::passes
