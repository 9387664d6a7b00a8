// SPDX-License-Identifier: Apache-2.0
// `drc explain-grad`: says in words what passes::explain_gradient finds.
#include "compiler/passes/explain_grad.h"

#include <cstdio>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/ir/print.h"
#include "dsl/diagnostic.h"
#include "dsl/place.h"

namespace dr::drc {
namespace {

using ir::ValueId;

// Values of the root under a name that the user may give, in the order in which they are made: `let`s, and the parts
// of one that is a struct, a tuple or an array.
std::vector<ValueId> named_values(const ir::Graph& graph, const std::string& name) {
  std::vector<ValueId> whole, parts;
  for (const ir::OpId id : graph.region(graph.root()).ops) {
    for (const ValueId result : graph.op(id).results) {
      const std::string& found = graph.value(result).name;
      if (found == name) whole.push_back(result);
      if (found.starts_with(name + ".")) parts.push_back(result);
    }
  }
  return whole.empty() ? parts : whole;
}

std::vector<std::string> known_names(const ir::Graph& graph) {
  std::vector<std::string> names;
  for (const ir::Leaf& leaf : graph.leaves) names.push_back(leaf.name);
  for (const ir::Step& step : graph.steps) {
    for (const ir::Output& output : step.outputs) names.push_back(output.name);
  }
  for (const ir::OpId id : graph.region(graph.root()).ops) {
    for (const ValueId result : graph.op(id).results) {
      if (!graph.value(result).name.empty()) names.push_back(graph.value(result).name);
    }
  }
  return names;
}

void print_unknown(const ir::Graph& graph, const std::string& name, const char* expected) {
  const auto nearest = dsl::nearest_name(name, known_names(graph));
  print_error("the program has no " + std::string(expected) + " '" + name + "'" +
              (nearest ? ", did you mean '" + *nearest + "'?" : ""));
}

// An output first, as NAME or STEP.NAME; of several values with one name the last, which is not a function's own.
std::optional<ValueId> find_loss(const ir::Graph& graph, const std::string& name) {
  for (const ir::Step& step : graph.steps) {
    for (const ir::Output& output : step.outputs) {
      if (name == output.name || name == step.name + "." + output.name) return output.value;
    }
  }
  const std::vector<ValueId> values = named_values(graph, name);
  if (values.empty()) return std::nullopt;
  return values.back();
}

std::vector<ValueId> find_targets(const ir::Graph& graph, const std::string& name) {
  std::vector<ValueId> targets;
  for (const ir::OpId id : graph.region(graph.root()).ops) {
    const ir::Op& op = graph.op(id);
    if (op.kind == ir::OpKind::Leaf && op.attrs.text == name) targets.push_back(op.results[0]);
  }
  if (!targets.empty()) return targets;
  targets = named_values(graph, name);
  const bool one = !targets.empty() && graph.value(targets.back()).name == name;
  return one ? std::vector<ValueId>{targets.back()} : targets;
}

class Printer {
 public:
  Printer(const ir::Graph& graph, const dsl::SourceManager& sources, const ExplainGradOptions& options)
      : graph_(graph), sources_(sources), options_(options) {}

  void print(const passes::GradientExplanation& found, ValueId loss, ValueId target) const {
    using Verdict = passes::GradientExplanation::Verdict;
    const std::string subject = "the gradient of '" + options_.loss + "' with respect to '" + options_.target + "' ";
    const std::string zero = subject + "is zero because ";
    switch (found.verdict) {
      case Verdict::NotFloat: {
        const bool is_target = graph_.value(loss).type.is_float();
        const std::string& name = is_target ? options_.target : options_.loss;
        std::printf("%s'%s' is made of %s, which has no derivative\n", zero.c_str(), name.c_str(),
                    graph_.value(is_target ? target : loss).type.str().c_str());
        return;
      }
      case Verdict::Independent:
        std::printf("%s'%s' does not depend on '%s'\n", zero.c_str(), options_.loss.c_str(), options_.target.c_str());
        return;
      case Verdict::Cut:
        std::printf("%s%s\n", zero.c_str(),
                    found.cuts.size() == 1 ? found.cuts[0].reason.c_str() : "every way from one to the other is cut");
        print_cuts(found);
        return;
      case Verdict::Flows: break;
    }
    std::printf("%sflows\n", subject.c_str());
    for (const auto& path : found.paths) print_path(path);
    if (found.more_paths > 0) std::printf("\nand along at least %zu more\n", found.more_paths);
    for (const ir::OpId clamp : found.clamps) {
      std::printf("\nzero where a value is outside the limits of\n");
      print_place(graph_.op(clamp).span, "'clamp'");
    }
    if (found.cuts.empty()) return;
    std::printf("\nnot along other ways, which are cut\n");
    print_cuts(found);
  }

