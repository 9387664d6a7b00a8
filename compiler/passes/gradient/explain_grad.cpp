// SPDX-License-Identifier: Apache-2.0
// Two walks over the values in the order in which they are made: what depends on a target at all, and what depends on
// it by differentiable steps alone. Where the second ends and the first goes on, the gradient is cut.
#include "compiler/passes/gradient/explain_grad.h"

#include <algorithm>
#include <deque>
#include <map>
#include <set>

#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"
#include "compiler/passes/gradient/differentiate.h"

namespace dr::passes {
namespace {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;
using ir::Yielded;
using ir::yielded;

constexpr uint32_t kFar = UINT32_MAX;
constexpr size_t kShownPaths = 3;
constexpr size_t kMaxPaths = 100;
constexpr size_t kMaxSearch = 20000;

struct Edge {
  ValueId from;
  bool flows;
};

// What a value is made of. Values of regions are made of each other and of what they capture.
std::vector<Edge> edges_of(const Graph& graph, ValueId id) {
  const ir::ValueInfo& info = graph.value(id);
  if (!info.op.valid()) return {};  // a region's parameter: a trip number, a face's record
  const Op& op = graph.op(info.op);
  std::vector<Edge> edges;
  const bool differentiable = ops::info(op.kind).differentiable && info.type.is_float();
  const auto add = [&](ValueId from, bool may_flow) {
    edges.push_back({from, may_flow && differentiable && graph.value(from).type.is_float()});
  };
  if (op.kind == OpKind::Vjp) {  // its value, the cotangent, arguments and their adjoints
    const size_t targets = (op.operands.size() - 2) / 2;
    for (size_t k = 2; k < 2 + targets; ++k) add(op.operands[k], !is_zero(graph, op.operands[k + targets]));
    add(op.operands[0], false);
    return edges;
  }
  for (const ValueId operand : op.operands) add(operand, op.regions.empty());
  if (op.kind == OpKind::Raster) {
    for (const ir::RegionId region : op.regions) {
      for (const ValueId captured : ir::captures(graph, region)) add(captured, false);
    }
    return edges;
  }
  if (op.kind == OpKind::Fold) {
    // States go round: what they start with and what sweeps capture is what each result is made of.
    for (size_t k = 2; k < op.operands.size(); ++k)
      edges[k].flows = differentiable && graph.value(op.operands[k]).type.is_float();
    for (const ir::RegionId region : op.regions)
      for (const ValueId captured : ir::captures(graph, region)) add(captured, true);
    return edges;
  }
  for (const ir::RegionId region : op.regions) {
    const Yielded yield = yielded(graph, op, region)[info.result_index];
    if (yield.index.valid()) add(yield.index, false);
    add(yield.value, true);
  }
  return edges;
}

// For each value how many edges lead from it to a target, kFar where none do. Operands have smaller ids than results.
std::vector<uint32_t> distances(const std::vector<std::vector<Edge>>& edges, std::span<const ValueId> targets,
                                bool flowing) {
  std::vector<uint32_t> distance(edges.size(), kFar);
  for (const ValueId target : targets) distance[target.index] = 0;
  for (size_t k = 0; k < edges.size(); ++k) {
    for (const Edge& edge : edges[k]) {
      if (flowing && !edge.flows) continue;
      const uint32_t further = distance[edge.from.index];
      if (further != kFar) distance[k] = std::min(distance[k], further + 1);
    }
  }
  return distance;
}

std::string reason_of(const Graph& graph, const Op& op) {
  if (op.kind == OpKind::Vjp) return "the function's '@vjp' gives it no gradient";
  const std::string name = "'" + std::string(ir::op_name(op.kind)) + "'";
  if (std::string reason(ops::info(op.kind).no_gradient); !reason.empty()) {
    if (const size_t at = reason.find('$'); at != std::string::npos) reason.replace(at, 1, name);
    return reason;
  }
  return name + " gives " + graph.value(op.results[0]).type.str() + ", which has no derivative";
}

class Explainer {
 public:
  Explainer(const Graph& graph, ValueId loss, std::span<const ValueId> targets)
      : graph_(graph), loss_(loss), targets_(targets.begin(), targets.end()) {
    for (uint32_t k = 0; k < graph.value_count(); ++k) edges_.push_back(edges_of(graph, ValueId{k}));
    any_ = distances(edges_, targets, false);
    flow_ = distances(edges_, targets, true);
  }

  GradientExplanation explain() {
    using Verdict = GradientExplanation::Verdict;
    GradientExplanation out;
    const bool floats = std::any_of(targets_.begin(), targets_.end(),
                                    [&](ValueId target) { return graph_.value(target).type.is_float(); });
    if (!floats || !graph_.value(loss_).type.is_float()) {
      out.verdict = Verdict::NotFloat;
      return out;
    }
    if (any_[loss_.index] == kFar) return out;
    find_cuts(out);
    out.verdict = flow_[loss_.index] == kFar ? Verdict::Cut : Verdict::Flows;
    if (out.verdict == Verdict::Flows) find_paths(out);
    return out;
  }

