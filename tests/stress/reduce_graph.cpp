// SPDX-License-Identifier: Apache-2.0
#include "tests/stress/reduce_graph.h"

#include <chrono>
#include <cmath>
#include <set>

#include "tests/stress/rewrite_graph.h"

namespace dr::test {

using namespace ir;

namespace {

bool is_source(OpKind kind) { return kind == OpKind::Const || kind == OpKind::Leaf; }

// Digits, so to speak.
size_t weight(double number) {
  if (number == 0) return 0;
  if (!(std::abs(number) < 1e15) || number != std::floor(number)) return 3;
  return 1 + static_cast<size_t>(std::log2(std::abs(number)));
}

std::set<int64_t> extents_of(const Graph& graph) {
  std::set<int64_t> found;
  const auto add = [&](const Dim& dim) {
    if (dim.is_constant() && dim.constant() > 1) found.insert(dim.constant());
  };
  for (const Leaf& leaf : graph.leaves)
    for (const Dim* dim : {&leaf.extent.w, &leaf.extent.h, &leaf.extent.l}) add(*dim);
  for (const OpId id : all_ops(graph))
    for (const Dim& dim : graph.op(id).attrs.dims) add(dim);
  return found;
}

// What reducing makes less of.
size_t weight(const Graph& graph) {
  size_t sum = 0;
  for (const OpId id : all_ops(graph)) {
    const Op& op = graph.op(id);
    const bool stretched =
        op.kind == OpKind::Broadcast && graph.op(graph.value(op.operands[0]).op).kind == OpKind::Const;
    sum += is_source(op.kind) || stretched ? 1 : 8 + op.results.size();
    if (op.kind == OpKind::Const) sum += weight(op.attrs.floats[0]);
  }
  for (const int64_t extent : extents_of(graph)) sum += weight(static_cast<double>(extent));
  for (const Step& step : graph.steps) sum += step.outputs.size() + step.updates.size();
  return sum;
}

class Reducer {
 public:
  Reducer(Graph graph, const std::function<bool(const Graph&)>& fails, double seconds)
      : graph_(std::move(graph)), weight_(weight(graph_)), fails_(fails), seconds_(seconds) {}

  Graph run() && {
    for (size_t before = 0; before != weight_ && !is_over();) {
      before = weight_;
      drop_outputs();
      drop_values();
      move_outputs();
      shorten_values();
      drop_regions();
      shrink();
    }
    return std::move(graph_);
  }

 private:
  bool is_over() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count() > seconds_;
  }

  bool take(const Edit& edit) {
    if (is_over()) return false;
    auto now = rewritten(graph_, edit);
    if (!now) return false;
    const size_t less = weight(*now);
    if (less >= weight_ || !fails_(*now)) return false;
    graph_ = std::move(*now);
    weight_ = less;
    return true;
  }

  // Each output alone, then without one after the other.
  void drop_outputs() {
    size_t count = 0;
    for (const Step& step : graph_.steps) count += step.outputs.size();
    if (count < 2) return;
    for (size_t k = 0; k < count; ++k) {
      Edit edit;
      for (size_t other = 0; other < count; ++other)
        if (other != k) edit.without_outputs.insert(other);
      if (take(edit)) return;
    }
    for (size_t k = count; k-- > 0;) {
      Edit edit;
      edit.without_outputs.insert(k);
      take(edit);
    }
  }

  // To the first values that show the fault, whatever their types.
  void move_outputs() {
    size_t outputs = 0;
    for (const Step& step : graph_.steps) outputs += step.outputs.size();
    for (size_t output = 0; output < outputs; ++output) {
      for (const OpId id : std::vector(graph_.region(graph_.root()).ops)) {
        bool found = false;
        for (const ValueId result : std::vector(graph_.op(id).results)) {
          Edit edit;
          edit.outputs[output] = result;
          if ((found = take(edit))) break;
        }
        if (found) break;
      }
    }
  }

