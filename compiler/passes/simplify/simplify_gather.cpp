// SPDX-License-Identifier: Apache-2.0
// A read at another place of what a few cheap ops make of one integer image in memory, such as a mask of a raster's
// faces: the integer is read there and the ops come after, so that the image in between need not be stored.
//   gather(select(0 <= seen, 1.0, 0.0), i)  ->  select(0 <= gather(seen, i), 1.0, 0.0)
// Only where `i` is clamped to the image: outside, a read gives 0 whatever the ops make of it.
#include <algorithm>
#include <iterator>

#include "compiler/ops/op.h"
#include "compiler/passes/simplify/simplify.h"

namespace dr::passes {

using namespace ir;

namespace {

constexpr int kCheapOps = 4;
constexpr OpKind kCheap[] = {OpKind::Select,   OpKind::Less,       OpKind::LessEqual,  OpKind::Equal,
                             OpKind::NotEqual, OpKind::LogicalNot, OpKind::LogicalAnd, OpKind::LogicalOr};

class Pulled {
 public:
  Pulled(Emitter& emitter, const Candidate& gather)
      : e_(emitter), gather_(gather), extent_(emitter.value(gather.operands[0]).extent) {}

  std::optional<ValueId> apply() {
    int ops = 0;
    if (!in_range() || !cheap(gather_.operands[0], ops) || ops == 0 || !source_.valid()) return std::nullopt;
    return rebuilt(gather_.operands[0]);
  }

 private:
  // clamp(_, low, high) within the extent's sizes, which are numbers.
  bool in_range() const {
    const Op* clamp = e_.definition(gather_.operands[1], OpKind::Clamp);
    if (!clamp) return false;
    const auto* low = e_.constant(clamp->operands[1]);
    const auto* high = e_.constant(clamp->operands[2]);
    const Dim* const sizes[] = {&extent_.w, &extent_.h, &extent_.l};
    if (!high || !low || high->size() != low->size() || high->size() > std::size(sizes)) return false;
    for (size_t k = 0; k < std::min(high->size(), std::size(sizes)); ++k)
      if (!sizes[k]->is_constant() || (*low)[k] < 0 || (*high)[k] < (*low)[k] ||
          (*high)[k] >= static_cast<double>(sizes[k]->constant()))
        return false;
    return true;
  }

  // Whether the value is made of constants and the source by ops that the target can afford for each read.
  bool cheap(ValueId id, int& ops) {
    if (e_.constant(id)) return true;
    const Op* op = e_.definition(id);
    if (!op || e_.value(id).region != e_.graph().root()) return false;
    if (op->kind == OpKind::Leaf || op->kind == OpKind::Raster) {
      const ValueInfo& source = e_.value(id);
      if (!source.type.is_integer() || !source.type.is_scalar() || source.extent != extent_) return false;
      if (source_.valid() && source_ != id) return false;
      source_ = id;
      return true;
    }
    if (op->kind == OpKind::Broadcast) return e_.constant(op->operands[0]) != nullptr;
    return std::ranges::find(kCheap, op->kind) != std::end(kCheap) && ++ops <= kCheapOps &&
           std::ranges::all_of(op->operands, [&](ValueId operand) { return cheap(operand, ops); });
  }

  ValueId rebuilt(ValueId id) {
    if (e_.constant(id)) return id;
    const Op op = *e_.definition(id);  // a copy: emitting moves ops
    if (op.kind == OpKind::Broadcast) return op.operands[0];
    const Type type = e_.value(id).type;
    if (id == source_)
      return e_.emit({OpKind::Gather, {id, gather_.operands[1]}, gather_.attrs, type, gather_.extent, gather_.span});
    std::vector<ValueId> operands;
    for (const ValueId operand : op.operands) operands.push_back(rebuilt(operand));
    Extent extent;
    for (const ValueId operand : operands) extent = broadcast(extent, e_.value(operand).extent).value_or(extent);
    return e_.emit({op.kind, std::move(operands), op.attrs, type, extent, op.span});
  }

  Emitter& e_;
  const Candidate& gather_;
  const Extent extent_;  // of what is read
  ValueId source_;
};

}  // namespace

std::optional<ValueId> pull_gather(Emitter& emitter, const Candidate& gather) {
  return emitter.in_root() ? Pulled(emitter, gather).apply() : std::nullopt;
}

}  // namespace dr::passes
