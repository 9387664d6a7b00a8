// SPDX-License-Identifier: Apache-2.0
// Whether the parts of a schedule fit together: everything that a schedule names is there and of the right kind. What
// follows from this is checked when the schedule is run in thought (check.cpp), and counted on everywhere else.
#include "compiler/backend/schedule/structure.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

template <typename Values>
bool holds(const Values& values, ValueId v) {
  return std::ranges::find(values, v) != values.end();
}

class StructureChecker {
 public:
  StructureChecker(const Graph& graph, const Schedule& schedule, std::vector<Violation>& violations)
      : graph_(graph), schedule_(schedule), violations_(violations) {}

  void process() {
    check_resources();
    for (const auto* divisors :
         {&schedule_.code.hidden_divisors, &schedule_.code.strict_hidden_divisors, &schedule_.code.moderate_divisors})
      for (const ValueId v : *divisors)
        if (!graph_.value(v).type.is_float()) bad("has a divisor that is no float");
    if (schedule_.steps.size() != graph_.steps.size()) bad("has another number of steps than the graph");
    for (size_t k = 0; k < schedule_.steps.size() && violations_.empty(); ++k) {
      step_ = &schedule_.steps[k];
      if (step_->name != graph_.steps[k].name)
        bad("stands where the graph has step '" + graph_.steps[k].name + "'");
      else
        check_step(graph_.steps[k]);
    }
  }

 private:
  void bad(const std::string& what) {
    const std::string where = pass_   ? "step " + step_->name + ", pass " + pass_->name + ": "
                              : step_ ? "step " + step_->name + ": "
                                      : "the schedule ";
    violations_.push_back({Violation::Kind::Unsound, where + what});
  }

  void check_resources() {
    const std::vector<Resource>& resources = schedule_.resources;
    if (resources.size() < graph_.leaves.size()) return bad("lacks resources of leaves");
    std::set<std::string> names;
    for (size_t k = 0; k < resources.size(); ++k) {
      const Resource& r = resources[k];
      const bool is_leaf = k < graph_.leaves.size();
      if (r.leaf != (is_leaf ? static_cast<int>(k) : -1)) bad("mixes the resources of leaves with others");
      if (is_leaf && (r.type != graph_.leaves[k].type || r.extent != graph_.leaves[k].extent))
        bad("gives leaf '" + r.name + "' another type");
      if ((is_leaf || r.half || r.sums || r.entries || r.step_index) && r.storage != Resource::Storage::Buffer)
        bad("stores '" + r.name + "', a buffer by its kind, elsewhere");
      if (is_leaf + r.half + r.sums + r.entries + r.step_index > 1) bad("calls '" + r.name + "' two things at once");
      if (!names.insert(r.name).second) bad("names two resources '" + r.name + "'");
    }
  }

  const Resource& resource(ValueId v) const { return schedule_.resources[step_->stored.at(v).index]; }
  bool is_root(ValueId v) const { return v.index < graph_.value_count() && graph_.value(v).region == graph_.root(); }

  void check_step(const ir::Step& step) {
    for (const auto& [v, id] : step_->stored) check_stored(v, id);
    if (!violations_.empty()) return;
    const bool same_outputs = std::ranges::equal(step_->outputs, step.outputs, [](const auto& a, const ir::Output& b) {
      return a.first == b.name && a.second == b.value;
    });
    const bool same_updates = std::ranges::equal(step_->updates, step.updates, [](const auto& a, const ir::Update& b) {
      return a.first == b.leaf && a.second == b.value;
    });
    if (!same_outputs) bad("has other outputs than the graph's step");
    if (!same_updates) bad("has other updates than the graph's step");
    for (size_t k = 0; k < step_->passes.size(); ++k) {
      pass_ = &step_->passes[k];
      if (k > 0 && step_->passes[k - 1].stage > pass_->stage) bad("stands behind a later stage");
      check_pass(k);
    }
    pass_ = nullptr;
  }

