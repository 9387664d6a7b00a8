// SPDX-License-Identifier: Apache-2.0
// Appending ops in their simplest form, equal ones once: a table of the ops that can be seen from the place under
// construction, by hash. Ops with regions are equal when their regions are, up to the names of what is defined inside.
#include <algorithm>
#include <bit>
#include <unordered_map>
#include <utility>

#include "compiler/ops/op.h"
#include "compiler/passes/simplify/simplify.h"

namespace dr::passes {

using namespace ir;

namespace {

uint64_t mix(uint64_t seed, uint64_t value) {
  seed = (seed ^ value) * 0x9e3779b97f4a7c15u;
  return seed ^ (seed >> 29);
}

// Does the order of the two operands matter to no bit of the result?
bool commutes(OpKind kind) { return ops::info(kind).commutes; }

uint64_t hash_attrs(const Attrs& attrs, uint64_t seed) {
  for (int64_t number : attrs.ints) seed = mix(seed, static_cast<uint64_t>(number));
  for (double number : attrs.floats) seed = mix(seed, std::bit_cast<uint64_t>(number));
  for (Yield yield : attrs.yields) seed = mix(seed, static_cast<uint64_t>(yield));
  if (!attrs.text.empty()) seed = mix(seed, std::hash<std::string>()(attrs.text));
  return mix(seed, attrs.dims.size());
}

// As bits: NaN is NaN, and the zeros differ.
bool same_floats(const std::vector<double>& a, const std::vector<double>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](double x, double y) { return std::bit_cast<uint64_t>(x) == std::bit_cast<uint64_t>(y); });
}

bool same_attrs(const Attrs& a, const Attrs& b) {
  return a.ints == b.ints && same_floats(a.floats, b.floats) && a.dims == b.dims && a.yields == b.yields &&
         a.text == b.text;
}

bool same_operands(OpKind kind, const std::vector<ValueId>& a, const std::vector<ValueId>& b) {
  if (a == b) return true;
  return commutes(kind) && a.size() == 2 && b.size() == 2 && a[0] == b[1] && a[1] == b[0];
}

uint64_t hash_candidate(const Candidate& candidate) {
  uint64_t seed = mix(0, static_cast<uint64_t>(candidate.kind));
  if (commutes(candidate.kind)) {
    // A sum, so that both orders meet.
    uint64_t sum = 0;
    for (ValueId id : candidate.operands) sum += mix(1, id.index);
    seed = mix(seed, sum);
  } else {
    for (ValueId id : candidate.operands) seed = mix(seed, id.index);
  }
  return hash_attrs(candidate.attrs, seed);
}

// Ops with regions. Values defined inside are named by their order.
class Structure {
 public:
  explicit Structure(const Graph& graph) : graph_(graph) {}

  uint64_t hash(OpId id) {
    const Op& op = graph_.op(id);
    uint64_t seed = mix(2, static_cast<uint64_t>(op.kind));
    for (ValueId operand : op.operands) seed = mix(seed, name(operand));
    seed = hash_attrs(op.attrs, seed);
    for (RegionId region_id : op.regions) {
      const Region& region = graph_.region(region_id);
      for (ValueId param : region.params) enter(param);
      for (OpId inner : region.ops) {
        seed = mix(seed, hash(inner));
        for (ValueId result : graph_.op(inner).results) enter(result);
      }
      for (ValueId yield : region.yields) seed = mix(seed, name(yield));
    }
    return seed;
  }

  bool equal(OpId a_id, OpId b_id) {
    const Op& a = graph_.op(a_id);
    const Op& b = graph_.op(b_id);
    if (a.kind != b.kind || a.regions.size() != b.regions.size() || !same_attrs(a.attrs, b.attrs)) return false;
    if (!equal(a.operands, b.operands) || !pair_up(a.results, b.results)) return false;
    for (size_t r = 0; r < a.regions.size(); ++r) {
      const Region& x = graph_.region(a.regions[r]);
      const Region& y = graph_.region(b.regions[r]);
      if (x.ops.size() != y.ops.size() || !pair_up(x.params, y.params)) return false;
      for (size_t i = 0; i < x.ops.size(); ++i) {
        if (!equal(x.ops[i], y.ops[i])) return false;
      }
      if (!equal(x.yields, y.yields)) return false;
    }
    return true;
  }

 private:
  void enter(ValueId id) { names_.emplace(id.index, names_.size()); }
  uint64_t name(ValueId id) const {
    const auto found = names_.find(id.index);
    return found == names_.end() ? id.index : found->second + (uint64_t{1} << 32);
  }

  bool equal(const std::vector<ValueId>& a, const std::vector<ValueId>& b) const {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(), [&](ValueId x, ValueId y) {
      const auto found = pairs_.find(x.index);
      return (found == pairs_.end() ? x : found->second) == y;
    });
  }
  bool pair_up(const std::vector<ValueId>& a, const std::vector<ValueId>& b) {
    if (a.size() != b.size()) return false;
    for (size_t i = 0; i < a.size(); ++i) {
      const ValueInfo& x = graph_.value(a[i]);
      const ValueInfo& y = graph_.value(b[i]);
      if (x.type != y.type || x.extent != y.extent || x.accumulation != y.accumulation) return false;
      pairs_.insert_or_assign(a[i].index, b[i]);
    }
    return true;
  }

  const Graph& graph_;
  std::unordered_map<uint32_t, uint64_t> names_;
  std::unordered_map<uint32_t, ValueId> pairs_;
};

}  // namespace

