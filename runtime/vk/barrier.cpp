// SPDX-License-Identifier: Apache-2.0
// Hazards between the commands of a step.
#include "runtime/vk/barrier.h"

#include <algorithm>
#include <map>
#include <set>

#include "compiler/backend/bundle/levels.h"

namespace dr::runtime {

namespace {

// Values of the Vulkan specification, so that this file needs no Vulkan.
constexpr uint32_t kVertexStage = 0x8, kFragmentStage = 0x80, kEarlyTests = 0x100, kLateTests = 0x200,
                   kColorStage = 0x400, kComputeStage = 0x800, kTransferStage = 0x1000, kIndirectStage = 0x2;
constexpr uint32_t kShaderRead = 0x20, kShaderWrite = 0x40, kColorRead = 0x80, kColorWrite = 0x100, kDepthRead = 0x200,
                   kDepthWrite = 0x400, kTransferRead = 0x800, kTransferWrite = 0x1000, kIndirectRead = 0x1;

// Whether `test` holds for each bit; all are visited while it does.
template <class F>
bool all_stages(uint32_t stages, F&& test) {
  for (uint32_t bit = 1; bit != 0 && bit <= stages; bit <<= 1)
    if ((stages & bit) != 0 && !test(bit)) return false;
  return true;
}

constexpr uint32_t kWriteAccess = kShaderWrite | kColorWrite | kDepthWrite | kTransferWrite;

}  // namespace

Scope scope_of(Use use) {
  switch (use) {
    case Use::ComputeRead: return {kComputeStage, kShaderRead};
    case Use::ComputeWrite: return {kComputeStage, kShaderWrite};
    case Use::ComputeReadWrite: return {kComputeStage, kShaderRead | kShaderWrite};
    case Use::GraphicsRead: return {kVertexStage | kFragmentStage, kShaderRead};
    case Use::ColorWrite: return {kColorStage, kColorRead | kColorWrite};
    case Use::DepthWrite: return {kEarlyTests | kLateTests, kDepthRead | kDepthWrite};
    case Use::IndirectRead: return {kIndirectStage, kIndirectRead};
    case Use::TransferRead: return {kTransferStage, kTransferRead};
    case Use::TransferWrite: return {kTransferStage, kTransferWrite};
  }
  return {};
}

bool writes(Use use) { return (scope_of(use).access & kWriteAccess) != 0; }

std::vector<std::vector<size_t>> by_level(std::span<const std::vector<Access>> commands) {
  bundle::Levels resources;
  std::vector<std::vector<size_t>> levels;
  for (size_t k = 0; k < commands.size(); ++k) {
    std::vector<bundle::Levels::Touch> touches;
    for (const Access& a : commands[k]) touches.push_back({a.resource, writes(a.use)});
    const size_t own = resources.add(touches);
    levels.resize(std::max(levels.size(), own + 1));
    levels[own].push_back(k);
  }
  return levels;
}

Scope first_uses(std::span<const std::vector<Access>> commands) {
  std::set<uint32_t> written;
  Scope out;
  for (const std::vector<Access>& accesses : commands) {
    for (const Access& a : accesses) {
      if (written.contains(a.resource)) continue;
      const Scope scope = scope_of(a.use);
      out.stages |= scope.stages;
      out.access |= scope.access;
    }
    for (const Access& a : accesses)
      if (writes(a.use)) written.insert(a.resource);
  }
  return out;
}

std::vector<Barrier> plan_barriers(std::span<const std::vector<Access>> commands) {
  // Barriers are global memory barriers: one makes every write of its source stages available. What remains
  // uncovered of a resource is its last write and the reads since, each until a barrier that reaches the same
  // destination.
  struct State {
    Scope write;                        // last write; stages 0: none
    std::map<uint32_t, uint32_t> seen;  // stage bit -> accesses that the write has been made visible to there
    std::map<uint32_t, uint32_t> read;  // stage bit that read since that write -> stages that have waited for it
  };
  std::map<uint32_t, State> states;
  std::vector<Barrier> out;
  for (const std::vector<Access>& accesses : commands) {
    Barrier barrier;
    for (const Access& a : accesses) {
      State& s = states[a.resource];
      const Scope need = scope_of(a.use);
      const bool visible = all_stages(need.stages, [&](uint32_t stage) {
        const auto it = s.seen.find(stage);
        return it != s.seen.end() && (need.access & ~it->second) == 0;
      });
      if (s.write.stages != 0 && !visible) {
        barrier.from.stages |= s.write.stages;
        barrier.from.access |= s.write.access & kWriteAccess;
        barrier.to.stages |= need.stages;
        barrier.to.access |= need.access;
      }
      if (!writes(a.use)) continue;
      for (const auto& [reader, waited] : s.read) {
        if ((need.stages & ~waited) == 0) continue;
        barrier.from.stages |= reader;
        barrier.to.stages |= need.stages;
        barrier.to.access |= need.access;
      }
    }
    if (barrier.from.stages != 0)
      for (auto& [resource, s] : states) {
        // The barrier covers every write whose stages and access it names.
        if ((s.write.stages & ~barrier.from.stages) == 0 &&
            (s.write.access & kWriteAccess & ~barrier.from.access) == 0) {
          all_stages(barrier.to.stages, [&](uint32_t stage) {
            s.seen[stage] |= barrier.to.access;
            return true;
          });
        }
        for (auto& [reader, waited] : s.read)
          if ((barrier.from.stages & reader) != 0) waited |= barrier.to.stages;
      }
    for (const Access& a : accesses) {
      State& s = states[a.resource];
      const Scope scope = scope_of(a.use);
      if (writes(a.use))
        s = {scope, {}, {}};
      else
        all_stages(scope.stages, [&](uint32_t stage) {
          s.read[stage] = 0;
          return true;
        });
    }
    out.push_back(barrier);
  }
  return out;
}

}  // namespace dr::runtime
