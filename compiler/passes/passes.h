// SPDX-License-Identifier: Apache-2.0
// The passes over graphs, in the order in which the pipeline runs them (pipeline.cpp holds the list as data).
#pragma once

#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::passes {

// Every violation found in a graph, one line each, with the printed op; empty for a sound graph. Two layers: structure
// (ids, order, captures, yields), then types and extents by the op table.
std::vector<std::string> verify(const ir::Graph& graph);

// What the passes leave out, by the names of docs/explain/skipping.md; `false` keeps it in the graph. Results have the
// same bits either way, but for the signs of zeros.
struct Skips {
  bool dead = true;   // ops that no step needs
  bool zero = true;   // terms of sums and of adjoints that are zero whatever the data
  bool fold = true;   // ops on constants alone
  bool share = true;  // ops that equal one before them, once gradients are written out
  // Counts what each leaves out where it is not null: ops, and for `zero` terms.
  struct LeftOut {
    size_t dead = 0, zero = 0, fold = 0, share = 0;
    size_t layers = 0, layers_kept = 0;  // of the program, by `known_zero(x)`
  };
  LeftOut* left_out = nullptr;
};

// Replace each Grad op by the ops that compute it, reverse mode.
ir::Graph differentiate(const ir::Graph& graph, const Skips& skips = {});
// Constant folding, common subexpressions, dead code, and algebra that changes no bit of any result but the sign of a
// zero (listed in simplify_identities.cpp). Values that a Grad names as targets are left alone.
ir::Graph simplify(const ir::Graph& graph, const Skips& skips = {});
// Scatters whose places can be undone become gathers.
ir::Graph invert_scatters(const ir::Graph& graph, const Skips& skips = {});
// An `if` that both scatters and gives values at its own element becomes two.
ir::Graph split_scatters(const ir::Graph& graph, const Skips& skips = {});
// Write scattered terms of a sum next to each other, so that they can become one.
ir::Graph group_sums(const ir::Graph& graph, const Skips& skips = {});
// Move what scatters of a region compute their indices of to the root region, where no step changes it.
ir::Graph hoist_indices(const ir::Graph& graph, const Skips& skips = {});

// What a host needs to take gradients from a step's outputs on to leaves.
struct Adjoint {
  std::string step;
  std::vector<std::string> leaves, outputs;
  friend bool operator==(const Adjoint&, const Adjoint&) = default;
};
// A graph as lowered with one step more, `STEP.adjoint`: its outputs, of the names of the leaves, are the gradients of
// the sum over the step's outputs, each times an input `STEP.adjoint.OUTPUT` of its type and extent. Or what is wrong.
std::variant<ir::Graph, std::string> add_adjoint(const ir::Graph& graph, const Adjoint& adjoint);

struct Pass {
  std::string_view name;
  ir::Graph (*run)(const ir::Graph&, const Skips&);
};
std::span<const Pass> default_passes();

struct PipelineOptions {
  bool verify_each = true;
  Skips skips = {};
  // Called after each pass with its name, the graph and the milliseconds it took; may be empty.
  std::function<void(std::string_view, const ir::Graph&, double)> after = {};
};
// Runs passes in order on a sound graph. One that fails verification after a pass is an internal error naming the pass.
ir::Graph run_passes(const ir::Graph& graph, std::span<const Pass> passes, const PipelineOptions& options = {});

}  // namespace dr::passes
