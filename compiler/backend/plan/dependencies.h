// SPDX-License-Identifier: Apache-2.0
// Which commands of a step need not run again: what each depends on, as the bundle tells the runtime.
#pragma once

#include <functional>

#include "compiler/backend/bundle/bundle.h"

namespace dr::backend {

// Fills Step.changes, and Command.leaves and Command.steady of every command. Commands of one render pass, and those
// that write one resource, depend on the same things: they run together or not at all. What writes a leaf depends on
// it.
void find_dependencies(bundle::BundleT& bundle);

// Whether two commands of a step always run together: both in every run, or both after the same leaves changed.
bool run_together(const bundle::CommandT& a, const bundle::CommandT& b);

// What a command reads and writes, every resource once; a Reduce's scratch is written and read.
void for_each_access(const bundle::CommandT& command, const std::function<void(uint32_t, bundle::Access)>& visit);

}  // namespace dr::backend