  void check_stored(ValueId v, ResourceId id) {
    if (!is_root(v)) return bad("stores a value of a region");
    if (id.index >= schedule_.resources.size()) return bad("stores a value in no resource");
    const Resource& r = schedule_.resources[id.index];
    const ir::ValueInfo& info = graph_.value(v);
    const Op& op = graph_.op(info.op);
    if (r.entries ? op.kind != OpKind::Raster : info.type != r.type || info.extent != r.extent)
      bad("stores a value of another type in '" + r.name + "'");
    if (op.kind == OpKind::Leaf ? graph_.leaf_index(op.attrs.text) != id.index : is_memory(op) != r.step_index)
      bad("stores a value in '" + r.name + "', which is another's");
    if (r.half && !is_packed(graph_, v)) bad("stores a value in halves that is none");
  }

  // Values that a line of a pass names are in order and stored.
  void check_values(const std::vector<ValueId>& values, const char* what) {
    for (size_t k = 0; k < values.size(); ++k) {
      if (step_->stored.count(values[k]) == 0) bad(std::string(what) + " a value that is not stored");
      if (k > 0 && !(values[k - 1] < values[k])) bad(std::string(what) + " values out of order");
    }
  }

  void check_pass(size_t place) {
    check_values(pass_->reads, "reads");
    check_values(pass_->writes, "writes");
    check_values(pass_->partial, "stores partly");
    if (!std::ranges::all_of(pass_->partial, [&](ValueId v) { return holds(pass_->writes, v); }))
      bad("stores partly what it does not store");
    if (!check_ops()) return;
    check_scatter();
    check_code();
    if (pass_->listed_by >= 0) check_helper(pass_->listed_by, place, "listed by");
    if (pass_->set_up_by >= 0) check_helper(pass_->set_up_by, place, "set up by");
  }

  void check_code() {
    const PassCode& code = pass_->code;
    const bool is_map = pass_->kind == Pass::Kind::Map && !pass_->hardware;
    const bool is_scatter = pass_->kind == Pass::Kind::Scatter;
    check_values(code.told, "tells of");
    if (!std::ranges::all_of(code.told, [&](ValueId v) { return holds(pass_->writes, v); }))
      bad("tells of what it does not store");
    for (const OpId id : code.heavy)
      if (std::ranges::find(pass_->ops, id) == pass_->ops.end() || graph_.op(id).kind != OpKind::If)
        bad("runs in two dispatches by what is no branch of it");
    if (!is_map && (!code.heavy.empty() || code.heavy_cut.cuts() || !code.told.empty()))
      bad("has code of a map and is none");
    if (!is_map && !is_scatter && (code.cut.cuts() || code.lists_in_runs)) bad("has code of elements and runs none");
    if (!is_scatter && code.skips_zeros) bad("skips zeros of no sum");
    if ((code.cut.cuts() || code.heavy_cut.cuts()) && schedule_.code.loop_trips == 0)
      bad("cuts loops that no device ends");
    const FaceWalk& w = code.walk;
    if ((w.lists || w.watched) && (pass_->kind != Pass::Kind::Raster || pass_->hardware)) bad("walks no faces");
    if (w.lists &&
        (w.team < 1 || w.middle_box < 1 || w.middle_invocations < w.team || w.large_invocations < kLargeTeam))
      bad("has too few invocations for the faces on its lists");
  }

