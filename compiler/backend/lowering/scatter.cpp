// SPDX-License-Identifier: Apache-2.0
// Joining scatters into sums, and choosing how each pass of them runs.
#include "compiler/backend/lowering/scatter.h"

#include <algorithm>
#include <set>

#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/lowering/heavy_branches.h"
#include "compiler/backend/lowering/scatter_active.h"
#include "compiler/backend/lowering/scatter_costs.h"
#include "compiler/backend/lowering/unite_passes.h"
#include "compiler/backend/pack/stages.h"
#include "compiler/backend/schedule/joined_sums.h"
#include "compiler/backend/schedule/limits.h"
#include "compiler/backend/schedule/trips.h"

namespace dr::backend {

using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::OpKind;
using ir::ValueId;

namespace {

bool is_scatter_result(const Graph& graph, ValueId v) {
  const ir::ValueInfo& info = graph.value(v);
  if (!info.op.valid()) return false;
  const Op& op = graph.op(info.op);
  if (op.kind == OpKind::ScatterAdd) return true;
  return !op.regions.empty() && info.result_index < op.attrs.yields.size() &&
         op.attrs.yields[info.result_index] == ir::Yield::Scatter;
}

// The input and its column that an index is, if it is one.
struct Column {
  uint32_t leaf = 0;
  int column = 0;
};
std::optional<Column> column_of(const Graph& graph, ValueId index) {
  const Op* op = &graph.op(graph.value(index).op);
  Column out;
  while (op->kind == OpKind::Broadcast) op = &graph.op(graph.value(op->operands[0]).op);
  if (op->kind == OpKind::Extract) {
    out.column = static_cast<int>(op->attrs.ints[0]);
    op = &graph.op(graph.value(op->operands[0]).op);
    while (op->kind == OpKind::Broadcast) op = &graph.op(graph.value(op->operands[0]).op);
  }
  if (op->kind != OpKind::Leaf) return std::nullopt;
  out.leaf = *graph.leaf_index(op->attrs.text);
  const ir::Leaf& leaf = graph.leaves[out.leaf];
  if (leaf.kind != ir::Leaf::Kind::Input || leaf.type.scalar != ir::Scalar::Int) return std::nullopt;
  if (!leaf.extent.h.is_one() || !leaf.extent.l.is_one()) return std::nullopt;
  return out;
}

class StepLegalizer {
 public:
  StepLegalizer(const Graph& graph, const target::Profile& profile, const ScatterOptions& options, Schedule& schedule,
                StepSchedule& step, std::set<uint32_t>& unused)
      : graph_(graph),
        profile_(profile),
        lower_(options.lower),
        may_list_(options.list_active),
        schedule_(schedule),
        step_(step),
        unused_(unused) {
    steady_ = steady_ops(graph, graph.steps[*graph.step_index(step.name)]);
  }

  // Whether passes were joined.
  bool process() {
    bool joined = false;
    bool any = false;
    for (Pass& pass : step_.passes)
      if (auto* scatter = pass.as<ScatterPass>())
        for (const ValueId v : pass.writes)
          if (is_scatter_result(graph_, v)) {
            scatter->sums.push_back({v, {v}});
            any = true;
          }
    for (Pass& pass : step_.passes)
      if (auto* scatter = pass.as<ScatterPass>(); scatter != nullptr && scatter->sums.empty())
        join_maxima(pass, *scatter);
    if (!any) return false;
    index_passes();
    for (const ScatterSum& sum : find_sums()) joined = join_most(sum) || joined;
    std::erase_if(step_.passes, [](const Pass& pass) { return pass.writes.empty(); });
    for (Pass& pass : step_.passes)
      if (auto* scatter = pass.as<ScatterPass>(); scatter != nullptr && !scatter->sums.empty()) {
        choose(pass, *scatter);
        choose_joining(pass, *scatter);
        choose_active(pass, *scatter);
        // Listed elements are few, and their shaders take longer to compile than joining saves.
        if (ExactScatter* exact = scatter->exact(); exact != nullptr && scatter->clauses().empty())
          exact->joins_runs = lanes_in_runs(profile_);
      }
    return (may_list_ && unite_scatters()) || joined;
  }

 private:
  const Op& def(ValueId v) const { return graph_.op(graph_.value(v).op); }
  bool steady(ValueId v) const { return steady_[graph_.value(v).op.index]; }
  bool steady(const ScatterLeaf& leaf, ValueId v) const {
    return std::ranges::any_of(root_values_at(graph_, leaf, std::span(&v, 1)), [&](ValueId x) { return steady(x); });
  }
  const Resource& resource(ValueId v) const { return schedule_.resources[step_.stored.at(v).index]; }

