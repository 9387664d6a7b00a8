// SPDX-License-Identifier: Apache-2.0
// What a shader binds, and whether a device can: all decisions count here. The schedule's checker counts for itself.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

// Resources of one shader: those it reads, by how they are stored, and those it writes.
struct Bindings {
  uint32_t buffers = 0;
  uint32_t images = 0;
  uint32_t writes = 0;
  bool hardware = false;  // a fragment shader: what it writes are colour attachments, otherwise buffers
  uint32_t more = 0;      // storage buffers that a lowering adds, which the shader may read and write
};

// Of a shader that reads the resources with these numbers, which may repeat.
Bindings bindings_of(const std::vector<Resource>& resources, std::vector<uint32_t> reads, size_t writes,
                     bool hardware = false);
// The numbers of the resources of stored values.
std::vector<uint32_t> resources_of(const StepSchedule& step, std::span<const ir::ValueId> values);

// That lowering a scatter may add to what its pass reads and writes: sums or tables, and lists.
inline constexpr uint32_t kScatterBuffers = 3;
// Lists that a map's shader may write: of heavy elements, and for a scatter.
inline constexpr uint32_t kMapLists = 2;
// The same where it lists for so many scatters.
inline uint32_t lists_bound(size_t scatters) {
  return scatters == 0 ? 0 : kMapLists - 1 + static_cast<uint32_t>(scatters);
}
// Words of a shader whose loops are cut.
inline constexpr uint32_t kCutBuffers = 3;

// Whether the first run of a scatter may add by a guessed exponent: all that the pass writes are sums of an exponent,
// and compute shaders alone read them as such, for those leave the guess.
bool may_guess(const ir::Graph& graph, const std::vector<Resource>& resources, const StepSchedule& step,
               const Pass& pass);
// What the shader of the map that lists what a scatter adds binds if it does the scatter's first run, too, beside those
// of others that join it.
Bindings joined_bindings(const std::vector<Resource>& resources, const StepSchedule& step, const Pass& scatter);
// So many elements an invocation of such a scatter's second run may compute, one after the other: where terms are kept,
// and where exponents are guessed.
inline constexpr int kElementsInTurn = 32, kElementsOfGuess = 128;
// What is known to be true where a scatter runs for elements that a map lists: conditions that all of them fulfil.
std::vector<ir::ValueId> true_where_listed(const ir::Graph& graph, const Pass& pass);
// Whether a scatter adds nothing where these branches are left out: each clause has one of their conditions, or all
// that it adds is zero.
bool adds_nothing_without(const ir::Graph& graph, const ScatterPass& scatter, std::span<const ir::OpId> heavy);

// The guesses that the shader of a pass binds beside what the pass reads and writes.
size_t guesses_bound(const std::vector<Resource>& resources, const StepSchedule& step, const Pass& pass);

// Whether the pass that reads a sum as it was added up may leave zeros: both run in every run of the step, and the
// reader's one dispatch takes each element once.
bool may_empty(const ir::Graph& graph, const StepSchedule& step, const Pass& pass, const ScatterSum& sum);

// The map that may clear a sum at the elements that it lists, before anything is added: a scatter alone reads the sum,
// in dispatches of its own for these elements, and all of them run in every run of the step.
std::optional<PassId> may_clear_where_listed(const ir::Graph& graph, const StepSchedule& step, const Pass& pass,
                                             const ScatterSum& sum);
// The sums that a scatter reads so, and those that a map clears, which its shader binds.
std::vector<ir::ValueId> sums_where_listed(const std::vector<Resource>& resources, const StepSchedule& step,
                                           const Pass& scatter);
uint32_t cleared_bound(const std::vector<Resource>& resources, const StepSchedule& step, PassId map);
// What the shader of a map binds with all that it lists, adds and clears for scatters.
Bindings listing_bindings(const std::vector<Resource>& resources, const StepSchedule& step, PassId map);

// Whether a sum by float atomics may be left zeros: one map alone reads it, in place, likewise.
bool may_empty_floats(const ir::Graph& graph, const std::vector<Resource>& resources, const StepSchedule& step,
                      const Pass& pass, const ScatterSum& sum);

// Whether one pass alone reads a value of its own extent, at its own element, and nothing does afterwards: a map, or a
// scatter in dispatches of its own for listed elements.
bool is_read_in_place(const ir::Graph& graph, const StepSchedule& step, ir::ValueId value);

bool fits(const target::Profile& profile, const Bindings& bindings);

}  // namespace dr::backend
