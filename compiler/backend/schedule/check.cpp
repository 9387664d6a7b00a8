// SPDX-License-Identifier: Apache-2.0
// The checker of schedules, which knows nothing of how packing decided.
#include <algorithm>
#include <bit>
#include <set>

#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/schedule/joined_sums.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/rest.h"
#include "compiler/backend/schedule/schedule.h"
#include "compiler/backend/schedule/structure.h"
#include "compiler/backend/schedule/trips.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

void captured_operands(const Graph& graph, const Op& op, std::set<ValueId>& out) {
  for (ValueId v : op.operands)
    if (graph.value(v).region == graph.root()) out.insert(v);
  for (ir::RegionId region : op.regions) {
    for (OpId id : graph.region(region).ops) captured_operands(graph, graph.op(id), out);
    for (ValueId v : graph.region(region).yields)
      if (graph.value(v).region == graph.root()) out.insert(v);
  }
}

// Runs the passes of a step in thought, in order.
class StepChecker {
 public:
  StepChecker(const Graph& graph, const Schedule& schedule, const StepSchedule& step, const target::Profile& profile,
              std::vector<Violation>& violations)
      : graph_(graph), schedule_(schedule), step_(step), profile_(profile), violations_(violations) {}

  void process() {
    for (place_ = 0; place_ < step_.passes.size(); ++place_) check_pass();
    for (const auto& [name, v] : step_.outputs)
      if (!is_kept(v)) unsound_step("output '" + name + "' is never stored");
    for (const auto& [leaf, v] : step_.updates)
      if (!is_kept(v)) unsound_step("the update of '" + graph_.leaves[leaf].name + "' is never stored");
  }

 private:
  const Pass& pass() const { return step_.passes[place_]; }
  const Resource* resource_of(ValueId v) const {
    const auto it = step_.stored.find(v);
    return it == step_.stored.end() ? nullptr : &schedule_.resources[it->second.index];
  }
  bool is_ready(ValueId v) const {
    if (!is_memory(graph_.op(graph_.value(v).op))) return ready_.count(v) != 0;
    const auto it = step_.stored.find(v);
    return it == step_.stored.end() || overwritten_.count(it->second.index) == 0;
  }
  bool is_tile(ValueId v) const {
    const Resource* resource = resource_of(v);
    return resource && resource->is(Resource::Storage::Tile);
  }
  bool is_kept(ValueId v) const { return resource_of(v) && is_ready(v) && !is_tile(v); }

  void report(Violation::Kind kind, const std::string& what) {
    violations_.push_back({kind, "step " + step_.name + ", pass " + pass().name + ": " + what, pass().ops});
  }
  void unsound(const std::string& what) { report(Violation::Kind::Unsound, what); }
  void unsound_step(const std::string& what) {
    violations_.push_back({Violation::Kind::Unsound, "step " + step_.name + ": " + what});
  }

  void check_pass() {
    inputs_ = stage_inputs(step_, place_);
    here_.clear();
    elsewhere_.clear();
    check_reads();
    check_setup();
    check_ops();
    check_joined_loops();
    check_teams();
    check_groups();
    check_guesses();
    check_emptied();
    check_rows();
    check_rest();
    check_stage();
    check_writes();
    if (pass().kind() != PassKind::Raster) check_limits();  // its draws and dispatches bind one result at a time
    if (inputs_.size() > profile_.max_per_stage_descriptor_input_attachments)
      over(inputs_.size(), "input attachments", profile_.max_per_stage_descriptor_input_attachments);
  }

  void check_reads() {
    for (ValueId v : pass().reads) {
      const Resource* resource = resource_of(v);
      if (!resource)
        unsound("reads a value that is not stored");
      else if (!is_ready(v))
        unsound("reads '" + resource->name + "' before it is written");
      else if (is_tile(v) && !contains(inputs_, v))
        unsound("reads '" + resource->name + "', which its stage has not written");
      here_.insert(v);
    }
    for (ValueId v : true_where_listed(graph_, pass())) here_.insert(v);
  }

  // What sets the pass up runs no earlier than here.
  void check_setup() {
    const FaceSetup* by = pass().setup();
    if (by == nullptr) return;
    const Pass& setup = step_.pass(by->pass);
    for (size_t j = by->pass.index + 1; j < place_; ++j)
      for (ValueId v : step_.passes[j].reads)
        if (contains(setup.writes, v)) unsound("sets up late what '" + step_.passes[j].name + "' reads");
    if (setup.steady != pass().steady) unsound("sets up what runs at other times");
    const Trips trips = trips_of(graph_, setup.ops);
    if (may_pass_limit(trips, profile_)) unsound("sets up in loops that may stop and go on later");
    for (OpId id : setup.ops)
      for (ValueId v : graph_.op(id).results) here_.insert(v);
  }

