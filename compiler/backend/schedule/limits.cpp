// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/limits.h"

#include <algorithm>

#include "compiler/backend/analysis/bins.h"
#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/analysis/zero_without.h"

namespace dr::backend {

Bindings bindings_of(const std::vector<Resource>& resources, std::vector<uint32_t> reads, size_t writes,
                     bool hardware) {
  std::ranges::sort(reads);
  reads.erase(std::ranges::unique(reads).begin(), reads.end());
  const auto buffers =
      static_cast<uint32_t>(std::ranges::count_if(reads, [&](uint32_t r) { return resources[r].is_buffer(); }));
  return {buffers, static_cast<uint32_t>(reads.size()) - buffers, static_cast<uint32_t>(writes), hardware};
}

std::vector<uint32_t> resources_of(const StepSchedule& step, std::span<const ir::ValueId> values) {
  std::vector<uint32_t> out;
  for (const ir::ValueId v : values) out.push_back(step.stored.at(v).index);
  return out;
}

namespace {

bool reads_sums(const std::vector<Resource>& resources, const StepSchedule& step, const Pass& pass,
                const ScatterSum& sum) {
  return std::ranges::find(pass.reads, sum.value) != pass.reads.end() &&
         resources[step.stored.at(sum.value).index].is_sums();
}

}  // namespace

bool may_guess(const ir::Graph& graph, const std::vector<Resource>& resources, const StepSchedule& step,
               const Pass& pass) {
  const auto& scatter = pass.get<ScatterPass>();
  if (scatter.exact() == nullptr || scatter.sums.empty() || pass.writes.size() != scatter.sums.size()) return false;
  return std::ranges::all_of(scatter.sums, [&](const ScatterSum& sum) {
    const bool is_drawn = std::ranges::any_of(
        step.passes, [&](const Pass& reader) { return reader.is_drawn() && reads_sums(resources, step, reader, sum); });
    return graph.value(sum.value).type.is_float() && !named_once(graph, sum.terms) &&
           !adds_in_bins(graph, sum.value, sum.terms) && !is_drawn;
  });
}

Bindings joined_bindings(const std::vector<Resource>& resources, const StepSchedule& step, const Pass& scatter) {
  const Pass& pass = step.pass(*scatter.lister());
  std::vector<uint32_t> reads = resources_of(step, pass.reads);
  size_t writes = pass.writes.size();
  for (const Pass* listed : listed_for(step, *scatter.lister())) {
    ++writes;  // its list
    const auto& how = listed->get<ScatterPass>();
    if (listed != &scatter && how.joined_run() == nullptr) continue;
    for (const uint32_t r : resources_of(step, listed->reads)) reads.push_back(r);
    writes += how.sums.size() * (listed != &scatter && how.keeps_terms() ? 2 : 1);
  }
  Bindings out = bindings_of(resources, std::move(reads), writes);
  out.more += static_cast<uint32_t>(guesses_bound(resources, step, pass));
  return out;
}

std::vector<ir::ValueId> true_where_listed(const ir::Graph& graph, const Pass& pass) {
  const auto* scatter = pass.as<ScatterPass>();
  if (scatter == nullptr || !scatter->lister() || scatter->runs_again() || scatter->clauses().size() != 1) return {};
  std::vector<ir::ValueId> out = scatter->clauses()[0];
  std::erase_if(out, [&](ir::ValueId v) { return graph.value(v).type != ir::kBool; });
  return out;
}

bool adds_nothing_without(const ir::Graph& graph, const ScatterPass& scatter, std::span<const ir::OpId> heavy) {
  const auto leaves_out = [&](const std::vector<ir::ValueId>& clause) {
    return std::ranges::any_of(
        heavy, [&](ir::OpId id) { return std::ranges::find(clause, graph.op(id).operands[0]) != clause.end(); });
  };
  if (std::ranges::all_of(scatter.clauses(), leaves_out)) return true;
  return std::ranges::all_of(scatter.sums, [&](const ScatterSum& sum) {
    return std::ranges::all_of(sum.terms, [&](ir::ValueId term) {
      const ir::Op& op = graph.op(graph.value(term).op);
      return op.kind == ir::OpKind::ScatterAdd && is_zero_without(graph, op.operands[1], heavy);
    });
  });
}

size_t guesses_bound(const std::vector<Resource>& resources, const StepSchedule& step, const Pass& pass) {
  size_t out = 0;
  for (const Pass& other : step.passes) {
    const auto* scatter = other.as<ScatterPass>();
    if (scatter == nullptr || !scatter->guesses()) continue;
    const JoinedRun* joined = scatter->joined_run();
    const bool adds = &other == &pass || (joined != nullptr && &step.pass(joined->lister) == &pass);
    for (const ScatterSum& sum : scatter->sums)
      if (adds || reads_sums(resources, step, pass, sum)) ++out;
    if (adds && scatter->asks()) ++out;
  }
  return out;
}

bool may_empty(const ir::Graph& graph, const StepSchedule& step, const Pass& pass, const ScatterSum& sum) {
  // Few bins are cleared in no time.
  if (!pass.steady || adds_in_bins(graph, sum.value, sum.terms)) return false;
  // What counts contributions has no word left that says whether an element is flagged.
  if (std::ranges::any_of(sum.terms, [&](ir::ValueId term) { return contributions(graph, term) < 0; })) return false;
  for (size_t k = 0; k < step.passes.size(); ++k) {
    const Pass& reader = step.passes[k];
    if (std::ranges::find(reader.reads, sum.value) == reader.reads.end()) continue;
    const auto* map = reader.as<MapPass>();
    // One that leaves elements at rest runs for all that this pass adds to, if that is its gradient.
    const bool leaves_some = map != nullptr && map->rest && &step.pass(map->rest->gradient) != &pass;
    if (map == nullptr || !reader.steady || map->block || leaves_some || map->code.heavy || map->code.cut ||
        set_up_for(step, pass_id(k)) != nullptr)
      return false;
  }
  return true;
}

std::optional<PassId> may_clear_where_listed(const ir::Graph& graph, const StepSchedule& step, const Pass& pass,
                                             const ScatterSum& sum) {
  if (!pass.steady || adds_in_bins(graph, sum.value, sum.terms) || !is_read_in_place(graph, step, sum.value)) return {};
  const auto reader = std::ranges::find_if(
      step.passes, [&](const Pass& p) { return std::ranges::find(p.reads, sum.value) != p.reads.end(); });
  const auto* scatter = reader->as<ScatterPass>();
  if (scatter == nullptr || !reader->steady || scatter->own_run() == nullptr || !scatter->lister()) return {};
  const PassId by = *scatter->lister();
  const auto own = static_cast<size_t>(&pass - step.passes.data());
  const auto& adds = pass.get<ScatterPass>();
  const size_t first = adds.joined_run() != nullptr ? adds.lister()->index : own;
  return step.pass(by).steady && by.index < first ? std::optional(by) : std::nullopt;
}

std::vector<ir::ValueId> sums_where_listed(const std::vector<Resource>& resources, const StepSchedule& step,
                                           const Pass& scatter) {
  std::vector<ir::ValueId> out = scatter.reads;
  std::erase_if(out,
                [&](ir::ValueId v) { return !resources[step.stored.at(v).index].is(Resource::Storage::ListedSums); });
  return out;
}

uint32_t cleared_bound(const std::vector<Resource>& resources, const StepSchedule& step, PassId map) {
  size_t out = 0;
  for (const Pass* scatter : listed_for(step, map)) out += sums_where_listed(resources, step, *scatter).size();
  return static_cast<uint32_t>(out);
}

Bindings listing_bindings(const std::vector<Resource>& resources, const StepSchedule& step, PassId map) {
  const Pass& pass = step.pass(map);
  Bindings out = bindings_of(resources, resources_of(step, pass.reads), pass.writes.size());
  const std::vector<const Pass*> scatters = listed_for(step, map);
  for (const Pass* scatter : scatters)
    if (scatter->get<ScatterPass>().joined_run() != nullptr) out = joined_bindings(resources, step, *scatter);
  out.more += lists_bound(scatters.size()) + cleared_bound(resources, step, map);
  return out;
}

bool may_empty_floats(const ir::Graph& graph, const std::vector<Resource>& resources, const StepSchedule& step,
                      const Pass& pass, const ScatterSum& sum) {
  const Resource& r = resources[step.stored.at(sum.value).index];
  return pass.get<ScatterPass>().lowering() == ScatterLowering::Atomic && graph.value(sum.value).type.is_float() &&
         !named_once(graph, sum.terms) && (r.is(Resource::Storage::Buffer) || r.is(Resource::Storage::Emptied)) &&
         is_read_in_place(graph, step, sum.value) && may_empty(graph, step, pass, sum);
}

bool is_read_in_place(const ir::Graph& graph, const StepSchedule& step, ir::ValueId value) {
  if (read_afterwards(graph, step).count(value) != 0) return false;
  const Pass* reader = nullptr;
  for (const Pass& pass : step.passes) {
    if (std::ranges::find(pass.reads, value) == pass.reads.end()) continue;
    if (reader != nullptr) return false;
    reader = &pass;
  }
  const auto* scatter = reader == nullptr ? nullptr : reader->as<ScatterPass>();
  const bool reads_each =
      reader != nullptr && (reader->is<MapPass>() || (scatter != nullptr && scatter->active_list()));
  return reads_each && reader->domain == graph.value(value).extent &&
         std::ranges::none_of(reader->ops, [&](ir::OpId id) {
           const Uses uses = uses_of(graph, graph.op(id));
           return std::ranges::find(uses.elsewhere, value) != uses.elsewhere.end();
         });
}

bool fits(const target::Profile& profile, const Bindings& b) {
  // What is only read is a texel buffer where lanes go in turn, which counts as a sampled image.
  const uint32_t texels = profile.lanes_in_turn ? b.buffers : 0;
  const uint32_t bound = b.buffers - texels + b.more + (b.hardware ? 0 : b.writes);
  if (bound > profile.max_per_stage_descriptor_storage_buffers ||
      b.images + texels > profile.max_per_stage_descriptor_sampled_images ||
      b.buffers + b.more + b.images + b.writes > profile.max_per_stage_resources)
    return false;
  if (!b.hardware) return true;
  return b.writes <= profile.max_color_attachments &&
         b.more + b.writes <= profile.max_fragment_combined_output_resources;
}

}  // namespace dr::backend
