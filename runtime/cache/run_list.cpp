// SPDX-License-Identifier: Apache-2.0
// Groups of commands, clean and dirty.
#include "runtime/cache/run_list.h"

#include <algorithm>

namespace dr::runtime {

RunList::RunList(const bundle::StepT& step) : changes_(step.changes) {
  for (const auto& c : step.commands) {
    auto group = std::find_if(groups_.begin(), groups_.end(), [&](const Group& g) {
      return g.steady == c->steady && (g.steady || (g.leaves == c->leaves && g.foresees == c->foresees));
    });
    if (group == groups_.end())
      group = groups_.insert(group, {c->steady, c->foresees, c->leaves, std::vector<uint64_t>(c->leaves.size())});
    group_of_.push_back(static_cast<size_t>(group - groups_.begin()));
  }
  dirty_.assign(groups_.size(), true);
  all_ = dirty_;
}

const std::vector<bool>& RunList::dirty(const std::vector<uint64_t>& versions) {
  for (size_t g = 0; g < groups_.size(); ++g) {
    const Group& group = groups_[g];
    bool run = group.steady || !group.has_run;
    for (size_t k = 0; k < group.leaves.size() && !run; ++k) run = group.seen[k] != versions[group.leaves[k]];
    dirty_[g] = run;
  }
  return dirty_;
}

void RunList::ran(const std::vector<bool>& dirty, const std::vector<uint64_t>& versions) {
  for (size_t g = 0; g < groups_.size(); ++g) {
    Group& group = groups_[g];
    if (group.steady || !(dirty[g] || (group.foresees && group.has_run))) continue;
    group.has_run = true;
    for (size_t k = 0; k < group.leaves.size(); ++k) {
      const bool changes = group.foresees && std::ranges::binary_search(changes_, group.leaves[k]);
      group.seen[k] = versions[group.leaves[k]] + (changes ? 1 : 0);
    }
  }
}

}  // namespace dr::runtime