  void index_passes() {
    writer_.clear();
    holders_.clear();
    users_.clear();
    for (size_t k = 0; k < step_.passes.size(); ++k) {
      for (const ValueId v : step_.passes[k].writes) writer_[v] = k;
      for (const OpId id : step_.passes[k].ops) {
        holders_[id].insert(k);
        const Uses uses = uses_of(graph_, graph_.op(id));
        for (const auto* list : {&uses.at_element, &uses.elsewhere})
          for (const ValueId v : *list) users_[v].insert(id);
      }
    }
    for (const auto& [name, v] : step_.outputs) kept_.insert(v);
    for (const auto& [leaf, v] : step_.updates) kept_.insert(v);
  }

  // The scatter results that `v` adds up, if nothing else wants them.
  bool collect(ValueId v, std::vector<ValueId>& terms) const {
    if (is_scatter_result(graph_, v)) {
      terms.push_back(v);
      return writer_.count(v) != 0;
    }
    const Op& op = def(v);
    if (op.kind != OpKind::Add) return false;
    return std::all_of(op.operands.begin(), op.operands.end(), [&](ValueId part) {
      const auto users = users_.find(part);
      return graph_.value(part).op.valid() && users != users_.end() && users->second.size() == 1 &&
             kept_.count(part) == 0 && graph_.value(part).type == graph_.value(v).type &&
             graph_.value(part).extent == graph_.value(v).extent && collect(part, terms);
    });
  }

  // The largest sums of scatter results, in the graph's order.
  std::vector<ScatterSum> find_sums() const {
    std::vector<ScatterSum> sums;
    std::set<ValueId> taken;
    for (auto it = holders_.rbegin(); it != holders_.rend(); ++it) {
      const Op& op = graph_.op(it->first);
      if (op.kind != OpKind::Add || taken.count(op.results[0]) != 0) continue;
      ScatterSum sum{op.results[0], {}};
      if (!collect(sum.value, sum.terms)) continue;
      if (std::set<ValueId>(sum.terms.begin(), sum.terms.end()).size() != sum.terms.size()) continue;  // x + x
      const auto same_domain = [&](ValueId term) {
        return step_.passes[writer_.at(term)].domain == step_.passes[writer_.at(sum.terms[0])].domain;
      };
      if (!std::ranges::all_of(sum.terms, same_domain)) continue;
      for (const OpId id : additions(sum)) taken.insert(graph_.op(id).results[0]);
      sums.push_back(std::move(sum));
    }
    std::sort(sums.begin(), sums.end(), [](const auto& a, const auto& b) { return a.value < b.value; });
    return sums;
  }

  // The additions of a sum.
  std::vector<OpId> additions(const ScatterSum& sum) const {
    std::vector<OpId> out;
    std::vector<ValueId> open{sum.value};
    while (!open.empty()) {
      const ValueId v = open.back();
      open.pop_back();
      if (is_scatter_result(graph_, v)) continue;
      out.push_back(graph_.value(v).op);
      for (const ValueId part : def(v).operands) open.push_back(part);
    }
    return out;
  }

  // Whether some pass of `group` waits for another one.
  bool wait_for_each_other(const std::set<size_t>& group) const {
    std::vector<size_t> open(group.begin(), group.end());
    std::set<size_t> seen;
    while (!open.empty()) {
      const Pass& pass = step_.passes[open.back()];
      open.pop_back();
      for (const ValueId v : pass.reads) {
        const auto from = writer_.find(v);
        if (from == writer_.end() || !seen.insert(from->second).second) continue;
        if (group.count(from->second) != 0) return true;
        open.push_back(from->second);
      }
    }
    return false;
  }

  // What a shader binds that reads and writes these, and buffers besides.
  Bindings bindings(std::span<const ValueId> reads, size_t writes, bool hardware, uint32_t more_buffers) const {
    Bindings out = bindings_of(schedule_.resources, resources_of(step_, reads), writes, hardware);
    out.more += more_buffers;
    return out;
  }

  // All of a sum, or where its terms are scattered by passes that cannot be one, its parts.
  bool join_most(const ScatterSum& sum) {
    if (join(sum)) return true;
    bool joined = false;
    for (const ValueId part : def(sum.value).operands)
      if (ScatterSum of{part, {}}; def(part).kind == OpKind::Add && collect(part, of.terms))
        joined = join_most(of) || joined;
    return joined;
  }

