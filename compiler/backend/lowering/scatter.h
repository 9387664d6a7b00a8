// SPDX-License-Identifier: Apache-2.0
// How scatter passes sum: every decision about them is made here, after packing.
//   add(scatter_add(i, x), scatter_add(j, y))      =>  one pass over the sources, one sum
//   scatter_add(face.x, x) with an input `face`    =>  rows: the sources of each target, read in ascending order
// Requires: a schedule of pack(). Establishes: `scatter`, `sums` and `rows` of every Scatter pass; stages packed anew
// where passes were joined.
//
// Exact  64-bit fixed point numbers whose exponent is that of the largest contribution, added by atomics: independent
//        of order, correct to about 2^-38 of the largest contribution.
//        Where atomics are dear, the lanes of a subgroup that add to one element join what they add first.
// Binned of few elements, whatever was asked but float atomics: integers over all exponents, added by atomics in one
// run
//        and rounded once. What of these a sum is follows from the program alone (analysis/bins.h).
// Rows   a gather by the inverse of an index: the host makes it of one that is a column of an input, the device sorts
//        one that is computed of what the step does not change. The same numbers, summed in registers with an exponent
//        of each row's own.
// Atomic float atomics: the sum depends on order, and differs from run to run. Never chosen by itself.
#pragma once

#include <optional>
#include <string>

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

enum class ScatterLower : uint8_t { Auto, Exact, Rows, Atomic };

struct ScatterOptions {
  ScatterLower lower = ScatterLower::Auto;
  bool join_stages = true;  // see pack_stages()
  bool list_active = true;  // scatters run for the elements that may add something
};

// The error says what the profile lacks.
std::optional<std::string> legalize_scatter(const ir::Graph& graph, const target::Profile& profile,
                                            const ScatterOptions& options, Schedule& schedule);

}  // namespace dr::backend