void OpTable::insert(uint64_t hash, OpId op) {
  const auto place = [this](const Entry& entry) {
    const size_t mask = entries_.size() - 1;
    size_t at = entry.hash & mask;
    while (entries_[at].op.valid()) at = (at + 1) & mask;
    entries_[at] = entry;
  };
  if (2 * (count_ + 1) > entries_.size()) {
    std::vector<Entry> old(std::max<size_t>(16, 2 * entries_.size()));
    old.swap(entries_);
    // From behind a free place on, so that entries of one hash keep their order.
    const auto free = std::find_if(old.begin(), old.end(), [](const Entry& entry) { return !entry.op.valid(); });
    std::rotate(old.begin(), free, old.end());
    for (const Entry& entry : old) {
      if (entry.op.valid()) place(entry);
    }
  }
  place({hash, op});
  ++count_;
}

template <class IsEqual>
OpId Emitter::find(uint64_t hash, const IsEqual& is_equal) const {
  for (const OpTable& scope : scopes_) {
    if (const OpId found = scope.find(hash, is_equal); found.valid()) return found;
  }
  return {};
}

ValueId Emitter::emit(Candidate candidate) {
  if (const auto simpler = apply_identity(*this, candidate)) return *simpler;
  if (leaves_out(&Skips::fold)) {
    if (const auto constant = fold(*this, candidate)) {
      count(&Skips::LeftOut::fold);
      return *constant;
    }
  }
  if (!leaves_out(&Skips::share)) return append(std::move(candidate));
  const uint64_t hash = hash_candidate(candidate);
  if (const auto equal = existing(candidate, hash)) {
    if (candidate.kind != OpKind::Const) count(&Skips::LeftOut::share);
    return *equal;
  }
  const ValueId result = append(std::move(candidate));
  scopes_.back().insert(hash, value(result).op);
  return result;
}

std::optional<ValueId> Emitter::existing(const Candidate& candidate) const {
  return leaves_out(&Skips::share) ? existing(candidate, hash_candidate(candidate)) : std::nullopt;
}

std::optional<ValueId> Emitter::existing(const Candidate& candidate, uint64_t hash) const {
  const OpId equal = find(hash, [&](OpId id) {
    const Op& op = graph().op(id);
    if (op.kind != candidate.kind || !op.regions.empty()) return false;
    const ValueInfo& info = value(op.results[0]);
    return same_operands(op.kind, op.operands, candidate.operands) && same_attrs(op.attrs, candidate.attrs) &&
           info.type == candidate.type && info.extent == candidate.extent;
  });
  return equal.valid() ? std::optional(graph().op(equal).results[0]) : std::nullopt;
}

ValueId Emitter::emit_opaque(Candidate candidate) {
  const ValueId result = append(std::move(candidate));
  set_opaque(result);
  return result;
}

void Emitter::set_opaque(ValueId id) {
  if (id.index >= opaque_.size()) opaque_.resize(id.index + 1);
  opaque_[id.index] = true;
}

ValueId Emitter::append(Candidate candidate) {
  const ResultType type{candidate.type, candidate.extent};
  const OpId op = to_.add(candidate.kind, std::move(candidate.operands), {&type, 1}, std::move(candidate.attrs), {},
                          candidate.span);
  return graph().op(op).results[0];
}

OpId Emitter::share(OpId id) {
  if (!leaves_out(&Skips::share)) return id;
  const uint64_t hash = Structure(graph()).hash(id);
  // The op just appended has no users then: the next round drops it.
  const OpId equal = find(hash, [&](OpId other) { return Structure(graph()).equal(id, other); });
  if (equal.valid()) {
    count(&Skips::LeftOut::share);
    return equal;
  }
  scopes_.back().insert(hash, id);
  return id;
}

const Op* Emitter::definition(ValueId id) const {
  const OpId op = value(id).op;
  const bool opaque = id.index < opaque_.size() && opaque_[id.index];
  return op.valid() && !opaque ? &graph().op(op) : nullptr;
}

const Op* Emitter::definition(ValueId id, OpKind kind) const {
  const Op* op = definition(id);
  return op && op->kind == kind ? op : nullptr;
}

const std::vector<double>* Emitter::constant(ValueId id) const {
  const Op* op = definition(id, OpKind::Const);
  return op ? &op->attrs.floats : nullptr;
}

const std::vector<double>* Emitter::constant_everywhere(ValueId id) const {
  const Op* stretch = definition(id, OpKind::Broadcast);
  return constant(stretch ? stretch->operands[0] : id);
}

ValueId Emitter::make_constant(Type type, std::vector<double> components) {
  return emit({.kind = OpKind::Const,
               .operands = {},
               .attrs = {.floats = std::move(components)},
               .type = type,
               .extent = {},
               .span = {}});
}

ValueId Emitter::stretched(ValueId id, const Extent& extent) {
  if (!in_root() || value(id).extent == extent) return id;
  return emit({.kind = OpKind::Broadcast,
               .operands = {id},
               .attrs = {.dims = {extent.w, extent.h, extent.l}},
               .type = value(id).type,
               .extent = extent,
               .span = {}});
}

}  // namespace dr::passes
