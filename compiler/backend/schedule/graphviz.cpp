// SPDX-License-Identifier: Apache-2.0
// Schedule -> DOT.
#include "compiler/backend/schedule/graphviz.h"

#include <map>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/initial_step.h"

namespace dr::backend {

namespace {

// Op names, equal ones in a row counted, a few a line.
std::string op_list(const ir::Graph& graph, const Pass& pass) {
  constexpr size_t kLine = 48;
  std::string out, line;
  for (size_t k = 0; k < pass.ops.size();) {
    size_t end = k;
    const ir::Op& op = graph.op(pass.ops[k]);
    while (end < pass.ops.size() && graph.op(pass.ops[end]).kind == op.kind) ++end;
    std::string text(ir::op_name(op.kind));
    if (end - k > 1) text += "*" + std::to_string(end - k);
    k = end;
    if (is_inline(op) || is_memory(op)) continue;
    if (line.size() + text.size() > kLine) {
      out += line + "\\n";
      line.clear();
    }
    line += (line.empty() ? "" : " ") + text;
  }
  return out + line;
}

}  // namespace

std::string print_graphviz(const ir::Graph& graph, const Schedule& schedule) {
  std::string out = "digraph schedule {\n  rankdir = LR;\n  node [shape = box, fontname = \"monospace\"];\n";
  for (size_t s = 0; s < schedule.steps.size(); ++s) {
    const StepSchedule& step = schedule.steps[s];
    const std::string prefix = "s" + std::to_string(s) + "_";
    auto resource = [&](ir::ValueId v) -> const Resource& { return schedule.resources[step.stored.at(v).index]; };
    out += "  subgraph cluster_" + prefix + "step {\n    label = \"" + ir::step_title(step.name) + "\";\n";
    std::map<ir::ValueId, size_t> writer;
    std::set<std::string> leaves;
    for (size_t k = 0; k < step.passes.size(); ++k) {
      const Pass& pass = step.passes[k];
      const bool opens = k == 0 || step.passes[k - 1].stage != pass.stage;
      const bool closes = k + 1 == step.passes.size() || step.passes[k + 1].stage != pass.stage;
      if (opens)
        out += "    subgraph cluster_" + prefix + "stage" + std::to_string(pass.stage) + " {\n      label = \"stage " +
               std::to_string(pass.stage) + "\";\n";
      out += "      " + prefix + "p" + std::to_string(k) + " [label = \"" + pass.name + "\\n" + kind_name(pass) + " " +
             (pass.domain.is_unit() ? "[1]" : pass.domain.str()) + "\\n" + op_list(graph, pass) + "\"];\n";
      if (closes) out += "    }\n";
      for (ir::ValueId v : pass.reads)
        if (is_memory(graph.op(graph.value(v).op))) leaves.insert(resource(v).name);
    }
    for (const std::string& leaf : leaves)
      out += "    " + prefix + "leaf_" + leaf + " [label = \"" + leaf + "\", style = rounded];\n";
    for (size_t k = 0; k < step.passes.size(); ++k) {
      const std::string to = prefix + "p" + std::to_string(k);
      for (ir::ValueId v : step.passes[k].reads) {
        const auto from = writer.find(v);
        const std::string source =
            from != writer.end() ? prefix + "p" + std::to_string(from->second) : prefix + "leaf_" + resource(v).name;
        out += "    " + source + " -> " + to + " [label = \"" + resource(v).name + "\"];\n";
      }
      for (ir::ValueId v : step.passes[k].writes) writer[v] = k;
    }
    auto result = [&](const std::string& kind, const std::string& name, ir::ValueId v) {
      const std::string node = prefix + kind + "_" + name;
      out += "    " + node + " [label = \"" + kind + " " + name + "\", style = rounded];\n";
      const auto from = writer.find(v);
      out +=
          "    " +
          (from != writer.end() ? prefix + "p" + std::to_string(from->second) : prefix + "leaf_" + resource(v).name) +
          " -> " + node + ";\n";
    };
    for (const auto& [name, v] : step.outputs) result("output", name, v);
    for (const auto& [leaf, v] : step.updates) result("update", graph.leaves[leaf].name, v);
    out += "  }\n";
  }
  return out + "}\n";
}

}  // namespace dr::backend
