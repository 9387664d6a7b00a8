// SPDX-License-Identifier: Apache-2.0
// Where values live: which resources share memory because they are never needed at the same time.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/dim.h"

namespace dr::backend {

// When a resource's content is needed: from the command `first` to `last` of a step, or for ever (leaves, outputs,
// counters, and what commands share that need not run together, see dependencies.h: one of them may be left out).
// Raster results and pinned values are needed until their step ends, where they can be read.
struct Lifetime {
  int step = -1;  // -1: for ever, or never used
  int first = 0, last = 0;
  bool used = false;
  bool transient() const { return step >= 0; }
};
std::vector<Lifetime> lifetimes(const bundle::BundleT& bundle);

// Gives every resource a slot. Transient resources of one storage share slots when their lifetimes do not overlap; they
// are placed from large to small (their sizes when all symbols are equal and large), each into the smallest slot that
// is free. The runtime makes a slot as large as its largest resource, so a wrong guess of the order wastes memory and
// nothing else.
void plan_memory(bundle::BundleT& bundle);

// Slots with resources that are needed at the same time; empty when sound. Independent of plan_memory().
std::vector<std::string> check_memory(const bundle::BundleT& bundle);

// Bytes of a resource for these symbols (tightly packed: devices may add to it); nullopt when a symbol has no value.
std::optional<int64_t> resource_bytes(const bundle::ResourceT& resource, const ir::SymbolValues& symbols);

// Device memory that a program holds, by its slots, and what it would need at least: what lives for ever and the most
// that any command needs alive around it.
struct MemoryUse {
  int64_t persistent = 0;  // leaves, outputs, counters
  int64_t planned = 0;     // persistent + slots
  int64_t lower_bound = 0;
  int64_t unshared = 0;  // with a slot for each
};
std::optional<MemoryUse> memory_use(const bundle::BundleT& bundle, const ir::SymbolValues& symbols);

}  // namespace dr::backend