  bool check_ops() {
    const std::vector<OpId>& ops = pass_->ops;
    if (ops.empty()) return bad("has no ops"), false;
    for (size_t k = 0; k < ops.size(); ++k) {
      const Op& op = graph_.op(ops[k]);
      if (op.results.empty() || op.parent != graph_.root()) return bad("runs an op of a region"), false;
      if (op.kind == OpKind::Grad) return bad("runs a 'grad'"), false;
      if (k > 0 && !(ops[k - 1] < ops[k])) return bad("runs ops out of order"), false;
      const Pass::Kind kind = pass_kind(op);
      const bool sums = pass_->kind == Pass::Kind::Scatter && kind == Pass::Kind::Scatter;
      const bool last = k + 1 == ops.size() && kind == pass_->kind;
      if (kind != Pass::Kind::Map && !sums && !last)
        return bad("runs a '" + std::string(ir::op_name(op.kind)) + "' where passes of its kind do not"), false;
    }
    const Op& last = graph_.op(ops.back());
    if ((pass_->kind == Pass::Kind::Reduce || pass_->kind == Pass::Kind::Raster) && pass_kind(last) != pass_->kind)
      return bad("lacks the op that its kind is of"), false;
    if (pass_->kind != Pass::Kind::Map && pass_->kind != Pass::Kind::Raster && pass_->hardware)
      return bad("is drawn, which only maps and rasters are"), false;
    return true;
  }

  void check_scatter() {
    const bool is_scatter = pass_->kind == Pass::Kind::Scatter;
    if (!is_scatter && (!pass_->sums.empty() || !pass_->active.empty() || pass_->listed_by >= 0 || pass_->join_lanes ||
                        pass_->joins_lister || pass_->keeps_terms || pass_->relist))
      bad("says how it sums and does not");
    if (pass_->kind != Pass::Kind::Raster && (pass_->set_up_by >= 0 || pass_->sets_up_again))
      bad("is set up and is no raster");
    for (const ScatterSum& sum : pass_->sums) {
      if (!holds(pass_->writes, sum.value)) bad("sums what it does not store");
      for (const ValueId term : sum.terms)
        if (!is_root(term) || pass_kind(graph_.op(graph_.value(term).op)) != Pass::Kind::Scatter ||
            std::ranges::find(pass_->ops, graph_.value(term).op) == pass_->ops.end())
          bad("sums a term that it does not scatter");
    }
    for (const std::vector<ValueId>& clause : pass_->active)
      if (clause.empty() || !std::ranges::all_of(clause, [&](ValueId v) { return is_root(v); }))
        bad("is active by a value of a region");
    check_rows();
  }

  void check_rows() {
    const RowsTable& rows = pass_->rows;
    const bool has_table = rows.sorted() || !rows.columns.empty();
    if (has_table != (pass_->kind == Pass::Kind::Scatter && pass_->scatter == ScatterLowering::Rows))
      return bad("has rows without a table, or a table without rows");
    if (rows.sorted() && !rows.columns.empty()) bad("has two tables of rows");
    if (!rows.columns.empty()) {
      const ir::Leaf& leaf = graph_.leaves[rows.leaf];
      for (const int column : rows.columns)
        if (!leaf.type.is_integer() || column < 0 || column >= leaf.type.components())
          bad("has rows by a column that leaf '" + leaf.name + "' lacks");
    }
    for (const ScatterLeaf& place : rows.places) {
      if (!graph_.value(place.index).type.is_integer()) bad("sorts by what is no index");
      for (const ScatterLeaf::Branch& branch : place.path)
        if (graph_.op(branch.op).kind != OpKind::If || branch.region > 1) bad("sorts in what is no branch");
    }
  }

  // A map pass before this one that does a part of its work.
  void check_helper(int helper, size_t place, const char* what) {
    if (static_cast<size_t>(helper) >= place) return bad(std::string("is ") + what + " no earlier pass");
    const Pass& pass = step_->passes[static_cast<size_t>(helper)];
    if (pass.kind != Pass::Kind::Map || pass.hardware)
      bad(std::string("is ") + what + " '" + pass.name + "', which is no map of a compute shader");
  }

  const Graph& graph_;
  const Schedule& schedule_;
  std::vector<Violation>& violations_;
  const StepSchedule* step_ = nullptr;
  const Pass* pass_ = nullptr;
};

}  // namespace

std::vector<Violation> check_structure(const Graph& graph, const Schedule& schedule) {
  std::vector<Violation> violations;
  StructureChecker(graph, schedule, violations).process();
  return violations;
}

}  // namespace dr::backend
