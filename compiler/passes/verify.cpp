// SPDX-License-Identifier: Apache-2.0
// Checks a graph in two layers: structure first, and only if that is sound, types and extents by the op table, whose
// rules may rely on it. It lists every violation with the op's line as the text form prints it.
#include <algorithm>
#include <unordered_set>

#include "compiler/ir/print.h"
#include "compiler/ir/raster.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"
#include "compiler/passes/passes.h"
#include "compiler/topology/topology.h"

namespace dr::passes {

using namespace ir;

namespace {

constexpr size_t kAnyNumber = SIZE_MAX;

size_t region_count(OpKind kind) {
  if (kind == OpKind::Fold) return kAnyNumber;
  if (kind == OpKind::If) return 2;
  if (kind == OpKind::Reduce) return 1;
  if (kind == OpKind::Raster) return 3;
  return 0;
}

bool stretches_to(const Extent& extent, const Extent& domain) {
  const auto common = broadcast(extent, domain);
  return common && *common == domain;
}

std::string words(const Type& type, const Extent& extent) { return type.str() + extent.str(); }

std::string extent_words(const Extent& extent) { return extent.is_unit() ? "[1]" : extent.str(); }

class Verifier {
 public:
  explicit Verifier(const Graph& graph)
      : graph_(graph),
        numbers_(print_numbers(graph)),
        visible_(graph.value_count()),
        regions_seen_(graph.region_count()) {}

  std::vector<std::string> run() {
    check_leaves();
    check_region(graph_.root(), OpId{});
    check_unreached();
    check_steps();
    if (violations_.empty()) {
      check_types(graph_.root());
      check_updates();
    }
    return std::move(violations_);
  }

 private:
  void report(std::string message) { violations_.push_back(std::move(message)); }
  void report(OpId op, const std::string& message) { report(message + ": " + print_op(graph_, op, numbers_)); }

  // --- structure ---

  void check_leaves() {
    std::unordered_set<std::string_view> names;
    for (const Leaf& leaf : graph_.leaves) {
      if (!names.insert(leaf.name).second) report("two leaves are named '" + leaf.name + "'");
      if (!leaf.initial.empty() && leaf.initial.size() != static_cast<size_t>(leaf.type.components())) {
        report("leaf '" + leaf.name + "' is " + leaf.type.str() + " and has " + std::to_string(leaf.initial.size()) +
               " initial components");
      }
      if (!leaf.table.empty()) check_table(leaf);
    }
  }

  void check_table(const Leaf& leaf) {
    const topology::Table* table = topology::find_table(leaf.table);
    const auto of = graph_.leaf_index(leaf.table_of);
    if (!table || leaf.kind != Leaf::Kind::Input || leaf.type != vec(table->components, Scalar::Int)) {
      report("leaf '" + leaf.name + "' is no table of a topology");
    } else if (!of || graph_.leaves[*of].type != vec(3, Scalar::Int) || !graph_.leaves[*of].table.empty()) {
      report("leaf '" + leaf.name + "' is a table of '" + leaf.table_of + "', which are no faces");
    }
  }

  // Whether a use of the value is sound so far; reports what is not.
  bool check_use(OpId user, ValueId id) {
    if (id.index >= graph_.value_count()) {
      report(user, "an operand or yield is no value of the graph");
      return false;
    }
    if (!visible_[id.index]) {
      report(user, "value " + number(id) + " is not defined before its use in this or an enclosing region");
      return false;
    }
    return true;
  }

  std::string number(ValueId id) const {
    const uint32_t n = numbers_[id.index];
    return n == UINT32_MAX ? "%?" : std::string("%") + std::to_string(n);
  }

  void define(OpId op, ValueId id, RegionId region, OpId maker, size_t index) {
    if (id.index >= graph_.value_count()) return report(op, "a result or parameter is no value of the graph");
    const ValueInfo& info = graph_.value(id);
    if (info.op != maker || info.region != region || info.result_index != index) {
      report(op, "value " + number(id) + " does not say where it comes from");
    }
    visible_[id.index] = true;
  }

