// SPDX-License-Identifier: Apache-2.0
// The queue of a device.
#include "runtime/vk/queue.h"

namespace dr::runtime {

Queue::Queue(std::shared_ptr<DeviceState> device) : device_(std::move(device)) {
  pool_ = vk::raii::CommandPool(
      device_->device, vk::CommandPoolCreateInfo(vk::CommandPoolCreateFlagBits::eResetCommandBuffer, device_->family));
  fence_ = vk::raii::Fence(device_->device, vk::FenceCreateInfo());
}

vk::raii::CommandBuffer Queue::command_buffer() const {
  const vk::CommandBufferAllocateInfo one(*pool_, vk::CommandBufferLevel::ePrimary, 1);
  return std::move(vk::raii::CommandBuffers(device_->device, one).front());
}

void Queue::submit_and_wait(const vk::raii::CommandBuffer& commands) {
  vk::SubmitInfo submit;
  const vk::CommandBuffer handle = *commands;
  submit.setCommandBuffers(handle);
  device_->queue.submit(submit, *fence_);
  constexpr uint64_t kSecond = 1'000'000'000;
  if (device_->device.waitForFences(*fence_, VK_TRUE, 600 * kSecond) != vk::Result::eSuccess) {
    device_->device.waitIdle();  // what the device still uses must not be freed under it
    throw Failure{"the device did not finish within ten minutes"};
  }
  device_->device.resetFences(*fence_);
}

void Queue::once(const std::function<void(const vk::raii::CommandBuffer&)>& record) {
  const auto commands = command_buffer();
  commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eOneTimeSubmit));
  everything_before(commands);
  record(commands);
  commands.end();
  submit_and_wait(commands);
}

void Queue::everything_before(const vk::raii::CommandBuffer& commands) {
  const auto stages = vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eAllGraphics |
                      vk::PipelineStageFlagBits::eTransfer;
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                  vk::AccessFlagBits::eMemoryRead | vk::AccessFlagBits::eMemoryWrite);
  commands.pipelineBarrier(stages, stages, {}, barrier, {}, {});
}

}  // namespace dr::runtime
