// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/analysis/alike_branches.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::RegionId;
using ir::ValueId;

namespace {

// Ops of a branch that are worth a loop, and for each value that must be chosen.
constexpr size_t kWorthLoop = 32, kWorthChoice = 4;

size_t size_of(const Graph& graph, RegionId region) {
  size_t size = 0;
  for (const OpId id : graph.region(region).ops) {
    if (!is_inline(graph.op(id))) ++size;
    for (const RegionId inner : graph.op(id).regions) size += size_of(graph, inner);
  }
  return size;
}

// Folds have arrays of their own and stop in ways that depend on what they take.
bool has_folds(const Graph& graph, RegionId region) {
  return std::ranges::any_of(graph.region(region).ops, [&](OpId id) {
    const Op& op = graph.op(id);
    return op.kind == OpKind::Fold ||
           std::ranges::any_of(op.regions, [&](RegionId inner) { return has_folds(graph, inner); });
  });
}

// Whether the second branch only says what stands for the first: it computes and adds nothing.
bool is_plain(const Graph& graph, const Op& op) {
  const RegionId region = op.regions[1];
  const auto is_nowhere = [&](ValueId index) {
    const Op& by = graph.op(graph.value(index).op);
    return by.kind == OpKind::Const && std::ranges::any_of(by.attrs.floats, [](double x) { return x < 0; });
  };
  if (!std::ranges::all_of(graph.region(region).ops, [&](OpId id) { return is_inline(graph.op(id)); })) return false;
  const std::vector<ir::Yielded> parts = ir::yielded(graph, op, region);
  for (size_t k = 0; k < parts.size(); ++k) {
    if (op.attrs.yields[k] != ir::Yield::Scatter) continue;
    if (!parts[k].index.valid() || !graph.value(parts[k].index).op.valid() || !is_nowhere(parts[k].index)) return false;
  }
  return true;
}

// Whether two ops do the same with what they take, and what each takes.
class Comparison {
 public:
  explicit Comparison(const Graph& graph) : graph_(graph) {}

  // Two `if`s, whatever their conditions.
  bool alike_branches(const Op& a, const Op& b) { return alike_results(a, b); }

  // From outside: what the second op has in the place of what the first has.
  const std::map<ValueId, ValueId>& outside() const { return outside_; }

 private:
  bool alike(const Op& a, const Op& b) {
    if (a.kind != b.kind || a.operands.size() != b.operands.size()) return false;
    const auto reads = ops::info(a.kind).reads.value_or(ops::Reads::AtElement);
    for (size_t k = 0; k < a.operands.size(); ++k) {
      // What is read at other places is an image, which nothing can choose.
      const bool image = reads != ops::Reads::AtElement && (k == 0 || reads != ops::Reads::FirstElsewhere);
      if (image ? a.operands[k] != b.operands[k] : !same(a.operands[k], b.operands[k])) return false;
    }
    if (a.kind == OpKind::Div && !same_divisor(a.operands[1], b.operands[1])) return false;
    return alike_results(a, b);
  }

  bool alike_results(const Op& a, const Op& b) {
    if (a.attrs != b.attrs || a.results.size() != b.results.size() || a.regions.size() != b.regions.size())
      return false;
    for (size_t k = 0; k < a.results.size(); ++k) {
      if (graph_.value(a.results[k]).type != graph_.value(b.results[k]).type) return false;
      define(a.results[k], b.results[k]);
    }
    for (size_t k = 0; k < a.regions.size(); ++k)
      if (!alike(graph_.region(a.regions[k]), graph_.region(b.regions[k]))) return false;
    return true;
  }

  bool alike(const ir::Region& a, const ir::Region& b) {
    const std::vector<OpId> one = computed(a), other = computed(b);
    if (one.size() != other.size() || a.params.size() != b.params.size() || a.yields.size() != b.yields.size())
      return false;
    for (size_t k = 0; k < a.params.size(); ++k) define(a.params[k], b.params[k]);
    for (size_t k = 0; k < one.size(); ++k)
      if (!alike(graph_.op(one[k]), graph_.op(other[k]))) return false;
    for (size_t k = 0; k < a.yields.size(); ++k)
      if (!same(a.yields[k], b.yields[k])) return false;
    return true;
  }

