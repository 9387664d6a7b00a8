// SPDX-License-Identifier: Apache-2.0
// Barriers from declared accesses: a pure function, tested without a device.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace dr::runtime {

// How a command uses a resource.
enum class Use : uint8_t {
  ComputeRead,
  ComputeWrite,
  ComputeReadWrite,
  GraphicsRead,  // by vertex and fragment shaders
  ColorWrite,    // colour attachment, cleared first
  DepthWrite,    // depth attachment, cleared first, tested and written
  IndirectRead,  // numbers of workgroups
  TransferRead,
  TransferWrite,
};

struct Access {
  uint32_t resource;
  Use use;
};

// Vulkan's VkPipelineStageFlags and VkAccessFlags of one side.
struct Scope {
  uint32_t stages = 0;
  uint32_t access = 0;
  friend bool operator==(const Scope&, const Scope&) = default;
};

// What must be waited for before a command: nothing when `from.stages` is 0.
struct Barrier {
  Scope from, to;
  friend bool operator==(const Barrier&, const Barrier&) = default;
};

Scope scope_of(Use use);
bool writes(Use use);

// The commands by level: each stands one level behind the last of those that it must wait for, for what it reads or
// writes. Commands of a level keep their order. What waits for nothing thus runs beside what comes long before it, such
// as the clears of a run beside the end of the run before.
std::vector<std::vector<size_t>> by_level(std::span<const std::vector<Access>> commands);

// What the commands do with each resource up to their first write of it: it waits for what came before them, and all
// else waits for that write.
Scope first_uses(std::span<const std::vector<Access>> commands);

// One barrier a command, in order: against every earlier write of what it touches, and every earlier read of what
// it writes, that no barrier has covered yet. The first command waits for nothing: what came before the
// sequence is the caller's to wait for.
std::vector<Barrier> plan_barriers(std::span<const std::vector<Access>> commands);

}  // namespace dr::runtime
