// SPDX-License-Identifier: Apache-2.0
// What a step's commands are, and what each reads and writes.
#include <algorithm>

#include "compiler/backend/plan/show.h"
#include "runtime/c/handles.h"

using namespace dr::c;

const char* dressi_schedule(dressi_bundle* bundle, const char* step) {
  return guarded(static_cast<const char*>(nullptr), [&] {
    auto& here = given(bundle, "the bundle");
    const std::string name = word(step, "the step");
    const auto& steps = here.tables.steps;
    const auto found = std::ranges::find_if(steps, [&](const auto& s) { return s->name == name; });
    if (found == steps.end()) fail("the program has no step '" + name + "'");
    here.schedule = dr::backend::show_commands(here.tables, **found);
    return here.schedule.c_str();
  });
}