  void check_region(RegionId id, OpId parent) {
    const Region& region = graph_.region(id);
    if (regions_seen_[id.index]) return report(parent, "a region belongs to two ops");
    regions_seen_[id.index] = true;
    if (region.parent != parent) {
      if (parent.valid()) {
        report(parent, "a region does not know its op");
      } else {
        report("the root region has a parent");
      }
    }
    for (size_t i = 0; i < region.params.size(); ++i) define(parent, region.params[i], id, OpId{}, i);
    for (OpId op : region.ops) check_op(op, id);
    if (parent.valid()) {
      check_yields(parent, id);
    } else if (!region.params.empty() || !region.yields.empty()) {
      report("the root region has parameters or yields");
    }
    // What a region defines ends with it.
    for (ValueId param : region.params) visible_[param.index] = false;
    for (OpId op : region.ops) {
      for (ValueId result : graph_.op(op).results) visible_[result.index] = false;
    }
    if (!parent.valid()) {  // but steps name the root's values
      for (OpId op : region.ops) {
        for (ValueId result : graph_.op(op).results) visible_[result.index] = true;
      }
    }
  }

  void check_op(OpId id, RegionId region) {
    const Op& op = graph_.op(id);
    if (op.parent != region) report(id, "an op does not know its region");
    for (ValueId operand : op.operands) {
      if (check_use(id, operand) && graph_.value(operand).accumulation) {
        report(id, "accumulation " + number(operand) + " may only be yielded on");
      }
    }
    if (region != graph_.root()) check_place(id, op);
    if (check_counts(id, op)) {
      for (RegionId inner : op.regions) check_region(inner, id);
    }
    for (size_t i = 0; i < op.results.size(); ++i) define(id, op.results[i], region, id, i);
    for (size_t i = 0; i < op.results.size(); ++i) {
      const bool scatters =
          combines_yields(op.kind) && i < op.attrs.yields.size() && op.attrs.yields[i] == Yield::Scatter;
      if (graph_.value(op.results[i]).accumulation != (scatters && region != graph_.root())) {
        report(id, scatters ? "a scatter is an accumulation inside a region and an image in the root"
                            : "only a scatter inside a region is an accumulation");
      }
    }
  }

  // Ops that make sense for one element at a time.
  void check_place(OpId id, const Op& op) {
    const ops::Shape shape = ops::info(op.kind).shape;
    const bool gather = op.kind == OpKind::Gather;
    const bool element = shape == ops::Shape::Elementwise || shape == ops::Shape::Source || combines_yields(op.kind) ||
                         gather || op.kind == OpKind::Vjp || op.kind == OpKind::Cotangent;
    if (!element) report(id, "this op may not stand in a region");
    if (gather && !op.operands.empty() && op.operands[0].index < graph_.value_count() &&
        graph_.value(op.operands[0]).region != graph_.root()) {
      report(id, "a gather inside a region reads a value that is not of the root region");
    }
  }

  bool expect_count(OpId id, std::string_view what, size_t count, size_t wanted) {
    if (count == wanted || wanted == kAnyNumber) return true;
    report(id, "expected " + std::to_string(wanted) + " " + std::string(what) + ", found " + std::to_string(count));
    return false;
  }

  // Whether the op has the regions, results and attributes that walking its regions relies on.
  bool check_counts(OpId id, const Op& op) {
    bool ok = expect_count(id, "regions", op.regions.size(), region_count(op.kind));
    size_t params = 0, operands = kAnyNumber, results = kAnyNumber;
    if (op.kind == OpKind::Fold) {
      if (!check_sweeps(id, op)) return false;
      operands = op.operands.size();
      params = kAnyNumber;
      results = op.attrs.yields.size();
    } else if (combines_yields(op.kind)) {
      const auto scatters =
          static_cast<size_t>(std::count(op.attrs.yields.begin(), op.attrs.yields.end(), Yield::Scatter));
      ok &= expect_count(id, "dims", op.attrs.dims.size(), 3 + 3 * scatters);
      params = op.kind == OpKind::Reduce ? 1 : 0;
      operands = op.kind == OpKind::Reduce ? 2 : 1;
      results = op.attrs.yields.size();
      if (results == 0) {
        report(id, "an op has at least one result");
        return false;
      }
      if (op.kind == OpKind::Reduce) {
        ok &= expect_count(id, "ints", op.attrs.ints.size(), 1);
        if (std::count(op.attrs.yields.begin(), op.attrs.yields.end(), Yield::Element) > 0) {
          report(id, "a reduce combines what its trips yield, 'element' does not say how");
        }
      } else {
        for (Yield yield : op.attrs.yields) {
          if (yield == Yield::Element || yield == Yield::Scatter) continue;
          report(id, "an if yields elements and scatters only");
          break;
        }
      }
    } else if (op.kind == OpKind::Raster) {
      if (!expect_count(id, "ints", op.attrs.ints.size(),
                        ir::lists_faces(op.attrs) || ir::results_a_rank(op.attrs) == 3 ? 4 : 3) ||
          !expect_count(id, "dims", op.attrs.dims.size(), 4))
        return false;
      const int64_t nearest = op.attrs.ints[0], fields = op.attrs.ints[1], corners = op.attrs.ints[2];
      if (nearest < 1 || fields < 0 || fields > 1 << 20 || nearest > 1 << 20 || (corners != 3 && corners != 6)) {
        report(id, "a raster's ints are {at least 1, at least 0, 3 or 6}");
        return false;
      }
      params = static_cast<size_t>(fields) + 1;
      operands = static_cast<size_t>(fields + corners) + 1;
      results = ir::lists_faces(op.attrs) ? 1 : ir::results_a_rank(op.attrs) * static_cast<size_t>(nearest);
    } else if (op.kind == OpKind::Grad) {
      if (op.operands.size() < 3) {
        report(id, "a grad has a value, a seed and at least one target");
        return false;
      }
      results = op.operands.size() - 2;
    } else {
      results = 1;
    }
    ok &= expect_count(id, "operands", op.operands.size(), operands);
    ok &= expect_count(id, "results", op.results.size(), results);
    for (RegionId region : op.regions) {
      if (region.index >= graph_.region_count()) {
        report(id, "a region is none of the graph");
        return false;
      }
      ok &= expect_count(id, "parameters of a region", graph_.region(region).params.size(), params);
    }
    return ok;
  }