  // The ops of a region but those that are written down where they are used, inside or outside of it.
  std::vector<OpId> computed(const ir::Region& region) {
    std::vector<OpId> out;
    for (const OpId id : region.ops) {
      const Op& op = graph_.op(id);
      if (!is_inline(op))
        out.push_back(id);
      else
        written_.insert(op.results[0]);
    }
    return out;
  }

  // Whether two values are written down alike.
  bool same_text(ValueId a, ValueId b) const {
    if (!graph_.value(a).op.valid() || !graph_.value(b).op.valid()) return false;
    const Op &x = graph_.op(graph_.value(a).op), &y = graph_.op(graph_.value(b).op);
    return is_inline(x) && x.kind == y.kind && x.attrs == y.attrs && graph_.value(a).type == graph_.value(b).type;
  }

  void define(ValueId a, ValueId b) {
    inside_[a] = b;
    second_.insert(b);
  }

  bool same(ValueId a, ValueId b) {
    if (const auto it = inside_.find(a); it != inside_.end()) return it->second == b;
    if (same_text(a, b)) return true;
    const bool inside = second_.count(b) != 0 || written_.count(a) != 0 || written_.count(b) != 0;
    if (inside || graph_.value(a).type != graph_.value(b).type) return false;
    // What is written down where it is used may stand for itself elsewhere in the branch: nothing is chosen for it.
    if (graph_.value(a).op.valid() && is_inline(graph_.op(graph_.value(a).op))) return false;
    return outside_.emplace(a, b).first->second == b;
  }

  // What is divided by may be known to drivers, which divide by known numbers in ways of their own: see divisors.h.
  bool same_divisor(ValueId a, ValueId b) const {
    if (inside_.count(a) == 0) return a == b || same_text(a, b);
    const OpId from = graph_.value(a).op;
    if (!from.valid() || !ops::info(graph_.op(from).kind).moves) return true;
    const Op &x = graph_.op(from), &y = graph_.op(graph_.value(b).op);
    for (size_t k = 0; k < x.operands.size(); ++k)
      if (!same_divisor(x.operands[k], y.operands[k])) return false;
    return true;
  }

  const Graph& graph_;
  std::map<ValueId, ValueId> inside_, outside_;
  std::set<ValueId> second_;
  std::set<ValueId> written_;  // inside
};

// Ops of a list, by their places in it.
class List {
 public:
  List(const Graph& graph, std::span<const OpId> ops) : graph_(graph), ops_(ops), needs_(ops.size()) {
    for (size_t k = 0; k < ops.size(); ++k)
      for (const ValueId v : graph.op(ops[k]).results) made_by_[v] = k;
    for (size_t k = 0; k < ops.size(); ++k) add_needs(graph.op(ops[k]), needs_[k]);
  }

  // All that must run before one of these does, where the ops of a group run together. `group_of`: by place, or -1.
  std::set<size_t> before(const std::vector<size_t>& places, const std::vector<std::vector<size_t>>& groups,
                          const std::vector<int>& group_of) const {
    std::set<size_t> out;
    std::vector<size_t> open;
    const auto visit = [&](size_t place) {
      if (out.insert(place).second) open.push_back(place);
    };
    for (const size_t place : places)
      for (const size_t need : needs_[place]) visit(need);
    while (!open.empty()) {
      const size_t place = open.back();
      open.pop_back();
      for (const size_t need : needs_[place]) visit(need);
      if (group_of[place] < 0) continue;
      for (const size_t other : groups[static_cast<size_t>(group_of[place])]) visit(other);
    }
    return out;
  }

 private:
  void add_needs(const Op& op, std::set<size_t>& needs) const {
    const auto add = [&](ValueId v) {
      if (const auto it = made_by_.find(v); it != made_by_.end()) needs.insert(it->second);
    };
    for (const ValueId v : op.operands) add(v);
    for (const RegionId id : op.regions) {
      for (const OpId inner : graph_.region(id).ops) add_needs(graph_.op(inner), needs);
      for (const ValueId v : graph_.region(id).yields) add(v);
    }
  }

