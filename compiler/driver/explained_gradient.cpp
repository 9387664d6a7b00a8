// SPDX-License-Identifier: Apache-2.0
#include "compiler/driver/explained_gradient.h"

#include <cstdio>
#include <optional>
#include <set>

#include "compiler/ir/print.h"
#include "compiler/passes/gradient/explain_grad.h"
#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/place.h"

namespace dr::driver {
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

std::string unknown(const ir::Graph& graph, const std::string& name, const char* expected) {
  const auto nearest = dsl::nearest_name(name, known_names(graph));
  return "the program has no " + std::string(expected) + " '" + name + "'" +
         (nearest ? ", did you mean '" + *nearest + "'?" : "");
}

// Where steps have unlike outputs of a name, the ways to say which: "fit.loss or judge.loss"; else nothing.
std::string to_choose_from(const ir::Graph& graph, const std::string& name) {
  std::string all;
  std::set<ValueId> values;
  for (const ir::Step& step : graph.steps)
    for (const ir::Output& output : step.outputs)
      if (name == output.name && values.insert(output.value).second)
        all += (all.empty() ? "" : " or ") + step.name + "." + name;
  return values.size() > 1 ? all : "";
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

class Explainer {
 public:
  Explainer(const ir::Graph& graph, const dsl::SourceManager& sources, const std::string& loss,
            const std::string& target)
      : graph_(graph), sources_(sources), loss_(loss), target_(target) {}

  ExplainedGradient explain(const passes::GradientExplanation& found, ValueId loss, ValueId target) const {
    using Verdict = passes::GradientExplanation::Verdict;
    ExplainedGradient out;
    const std::string subject = "the gradient of '" + loss_ + "' with respect to '" + target_ + "' ";
    const std::string zero = subject + "is zero because ";
    out.flows = found.verdict == Verdict::Flows;
    switch (found.verdict) {
      case Verdict::NotFloat: {
        const bool is_target = graph_.value(loss).type.is_float();
        out.summary = zero + "'" + (is_target ? target_ : loss_) + "' is made of " +
                      graph_.value(is_target ? target : loss).type.str() + ", which has no derivative";
        return out;
      }
      case Verdict::Independent:
        out.summary = zero + "'" + loss_ + "' does not depend on '" + target_ + "'";
        return out;
      case Verdict::Cut:
        out.summary = zero + (found.cuts.size() == 1 ? found.cuts[0].reason : "every way from one to the other is cut");
        break;
      case Verdict::Flows: out.summary = subject + "flows"; break;
    }
    for (const auto& path : found.paths) out.paths.push_back(path_of(path));
    out.more_paths = found.more_paths;
    for (const ir::OpId clamp : found.clamps)
      out.clamps.push_back(mark(graph_.op(clamp).span, "outside of the limits of 'clamp'", "'clamp'"));
    for (const passes::GradientCut& cut : found.cuts) {
      const std::string op = "'" + std::string(ir::op_name(graph_.op(cut.op).kind)) + "'";
      const bool told = found.verdict == Verdict::Cut && found.cuts.size() == 1;
      out.cuts.push_back(mark(graph_.op(cut.op).span, cut.reason, told ? op : cut.reason));
    }
    return out;
  }

 private:
  std::string place(const dsl::Span& span) const {
    std::string text = span.valid() ? dsl::format_place(sources_, span) : "";
    if (text.ends_with(": ")) text.resize(text.size() - 2);
    return text;
  }

  std::string name_of(ValueId id) const {
    if (!graph_.value(id).name.empty()) return graph_.value(id).name;
    return loss_;  // the only stop of a path that may be without a name
  }

  std::vector<ExplainedGradient::Stop> path_of(const std::vector<passes::GradientStop>& path) const {
    std::vector<ExplainedGradient::Stop> out;
    for (const passes::GradientStop& stop : path) {
      const ir::Op& op = graph_.op(graph_.value(stop.value).op);
      const bool leaf = op.kind == ir::OpKind::Leaf;
      const dsl::Span span = leaf ? graph_.leaves[*graph_.leaf_index(op.attrs.text)].span : op.span;
      std::string through;
      for (const ir::OpKind kind : stop.through)
        through += (through.empty() ? "" : ", ") + std::string(ir::op_name(kind));
      if (leaf) through = ir::leaf_kind_name(graph_.leaves[*graph_.leaf_index(op.attrs.text)].kind);
      out.push_back({name_of(stop.value), place(span), through});
    }
    return out;
  }

  ExplainedGradient::Mark mark(const dsl::Span& span, const std::string& reason, const std::string& text) const {
    if (!span.valid()) return {"", reason, "  " + text + "\n"};
    return {place(span), reason,
            dsl::format_place(sources_, span) + text + "\n" + dsl::format_source_line(sources_, span)};
  }

  const ir::Graph& graph_;
  const dsl::SourceManager& sources_;
  const std::string &loss_, &target_;
};

std::string padded(std::string text, size_t width) {
  if (text.size() < width) text.resize(width, ' ');
  return text;
}

}  // namespace

std::string ExplainedGradient::text() const {
  std::string out = summary + "\n";
  for (const auto& path : paths) {
    out += "\n";
    for (const Stop& stop : path) {
      out += "  " + padded(stop.name, 20) + " ";
      out += (stop.through.empty() ? stop.place : padded(stop.place, 24) + " " + stop.through) + "\n";
    }
  }
  if (more_paths > 0) out += "\nand along at least " + std::to_string(more_paths) + " more\n";
  for (const Mark& clamp : clamps) out += "\nzero where a value is outside the limits of\n" + clamp.shown;
  if (flows && !cuts.empty()) out += "\nnot along other ways, which are cut\n";
  for (const Mark& cut : cuts) out += cut.shown;
  return out;
}

std::variant<ExplainedGradient, std::string> explain_gradient(Compilation& program, const std::string& loss,
                                                              const std::string& target) {
  const ir::Graph& graph = *program.lowered();
  if (const std::string several = to_choose_from(graph, loss); !several.empty())
    return "several steps have an output '" + loss + "': say which, as " + several;
  const auto value = find_loss(graph, loss);
  if (!value) return unknown(graph, loss, "output or let");
  const std::vector<ValueId> targets = find_targets(graph, target);
  if (targets.empty() && graph.leaf_index(target)) {
    ExplainedGradient out;
    out.summary = "the gradient of '" + loss + "' with respect to '" + target + "' is zero because nothing reads '" +
                  target + "'";
    return out;
  }
  if (targets.empty()) return unknown(graph, target, "leaf or let");
  return Explainer(graph, program.sources(), loss, target)
      .explain(passes::explain_gradient(graph, *value, targets), *value, targets[0]);
}

}  // namespace dr::driver
