// SPDX-License-Identifier: Apache-2.0
// Levels are first as low as can be. Then each element-wise op has a range: up to the level at which its first user
// needs it. Fewest levels that meet all ranges of an extent: take the range that begins last, open its first level,
// leave out all ranges that hold it, and so on. At the end ops go to the first open level that they can.
#include "compiler/backend/analysis/levels.h"

#include <algorithm>
#include <climits>
#include <map>
#include <set>

namespace dr::backend {

using ir::Extent;
using ir::Op;
using ir::OpId;
using ir::ValueId;

namespace {

class LevelFinder {
 public:
  explicit LevelFinder(const LevelInput& in) : in_(in), level_(in.graph.op_count()) {}

  std::vector<int> process() {
    for (OpId id : in_.order) level_[id.index] = first_level(id);
    open_levels();
    for (OpId id : in_.order) {
      int level = first_level(id);
      if (const Extent* domain = gathered(id)) level = *open_[*domain].lower_bound(level);
      level_[id.index] = level;
    }
    return std::move(level_);
  }

 private:
  const Op& op(OpId id) const { return in_.graph.op(id); }
  OpId maker(ValueId v) const { return in_.graph.value(v).op; }

  // Whether `user` can have `v`, which it reads at its own element, in a register.
  bool share(OpId user, ValueId v) const {
    const Extent* domain = in_.domain(op(user));
    return domain && in_.domain(op(maker(v))) && in_.graph.value(v).extent == *domain;
  }
  // The domain of an op that may wait for others of it; nullptr where that changes nothing.
  const Extent* gathered(OpId id) const {
    const Op& o = op(id);
    if (is_memory(o) || is_inline(o)) return nullptr;
    const bool kept = std::any_of(o.results.begin(), o.results.end(),
                                  [&](ValueId v) { return in_.stored(v) || !in_.recomputed(v, OpId{}); });
    return kept ? in_.domain(o) : nullptr;
  }

  // Calls f(v, distance) for each value that has to be computed `distance` levels before `id`, or at its level.
  template <class F>
  void for_each_wait(OpId id, const F& f) const {
    for (ValueId v : in_.uses[id.index].at_element)
      if (!in_.ready(v)) f(v, in_.absorbed(v) || share(id, v) || (in_.recomputed(v, id) && !in_.loads(v)) ? 0 : 1);
    for (ValueId v : in_.uses[id.index].elsewhere)
      if (!in_.ready(v)) f(v, 1);
  }
  int first_level(OpId id) const {
    int level = 0;
    for_each_wait(id, [&](ValueId v, int distance) { level = std::max(level, level_[maker(v).index] + distance); });
    return level;
  }

  void open_levels() {
    // Users come before what they use: theirs is the later first level, or the later place.
    std::vector<OpId> order = in_.order;
    std::reverse(order.begin(), order.end());
    std::stable_sort(order.begin(), order.end(), [&](OpId a, OpId b) { return level_[a.index] > level_[b.index]; });
    std::vector<int> last(level_.size(), INT_MAX);
    for (OpId id : order) {
      int level = level_[id.index];
      if (const Extent* domain = gathered(id)) {
        std::set<int>& open = open_[*domain];
        const auto above = open.upper_bound(last[id.index]);
        if (above != open.begin() && *std::prev(above) >= level)
          level = *std::prev(above);
        else
          open.insert(level);
      }
      for_each_wait(id, [&](ValueId v, int distance) {
        int& bound = last[maker(v).index];
        bound = std::min(bound, level - distance);
      });
    }
  }

  const LevelInput& in_;
  std::vector<int> level_;
  std::map<Extent, std::set<int>> open_;
};

}  // namespace

std::vector<int> find_levels(const LevelInput& in) { return LevelFinder(in).process(); }

}  // namespace dr::backend