 private:
  std::string place(const dsl::Span& span) const {
    std::string text = span.valid() ? dsl::format_place(sources_, span) : "";
    if (text.ends_with(": ")) text.resize(text.size() - 2);
    return text;
  }

  std::string name_of(ValueId id) const {
    if (!graph_.value(id).name.empty()) return graph_.value(id).name;
    return options_.loss;  // the only stop of a path that may be without a name
  }

  void print_path(const std::vector<passes::GradientStop>& path) const {
    std::printf("\n");
    for (const passes::GradientStop& stop : path) {
      const ir::Op& op = graph_.op(graph_.value(stop.value).op);
      const bool leaf = op.kind == ir::OpKind::Leaf;
      const dsl::Span span = leaf ? graph_.leaves[*graph_.leaf_index(op.attrs.text)].span : op.span;
      std::string through;
      for (const ir::OpKind kind : stop.through)
        through += (through.empty() ? "" : ", ") + std::string(ir::op_name(kind));
      if (leaf) through = ir::leaf_kind_name(graph_.leaves[*graph_.leaf_index(op.attrs.text)].kind);
      const std::string where = place(span);
      if (through.empty())
        std::printf("  %-20s %s\n", name_of(stop.value).c_str(), where.c_str());
      else
        std::printf("  %-20s %-24s %s\n", name_of(stop.value).c_str(), where.c_str(), through.c_str());
    }
  }

  void print_place(const dsl::Span& span, const std::string& text) const {
    if (!span.valid()) {
      std::printf("  %s\n", text.c_str());
      return;
    }
    std::printf("%s%s\n%s", dsl::format_place(sources_, span).c_str(), text.c_str(),
                dsl::format_source_line(sources_, span).c_str());
  }

  void print_cuts(const passes::GradientExplanation& found) const {
    for (const passes::GradientCut& cut : found.cuts) {
      const std::string op = "'" + std::string(ir::op_name(graph_.op(cut.op).kind)) + "'";
      const bool told = found.verdict == passes::GradientExplanation::Verdict::Cut && found.cuts.size() == 1;
      print_place(graph_.op(cut.op).span, told ? op : cut.reason);
    }
  }

  const ir::Graph& graph_;
  const dsl::SourceManager& sources_;
  const ExplainGradOptions& options_;
};

}  // namespace

int explain_grad(const ExplainGradOptions& options) {
  const auto program = load_graph(options.input);
  if (!program) return kUserError;
  const ir::Graph* graph = program->lowered();
  const auto loss = find_loss(*graph, options.loss);
  if (!loss) return print_unknown(*graph, options.loss, "output or let"), kUserError;
  const std::vector<ValueId> targets = find_targets(*graph, options.target);
  if (targets.empty() && graph->leaf_index(options.target)) {
    std::printf("the gradient of '%s' with respect to '%s' is zero because nothing reads '%s'\n", options.loss.c_str(),
                options.target.c_str(), options.target.c_str());
    return kOk;
  }
  if (targets.empty()) return print_unknown(*graph, options.target, "leaf or let"), kUserError;
  Printer(*graph, program->sources(), options)
      .print(passes::explain_gradient(*graph, *loss, targets), *loss, targets[0]);
  return kOk;
}

}  // namespace dr::drc
