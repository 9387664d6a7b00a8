// SPDX-License-Identifier: Apache-2.0
// Initial values that are computed. The graph has a step for each, named after the leaf, with one update: what the leaf
// holds at first. It may read inputs. The host runs it once, before a step first needs the leaf, and not where the leaf
// is bound. No program's own step has such a name: the names of leaves and of instances of modules differ.
#pragma once

#include <string>
#include <string_view>

namespace dr::ir {

inline constexpr std::string_view kInitialStep = ".initial";

inline std::string initial_step_of(std::string_view leaf) { return std::string(leaf) + std::string(kInitialStep); }

// The leaf that a step of this name would fill; empty where the name is no such step's.
inline std::string_view leaf_of_initial_step(std::string_view step) {
  return step.ends_with(kInitialStep) ? step.substr(0, step.size() - kInitialStep.size()) : std::string_view();
}

// As people read about it: "step fit", "initial value of ramp".
inline std::string step_title(const std::string& step) {
  const std::string_view leaf = leaf_of_initial_step(step);
  return leaf.empty() ? "step " + step : "initial value of " + std::string(leaf);
}

}  // namespace dr::ir
