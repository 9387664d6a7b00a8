// SPDX-License-Identifier: Apache-2.0
// Sums, exact or by float atomics, that the pass which reads them leaves zeros for the next run, so that no run begins
// with clearing them:
// few elements of a large picture's gradient get anything.
//   sums buffer grad : vec3[T, T]              =>      emptied sums buffer grad : vec3[T, T]
// Where both passes run in every run, and the reader takes each element once. Only on GPUs: a processor's driver stores
// for one lane after the other, which takes longer than clearing does.
#pragma once

#include "compiler/backend/schedule/schedule.h"
#include "compiler/target/profile.h"

namespace dr::backend {

void empty_sums(const ir::Graph& graph, const target::Profile& profile, Schedule& schedule);

}  // namespace dr::backend
