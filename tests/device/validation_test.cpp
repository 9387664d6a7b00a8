// SPDX-License-Identifier: Apache-2.0
// Synchronization validation is alive: it speaks up when a barrier of ours is left out, and is silent when it is there.
#include <cstdlib>

#include "runtime/vk/barrier.h"
#include "runtime/vk/device.h"
#include "runtime/vk/queue.h"
#include "tests/catch.h"
#include "tests/device/devices.h"

using namespace dr;
using runtime::Use;

namespace {

// Messages about a fill and a copy of what it filled, with the barrier that the plan has between them or without.
std::vector<std::string> messages(const std::string& device_name, bool with_barrier) {
  const auto device = runtime::open_device({device_name, true});
  const vk::BufferCreateInfo info({}, 256,
                                  vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst);
  vk::raii::Buffer from(device->device, info), to(device->device, info);
  const auto need = from.getMemoryRequirements();
  const uint32_t type = device->memory_type(need.memoryTypeBits, {}, {});
  const vk::raii::DeviceMemory memory(device->device, vk::MemoryAllocateInfo(2 * need.size, type));
  from.bindMemory(*memory, 0);
  to.bindMemory(*memory, need.size);
  const std::vector<std::vector<runtime::Access>> accesses{{{0, Use::TransferWrite}},
                                                           {{0, Use::TransferRead}, {1, Use::TransferWrite}}};
  const runtime::Barrier barrier = runtime::plan_barriers(accesses)[1];
  runtime::Queue queue(device);
  queue.once([&](const vk::raii::CommandBuffer& c) {
    c.fillBuffer(*from, 0, VK_WHOLE_SIZE, 7);
    if (with_barrier)
      c.pipelineBarrier(vk::PipelineStageFlags(barrier.from.stages), vk::PipelineStageFlags(barrier.to.stages), {},
                        vk::MemoryBarrier(vk::AccessFlags(barrier.from.access), vk::AccessFlags(barrier.to.access)), {},
                        {});
    c.copyBuffer(*from, *to, vk::BufferCopy(0, 0, 256));
  });
  const std::lock_guard lock(device->messages_lock);
  return device->messages;
}

}  // namespace

TEST_CASE("a barrier that is left out is told") {
  for (const auto& [name, unused] : test::devices()) {
    INFO(name);
    // The loader finds the device that was opened last; the others are gone from its list.
    setenv("VK_ICD_FILENAMES", std::getenv(name == "lavapipe" ? "DR_LAVAPIPE_ICD" : "DR_SWIFTSHADER_ICD"), 1);
    setenv("VK_DRIVER_FILES", std::getenv(name == "lavapipe" ? "DR_LAVAPIPE_ICD" : "DR_SWIFTSHADER_ICD"), 1);
    for (const std::string& message : messages(name, true)) FAIL("validation: " << message);
    const auto told = messages(name, false);
    REQUIRE(told.size() == 1);
    CHECK(told[0].find("SYNC-HAZARD-READ-AFTER-WRITE") != std::string::npos);
  }
}
