// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/schedule/joined_sums.h"

#include <algorithm>
#include <bit>

#include "compiler/backend/analysis/scatter_leaves.h"

namespace dr::backend {

namespace {

bool same_places(const ir::Graph& graph, ir::ValueId a, ir::ValueId b) {
  const auto one = scatter_leaves(graph, a), other = scatter_leaves(graph, b);
  return one && other &&
         std::ranges::equal(*one, *other, [](const ScatterLeaf& x, const ScatterLeaf& y) { return x.same_place(y); });
}

bool same_places(const ir::Graph& graph, const ScatterSum& a, const ScatterSum& b) {
  return graph.value(a.value).extent == graph.value(b.value).extent &&
         std::ranges::equal(a.terms, b.terms, [&](ir::ValueId x, ir::ValueId y) { return same_places(graph, x, y); });
}

uint32_t bytes_of(const ir::Graph& graph, std::span<const ScatterSum* const> sums,
                  const std::vector<JoinedSums>& joined) {
  int words = 1;
  for (const JoinedSums& same : joined) {
    int each = 1;
    for (const size_t k : same.sums) each += 2 * graph.value(sums[k]->value).type.components();
    words += same.elements * each;
  }
  return static_cast<uint32_t>(words) * static_cast<uint32_t>(sizeof(uint32_t));
}

}  // namespace

std::vector<JoinedSums> joined_sums(const ir::Graph& graph, std::span<const ScatterSum* const> sums, int group) {
  // More bytes would leave too few workgroups at a time to a GPU's processor.
  constexpr uint32_t kMostBytes = 80;  // an invocation
  const auto invocations = static_cast<unsigned>(group), least = invocations / 2;
  std::vector<JoinedSums> out;
  for (size_t k = 0; k < sums.size(); ++k) {
    const auto same = std::ranges::find_if(
        out, [&](const JoinedSums& joined) { return same_places(graph, *sums[joined.sums[0]], *sums[k]); });
    if (same != out.end())
      same->sums.push_back(k);
    else
      out.push_back({{k}, static_cast<int>(std::bit_ceil(static_cast<unsigned>(sums[k]->terms.size()) * least))});
  }
  while (bytes_of(graph, sums, out) > kMostBytes * invocations) {
    const int half = std::ranges::max_element(out, {}, &JoinedSums::elements)->elements / 2;
    if (half < static_cast<int>(least)) return {};
    for (JoinedSums& same : out) same.elements = std::min(same.elements, half);
  }
  return out;
}

std::vector<const ScatterSum*> joined_in_groups(const StepSchedule& step, PassId map) {
  std::vector<const ScatterSum*> sums;
  for (const Pass* pass : listed_for(step, map))
    if (const auto& scatter = pass->get<ScatterPass>(); scatter.joins_groups())
      for (const ScatterSum& sum : scatter.sums) sums.push_back(&sum);
  return sums;
}

bool groups_have_room(const ir::Graph& graph, const target::Profile& profile, std::span<const ScatterSum* const> sums,
                      int group) {
  if (!profile.is_gpu() || profile.max_compute_work_group_invocations < static_cast<uint32_t>(group)) return false;
  const std::vector<JoinedSums> joined = joined_sums(graph, sums, group);
  return !joined.empty() && bytes_of(graph, sums, joined) <= profile.max_compute_shared_memory_size;
}

}  // namespace dr::backend