  // Makes one pass of those that scatter the terms, which then stores their sum only.
  bool join(const ScatterSum& sum) {
    std::set<size_t> group;
    for (const ValueId v : sum.terms) group.insert(writer_.at(v));
    for (const size_t k : group)
      if (step_.passes[k].domain != step_.passes[*group.begin()].domain) return false;
    if (wait_for_each_other(group)) return false;
    Pass pass = united(graph_, step_, group);
    std::erase_if(pass.writes, [&](ValueId v) { return contains(sum.terms, v); });
    const auto stored = step_.stored.find(sum.value);
    const bool was_stored = stored != step_.stored.end();
    // Of one pass it only takes buffers away, also where others are left for another sum.
    if (group.size() > 1 && !fits(profile_, bindings(pass.reads, pass.writes.size() + 1, false, 0))) return false;
    // What was an image becomes a buffer of the shaders that read it: where one joins sums, all packings have to.
    if (was_stored && resource(sum.value).is(Resource::Storage::Image)) {
      for (const Pass& reader : step_.passes) {
        if (!std::binary_search(reader.reads.begin(), reader.reads.end(), sum.value)) continue;
        if (!fits(profile_, bindings(reader.reads, reader.writes.size(), reader.is_drawn(), 1))) return false;
      }
      schedule_.resources[stored->second.index].storage = Resource::Storage::Buffer;
    }

    for (const ValueId v : sum.terms) {
      writer_.erase(v);
      if (was_stored || v != sum.terms.front()) unused_.insert(step_.stored.at(v).index);
    }
    if (!was_stored) step_.stored[sum.value] = step_.stored.at(sum.terms.front());
    const std::vector<OpId> adds = additions(sum);
    std::set<size_t> readers;
    for (const OpId id : adds) readers.insert(holders_[id].begin(), holders_[id].end());
    for (const size_t k : readers) replace_by_read(step_.passes[k], sum, adds);
    for (const ValueId v : sum.terms) step_.stored.erase(v);
    for (const OpId id : adds) {
      const ValueId v = graph_.op(id).results[0];
      const auto part = step_.stored.find(v);
      if (v == sum.value || part == step_.stored.end()) continue;
      unused_.insert(part->second.index);
      step_.stored.erase(part);
    }

    std::set<OpId> ops(pass.ops.begin(), pass.ops.end());
    ops.insert(adds.begin(), adds.end());
    pass.ops = in_order(graph_, ops);
    pass.writes.push_back(sum.value);
    std::ranges::sort(pass.writes);
    std::vector<ScatterSum>& sums = pass.get<ScatterPass>().sums;
    std::erase_if(sums, [&](const ScatterSum& other) { return contains(sum.terms, other.value); });
    sums.push_back(sum);
    std::ranges::sort(sums, {}, &ScatterSum::value);
    pass.name.clear();
    for (const ValueId v : pass.writes) pass.name += (pass.name.empty() ? "" : "_") + resource(v).name;
    replace(group, std::move(pass));
    return true;
  }

  // Puts a pass in the place of those that it is made of.
  void replace(const std::set<size_t>& group, Pass pass) {
    for (const size_t k : group)
      for (const OpId id : step_.passes[k].ops) holders_[id].erase(k);
    for (const OpId id : pass.ops) holders_[id].insert(*group.begin());
    for (const ValueId v : pass.writes) writer_[v] = *group.begin();
    put_in_place_of(group, std::move(pass), step_);
  }

  // A pass that added the terms up, or some of them, reads their sum.
  void replace_by_read(Pass& pass, const ScatterSum& sum, const std::vector<OpId>& adds) {
    const std::set<OpId> gone(adds.begin(), adds.end());
    std::erase_if(pass.writes, [&](ValueId v) { return gone.count(graph_.value(v).op) != 0; });
    std::erase_if(pass.ops, [&](OpId id) { return gone.count(id) != 0; });
    std::set<ValueId> used;
    for (const OpId id : pass.ops) {
      const Uses uses = uses_of(graph_, graph_.op(id));
      used.insert(uses.at_element.begin(), uses.at_element.end());
      used.insert(uses.elsewhere.begin(), uses.elsewhere.end());
    }
    std::set<ValueId> reads(pass.reads.begin(), pass.reads.end());
    for (const ValueId v : sum.terms) reads.erase(v);
    for (const OpId id : adds) reads.erase(graph_.op(id).results[0]);
    if (used.count(sum.value) != 0) reads.insert(sum.value);
    pass.reads.assign(reads.begin(), reads.end());
  }

