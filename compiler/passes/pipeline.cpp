// SPDX-License-Identifier: Apache-2.0
// The order of the passes over graphs, and the one place that runs them: verification and timing are done here, so that
// passes hold none of it.
#include <chrono>

#include "compiler/passes/passes.h"

namespace dr::passes {
namespace {

constexpr Pass kDefaultPasses[] = {
    {"simplify", simplify},                // fewer ops to differentiate; Grad targets stay what the program named
    {"differentiate", differentiate},      // no Grad op is left
    {"invert-scatters", invert_scatters},  // adjoints of reads at places that are known
    {"split-scatters", split_scatters},    // what a branch scatters, apart from what it gives its element
    {"simplify", simplify},                // adjoints that nobody asked for, ops that forward and backward share
    {"group-sums", group_sums},            // scattered terms that can be summed as one
    {"hoist-indices", hoist_indices},      // where scatters add, so that it can be kept
};

void require_sound(const ir::Graph& graph, std::string_view pass) {
  const std::vector<std::string> violations = verify(graph);
  if (violations.empty()) return;
  std::string message = "graph fails verification after pass " + std::string(pass);
  for (const std::string& violation : violations) message += "\n  " + violation;
  DR_ICE(message);
}

}  // namespace

std::span<const Pass> default_passes() { return kDefaultPasses; }

ir::Graph run_passes(const ir::Graph& graph, std::span<const Pass> passes, const PipelineOptions& options) {
  if (passes.empty()) return graph;
  ir::Graph current;
  for (const Pass& pass : passes) {
    const auto start = std::chrono::steady_clock::now();
    current = pass.run(&pass == passes.data() ? graph : current, options.skips);
    const std::chrono::duration<double, std::milli> elapsed = std::chrono::steady_clock::now() - start;
    if (options.verify_each) require_sound(current, pass.name);
    if (options.after) options.after(pass.name, current, elapsed.count());
  }
  return current;
}

}  // namespace dr::passes