  // Results of ops that constants may stand for, the last ones first.
  std::vector<ValueId> candidates() const {
    std::vector<ValueId> out;
    for (const OpId id : all_ops(graph_)) {
      const Op& op = graph_.op(id);
      if (op.kind == OpKind::Const) continue;
      if (op.kind == OpKind::Broadcast && graph_.op(graph_.value(op.operands[0]).op).kind == OpKind::Const) continue;
      out.insert(out.end(), op.results.begin(), op.results.end());
    }
    return {out.rbegin(), out.rend()};
  }

  // By zeros: half of them at a time, a quarter, and so on. Whatever goes changes all numbers of values, so that a
  // sweep begins anew behind the place where it was.
  void drop_values() {
    for (size_t at_once = candidates().size(); at_once > 0; at_once /= 2) {
      for (size_t first = 0; first < candidates().size();) {
        const std::vector<ValueId> values = candidates();
        Edit edit;
        for (size_t k = first; k < std::min(values.size(), first + at_once); ++k) edit.values[values[k]] = {};
        if (!take(edit)) first += at_once;
        if (is_over()) return;
      }
    }
  }

  // By what they are made of, and by ones.
  void shorten_values() {
    for (size_t k = 0; k < candidates().size() && !is_over();) {
      const ValueId value = candidates()[k];
      const ValueInfo info = graph_.value(value);
      if (info.accumulation) {
        ++k;
        continue;
      }
      const auto replaced = [&](const Instead& instead) {
        Edit edit;
        edit.values[value] = instead;
        return take(edit);
      };
      bool found = replaced({{}, 1});
      const std::vector<ValueId> operands = graph_.op(info.op).operands;
      for (size_t i = 0; !found && i < operands.size(); ++i)
        if (graph_.value(operands[i]).type == info.type) found = replaced({operands[i], 0});
      if (!found) ++k;
    }
  }

  void drop_regions() {
    for (size_t k = 0; k < all_ops(graph_).size() && !is_over();) {
      const OpId id = all_ops(graph_)[k];
      const Op op = graph_.op(id);
      bool found = false;
      for (size_t region = 0; !found && region < op.regions.size(); ++region) {
        Edit edit;
        edit.inlined = id;
        edit.region = region;
        found = take(edit);
      }
      for (size_t result = 0; !found && !op.regions.empty() && result < op.results.size(); ++result) {
        Edit edit;
        edit.narrowed = id;
        edit.result = result;
        found = take(edit);
      }
      if (!found) ++k;
    }
  }

  void shrink() {
    for (const int64_t extent : extents_of(graph_)) {
      for (const int64_t shrunk : {int64_t{1}, int64_t{2}, extent / 2, extent - 1}) {
        Edit edit;
        edit.extent = extent;
        edit.shrunk = shrunk;
        if (shrunk < extent && shrunk > 0 && take(edit)) break;
      }
    }
    for (size_t k = 0; k < all_ops(graph_).size() && !is_over(); ++k) {
      for (bool found = true; found;) {
        const OpId id = all_ops(graph_)[k];
        if (graph_.op(id).kind != OpKind::Const) break;
        const double number = graph_.op(id).attrs.floats[0];
        found = false;
        for (const double becomes : {0.0, 1.0, std::trunc(number / 2), number - 1}) {
          Edit edit;
          edit.constant = id;
          edit.becomes = becomes;
          if (take(edit)) {
            found = true;
            break;
          }
        }
        if (k >= all_ops(graph_).size()) break;
      }
    }
  }

  Graph graph_;
  size_t weight_;
  const std::function<bool(const Graph&)>& fails_;
  double seconds_;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

}  // namespace

size_t ops_of(const Graph& graph) {
  size_t count = 0;
  for (const OpId id : all_ops(graph)) count += is_source(graph.op(id).kind) ? 0 : 1;
  return count;
}

Graph reduce_graph(Graph graph, const std::function<bool(const Graph&)>& fails, double seconds) {
  return Reducer(std::move(graph), fails, seconds).run();
}

}  // namespace dr::test