  // Makes one pass of several that add at all elements what one map computes: this map adds it then, by workgroups,
  // where each of them would load it again. A map with a second dispatch for some elements has no squares of them.
  bool unite_scatters() {
    if (!profile_.is_gpu() || profile_.lanes_in_turn) return false;
    index_passes();
    std::map<PassId, std::set<size_t>> groups;
    for (size_t k = 0; k < step_.passes.size(); ++k)
      if (const auto lister = may_unite(k)) groups[*lister].insert(k);
    bool joined = false;
    for (const auto& [lister, group] : groups) {
      if (group.size() < 2 || wait_for_each_other(group)) continue;
      Pass pass = united(graph_, step_, group);
      auto& scatter = pass.get<ScatterPass>();
      if (!may_add_in_map(step_.pass(lister), pass.reads, scatter.sums)) continue;
      choose_joining(pass, scatter);
      std::get<OwnFirstRun>(scatter.exact()->first_run).active = ActiveList{active_elements(graph_, pass), OwnList{}};
      replace(group, std::move(pass));
      joined = true;
    }
    std::erase_if(step_.passes, [](const Pass& pass) { return pass.writes.empty(); });
    return joined;
  }

  // Whether one shader of the map may add to all these sums, by guesses and workgroups.
  bool may_add_in_map(const Pass& map, std::vector<ValueId> reads, const std::vector<ScatterSum>& sums) const {
    std::vector<const ScatterSum*> all;
    for (const ScatterSum& sum : sums) all.push_back(&sum);
    reads.insert(reads.end(), map.reads.begin(), map.reads.end());
    const size_t writes = map.writes.size() + 2 * sums.size();  // with their guesses
    return are_cached(graph_, sums) && groups_have_room(graph_, profile_, all) &&
           fits(profile_, bindings(reads, writes, false, lists_bound(1)));
  }

  // The map that a scatter may join with others.
  std::optional<PassId> may_unite(size_t k) const {
    const Pass& pass = step_.passes[k];
    const auto* scatter = pass.as<ScatterPass>();
    if (scatter == nullptr || scatter->exact() == nullptr || scatter->sums.size() != pass.writes.size() ||
        !adds_everywhere(graph_, pass) || scatter->active_list() != nullptr)
      return std::nullopt;
    if (!std::ranges::all_of(scatter->sums, [&](const ScatterSum& sum) { return needs_exponent(sum); }))
      return std::nullopt;
    const Clauses clauses = active_elements(graph_, pass);
    if (clauses.empty()) return std::nullopt;
    const auto lister = find_lister(graph_, step_, k, clauses);
    if (!lister || !pass.steady || !step_.pass(*lister).steady) return std::nullopt;
    const Trips trips = trips_of(graph_, step_.pass(*lister).ops);
    if (needs_cut(trips, profile_) || !heavy_branches(graph_, step_.pass(*lister), trips, profile_).empty())
      return std::nullopt;
    return lister;
  }

  // Listing the elements that may add something costs an element few loads; running one costs its own loads, twice. A
  // scatter of a region is worth it, since conditions of the program lie before it. What it finds to add nothing in the
  // first run is left out of the second.
  void choose_active(const Pass& pass, ScatterPass& scatter) const {
    const bool regions = std::any_of(pass.ops.begin(), pass.ops.end(), [&](OpId id) {
      const Op& op = graph_.op(id);
      return !op.regions.empty() &&
             std::any_of(op.results.begin(), op.results.end(), [&](ValueId v) { return is_scatter_result(graph_, v); });
    });
    if (!regions) return;
    constexpr uint32_t kLists = 2;
    if (!fits(profile_, bindings(pass.reads, pass.writes.size(), false, kLists))) return;
    if (pass.writes.size() != scatter.sums.size()) return;
    if (!std::ranges::all_of(scatter.sums, [&](const ScatterSum& sum) { return is_float(sum); })) return;
    if (std::ranges::any_of(scatter.sums, [&](const ScatterSum& sum) { return named_once(graph_, sum.terms); })) return;
    OwnRun run;
    if (Clauses clauses = active_elements(graph_, pass); !clauses.empty())
      run.active = ActiveList{std::move(clauses), OwnList{}};
    std::visit(Overloaded{[&](ExactScatter& exact) {
                            exact.first_run = OwnFirstRun{std::move(run), true, {}};
                          },
                          [](RowsScatter&) {}, [&](auto& by) { by.run = std::move(run); }},
               scatter.how);
  }