  const Graph& graph_;
  std::span<const OpId> ops_;
  std::map<ValueId, size_t> made_by_;
  std::vector<std::set<size_t>> needs_;
};

struct Group {
  size_t size = 0;  // of a branch
  std::vector<size_t> places;
  std::map<ValueId, std::vector<ValueId>> outside;  // by what the first takes

  std::vector<std::vector<ValueId>> taken() const {
    std::vector<std::vector<ValueId>> out;
    for (const auto& [first, values] : outside) {
      if (std::ranges::all_of(values, [&](ValueId v) { return v == first; })) continue;
      out.push_back(values);
      out.back().resize(places.size(), first);
    }
    return out;
  }
};

// The `if`s that are worth a loop, by what is alike.
std::vector<Group> find_groups(const Graph& graph, std::span<const OpId> ops, std::optional<List>& list) {
  std::vector<Group> groups;
  const std::vector<int> alone(ops.size(), -1);
  for (size_t place = 0; place < ops.size(); ++place) {
    const Op& op = graph.op(ops[place]);
    if (op.kind != OpKind::If) continue;
    const size_t size = size_of(graph, op.regions[0]);
    if (size < kWorthLoop || !is_plain(graph, op) || has_folds(graph, op.regions[0])) continue;
    bool joined = false;
    for (Group& group : groups) {
      Comparison comparison(graph);
      if (group.size != size || !comparison.alike_branches(graph.op(ops[group.places[0]]), op)) continue;
      if (!list) list.emplace(graph, ops);
      const std::set<size_t> before = list->before({place}, {}, alone);
      if (std::ranges::any_of(group.places, [&](size_t member) { return before.count(member) != 0; })) continue;
      for (const auto& [first, value] : comparison.outside()) {
        std::vector<ValueId>& values = group.outside[first];
        values.resize(group.places.size(), first);
        values.push_back(value);
      }
      group.places.push_back(place);
      joined = true;
      break;
    }
    if (!joined) groups.push_back({size, {place}, {}});
  }
  std::erase_if(groups, [](const Group& group) {
    return group.places.size() < 2 || group.taken().size() * kWorthChoice > group.size;
  });
  return groups;
}

}  // namespace

std::vector<Together> alike_together(const Graph& graph, std::span<const OpId> ops) {
  std::optional<List> all;
  const std::vector<Group> found = find_groups(graph, ops, all);
  if (found.empty()) return {};
  const List& list = *all;
  std::vector<std::vector<size_t>> groups;
  std::vector<std::vector<std::vector<ValueId>>> taken;
  std::vector<int> group_of(ops.size(), -1);
  for (const Group& group : found) {
    // None of them may wait for another, whatever runs together already.
    const std::set<size_t> before = list.before(group.places, groups, group_of);
    if (std::ranges::any_of(group.places, [&](size_t place) { return before.count(place) != 0; })) continue;
    for (const size_t place : group.places) group_of[place] = static_cast<int>(groups.size());
    groups.push_back(group.places);
    taken.push_back(group.taken());
  }
  if (groups.empty()) return {};

  std::vector<Together> out;
  std::vector<bool> is_out(ops.size(), false);
  const auto append = [&](const auto& self, size_t place) -> void {
    if (is_out[place]) return;
    if (group_of[place] < 0) {
      is_out[place] = true;
      out.push_back({{ops[place]}, {}});
      return;
    }
    const auto group = static_cast<size_t>(group_of[place]);
    for (const size_t earlier : list.before(groups[group], groups, group_of)) self(self, earlier);
    Together& together = out.emplace_back();
    for (const size_t member : groups[group]) {
      is_out[member] = true;
      together.ops.push_back(ops[member]);
    }
    together.taken = taken[group];
  };
  for (size_t place = 0; place < ops.size(); ++place) append(append, place);
  return out;
}

}  // namespace dr::backend
