// SPDX-License-Identifier: Apache-2.0
// Whether the parts of a schedule fit together: everything that a schedule names is there and of the right kind. What
// follows from this is checked when the schedule is run in thought (check.cpp), and counted on everywhere else.
#include "compiler/backend/schedule/structure.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/axes.h"
#include "compiler/backend/analysis/raster_parts.h"
#include "compiler/backend/analysis/read_part.h"
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
      if (r.is(Resource::Storage::Leaf) != is_leaf) bad("mixes the resources of leaves with others");
      if (is_leaf && (r.type != graph_.leaves[k].type || r.extent != graph_.leaves[k].extent))
        bad("gives leaf '" + r.name + "' another type");
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
    const bool of_raster = op.kind == OpKind::Raster && (r.is_entries() || r.is(Resource::Storage::Bits));
    if (!of_raster && (r.is_entries() || info.type != r.type || info.extent != r.extent))
      bad("stores a value of another type in '" + r.name + "'");
    if (op.kind == OpKind::Leaf ? graph_.leaf_index(op.attrs.text) != id.index
                                : is_memory(op) != r.is(Resource::Storage::StepIndex))
      bad("stores a value in '" + r.name + "', which is another's");
    if (r.is(Resource::Storage::Halves) && !is_packed(graph_, v)) bad("stores a value in halves that is none");
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
    if (!check_ops()) return;
    std::visit(Overloaded{[&](const MapPass& map) { check_map(map, place); }, [](const FragmentPass&) {},
                          [](const ReducePass&) {}, [&](const ScatterPass& scatter) { check_scatter(scatter); },
                          [&](const RasterPass& raster) { check_walk(raster); }, [](const DrawnRasterPass&) {}},
               pass_->of_kind);
    if (const auto lister = pass_->lister()) check_helper(*lister, place, "listed by");
    if (const FaceSetup* setup = pass_->setup()) check_helper(setup->pass, place, "set up by");
  }

  void check_map(const MapPass& map, size_t place) {
    check_values(map.partial, "stores partly");
    if (!std::ranges::all_of(map.partial, [&](ValueId v) { return holds(pass_->writes, v); }))
      bad("stores partly what it does not store");
    if (map.rest) {
      check_values(map.rest->memory, "rests by");
      if (map.rest->gradient.index >= place) bad("rests without what is no earlier pass");
      for (const OpId id : map.rest->gathers) {
        const ir::Op& op = graph_.op(id);
        if (std::ranges::find(pass_->ops, id) == pass_->ops.end() || (op.kind != OpKind::Gather && op.regions.empty()))
          bad("looks at what is no gather of it");
      }
    }
    if (map.block) check_block(map, *map.block);
    check_values(map.code.told, "tells of");
    if (!std::ranges::all_of(map.code.told, [&](ValueId v) { return holds(pass_->writes, v); }))
      bad("tells of what it does not store");
    check_cut(map.code.cut);
    const bool plain =
        map.partial.empty() && !map.rest && !map.block && !map.code.lists_in_runs && !map.code.heavy && !map.code.cut;
    if (map.code.each < 1 || (map.code.each > 1 && !plain)) bad("takes elements in turn and is no plain map");
    if (!map.code.heavy) return;
    const auto is_branch = [&](OpId id) {
      return std::ranges::find(pass_->ops, id) != pass_->ops.end() &&
             (graph_.op(id).kind == OpKind::If || graph_.op(id).kind == OpKind::Select);
    };
    if (!std::ranges::all_of(map.code.heavy->ops, is_branch)) bad("runs in two dispatches by what is no branch of it");
    if (!std::ranges::all_of(map.code.heavy->unlikely, is_branch))
      bad("runs in three dispatches by what is no branch of it");
    check_cut(map.code.heavy->cut);
  }

  void check_cut(const std::optional<LoopCut>& cut) {
    if (cut && (cut->part == 0 || schedule_.code.loop_trips == 0)) bad("cuts loops that no device ends");
  }

  void check_walk(const RasterPass& raster) {
    const FaceWalk& walk = raster.walk;
    const Op& op = graph_.op(pass_->ops.back());
    const auto resource_of = [&](ValueId v) {
      const auto stored = step_->stored.find(v);
      return stored == step_->stored.end() ? nullptr : &schedule_.resources[stored->second.index];
    };
    const Resource* bits = resource_of(op.results[0]);
    const bool in_bits = bits != nullptr && bits->is(Resource::Storage::Bits);
    if (in_bits && (op.results.size() != 2 || resource_of(op.results[1]) != bits || bits->type != ir::kUint ||
                    bits->extent != bits_extent(pass_->domain)))
      bad("has no bit a pixel for both of its results");
    if (raster.rows &&
        (!in_bits || !is_rows_of(graph_, *raster.rows, op.results[0]) || resource_of(*raster.rows) != bits))
      bad("gives rows that are not its bits");
    if (walk.in_turn) {
      const Pass* setup = raster.setup ? &step_->pass(raster.setup->pass) : nullptr;
      if (walk.in_turn->each < 2 || walk.in_turn->each > kMostInTurn ||
          std::ranges::any_of(walk.in_turn->shown, [&](ValueId v) {
            return setup == nullptr || std::ranges::find(setup->ops, graph_.value(v).op) == setup->ops.end();
          }))
        bad("takes faces in turn by what does not set them up");
    }
    const auto wanted = wanted_pixels(graph_, op);
    if (walk.wanted && (in_bits || !wanted || wanted->bits != *walk.wanted))
      bad("looks for faces at pixels that its closures do not tell");
    if (!walk.lists) return;
    const FaceBins& bins = *walk.lists;
    constexpr int kRegister = 64;
    if (in_bits && bins.small_box > kRegister) bad("has no register for the bits of large boxes");
    if (bins.team < 1 || bins.middle_box < 1 || bins.middle_invocations < bins.team ||
        bins.large_invocations < kLargeTeam)
      bad("has too few invocations for the faces on its lists");
    if (bins.few_box > bins.small_box) bad("walks larger boxes alone where there are few");
  }

  bool check_ops() {
    const std::vector<OpId>& ops = pass_->ops;
    if (ops.empty()) return bad("has no ops"), false;
    for (size_t k = 0; k < ops.size(); ++k) {
      const Op& op = graph_.op(ops[k]);
      if (op.results.empty() || op.parent != graph_.root()) return bad("runs an op of a region"), false;
      if (op.kind == OpKind::Grad) return bad("runs a 'grad'"), false;
      if (k > 0 && !(ops[k - 1] < ops[k])) return bad("runs ops out of order"), false;
      const PassKind kind = pass_kind(op), of_pass = pass_->kind();
      const bool sums = of_pass == PassKind::Scatter && kind == PassKind::Scatter;
      const bool last = k + 1 == ops.size() && kind == of_pass;
      if (kind != PassKind::Map && !sums && !last)
        return bad("runs a '" + std::string(ir::op_name(op.kind)) + "' where passes of its kind do not"), false;
    }
    const PassKind kind = pass_->kind();
    if ((kind == PassKind::Reduce || kind == PassKind::Raster) && pass_kind(graph_.op(ops.back())) != kind)
      return bad("lacks the op that its kind is of"), false;
    return true;
  }

  // Which of them can be read together is told from the graph.
  void check_block(const MapPass& map, const Block& block) {
    constexpr int kMost = 16, kMostInvocations = 1024, kMostTrips = 1024;
    for (const int n : block.each)
      if (n < 1 || n > kMost) return bad("computes no number of elements side by side");
    if (block.elements() == 1) return bad("computes one element side by side");
    if (block.elements() > kMostBlock) return bad("computes too many elements side by side");
    if (!map.partial.empty() || map.code.heavy) return bad("computes elements side by side and is no plain map");
    if (!block.together) return;
    const GroupReads& together = *block.together;
    for (const int n : together.group)
      if (n < 1 || n > kMostInvocations) return bad("reads together in a workgroup of no size");
    if (together.invocations() > kMostInvocations || together.trips < 1 || together.trips > kMostTrips)
      return bad("reads together for too many");
    if (!together.loop.valid() || std::ranges::find(pass_->ops, root_op(together.loop)) == pass_->ops.end())
      return bad("reads together in a loop that it does not run");
    ChangingAxes changing(graph_);
    for (OpId id = together.loop; id.valid(); id = graph_.region(graph_.op(id).parent).parent)
      if (!shares_trips(graph_.op(id), 7, changing)) return bad("reads together in what is no loop of all elements");
    const std::vector<OpId> inside = gathers_in(graph_, graph_.op(together.loop));
    for (const OpId id : together.gathers)
      if (std::ranges::find(inside, id) == inside.end()) return bad("reads together what its loop does not read");
    if (!shared_bytes(graph_, block)) bad("reads together what is no part of an image");
  }

  // The op of the root region that an op stands in.
  OpId root_op(OpId id) const {
    while (graph_.op(id).parent != graph_.root()) id = graph_.region(graph_.op(id).parent).parent;
    return id;
  }

  void check_scatter(const ScatterPass& scatter) {
    for (const ScatterSum& sum : scatter.sums) {
      if (!holds(pass_->writes, sum.value)) bad("sums what it does not store");
      for (const ValueId term : sum.terms)
        if (!is_root(term) || pass_kind(graph_.op(graph_.value(term).op)) != PassKind::Scatter ||
            std::ranges::find(pass_->ops, graph_.value(term).op) == pass_->ops.end())
          bad("sums a term that it does not scatter");
    }
    for (const std::vector<ValueId>& clause : scatter.clauses())
      if (clause.empty() || !std::ranges::all_of(clause, [&](ValueId v) { return is_root(v); }))
        bad("is active by a value of a region");
    for (const ValueId v : scatter.nonzero())
      if (!holds(pass_->reads, v)) bad("runs if what it does not read is not zero");
    check_cut(scatter.cut());
    if (const auto* rows = std::get_if<RowsScatter>(&scatter.how)) check_rows(*rows);
  }

  void check_rows(const RowsScatter& rows) {
    if (rows.names() == 0) return bad("has rows without a table");
    std::visit(Overloaded{[&](const RowsOfLeaf& table) { check_table(table); },
                          [&](const SortedRows& table) { check_table(table); }},
               rows.table);
  }

  void check_table(const RowsOfLeaf& table) {
    const ir::Leaf& leaf = graph_.leaves[table.leaf];
    for (const int column : table.columns)
      if (!leaf.type.is_integer() || column < 0 || column >= leaf.type.components())
        bad("has rows by a column that leaf '" + leaf.name + "' lacks");
  }

  void check_table(const SortedRows& table) {
    for (const ScatterLeaf& place : table.places) {
      if (!graph_.value(place.index).type.is_integer()) bad("sorts by what is no index");
      for (const ScatterLeaf::Branch& branch : place.path)
        if (graph_.op(branch.op).kind != OpKind::If || branch.region > 1) bad("sorts in what is no branch");
    }
  }

  // A map pass before this one that does a part of its work.
  void check_helper(PassId helper, size_t place, const char* what) {
    if (helper.index >= place) return bad(std::string("is ") + what + " no earlier pass");
    const Pass& pass = step_->pass(helper);
    if (!pass.is<MapPass>())
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