  void join_maxima(const Pass& pass, ScatterPass& scatter) const {
    if (ExactScatter* exact = scatter.exact())
      exact->joins_parts = lanes_join(profile_) && many_share(graph_, pass, scatter);
  }

  void choose_joining(const Pass& pass, ScatterPass& scatter) const {
    std::visit(Overloaded{[&](ExactScatter& exact) {
                            exact.joins_lanes = joining_pays(graph_, profile_, scatter);
                            exact.joins_parts = exact.joins_lanes && many_share(graph_, pass, scatter);
                          },
                          [&](BinnedScatter& binned) {
                            binned.joins_parts =
                                joining_pays(graph_, profile_, scatter) && many_share(graph_, pass, scatter);
                          },
                          [](auto&) {}},
               scatter.how);
  }

  bool is_float(const ScatterSum& sum) const { return graph_.value(sum.value).type.is_float(); }
  bool is_binned(const ScatterSum& sum) const { return adds_in_bins(graph_, sum.value, sum.terms); }
  // Whether a sum needs the exponent of its largest contribution.
  bool needs_exponent(const ScatterSum& sum) const {
    return is_float(sum) && !is_binned(sum) && !named_once(graph_, sum.terms);
  }

  void choose(const Pass& pass, ScatterPass& scatter) const {
    const bool bins = std::ranges::any_of(scatter.sums, [&](const ScatterSum& sum) { return is_binned(sum); });
    if (bins && lower_ != ScatterLower::Atomic) {
      // A row's sum has an exponent of its own.
      const std::string why = "it sums few elements, in bins";
      const bool asked = lower_ == ScatterLower::Rows;
      if (std::ranges::none_of(scatter.sums, [&](const ScatterSum& sum) { return needs_exponent(sum); }))
        scatter.how.emplace<BinnedScatter>().no_rows = asked ? why : "";
      else if (asked)
        scatter.exact()->no_rows = why;
      return;
    }
    switch (lower_) {
      case ScatterLower::Exact: return;
      case ScatterLower::Atomic:
        if (std::ranges::any_of(scatter.sums, [&](const ScatterSum& sum) { return is_float(sum); }))
          scatter.how = AtomicScatter{};
        return;
      case ScatterLower::Auto:
      case ScatterLower::Rows: choose_rows(pass, scatter, lower_ == ScatterLower::Rows); return;
    }
  }

  void choose_rows(const Pass& pass, ScatterPass& scatter, bool asked) const {
    const auto refuse = [&](std::string why) {
      if (asked) scatter.exact()->no_rows = std::move(why);
    };
    std::string lacks;
    auto rows = rows_of(pass, scatter);
    if (!rows || !(asked || rows_pay(graph_, profile_, scatter, *rows))) {
      rows = sorted_rows_of(pass, scatter, lacks);
      if (rows && !asked && !(changes(scatter) && rows_pay(graph_, profile_, scatter, *rows))) rows.reset();
    }
    if (!rows) return refuse(lacks);
    // The walk computes what an element adds for each of its items, in loops that cannot be cut.
    if (!may_walk_rows(graph_, pass, *rows, profile_))
      return refuse("its loops may take more trips than the device lets an invocation have");
    scatter.how = std::move(*rows);
  }

  // The table by which a pass can gather what it scatters.
  std::optional<RowsScatter> rows_of(const Pass& pass, const ScatterPass& scatter) const {
    RowsScatter rows;
    auto& table = rows.table.emplace<RowsOfLeaf>();
    std::set<int> columns;
    bool first = true;
    for (const ScatterSum& sum : scatter.sums) {
      const ir::Extent& to = graph_.value(sum.value).extent;
      for (const ValueId term : sum.terms) {
        const Op& op = def(term);
        if (op.kind != OpKind::ScatterAdd) return std::nullopt;
        const auto column = column_of(graph_, op.operands[0]);
        if (!column || graph_.value(op.operands[0]).type.rows != 1) return std::nullopt;
        if (!first && (table.leaf != column->leaf || rows.targets != to.w)) return std::nullopt;
        table.leaf = column->leaf;
        rows.targets = to.w;
        columns.insert(column->column);
        first = false;
      }
      // Layers stay apart, or there is one.
      if (!to.h.is_one() || to.l != pass.domain.l) return std::nullopt;
    }
    if (pass.writes.size() != scatter.sums.size()) return std::nullopt;
    if (!pass.domain.h.is_one() || pass.domain.w != graph_.leaves[table.leaf].extent.w) return std::nullopt;
    // The host fills the table when it binds the leaf: no step may change that.
    for (const ir::Step& step : graph_.steps)
      for (const ir::Update& update : step.updates)
        if (update.leaf == table.leaf) return std::nullopt;
    table.columns.assign(columns.begin(), columns.end());
    constexpr uint32_t kTable = 3;  // starts, items, sums of blocks
    if (!fits(profile_, bindings(pass.reads, pass.writes.size(), false, kTable))) return std::nullopt;
    return rows;
  }