  void check_ops() {
    for (OpId id : pass().ops) {
      const Op& op = graph_.op(id);
      for (ValueId v : uses_of(graph_, op).elsewhere) elsewhere_.insert(v);
      std::set<ValueId> needs;
      captured_operands(graph_, op, needs);
      for (ValueId v : needs)
        if (here_.count(v) == 0 && !(op.kind == OpKind::Raster && is_inline(graph_.op(graph_.value(v).op))))
          unsound("op '" + std::string(ir::op_name(op.kind)) + "' lacks an operand");
      for (ValueId v : op.results) here_.insert(v);
    }
  }

  // Loops that another shader runs, or that run for many items.
  void check_joined_loops() {
    const auto* scatter = pass().as<ScatterPass>();
    if (scatter == nullptr) return;
    if (scatter->lowering() == ScatterLowering::Rows && !may_walk_rows(graph_, pass(), scatter->rows(), profile_))
      unsound("walks rows in loops that may take more trips than the device allows");
    Trips trips = trips_of(graph_, pass().ops);
    if (trips.loops == 0 || scatter->joined_run() == nullptr) return;
    const PassId lister = scatter->joined_run()->lister;
    trips += trips_of(graph_, step_.pass(lister).ops);
    for (const Pass* other : listed_for(step_, lister))
      if (other != &pass() && other->get<ScatterPass>().joined_run() != nullptr) trips += trips_of(graph_, other->ops);
    if (needs_cut(trips, profile_)) unsound("joins loops that may stop and go on later");
  }

  void check_teams() {
    const auto* reduce = pass().as<ReducePass>();
    if (reduce == nullptr || !reduce->in_teams) return;
    if (!graph_.value(graph_.op(pass().ops.back()).results[0]).extent.is_unit())
      unsound("shares inputs of many results");
    if (profile_.max_compute_work_group_invocations < static_cast<uint32_t>(kReducingGroup))
      report(Violation::Kind::Limit, "has workgroups of " + std::to_string(kReducingGroup) + " invocations");
  }

  void check_groups() {
    const auto* map = pass().as<MapPass>();
    if (map == nullptr) return;
    if (const auto& heavy = map->code.heavy; heavy && heavy->shares_loops) {
      if (!profile_.subgroup_shuffle) report(Violation::Kind::Limit, "shares loops by lanes, which the profile cannot");
      if (heavy->apart == 0 || heavy->cut) unsound("shares loops of elements that have an invocation each");
    }
    if (map->code.joining_group == kJoiningGroup) return;
    if (map->code.joining_group <= 0 || !std::has_single_bit(static_cast<uint32_t>(map->code.joining_group)))
      return unsound("has workgroups of no power of two");
    if (!groups_have_room(graph_, profile_, joined_in_groups(step_, pass_id(place_)), map->code.joining_group))
      report(Violation::Kind::Limit,
             "joins in workgroups of " + std::to_string(map->code.joining_group) + " invocations");
  }

  void check_guesses() {
    const auto* scatter = pass().as<ScatterPass>();
    if (scatter == nullptr) return;
    if (scatter->joins_pairs()) check_pairs(*scatter);
    if (scatter->joins_runs() != 0) check_runs(*scatter);
    if (scatter->asks() && !scatter->guesses()) unsound("asks for guesses that it does not make");
    if (!scatter->guesses()) {
      if (scatter->shares_loops()) unsound("shares loops in a run that lists what adds");
      return;
    }
    if (schedule_.code.native || scatter->keeps_terms() || scatter->relists() ||
        !may_guess(graph_, schedule_.resources, step_, pass()))
      unsound("guesses exponents of sums that need two runs");
    if (scatter->shares_loops() && (scatter->active_list() == nullptr || scatter->cut()))
      unsound("shares loops of elements that are not listed");
    if (scatter->joins_groups() && scatter->joined_run() == nullptr) unsound("joins what workgroups of no map add");
    for (const ScatterSum& sum : scatter->sums)
      if (scatter->joins_groups() &&
          std::ranges::any_of(sum.terms, [&](ValueId term) { return contributions(graph_, term) != 1; }))
        unsound("joins in workgroups what an element adds several times");
  }

