// SPDX-License-Identifier: Apache-2.0
// Dependencies, from the accesses of commands to a fixed point.
#include "compiler/backend/plan/dependencies.h"

#include <algorithm>
#include <set>

namespace dr::backend {

using bundle::BundleT;
using bundle::CommandT;

namespace {

// Numbers of leaves; one past them all is the step's counter.
using Set = std::set<uint32_t>;

// Adds and says whether that was new.
bool add(Set& to, const Set& from) {
  const size_t before = to.size();
  to.insert(from.begin(), from.end());
  return to.size() != before;
}

class StepDependencies {
 public:
  StepDependencies(const BundleT& bundle, bundle::StepT& step)
      : bundle_(bundle),
        step_(step),
        of_(bundle.resources.size()),
        is_memory_(bundle.resources.size(), false),
        is_foreseen_(bundle.resources.size(), false) {
    for (const auto& c : step.commands)
      for_each_access(*c, [&](uint32_t r, bundle::Access access) {
        if (c->foresees && access != bundle::Access::Read) is_foreseen_[r] = true;
      });
    const auto counter = static_cast<uint32_t>(bundle.leaves.size());
    for (uint32_t k = 0; k < counter; ++k) start(bundle.leaves[k]->resource, k);
    if (step.step_index >= 0) start(static_cast<uint32_t>(step.step_index), counter);
  }

  void process() {
    for (bool again = true; again;) {
      again = false;
      for (size_t begin = 0, next; begin < step_.commands.size(); begin = next) {
        next = begin + 1;
        while (next < step_.commands.size() && step_.commands[next]->joins) ++next;
        again = visit(begin, next) || again;
      }
    }
    Set changes;
    for (const auto& c : step_.commands)
      for_each_access(*c, [&](uint32_t r, bundle::Access access) {
        if (is_memory_[r] && access != bundle::Access::Read) add(changes, of_[r]);
      });
    const auto counter = static_cast<uint32_t>(bundle_.leaves.size());
    step_.changes.assign(changes.begin(), changes.lower_bound(counter));
    for (size_t k = 0; k < step_.commands.size(); ++k) {
      const Set& on = of_command_[k];
      CommandT& c = *step_.commands[k];
      c.leaves.assign(on.begin(), on.lower_bound(counter));
      c.steady = !c.foresees && (on.count(counter) != 0 || std::any_of(on.begin(), on.end(), [&](uint32_t leaf) {
                                   return changes.count(leaf) != 0;
                                 }));
    }
  }

 private:
  void start(uint32_t resource, uint32_t leaf) {
    of_[resource] = {leaf};
    is_memory_[resource] = true;
  }

  // One round over the commands of a render pass, or one other command; whether anything was new.
  bool visit(size_t begin, size_t end) {
    of_command_.resize(step_.commands.size());
    Set all;
    // No result depends on a guess, nor on which of the elements that stay as they are a step lists.
    const auto is_guess = [&](uint32_t r) {
      const bool foreseen = is_foreseen_[r] && !step_.commands[begin]->foresees;
      return foreseen || bundle_.resources[r]->role == bundle::Role::Guess;
    };
    for (size_t k = begin; k < end; ++k)
      for_each_access(*step_.commands[k], [&](uint32_t r, bundle::Access) {
        if (!is_guess(r)) add(all, of_[r]);
      });
    bool grew = false;
    for (size_t k = begin; k < end; ++k) {
      grew = add(of_command_[k], all) || grew;
      // What is memory keeps its own number: those that read it wait for it alone.
      for_each_access(*step_.commands[k], [&](uint32_t r, bundle::Access access) {
        if (access != bundle::Access::Read && !is_memory_[r] && !is_guess(r)) grew = add(of_[r], all) || grew;
      });
    }
    return grew;
  }

  const BundleT& bundle_;
  bundle::StepT& step_;
  std::vector<Set> of_;            // by resource
  std::vector<bool> is_memory_;    // leaves and the counter
  std::vector<bool> is_foreseen_;  // what commands that foresee what the step does write
  std::vector<Set> of_command_;
};

}  // namespace

void for_each_access(const CommandT& c, const std::function<void(uint32_t, bundle::Access)>& visit) {
  using bundle::Access;
  for (const auto& b : c.bindings) visit(b->resource, b->access);
  for (uint32_t color : c.colors) visit(color, Access::Write);
  if (c.depth >= 0) visit(static_cast<uint32_t>(c.depth), Access::Write);
  if (c.source >= 0) visit(static_cast<uint32_t>(c.source), Access::Read);
  if (c.target >= 0) visit(static_cast<uint32_t>(c.target), Access::Write);
  for (int scratch : {c.scratch_a, c.scratch_b})
    if (scratch >= 0) visit(static_cast<uint32_t>(scratch), Access::Write);
}

bool run_together(const CommandT& a, const CommandT& b) {
  return a.steady == b.steady && (a.steady || (a.leaves == b.leaves && a.foresees == b.foresees));
}

void find_dependencies(BundleT& bundle) {
  for (const auto& step : bundle.steps) StepDependencies(bundle, *step).process();
}

}  // namespace dr::backend
