// SPDX-License-Identifier: Apache-2.0
// For hosts whose own derivatives go on beyond the program: PyTorch's, for one.
#include <algorithm>

#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"

namespace dr::passes {
namespace {

using ir::Graph;
using ir::Leaf;
using ir::OpKind;
using ir::ValueId;

template <typename T>
std::string names_of(const std::vector<T>& all) {
  std::string names;
  for (const T& one : all) names += (names.empty() ? "" : ", ") + one.name;
  return names;
}

template <typename T>
const T* find(const std::vector<T>& all, const std::string& name) {
  const auto it = std::ranges::find(all, name, &T::name);
  return it == all.end() ? nullptr : &*it;
}

// The first name that stands there again.
const std::string* repeated(const std::vector<std::string>& names) {
  for (auto it = names.begin(); it != names.end(); ++it)
    if (std::find(names.begin(), it, *it) != it) return &*it;
  return nullptr;
}

ValueId read(ir::Builder& b, const std::string& leaf) {
  ir::Attrs attrs;
  attrs.text = leaf;
  const ValueId id = ops::emit(b, OpKind::Leaf, {}, std::move(attrs));
  b.set_name(id, leaf);
  return id;
}

// Where the program reads a leaf. What nothing reads is read here, and gets zeros.
std::vector<ValueId> reads(ir::Builder& b, const std::string& leaf) {
  std::vector<ValueId> out;
  const Graph& graph = b.graph();
  for (const ir::OpId id : graph.region(graph.root()).ops)
    if (const ir::Op& op = graph.op(id); op.kind == OpKind::Leaf && op.attrs.text == leaf) out.push_back(op.results[0]);
  if (out.empty()) out.push_back(read(b, leaf));
  return out;
}

// What is wrong with what is asked for, or nothing.
std::string problem_of(const Graph& graph, const Adjoint& adjoint) {
  const ir::Step* step = find(graph.steps, adjoint.step);
  if (!step) return "there is no step '" + adjoint.step + "'; there are " + names_of(graph.steps);
  if (adjoint.outputs.empty() || adjoint.leaves.empty())
    return "the adjoint of step '" + adjoint.step + "' needs at least one leaf and one output";
  for (const std::string& name : adjoint.outputs) {
    const ir::Output* output = find(step->outputs, name);
    if (!output)
      return "step '" + adjoint.step + "' has no output '" + name + "'; there are " + names_of(step->outputs);
    if (!graph.value(output->value).type.is_float())
      return "output '" + name + "' is made of " + graph.value(output->value).type.str() + ": it has no gradient";
  }
  for (const std::string& name : adjoint.leaves) {
    const Leaf* leaf = find(graph.leaves, name);
    if (!leaf) return "there is no leaf '" + name + "'; there are " + names_of(graph.leaves);
    if (!leaf->type.is_float()) return "leaf '" + name + "' is made of " + leaf->type.str() + ": it has no gradient";
  }
  const std::string of = "the adjoint of step '" + adjoint.step + "' ";
  if (const std::string* name = repeated(adjoint.leaves)) return of + "names leaf '" + *name + "' twice";
  if (const std::string* name = repeated(adjoint.outputs)) return of + "names output '" + *name + "' twice";
  return {};
}

}  // namespace

std::variant<Graph, std::string> add_adjoint(const Graph& graph, const Adjoint& adjoint) {
  if (std::string problem = problem_of(graph, adjoint); !problem.empty()) return problem;
  ir::Step back{.name = adjoint.step + ".adjoint", .outputs = {}, .updates = {}};
  if (find(graph.steps, back.name)) return "there is a step '" + back.name + "' already";
  ir::Builder b{Graph(graph)};
  std::vector<std::vector<ValueId>> targets;
  std::vector<ValueId> all;
  for (const std::string& name : adjoint.leaves) {
    targets.push_back(reads(b, name));
    all.insert(all.end(), targets.back().begin(), targets.back().end());
  }
  std::vector<ValueId> sums;  // by target: over the outputs
  for (const std::string& name : adjoint.outputs) {
    const ValueId value = find(find(b.graph().steps, adjoint.step)->outputs, name)->value;
    const ir::ValueInfo& info = b.value(value);
    Leaf seed;
    seed.kind = Leaf::Kind::Input;
    seed.name = back.name + "." + name;
    seed.type = info.type;
    seed.extent = info.extent;
    b.graph().leaves.push_back(seed);
    std::vector<ValueId> operands{value, read(b, seed.name)};
    operands.insert(operands.end(), all.begin(), all.end());
    const std::vector<ValueId> gradients = ops::emit_multi(b, OpKind::Grad, std::move(operands));
    if (sums.empty())
      sums = gradients;
    else
      for (size_t k = 0; k < sums.size(); ++k) sums[k] = ops::add(b, sums[k], gradients[k]);
  }
  size_t next = 0;
  for (size_t k = 0; k < targets.size(); ++k) {
    ValueId sum = sums[next++];
    for (size_t more = 1; more < targets[k].size(); ++more) sum = ops::add(b, sum, sums[next++]);
    back.outputs.push_back({adjoint.leaves[k], sum});
  }
  b.graph().steps.push_back(std::move(back));
  return std::move(b).finish();
}

}  // namespace dr::passes