  // Of a Fold: what the helpers in ir/yields.h rely on.
  bool check_sweeps(OpId id, const Op& op) {
    const auto scatters =
        static_cast<size_t>(std::count(op.attrs.yields.begin(), op.attrs.yields.end(), Yield::Scatter));
    bool ok = expect_count(id, "ints", op.attrs.ints.size(), 2 + op.regions.size()) &&
              expect_count(id, "dims", op.attrs.dims.size(), 3 + 3 * scatters);
    size_t states = 0;
    for (size_t k = 0; ok && k < op.regions.size(); ++k) {
      const int64_t count = op.attrs.ints[2 + k];
      if (count < 0 || count > 1 << 20 || op.regions[k].index >= graph_.region_count()) {
        report(id, "a fold's sweeps have a region and a number of states each");
        return false;
      }
      states += static_cast<size_t>(count);
      ok = expect_count(id, "parameters of a region", graph_.region(op.regions[k]).params.size(), 1 + states);
    }
    if (ok && (op.regions.empty() || op.attrs.yields.empty())) {
      report(id, "a fold has at least one sweep and one result");
      return false;
    }
    return ok && expect_count(id, "operands", op.operands.size(), 2 + states);
  }

  void check_yields(OpId id, RegionId region_id) {
    const Op& op = graph_.op(id);
    const std::vector<ValueId>& yields = graph_.region(region_id).yields;
    bool ok = true;
    for (ValueId yield : yields) ok &= check_use(id, yield);
    if (!ok) return;
    size_t wanted = 0;
    const bool first = op.kind == OpKind::Fold && region_id == op.regions[0];
    if (first && fold_stops(op)) wanted = 1;
    if (op.kind == OpKind::Fold && region_id != op.regions.back()) {
      const auto sweep = static_cast<size_t>(std::ranges::find(op.regions, region_id) - op.regions.begin());
      wanted += fold_states(op, sweep);
      for (ValueId yield : yields) {
        if (graph_.value(yield).accumulation) report(id, "accumulation " + number(yield) + " is yielded as a state");
      }
    } else if (combines_yields(op.kind)) {
      // An accumulation stands alone for a scatter, otherwise an index and a value do.
      for (Yield how : op.attrs.yields) {
        const bool accumulation = wanted < yields.size() && graph_.value(yields[wanted]).accumulation;
        if (accumulation && graph_.value(yields[wanted]).region != region_id) {
          report(id, "accumulation " + number(yields[wanted]) + " is yielded by a region that it was not made in");
        }
        if (accumulation && how != Yield::Scatter)
          report(id, "accumulation " + number(yields[wanted]) + " may only be yielded as a scatter");
        const bool pair = how == Yield::Scatter && !accumulation;
        if (pair && wanted + 1 < yields.size() && graph_.value(yields[wanted + 1]).accumulation) {
          report(id, "accumulation " + number(yields[wanted + 1]) + " is scattered as a value");
        }
        wanted += pair ? 2 : 1;
      }
    } else {
      wanted = 1;
      for (ValueId yield : yields) {
        if (graph_.value(yield).accumulation)
          report(id, "accumulation " + number(yield) + " may only be yielded as a scatter");
      }
    }
    expect_count(id, "yields of a region", yields.size(), wanted);
  }

