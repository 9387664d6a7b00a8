// SPDX-License-Identifier: Apache-2.0
// Where shaders that are too large are cut, so that what they compute is stored in parts.
#include <algorithm>
#include <functional>
#include <map>
#include <set>
#include <utility>

#include "compiler/backend/pack/step_packer.h"

namespace dr::backend {

// By a compute pass of its own, unless a pass has stored it already; later shaders load it.
void StepPacker::store_before(ValueId v, const Extent& domain) {
  if (!stored_[v.index]) {
    stored_[v.index] = true;
    add_resource(v, def(v));
  }
  resource(v).leave_image();
  if (!written_[v.index]) add_map_pass(domain, {v}, level_[graph_.value(v).op.index], false);
  spilled_[v.index] = true;
}

// What must be computed again for the ops behind `id` if `v` is stored: those ops of its cone that others use later,
// and what they take.
size_t StepPacker::size_again(ValueId v, OpId id, int level, size_t most) {
  begin_cone(level);
  grow(v, most);
  std::ranges::sort(cone_.ops, std::greater(), [&](OpId op) { return position_[op.index]; });
  std::set<OpId> again;
  size_t size = 0;
  for (OpId op : cone_.ops) {
    if (op == graph_.value(v).op) continue;
    bool later = false;
    for (ValueId result : graph_.op(op).results)
      for (OpId user : users_[result.index])
        later =
            later || again.contains(user) || (position_[user.index] > position_[id.index] && !spilled_[result.index]);
    if (!later) continue;
    again.insert(op);
    size += size_[op.index];
  }
  return size;
}

// Where `targets` take a shader that is too large, parts of it are stored by passes before: walks its ops, and where
// one takes too much, the operand is cut off without which least is left, and of which least is computed again later:
// where a backward sweep meets the values that its next part needs, the sweep is stored and not what came of one of
// these values. What is used again far behind may take a third only, and what several ops use a half: values of a
// forward sweep are computed again beside each part of the backward sweep, which should have room for as much. Ops that
// are too large by themselves stay.
void StepPacker::cut(const Extent& domain, const std::vector<ValueId>& targets, int level) {
  const size_t longest = kMaxSize;
  elsewhere_.clear();
  begin_cone(level);
  for (ValueId v : targets) grow(v);
  if (cone_.size <= longest) return;
  std::vector<OpId> ops = std::move(cone_.ops);
  std::ranges::sort(ops, {}, [&](OpId id) { return position_[id.index]; });
  std::vector<bool> small(graph_.op_count());  // not worth to be cut off
  std::map<OpId, size_t> begin;                // the size of all before an op
  for (size_t sum = 0; OpId id : ops) begin[id] = sum, sum += size_[id.index];
  for (OpId id : ops) {
    const ValueId result = graph_.op(id).results[0];
    const bool far = std::ranges::any_of(users_[result.index], [&](OpId user) {
      const auto found = begin.find(user);
      return found == begin.end() || found->second - begin[id] > longest / 8;
    });
    const size_t most = users_[result.index].size() <= 1 ? longest : far ? longest / 3 : longest / 2;
    const auto size = [&] {
      begin_cone(level);
      grow(result, most);
      return cone_.size;
    };
    size_t now = size();
    small[id.index] = now < longest / 16;
    while (now > most) {
      ValueId best;
      size_t least = 0;
      for (ValueId v : uses_[id.index].at_element) {
        if (spilled_[v.index] || small[graph_.value(v).op.index] || is_loaded(v, id)) continue;
        spilled_[v.index] = true;
        const size_t left = size();
        spilled_[v.index] = false;
        const size_t all = left + (left < now ? size_again(v, id, level, longest) : 2 * longest);
        if (!best.valid() || all < least) best = v, least = all;
      }
      if (!best.valid()) break;
      store_before(best, domain);
      now = size();
    }
  }
}

}  // namespace dr::backend