  void check_pairs(const ScatterPass& scatter) {
    if (!profile_.subgroup_shuffle) report(Violation::Kind::Limit, "joins pairs of lanes, which the profile cannot");
    if (scatter.joined_run() == nullptr || scatter.guesses() || scatter.keeps_terms() || scatter.joins_parts() ||
        scatter.cut())
      unsound("joins pairs of lanes that no run of its own has");
    for (const ScatterSum& sum : scatter.sums)
      if (std::ranges::any_of(sum.terms, [&](ValueId term) { return contributions(graph_, term) != 1; }))
        unsound("joins in pairs what an element adds several times");
  }

  void check_runs(const ScatterPass& scatter) {
    if (!profile_.subgroup_shuffle) report(Violation::Kind::Limit, "joins runs of lanes, which the profile cannot");
    const auto lanes = static_cast<uint32_t>(scatter.joins_runs());
    if (scatter.joins_runs() < 2 || lanes > 32 || !std::has_single_bit(lanes))
      unsound("joins runs of lanes that are no power of two up to 32");
    if (scatter.joins_parts()) unsound("joins lanes in two ways");
  }

  void check_emptied() {
    const auto* scatter = pass().as<ScatterPass>();
    for (ValueId v : pass().writes) {
      const Resource* r = resource_of(v);
      if (r != nullptr && r->is(Resource::Storage::ListedSums)) check_cleared_where_listed(v);
      if (!r || !r->is_emptied()) continue;
      const bool floats = r->is(Resource::Storage::Emptied);
      const auto is_sum = [&](const ScatterSum& sum) {
        return sum.value == v && (floats ? may_empty_floats(graph_, schedule_.resources, step_, pass(), sum)
                                         : may_empty(graph_, step_, pass(), sum));
      };
      if (scatter == nullptr || std::ranges::none_of(scatter->sums, is_sum))
        unsound("adds to sums that their reader may not leave empty");
    }
  }

  void check_cleared_where_listed(ValueId v) {
    const auto* scatter = pass().as<ScatterPass>();
    const auto is_sum = [&](const ScatterSum& sum) {
      return sum.value == v && may_clear_where_listed(graph_, step_, pass(), sum).has_value();
    };
    if (scatter == nullptr || std::ranges::none_of(scatter->sums, is_sum))
      unsound("adds to sums that no pass may clear where it lists elements");
  }

  void check_rows() {
    const auto* scatter = pass().as<ScatterPass>();
    const auto* rows = scatter == nullptr ? nullptr : std::get_if<RowsScatter>(&scatter->how);
    if (rows == nullptr || rows->sorted() == nullptr) return;
    if (steady_.empty()) steady_ = steady_ops(graph_, graph_.steps[*graph_.step_index(step_.name)]);
    for (const ScatterLeaf& place : rows->sorted()->places) {
      std::vector<ValueId> sorted_by{place.index};
      for (const ScatterLeaf::Branch& branch : place.path)
        if (branch.in_table) sorted_by.push_back(graph_.op(branch.op).operands[0]);
      for (ValueId v : root_values_at(graph_, place, sorted_by))
        if (steady_[graph_.value(v).op.index]) unsound("sorts by what its step changes");
    }
  }

  void check_rest() {
    const auto* map = pass().as<MapPass>();
    if (map != nullptr && map->rest && !may_rest(graph_, schedule_, step_, pass_id(place_), *map->rest))
      unsound("leaves elements out that may not stay as they are");
  }

  void check_stage() {
    const bool fragment = pass().is<FragmentPass>();
    if (place_ > 0 && step_.passes[place_ - 1].stage == pass().stage) {
      const Pass& before = step_.passes[place_ - 1];
      if (fragment != before.is<FragmentPass>() ||
          (fragment ? before.domain != pass().domain : pass().is_drawn() || before.is_drawn()))
        unsound("is of another kind or extent than the rest of its stage");
    }
    for (ValueId v : inputs_)
      if (!fragment)
        unsound("needs another pass of its stage");
      else if (elsewhere_.count(v) != 0 || graph_.value(v).extent != pass().domain)
        unsound("reads a value of its stage at other places");
  }

