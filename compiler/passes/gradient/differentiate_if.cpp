// SPDX-License-Identifier: Apache-2.0
// The adjoint of If is an If on the same condition. Each branch replays its forward branch and runs the reverse sweep,
// so the branch not taken computes nothing and has nothing to leak.
//   %r = if(%c) { %a = mul %x, %x; yield %a } else { yield %0 }
//     =>  %dx = if(%c) { %a = mul %x, %x; %t = mul %dr, %x; %u = add %t, %t; yield %u } else { yield 0 }
// A value that gets an adjoint in one branch only gets zero in the other; an image that only one branch reads gets a
// scatter to nowhere.
#include <optional>
#include <set>

#include "compiler/ops/emit.h"
#include "compiler/passes/gradient/differentiate.h"

namespace dr::passes {

using ir::Attrs;
using ir::Builder;
using ir::Extent;
using ir::Op;
using ir::OpKind;
using ir::RegionId;
using ir::Type;
using ir::ValueId;
using ir::Yield;

namespace {

// A Scatter result: which term each branch yields for it, if any.
struct Slot {
  std::optional<ScatterTerm> in_then;
  std::optional<ScatterTerm> in_else;
  const ScatterTerm& either() const { return in_then ? *in_then : *in_else; }
};

// Terms of the two branches share a result when they go to one image under one type of index.
std::vector<Slot> pair_up(const Builder& b, const Frame& then_frame, const Frame& else_frame) {
  const auto index_type = [&](const ScatterTerm& term) {
    return term.index.valid() ? std::optional<Type>(b.value(term.index).type) : std::nullopt;
  };
  std::vector<Slot> slots;
  for (const ScatterTerm& term : then_frame.scatters) slots.push_back({.in_then = term, .in_else = {}});
  for (const ScatterTerm& term : else_frame.scatters) {
    Slot* found = nullptr;
    for (Slot& slot : slots) {
      if (slot.in_else || slot.in_then->image != term.image || index_type(*slot.in_then) != index_type(term)) continue;
      found = &slot;
      break;
    }
    if (found != nullptr) {
      found->in_else = term;
    } else {
      slots.push_back({.in_then = {}, .in_else = term});
    }
  }
  return slots;
}

// What a branch yields for a slot: its term, or zero at an index outside any image.
void yield_slot(Sweep& sweep, const std::optional<ScatterTerm>& term, const ScatterTerm& other,
                std::vector<ValueId>& yields) {
  Builder& b = sweep.builder;
  if (!term) {
    const Type index = other.index.valid() ? b.value(other.index).type : ir::vec(3, ir::Scalar::Int);
    yields.push_back(ops::constant(b, index, -1.0));
    yields.push_back(ops::constant(b, sweep.source.value(other.image).type, 0.0));
    return;
  }
  if (term->index.valid()) yields.push_back(term->index);
  yields.push_back(term->value);
}

}  // namespace

void differentiate_if(Sweep& sweep, Frame& outer, ir::OpId id) {
  const Op& op = sweep.source.op(id);
  const std::vector<ResultAdjoint> adjoints = result_adjoints(sweep, outer, op);
  if (!any(adjoints)) return;
  const Extent domain = adjoint_domain(outer, op);
  Builder& b = sweep.builder;
  // The second branch is built while the first is open: either may have to yield zeros for what only the other has.
  const RegionId then_region = b.begin_region({});
  Frame then_frame{.root = false, .domain = domain, .adjoints = {}, .accumulated = {}, .scatters = {}};
  reverse(sweep, then_frame, op, op.regions[0], adjoints);
  const RegionId else_region = b.begin_region({});
  Frame else_frame{.root = false, .domain = domain, .adjoints = {}, .accumulated = {}, .scatters = {}};
  reverse(sweep, else_frame, op, op.regions[1], adjoints);

  std::set<ValueId> both;
  for (const auto& [value, adjoint] : then_frame.adjoints) both.insert(value);
  for (const auto& [value, adjoint] : else_frame.adjoints) both.insert(value);
  const std::vector<ValueId> captured(both.begin(), both.end());
  const std::vector<Slot> slots = pair_up(b, then_frame, else_frame);

  const auto close = [&](const Frame& frame, std::optional<ScatterTerm> Slot::*term) {
    std::vector<ValueId> yields;
    for (const ValueId value : captured) {
      const auto found = frame.adjoints.find(value);
      const bool has = found != frame.adjoints.end();
      yields.push_back(has ? found->second : ops::constant(b, sweep.source.value(value).type, 0.0));
    }
    for (const Slot& slot : slots) yield_slot(sweep, slot.*term, slot.either(), yields);
    // Rules may find that no adjoint flows after all; an op without results would be no op.
    if (yields.empty()) yields.push_back(ops::constant(b, ir::kFloat, 0.0));
    b.end_region(std::move(yields));
  };
  close(else_frame, &Slot::in_else);
  close(then_frame, &Slot::in_then);

  Attrs attrs;
  append_extent(attrs, domain);
  attrs.yields.assign(captured.size(), Yield::Element);
  std::vector<ValueId> images;
  for (const Slot& slot : slots) {
    images.push_back(slot.either().image);
    attrs.yields.push_back(Yield::Scatter);
    append_extent(attrs, sweep.source.value(images.back()).extent);
  }
  if (attrs.yields.empty()) attrs.yields.push_back(Yield::Element);
  const ValueId condition = sweep.now[op.operands[0]];
  const std::vector<ValueId> results =
      ops::emit_multi(b, OpKind::If, {condition}, std::move(attrs), {then_region, else_region});
  collect(sweep, outer, captured, images, results);
}

}  // namespace dr::passes
