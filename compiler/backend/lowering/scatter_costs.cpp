// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/scatter_costs.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/backend/schedule/joined_sums.h"

namespace dr::backend {

namespace {

bool is_processor(const target::Profile& profile) { return profile.costs.compute_operations_per_ns < 64; }

}  // namespace

std::optional<int64_t> usual_count(const ir::Extent& extent) {
  constexpr int64_t kSide = 1024;
  const ir::Dim count = extent.w * extent.h * extent.l;
  ir::SymbolValues sides;
  for (const std::string& symbol : count.symbols()) sides[symbol] = kSide;
  return count.evaluate(sides);
}

bool lanes_join(const target::Profile& profile) {
  return profile.subgroup_arithmetic && profile.subgroup_size >= 2 && profile.subgroup_size <= kMaxJoinedLanes &&
         !is_processor(profile);
}

bool joining_pays(const ir::Graph& graph, const target::Profile& profile, const ScatterPass& scatter) {
  if (!lanes_join(profile)) return false;
  double joins = 0, words = 0;
  for (const ScatterSum& sum : scatter.sums) {
    const ir::Type& type = graph.value(sum.value).type;
    if (!type.is_float()) continue;
    if (std::ranges::any_of(sum.terms, [&](ir::ValueId term) { return contributions(graph, term) < 0; })) return false;
    joins += kJoinRounds * (6 + 6 * type.components() * std::log2(profile.subgroup_size));  // operations
    words += (profile.shader_int64 && profile.shader_buffer_int64_atomics ? 1 : 2) * type.components();
  }
  constexpr double kLittle = 0.25;
  return joins / profile.costs.compute_operations_per_ns < kLittle * words * profile.costs.atomic_add_ns;
}

int lanes_in_runs(const target::Profile& profile) {
  constexpr uint32_t kMost = 32;
  const bool joins =
      profile.lanes_in_turn && profile.subgroup_shuffle && profile.subgroup_size > 1 && profile.subgroup_size <= kMost;
  return joins ? static_cast<int>(std::bit_floor(profile.subgroup_size)) : 0;
}

bool many_share(const ir::Graph& graph, const Pass& pass, const ScatterPass& scatter) {
  constexpr double kMany = 32;  // to 16 and fewer an element, lanes that add alone take two thirds of the time
  const auto count = [](const ir::Extent& extent) { return static_cast<double>(usual_count(extent).value_or(1)); };
  double most = 0;
  for (const ScatterSum& sum : scatter.sums) {
    double each = 0;
    for (const ir::ValueId term : sum.terms) each += std::max(contributions(graph, term), 1);
    most = std::max(most, each * count(pass.domain) / std::max(count(graph.value(sum.value).extent), 1.0));
  }
  for (const ir::ValueId v : pass.writes)
    if (graph.op(graph.value(v).op).kind == ir::OpKind::ScatterMax)
      most = std::max(most, count(pass.domain) / std::max(count(graph.value(v).extent), 1.0));
  return most >= kMany;
}

bool are_cached(const ir::Graph& graph, std::span<const ScatterSum> sums) {
  constexpr int64_t kMostCached = 1 << 23;  // words
  int64_t words = 0;
  for (const ScatterSum& sum : sums) {
    const ir::ValueInfo& info = graph.value(sum.value);
    words += 2 * info.type.components() * usual_count(info.extent).value_or(kMostCached);
  }
  return words <= kMostCached;
}

bool adds_everywhere(const ir::Graph& graph, const Pass& pass) {
  return std::ranges::all_of(pass.ops, [&](ir::OpId id) { return graph.op(id).regions.empty(); });
}

bool pairs_may_join(const ir::Graph& graph, const target::Profile& profile, const Pass& scatter) {
  const auto& how = scatter.get<ScatterPass>();
  if (!lanes_join(profile) || !profile.subgroup_shuffle || how.joins_parts()) return false;
  return std::ranges::all_of(how.sums, [&](const ScatterSum& sum) {
    const ir::Extent& extent = graph.value(sum.value).extent;
    return !extent.h.is_one() && sum.terms.size() > 1 &&
           std::ranges::all_of(sum.terms, [&](ir::ValueId term) { return contributions(graph, term) == 1; }) &&
           usual_count(scatter.domain).value_or(0) >= usual_count(extent).value_or(INT64_MAX);
  });
}

bool groups_may_join(const ir::Graph& graph, const target::Profile& profile, const StepSchedule& step,
                     const Pass& scatter) {
  const auto& how = scatter.get<ScatterPass>();
  const bool shares = how.joins_parts() && adds_everywhere(graph, scatter);
  for (const ScatterSum& sum : how.sums) {
    if (graph.value(sum.value).extent.h.is_one() && !shares) return false;
    if (std::ranges::any_of(sum.terms, [&](ir::ValueId term) { return contributions(graph, term) != 1; })) return false;
  }
  std::vector<const ScatterSum*> sums;
  const auto add = [&](const Pass& pass) {
    for (const ScatterSum& sum : pass.get<ScatterPass>().sums) sums.push_back(&sum);
  };
  add(scatter);
  if (const auto lister = scatter.lister())
    for (const Pass* other : listed_for(step, *lister))
      if (other != &scatter && other->get<ScatterPass>().joins_groups()) add(*other);
  return groups_have_room(graph, profile, sums);
}

bool rows_pay(const ir::Graph& graph, const target::Profile& profile, const ScatterPass& scatter,
              const RowsScatter& rows) {
  double row = 0, exact = 0;
  const target::Costs& c = profile.costs;
  for (const ScatterSum& sum : scatter.sums) {
    double terms = static_cast<double>(sum.terms.size());
    if (rows.sorted() != nullptr) {
      terms = 0;
      for (const ir::ValueId term : sum.terms) terms += static_cast<double>(scatter_leaves(graph, term)->size());
    }
    const double n = graph.value(sum.value).type.components() * terms;
    row += (8 * terms + 2 * 4 * n) / c.compute_buffer_bytes_per_ns;
    exact += 2 * 4 * n / c.compute_buffer_bytes_per_ns + 2 * n * c.atomic_add_ns;
  }
  return row <= exact;
}

}  // namespace dr::backend
