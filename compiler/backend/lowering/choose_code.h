// SPDX-License-Identifier: Apache-2.0
// How shaders are written for the device. Emission asks the schedule, never the device.
//   pass shade compute [W, H]    =>    code texel reads, hidden stores
//                                      pass shade compute [W, H]
//                                        heavy if %40
#pragma once

#include "compiler/backend/schedule/schedule.h"

namespace dr::backend {

struct CodeOptions {
  bool list_branches = true;   // heavy branches run for the elements that take them
  bool native_floats = false;  // the float profile
};

// Requires: no pass is added, removed or changed later. Establishes: Schedule::code and Pass::code.
void choose_code(const ir::Graph& graph, const target::Profile& profile, const CodeOptions& options,
                 Schedule& schedule);

}  // namespace dr::backend
