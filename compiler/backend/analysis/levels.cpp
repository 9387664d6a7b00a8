// SPDX-License-Identifier: Apache-2.0
// Levels are first as low as can be. Then each element-wise op has a range: up to the level at which its first user
// needs it. Fewest levels that meet all ranges of an extent: take the range that begins last, open its first level,
// leave out all ranges that hold it, and so on. At the end ops go to the first open level that they can, or to the
// last: whichever hands less from level to level. Early, what several ops need is made once; late, what only the
// gradient needs of the forward sweep is made beside the gradient and stored nowhere.
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
    std::vector<int> late = latest();
    settle([](OpId) { return 0; });
    std::vector<int> early = level_;
    const double stores_early = handed_on();
    settle([&](OpId id) { return late[id.index]; });
    return handed_on() < stores_early ? std::move(level_) : std::move(early);
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

  // Ops to the first open level that they can, but not before what `least` says.
  template <class F>
  void settle(const F& least) {
    for (OpId id : in_.order) {
      const int level = std::max(first_level(id), least(id));
      const Extent* domain = gathered(id);
      level_[id.index] = domain ? *open_.at(*domain).lower_bound(level) : level;
    }
  }

  // The last open level of each element-wise op by what its users need.
  std::vector<int> latest() const {
    std::vector<int> last(level_.size(), INT_MAX), out = level_;
    for (auto it = in_.order.rbegin(); it != in_.order.rend(); ++it) {
      const OpId id = *it;
      int& level = out[id.index];
      const Extent* domain = in_.domain(op(id));
      if (const auto open = domain ? open_.find(*domain) : open_.end(); open != open_.end()) {
        const auto above = open->second.upper_bound(last[id.index]);
        if (above != open->second.begin()) level = std::max(level, *std::prev(above));
      }
      for_each_wait(id, [&](ValueId v, int distance) {
        int& bound = last[maker(v).index];
        bound = std::min(bound, level - distance);
      });
    }
    return out;
  }

  // What passes store for later ones and load again, in components; those of lists are few beside images'.
  double handed_on() const {
    constexpr double kOfLists = 1.0 / 64;
    std::vector<std::set<int>> at(level_.size());  // the levels whose passes compute an op
    std::map<ValueId, std::set<int>> loads;
    double sum = 0;
    for (auto it = in_.order.rbegin(); it != in_.order.rend(); ++it) {
      const int level = level_[it->index];
      std::set<int>& here = at[it->index];
      if (gathered(*it) || !in_.domain(op(*it))) here = {level};
      for (ValueId v : in_.uses[it->index].at_element) {
        if (in_.ready(v)) continue;
        if (!gathered(maker(v))) {
          at[maker(v).index].insert(here.begin(), here.end());
          continue;
        }
        for (const int user : here)
          if (!share(*it, v) || user != level_[maker(v).index]) loads[v].insert(user);
      }
      for (ValueId v : op(*it).results) {
        const auto found = loads.find(v);
        if (found == loads.end()) continue;
        const ir::ValueInfo& info = in_.graph.value(v);
        const double times = static_cast<double>(found->second.size()) + (in_.stored(v) ? 0 : 1);
        sum += times * info.type.components() * (info.extent.h.is_one() ? kOfLists : 1);
      }
    }
    return sum;
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