  void check_unreached() {
    if (!violations_.empty()) return;  // regions of broken ops are not walked
    for (uint32_t i = 0; i < graph_.region_count(); ++i) {
      if (!regions_seen_[i]) report("region " + std::to_string(i) + " belongs to no op");
    }
  }

  void check_root(const std::string& what, ValueId id) {
    if (id.index >= graph_.value_count()) {
      report(what + " is no value of the graph");
    } else if (graph_.value(id).region != graph_.root()) {
      report(what + ", " + number(id) + ", is not of the root region");
    }
  }

  void check_steps() {
    std::unordered_set<std::string_view> steps;
    for (const Step& step : graph_.steps) {
      if (!steps.insert(step.name).second) report("two steps are named '" + step.name + "'");
      const std::string in_step = "step '" + step.name + "': ";
      std::unordered_set<std::string_view> outputs;
      for (const Output& output : step.outputs) {
        if (!outputs.insert(output.name).second) report(in_step + "two outputs are named '" + output.name + "'");
        check_root(in_step + "output '" + output.name + "'", output.value);
      }
      std::unordered_set<uint32_t> written;
      for (const Update& update : step.updates) {
        if (update.leaf >= graph_.leaves.size()) {
          report(in_step + "an update of a leaf that there is not");
          continue;
        }
        const std::string& leaf = graph_.leaves[update.leaf].name;
        if (!written.insert(update.leaf).second) report(in_step + "leaf '" + leaf + "' has two writers");
        check_root(in_step + "the update of '" + leaf + "'", update.value);
      }
    }
  }

  // --- types and extents ---

  void check_types(RegionId region) {
    for (OpId id : graph_.region(region).ops) {
      const Op& op = graph_.op(id);
      for (RegionId inner : op.regions) check_types(inner);
      if (!op.regions.empty()) check_domain(id, op);

      const ops::InferResult inferred =
          ops::infer(graph_, op.kind, op.operands, op.attrs, op.regions, graph_.value(op.results[0]).type);
      if (const auto* message = std::get_if<std::string>(&inferred)) {
        report(id, *message);
        continue;
      }
      const auto& types = std::get<std::vector<ResultType>>(inferred);
      if (!expect_count(id, "results", op.results.size(), types.size())) continue;
      for (size_t i = 0; i < types.size(); ++i) {
        const ValueInfo& info = graph_.value(op.results[i]);
        if (info.type == types[i].type && info.extent == types[i].extent) continue;
        report(id, "result " + number(op.results[i]) + " should be " + words(types[i].type, types[i].extent));
      }
    }
  }

  // A region runs once per element of its op's domain: whatever is in it must stretch to that. Operands and yields are
  // left to the op's type rule.
  void check_domain(OpId id, const Op& op) {
    const Extent domain = domain_of(op);
    for (RegionId region : op.regions) {
      for (ValueId param : graph_.region(region).params) {
        if (!stretches_to(graph_.value(param).extent, domain))
          report(id, "parameter " + number(param) + " does not stretch to the domain");
      }
      for (OpId inner_id : graph_.region(region).ops) {
        const Op& inner = graph_.op(inner_id);
        if (!inner.regions.empty() && !stretches_to(domain_of(inner), domain)) {
          report(inner_id, "the domain does not stretch to that of the region, " + extent_words(domain));
        }
        for (ValueId result : inner.results) {
          const ValueInfo& info = graph_.value(result);
          if (!info.accumulation && !stretches_to(info.extent, domain)) {
            report(inner_id, "the extent does not stretch to the region's domain, " + extent_words(domain));
          }
        }
      }
    }
  }

  void check_updates() {
    for (const Step& step : graph_.steps) {
      for (const Update& update : step.updates) {
        const Leaf& leaf = graph_.leaves[update.leaf];
        const ValueInfo& info = graph_.value(update.value);
        if (info.type == leaf.type && info.extent == leaf.extent) continue;
        report("step '" + step.name + "': leaf '" + leaf.name + "' is " + words(leaf.type, leaf.extent) +
               " and its new value " + number(update.value) + " is " + words(info.type, info.extent));
      }
    }
  }

  const Graph& graph_;
  std::vector<uint32_t> numbers_;
  std::vector<bool> visible_;
  std::vector<bool> regions_seen_;
  std::vector<std::string> violations_;
};

}  // namespace

std::vector<std::string> verify(const Graph& graph) { return Verifier(graph).run(); }

}  // namespace dr::passes
