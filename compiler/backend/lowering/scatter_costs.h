// SPDX-License-Identifier: Apache-2.0
// What ways of summing cost beside each other.
#pragma once

#include <cstdint>
#include <optional>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// The elements of an extent whose symbols are as large as the side of a picture; nothing where there are too many to
// count.
std::optional<int64_t> usual_count(const ir::Extent& extent);

// Whether lanes of a subgroup may join what they add: a device's shaders can, and its lanes do not run in turn.
bool lanes_join(const target::Profile& profile);

// Lanes beside each other often add to one element, and atomics of one element wait for each other. Where none do,
// joining is in vain: it has to cost little beside the atomics. On a processor, where a thread has all lanes of a
// subgroup, atomics do not wait, and sums over lanes go lane by lane. In a loop, each atomic that waits for the lanes
// beside it keeps those of later trips from starting.
bool joining_pays(const ir::Graph& graph, const target::Profile& profile, const ScatterPass& scatter);

// Lanes of a subgroup that join in runs (ExactScatter::joins_runs). Where lanes access memory in turn, an atomic of
// each takes longer than all that it takes to join them, and pixels of a row add to the same vertices, and often
// texels.
int lanes_in_runs(const target::Profile& profile);

// Whether lanes beside each other often add to one element of a sum: where there are many more of them than elements.
bool many_share(const ir::Graph& graph, const Pass& pass, const ScatterPass& scatter);

// A GPU adds to sums that its caches hold where they are computed; to larger ones it adds faster in a run of its own,
// whose lanes all add.
bool are_cached(const ir::Graph& graph, std::span<const ScatterSum> sums);

// Whether no condition of the program decides which elements of a scatter pass add.
bool adds_everywhere(const ir::Graph& graph, const Pass& pass);

// Whether two lanes beside each other often add to the same elements, all of them, in a run of their own: where there
// are no fewer pixels than texels.
bool pairs_may_join(const ir::Graph& graph, const target::Profile& profile, const Pass& scatter);

// Whether the invocations of a workgroup join what they add: pixels of a square add to texels of one, of which its
// memory has room for some hundred. Vertices lie anywhere: what few pixels add to them they add to memory, but where
// all that show a mesh do, those of a square share them. An invocation keeps one contribution of each term, so that
// none adds in a loop. Scatters that join one map share the memory.
bool groups_may_join(const ir::Graph& graph, const target::Profile& profile, const StepSchedule& step,
                     const Pass& scatter);

// A contribution costs a row its number and two loads, and an exact sum three words of atomics and their clearing.
bool rows_pay(const ir::Graph& graph, const target::Profile& profile, const ScatterPass& scatter,
              const RowsScatter& rows);

}  // namespace dr::backend
