// SPDX-License-Identifier: Apache-2.0
#include "compiler/passes/scatter/at_places.h"

#include <algorithm>

#include "compiler/ir/yields.h"
#include "compiler/ops/emit.h"
#include "compiler/ops/op.h"

namespace dr::passes {

using namespace ir;

namespace {

constexpr int kDepth = 6;

}  // namespace

const Op* AtPlaces::maker(ValueId v) const {
  const OpId op = from_.value(v).op;
  return op.valid() ? &from_.op(op) : nullptr;
}

std::optional<Variable> AtPlaces::variable(ValueId v) const {
  if (const auto trip = trips_.find(v); trip != trips_.end()) return trip->second;
  const Op* op = maker(v);
  if (!op || op->kind != OpKind::Coord) return std::nullopt;
  const auto axis = static_cast<size_t>(op->attrs.ints[0]);
  return op->attrs.dims[axis].is_one() ? std::nullopt : std::optional(static_cast<Variable>(axis));
}

std::vector<std::pair<ValueId, int>> AtPlaces::parts(const Op& op, int c) const {
  constexpr int kAll = -1;
  const Type& type = from_.value(op.results[0]).type;
  if (op.kind == OpKind::Compose && !type.is_matrix() && c != kAll) return {{op.operands[static_cast<size_t>(c)], 0}};
  if (op.kind == OpKind::Splat) return {{op.operands[0], 0}};
  const bool of_vector = !from_.value(op.operands.empty() ? op.results[0] : op.operands[0]).type.is_matrix();
  if (op.kind == OpKind::Extract && of_vector) return {{op.operands[0], static_cast<int>(op.attrs.ints[0])}};
  std::vector<std::pair<ValueId, int>> out;
  for (const ValueId v : op.operands) {
    const Type& of = from_.value(v).type;
    const bool same = c != kAll && !of.is_float() && !type.is_float() && of.rows == type.rows && of.cols == type.cols;
    out.emplace_back(v, of.is_scalar() ? 0 : same ? c : kAll);
  }
  return out;
}

Variables AtPlaces::depends(ValueId v) { return depends(v, -1); }

Variables AtPlaces::depends(ValueId v, int c) {
  if (const auto found = depends_.find({v, c}); found != depends_.end()) return found->second;
  Variables out = 0;
  const ValueInfo& info = from_.value(v);
  const Op* op = maker(v);
  if (const auto own = variable(v)) {
    out = only(*own);
  } else if (is_root(v) && info.extent.is_unit()) {
    out = 0;
  } else if (is_root(v) && !is_computed(v)) {
    const Dim* const axes[] = {&info.extent.w, &info.extent.h, &info.extent.l};
    for (Variable axis = 0; axis < 3; ++axis)
      if (!axes[axis]->is_one()) out |= only(axis);
  } else if (op) {
    if (op->kind == OpKind::Gather) {
      out = depends(op->operands[1]) | (reads_own_layer(*op) ? only(2) : 0);
    } else {
      for (const auto& [operand, part] : parts(*op, c)) out |= depends(operand, part);
    }
    for (const RegionId inner : op->regions) {
      // What is in there may be elements' places, too, which no region captures. Its own trips are known there.
      Variables inside = 0;
      for (const ValueId asked : asked_for(*op, inner)) inside |= depends(asked);
      for (const ValueId param : from_.region(inner).params)
        if (const auto trip = trips_.find(param); trip != trips_.end()) inside &= ~only(trip->second);
      out |= inside;
    }
  }  // else a parameter of a region inside, which is known there
  depends_[{v, c}] = out;
  return out;
}

// Whether a value of the root region is computed anew and not loaded.
bool AtPlaces::is_computed(ValueId v) {
  if (const auto found = computed_.find(v); found != computed_.end()) return found->second;
  std::set<ValueId> loads;
  const Op* op = maker(v);
  const bool small = op->kind != OpKind::Leaf && is_cheap(v, kDepth, loads) && loads.size() <= 1;
  const bool computed = is_pure(v) || op->kind == OpKind::Broadcast || small;
  computed_[v] = computed;
  return computed;
}

// Made of positions, sizes and constants.
bool AtPlaces::is_pure(ValueId v) {
  if (const auto found = pure_.find(v); found != pure_.end()) return found->second;
  const Op* op = maker(v);
  bool pure = false;
  if (op) {
    const bool source = op->kind == OpKind::Const || op->kind == OpKind::DimValue || op->kind == OpKind::Coord;
    const bool whole = op->kind == OpKind::Broadcast || ops::info(op->kind).shape == ops::Shape::Elementwise;
    pure = source || (whole && !from_.value(v).type.is_float() &&
                      std::ranges::all_of(op->operands, [&](ValueId operand) { return is_pure(operand); }));
  }
  pure_[v] = pure;
  return pure;
}

// Whether few ops make the value of `loads`, of leaves, and of elements that it reads at known places.
bool AtPlaces::is_cheap(ValueId v, int depth, std::set<ValueId>& loads) {
  if (is_pure(v) || from_.value(v).extent.is_unit()) return true;
  const Op& op = *maker(v);
  if (op.kind == OpKind::Leaf) return true;
  if (!ops::info(op.kind).light || depth == 0 || (op.kind == OpKind::Gather && !is_pure(op.operands[1]))) {
    loads.insert(v);
    return depth < kDepth;
  }
  if (op.kind == OpKind::Gather) return true;
  return std::ranges::all_of(op.operands, [&](ValueId operand) { return is_cheap(operand, depth - 1, loads); });
}

ValueId AtPlaces::now(Variable variable) const {
  for (size_t k = scopes_.size(); k-- > 0;)
    if (const auto found = scopes_[k].variables.find(variable); found != scopes_[k].variables.end())
      return found->second;
  DR_ICE("a variable is not known");
}

// Where an image of this extent has the element.
ValueId AtPlaces::place(const Extent& extent) {
  const Dim* const axes[] = {&extent.w, &extent.h, &extent.l};
  const int rows = !extent.l.is_one() ? 3 : !extent.h.is_one() ? 2 : 1;
  std::vector<ValueId> parts;
  for (Variable axis = 0; axis < rows; ++axis)
    parts.push_back(axes[axis]->is_one() ? ops::constant(to_, kInt, 0.0) : now(axis));
  return rows == 1 ? parts[0] : ops::compose(to_, std::move(parts), vec(rows, Scalar::Int));
}

ValueId AtPlaces::at(ValueId v) {
  for (size_t k = scopes_.size(); k-- > 0;)
    if (const auto found = scopes_[k].values.find(v); found != scopes_[k].values.end()) return found->second;
  if (const auto own = variable(v)) return now(*own);
  const ValueId value = compute(v);
  scopes_.back().values[v] = value;
  return value;
}

ValueId AtPlaces::at(ValueId v, int c) {
  if (from_.value(v).type.is_scalar()) return at(v);
  // The component alone: the others may depend on more than is known.
  const Op* op = maker(v);
  if (op && op->kind == OpKind::Compose && !from_.value(v).type.is_matrix())
    return at(op->operands[static_cast<size_t>(c)]);
  if (op && op->kind == OpKind::Splat) return at(op->operands[0]);
  if (op && !from_.value(v).type.is_float() && (!is_root(v) || is_computed(v)) &&
      (op->kind == OpKind::Broadcast || ops::info(op->kind).shape == ops::Shape::Elementwise)) {
    const auto from = parts(*op, c);
    if (std::ranges::all_of(from, [](const auto& part) { return part.second >= 0; })) {
      std::vector<ValueId> operands;
      for (const auto& [operand, part] : from) operands.push_back(at(operand, part));
      if (op->kind == OpKind::Broadcast) return operands[0];
      return ops::emit(to_, op->kind, std::move(operands), op->attrs);
    }
  }
  return ops::extract(to_, at(v), c);
}

// What a region yields but for what is scattered, which is not what is asked for.
std::vector<ValueId> AtPlaces::asked_for(const Op& op, RegionId id) const {
  const std::vector<ValueId>& yields = from_.region(id).yields;
  const auto combining = yielding_regions(op);
  if (std::ranges::find(combining, id) == combining.end()) return yields;
  const std::vector<Yielded> all = yielded(from_, op, id);
  size_t combined = 0;
  for (const Yielded& part : all) combined += part.index.valid() ? 2 : 1;
  std::vector<ValueId> out(yields.begin(), yields.end() - static_cast<std::ptrdiff_t>(combined));
  for (size_t k = 0; k < all.size(); ++k)
    if (op.attrs.yields[k] != Yield::Scatter) out.push_back(all[k].value);
  return out;
}

RegionId AtPlaces::region(const Op& op, RegionId id) {
  const Region& old = from_.region(id);
  std::vector<ResultType> params;
  for (const ValueId param : old.params) params.push_back({from_.value(param).type, domain_});
  const RegionId made = to_.begin_region(params);
  enter();
  for (size_t k = 0; k < params.size(); ++k) scopes_.back().values[old.params[k]] = to_.graph().region(made).params[k];
  std::vector<ValueId> yields;
  for (const ValueId v : asked_for(op, id)) yields.push_back(at(v));
  leave();
  to_.end_region(std::move(yields));
  return made;
}

// Whether an index names no layer of an image that has several: it means that of the element.
bool AtPlaces::reads_own_layer(const Op& gather) const {
  return !from_.value(gather.operands[0]).extent.l.is_one() && from_.value(gather.operands[1]).type.rows < 3;
}

ValueId AtPlaces::gather(const Op& op) {
  const ValueId index = op.operands[1];
  ValueId place = at(index);
  if (reads_own_layer(op)) {
    const ValueId zero = ops::constant(to_, kInt, 0.0);
    const bool one = from_.value(index).type.is_scalar();
    place = ops::compose(to_, {one ? place : at(index, 0), one ? zero : at(index, 1), now(2)}, vec(3, Scalar::Int));
  }
  return ops::emit(to_, OpKind::Gather, {map_[op.operands[0]], place});
}

ValueId AtPlaces::compute(ValueId v) {
  const ValueInfo& info = from_.value(v);
  if (is_root(v)) {
    if (info.extent.is_unit()) return map_[v];
    if (!is_computed(v)) return ops::emit(to_, OpKind::Gather, {map_[v], place(info.extent)});
  }
  const Op& op = *maker(v);
  if (op.kind == OpKind::Const) return ops::constant(to_, info.type, op.attrs.floats);
  if (op.kind == OpKind::Coord) return ops::constant(to_, kInt, 0.0);  // of an axis of extent 1
  if (op.kind == OpKind::Broadcast) return at(op.operands[0]);
  if (op.kind == OpKind::Gather) return gather(op);
  if (op.kind == OpKind::Extract && !from_.value(op.operands[0]).type.is_matrix())
    return at(op.operands[0], static_cast<int>(op.attrs.ints[0]));
  std::vector<ValueId> operands;
  for (const ValueId operand : op.operands) operands.push_back(at(operand));
  if (op.regions.empty()) return ops::emit(to_, op.kind, std::move(operands), op.attrs);
  Attrs attrs = op.attrs;
  attrs.dims = {domain_.w, domain_.h, domain_.l};
  std::erase(attrs.yields, Yield::Scatter);
  std::vector<RegionId> regions;
  for (const RegionId inner : op.regions) regions.push_back(region(op, inner));
  const std::vector<ValueId> results = ops::emit_multi(to_, op.kind, std::move(operands), attrs, std::move(regions));
  size_t at = 0;
  for (size_t k = 0; k < op.results.size(); ++k)
    if (op.attrs.yields[k] != Yield::Scatter) scopes_.back().values[op.results[k]] = results[at++];
  return scopes_.back().values.at(v);
}

void AtPlaces::prepare(ValueId v, Variables known) {
  std::set<ValueId> seen;  // one value is an operand of many
  std::vector<ValueId> open = {v};
  while (!open.empty()) {
    const ValueId next = open.back();
    open.pop_back();
    if (!seen.insert(next).second) continue;
    if ((depends(next) & ~known) == 0) {
      at(next);
      continue;
    }
    const Op* op = maker(next);
    if (!op || variable(next) || (is_root(next) && !is_computed(next))) continue;
    if (op->kind == OpKind::Gather)
      open.push_back(op->operands[1]);
    else
      open.insert(open.end(), op->operands.rbegin(), op->operands.rend());
  }
}

}  // namespace dr::passes