  // The table by which the device can: all that says where contributions go stays as it is in this step. `lacks`: why
  // there is none.
  std::optional<RowsScatter> sorted_rows_of(const Pass& pass, const ScatterPass& scatter, std::string& lacks) const {
    RowsScatter rows;
    auto& places = rows.table.emplace<SortedRows>().places;
    const ir::Extent& to = graph_.value(scatter.sums[0].value).extent;
    rows.targets = to.w * to.h * to.l;
    const auto lack = [&](const char* what) {
      lacks = what;
      return std::nullopt;
    };
    if (pass.writes.size() != scatter.sums.size()) return lack("the pass stores more than sums");
    for (const ScatterSum& sum : scatter.sums) {
      if (graph_.value(sum.value).extent != to) return lack("the pass sums into images of several extents");
      for (const ValueId term : sum.terms) {
        auto leaves = scatter_leaves(graph_, term);
        if (!leaves) return lack("a loop scatters");
        for (ScatterLeaf& leaf : *leaves) {
          if (steady(leaf, leaf.index)) return lack("an index depends on what the step changes");
          for (ScatterLeaf::Branch& branch : leaf.path)
            branch.in_table = !steady(leaf, graph_.op(branch.op).operands[0]);
          const auto same = [&](const ScatterLeaf& place) { return place.same_place(leaf); };
          if (std::ranges::none_of(places, same)) places.push_back(std::move(leaf));
        }
      }
    }
    if (places.empty()) return lack("nothing is added anywhere");
    constexpr uint32_t kTable = 3;  // starts, items, sums of blocks
    if (!fits(profile_, bindings(pass.reads, pass.writes.size(), false, kTable)))
      return lack("the profile allows too few buffers in a shader");
    return rows;
  }

  // Where what is scattered does not change either, a run seldom needs to add it up, and sorting is in vain.
  bool changes(const ScatterPass& scatter) const {
    return std::ranges::any_of(scatter.sums, [&](const ScatterSum& sum) {
      return std::ranges::any_of(sum.terms, [&](ValueId term) { return steady(term); });
    });
  }

  const Graph& graph_;
  const target::Profile& profile_;
  ScatterLower lower_;
  bool may_list_;
  Schedule& schedule_;
  StepSchedule& step_;
  std::set<uint32_t>& unused_;  // resources
  std::vector<bool> steady_;    // ops that depend on what the step changes, by index
  std::map<ValueId, size_t> writer_;
  std::map<OpId, std::set<size_t>> holders_;  // passes that run an op
  std::map<ValueId, std::set<OpId>> users_;
  std::set<ValueId> kept_;
};

void run_all_elements(Pass& pass) {
  auto* scatter = pass.as<ScatterPass>();
  if (scatter == nullptr) return;
  std::visit(Overloaded{[](ExactScatter& exact) { exact.first_run = OwnFirstRun{}; }, [](RowsScatter&) {},
                        [](auto& by) { by.run = OwnRun{}; }},
             scatter->how);
}

}  // namespace

std::optional<std::string> legalize_scatter(const Graph& graph, const target::Profile& profile,
                                            const ScatterOptions& options, Schedule& schedule) {
  if (options.lower == ScatterLower::Atomic && !profile.shader_buffer_float32_atomic_add)
    return "scatter by float atomics needs 'shader_buffer_float32_atomic_add', which profile '" + profile.name +
           "' lacks; choose auto, exact or rows";
  std::set<uint32_t> unused;
  for (StepSchedule& step : schedule.steps)
    if (StepLegalizer(graph, profile, options, schedule, step, unused).process())
      pack_stages(graph, step, profile, options.join_stages);
  remove_resources(schedule, std::move(unused));
  if (!options.list_active)
    for (StepSchedule& step : schedule.steps)
      for (Pass& pass : step.passes) run_all_elements(pass);
  return std::nullopt;
}

}  // namespace dr::backend