 private:
  bool is_target(ValueId id) const { return targets_.count(id) != 0; }
  bool is_stop(ValueId id) const { return id == loss_ || is_target(id) || !graph_.value(id).name.empty(); }

  // Dependencies that leave the part of the graph that the gradient of the loss reaches.
  void find_cuts(GradientExplanation& out) const {
    std::vector<bool> reached(edges_.size());
    reached[loss_.index] = true;
    std::set<OpId> seen;
    for (size_t k = edges_.size(); k-- > 0;) {
      if (!reached[k] || is_target(ValueId{static_cast<uint32_t>(k)})) continue;
      for (const Edge& edge : edges_[k]) {
        if (edge.flows) {
          reached[edge.from.index] = true;
        } else if (any_[edge.from.index] != kFar && !is_told(edges_[k], edge)) {
          const OpId cause = cause_of(ValueId{static_cast<uint32_t>(k)}, edge.from);
          if (seen.insert(cause).second) out.cuts.push_back({cause, reason_of(graph_, graph_.op(cause))});
        }
      }
    }
  }

  // Whether a value of a function with a '@vjp' is reached by an argument, whose own edge tells what becomes of it.
  bool is_told(const std::vector<Edge>& edges, const Edge& edge) const {
    const ir::OpId op = graph_.value(ValueId{static_cast<uint32_t>(&edges - edges_.data())}).op;
    return op.valid() && graph_.op(op).kind == OpKind::Vjp && &edge == &edges.back() &&
           std::any_of(edges.begin(), edges.end() - 1, [&](const Edge& e) { return any_[e.from.index] != kFar; });
  }

  // Of the ops on the shortest way from a target to the cut edge, the first that ends the gradient: what follows it
  // is discrete already.
  OpId cause_of(ValueId user, ValueId operand) const {
    OpId cause = graph_.value(user).op;
    for (ValueId at = operand; !is_target(at);) {
      const auto& edges = edges_[at.index];
      const auto nearest = std::min_element(edges.begin(), edges.end(), [&](const Edge& a, const Edge& b) {
        return any_[a.from.index] < any_[b.from.index];
      });
      if (!nearest->flows) cause = graph_.value(at).op;
      at = nearest->from;
    }
    return cause;
  }

  // The stops that a stop's gradient goes to next, with the ops on the shortest way there.
  std::map<ValueId, std::vector<OpId>> next_stops(ValueId from) const {
    std::map<ValueId, std::vector<OpId>> next;
    std::map<ValueId, ValueId> reached_from;
    std::deque<ValueId> queue{from};
    while (!queue.empty()) {
      const ValueId at = queue.front();
      queue.pop_front();
      for (const Edge& edge : edges_[at.index]) {
        if (!edge.flows || flow_[edge.from.index] == kFar) continue;
        if (!reached_from.emplace(edge.from, at).second) continue;
        if (!is_stop(edge.from)) {
          queue.push_back(edge.from);
          continue;
        }
        std::vector<OpId>& ops = next[edge.from];
        for (ValueId v = at;; v = reached_from.at(v)) {
          ops.insert(ops.begin(), graph_.value(v).op);
          if (v == from) break;
        }
      }
    }
    return next;
  }

  // Breadth first over stops: paths of few names come first.
  void find_paths(GradientExplanation& out) const {
    struct Step {
      ValueId value;
      size_t before;  // index of the step that led here
      std::vector<OpId> ops;
    };
    std::vector<Step> steps{{loss_, 0, {}}};
    std::map<ValueId, std::map<ValueId, std::vector<OpId>>> known;
    std::set<OpId> clamps;
    size_t found = 0;
    for (size_t k = 0; k < steps.size() && k < kMaxSearch && found < kMaxPaths; ++k) {
      const ValueId here = steps[k].value;
      if (is_target(here)) {
        if (++found > kShownPaths) continue;
        std::vector<GradientStop> path{{here, {}}};
        for (size_t at = k; at != 0; at = steps[at].before) {
          GradientStop stop{steps[steps[at].before].value, {}};
          for (const OpId op : steps[at].ops) {
            const OpKind kind = graph_.op(op).kind;
            if (std::find(stop.through.begin(), stop.through.end(), kind) == stop.through.end())
              stop.through.push_back(kind);
            if (kind == OpKind::Clamp && clamps.insert(op).second) out.clamps.push_back(op);
          }
          path.insert(path.begin(), std::move(stop));
        }
        out.paths.push_back(std::move(path));
        continue;
      }
      if (known.count(here) == 0) known[here] = next_stops(here);
      for (const auto& [value, ops] : known[here]) steps.push_back({value, k, ops});
    }
    out.more_paths = found - std::min(found, kShownPaths);
  }

  const Graph& graph_;
  ValueId loss_;
  std::set<ValueId> targets_;
  std::vector<std::vector<Edge>> edges_;  // by value
  std::vector<uint32_t> any_, flow_;
};

}  // namespace

GradientExplanation explain_gradient(const Graph& graph, ValueId loss, std::span<const ValueId> targets) {
  DR_ASSERT(!targets.empty());
  return Explainer(graph, loss, targets).explain();
}

}  // namespace dr::passes
