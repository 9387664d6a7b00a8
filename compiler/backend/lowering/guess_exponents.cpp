// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/lowering/guess_exponents.h"

#include <algorithm>

#include "compiler/backend/analysis/named_once.h"
#include "compiler/backend/schedule/limits.h"

namespace dr::backend {

using ir::ValueId;

namespace {

// A GPU adds to sums that its caches hold where they are computed; to larger ones it adds faster in a run of its own,
// whose lanes all add. So do processors to all.
constexpr int64_t kMostCached = 1 << 23;  // words
constexpr int64_t kSide = 1024;           // of what symbols stand for

bool is_cached(const ir::Graph& graph, const ScatterPass& scatter) {
  int64_t words = 0;
  for (const ScatterSum& sum : scatter.sums) {
    const ir::ValueInfo& info = graph.value(sum.value);
    const ir::Dim count = info.extent.w * info.extent.h * info.extent.l;
    ir::SymbolValues sides;
    for (const std::string& symbol : count.symbols()) sides[symbol] = kSide;
    words += 2 * info.type.components() * count.evaluate(sides).value_or(kMostCached);
  }
  return words <= kMostCached;
}

bool is_read_by(const Pass& pass, ValueId v) { return std::ranges::find(pass.reads, v) != pass.reads.end(); }

// Whether a pass may bind so many buffers more.
bool has_room(const target::Profile& profile, const Schedule& schedule, const StepSchedule& step, const Pass& pass,
              size_t more) {
  Bindings bindings =
      bindings_of(schedule.resources, resources_of(step, pass.reads), pass.writes.size(), pass.is_drawn());
  bindings.more += static_cast<uint32_t>(more);
  return fits(profile, bindings);
}

// A word for each sum beside what the pass binds anyway: sums, and a list of elements.
bool all_have_room(const target::Profile& profile, const Schedule& schedule, const StepSchedule& step, const Pass& pass,
                   const ScatterPass& scatter) {
  const size_t sums = scatter.sums.size();
  if (!has_room(profile, schedule, step, pass, sums + kScatterBuffers)) return false;
  return std::ranges::all_of(step.passes, [&](const Pass& reader) {
    const auto count = static_cast<size_t>(
        std::ranges::count_if(scatter.sums, [&](const ScatterSum& sum) { return is_read_by(reader, sum.value); }));
    return count == 0 || has_room(profile, schedule, step, reader, count + kMapLists);
  });
}

}  // namespace

void guess_exponents(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule) {
  if (!profile.is_gpu()) return;
  for (StepSchedule& step : schedule.steps)
    for (Pass& pass : step.passes) {
      auto* scatter = pass.as<ScatterPass>();
      ExactScatter* exact = scatter == nullptr ? nullptr : scatter->exact();
      if (exact == nullptr || !pass.steady) continue;  // what runs once guesses nothing
      const bool all_fixed = std::ranges::all_of(scatter->sums, [&](const ScatterSum& sum) {
        return graph.value(sum.value).type.is_float() && !named_once(graph, sum.terms);
      });
      if (scatter->sums.empty() || !all_fixed || pass.writes.size() != scatter->sums.size()) continue;
      if (!is_cached(graph, *scatter)) continue;
      auto* joined = std::get_if<JoinedFirstRun>(&exact->first_run);
      // Where terms are kept there is room for a buffer a sum, which they no longer need.
      if (joined != nullptr ? !joined->keeps_terms : !all_have_room(profile, schedule, step, pass, *scatter)) continue;
      exact->guesses = true;
      if (joined != nullptr)
        joined->keeps_terms = false;
      else
        std::get<OwnFirstRun>(exact->first_run).relists = false;
    }
}

}  // namespace dr::backend