  void check_writes() {
    for (ValueId v : pass().writes) {
      const auto* raster = pass().as<RasterPass>();
      if (here_.count(v) == 0 && (raster == nullptr || raster->rows != v))
        unsound("stores a value that it does not compute");
      const Resource* to = resource_of(v);
      if (!to) {
        unsound("stores a value without a resource");
        continue;
      }
      if (to->is(Resource::Storage::Leaf)) check_overwritten(*to, step_.stored.at(v));
      if (!ready_.insert(v).second && pass().kind() != PassKind::Map) unsound("stores a value twice");
    }
  }

  void check_overwritten(const Resource& leaf, ResourceId id) {
    overwritten_.insert(id.index);
    for (ValueId old : elsewhere_)
      if (step_.stored.count(old) != 0 && step_.stored.at(old) == id)
        unsound("overwrites leaf '" + leaf.name + "' while it reads it at other places");
    if (pass().kind() != PassKind::Map || pass().domain != leaf.extent)
      unsound("overwrites leaf '" + leaf.name + "' from other places");
  }

  bool over(size_t count, const std::string& what, size_t most, const std::string& where = "") {
    if (count <= most) return false;
    report(Violation::Kind::Limit,
           std::to_string(count) + " " + what + ", device allows " + std::to_string(most) + where);
    return true;
  }

  void check_limits() {
    // Where lanes go in turn, what is only read is a texel buffer.
    std::set<uint32_t> buffers, images, texels;
    for (ValueId v : pass().reads)
      if (const auto it = step_.stored.find(v); it != step_.stored.end()) {
        const bool buffer = schedule_.resources[it->second.index].is_buffer();
        (!buffer ? images : profile_.lanes_in_turn ? texels : buffers).insert(it->second.index);
      }
    const size_t sampled = images.size() + texels.size();
    std::set<uint32_t> written;
    size_t colors = 0;
    for (ValueId v : pass().writes)
      if (const auto it = step_.stored.find(v); it != step_.stored.end()) {
        if (schedule_.resources[it->second.index].is_buffer())
          written.insert(it->second.index);
        else
          ++colors;
      }
    buffers.insert(written.begin(), written.end());
    if (over(buffers.size(), "storage buffers", profile_.max_per_stage_descriptor_storage_buffers))
      violations_.back().of_buffers = true;
    over(sampled, "sampled images", profile_.max_per_stage_descriptor_sampled_images);
    over(colors, "colour attachments", profile_.max_color_attachments);
    over(buffers.size() + sampled + colors, "resources", profile_.max_per_stage_resources);
    check_block();
    if (pass().is_drawn() && needs_cut(trips_of(graph_, pass().ops), profile_))
      report(Violation::Kind::Limit, "loops of a fragment shader that may take more trips than the " +
                                         std::to_string(profile_.loop_trips) + " that the device allows");
    if (pass().is_drawn() && over(written.size() + colors, "storage buffers and colour attachments to write",
                                  profile_.max_fragment_combined_output_resources, " in a fragment shader"))
      violations_.back().of_buffers = true;
  }

  void check_block() {
    const auto* map = pass().as<MapPass>();
    if (map == nullptr || !map->block || !map->block->together) return;
    over(static_cast<size_t>(map->block->together->invocations()), "invocations in a workgroup",
         profile_.max_compute_work_group_invocations);
    over(static_cast<size_t>(*shared_bytes(graph_, *map->block)), "bytes that a workgroup shares",
         profile_.max_compute_shared_memory_size);
    if (needs_cut(trips_of(graph_, pass().ops), profile_))
      unsound("reads together in loops that may stop and go on later");
    if (!listed_for(step_, pass_id(place_)).empty()) unsound("computes elements side by side and lists them");
  }

  const Graph& graph_;
  const Schedule& schedule_;
  const StepSchedule& step_;
  const target::Profile& profile_;
  std::vector<Violation>& violations_;
  size_t place_ = 0;                    // of the pass
  std::set<ValueId> ready_;             // stored by now
  std::set<uint32_t> overwritten_;      // leaves that hold their new value already
  std::vector<ValueId> inputs_;         // read as input attachments by the pass
  std::set<ValueId> here_, elsewhere_;  // at hand in the pass; read by it at other places
  std::vector<bool> steady_;            // by op, where a pass needs it; the same for all passes
};

}  // namespace

std::vector<Violation> check_schedule(const Graph& graph, const Schedule& schedule, const target::Profile& profile) {
  std::vector<Violation> violations = check_structure(graph, schedule);
  if (!violations.empty()) return violations;
  for (const StepSchedule& step : schedule.steps) StepChecker(graph, schedule, step, profile, violations).process();
  return violations;
}

}  // namespace dr::backend
