// SPDX-License-Identifier: Apache-2.0
// The queue of a device.
#include "runtime/vk/queue.h"

namespace dr::runtime {

Queue::Queue(std::shared_ptr<DeviceState> device) : device_(std::move(device)) {
  pool_ = vk::raii::CommandPool(
      device_->device, vk::CommandPoolCreateInfo(vk::CommandPoolCreateFlagBits::eResetCommandBuffer, device_->family));
  for (Flight& f : flights_) f.fence = vk::raii::Fence(device_->device, vk::FenceCreateInfo());
}

vk::raii::CommandBuffer Queue::command_buffer() const {
  const vk::CommandBufferAllocateInfo one(*pool_, vk::CommandBufferLevel::ePrimary, 1);
  return std::move(vk::raii::CommandBuffers(device_->device, one).front());
}

void Queue::submit(const vk::raii::CommandBuffer& commands) {
  Flight& flight = flights_[next_];
  wait(flight);
  const vk::CommandBuffer handle = *commands;
  vk::SubmitInfo submit;
  submit.setCommandBuffers(handle);
  device_->queue.submit(submit, *flight.fence);
  flight.busy = true;
  next_ = (next_ + 1) % kFlights;
}

void Queue::finish() {
  for (size_t k = 0; k < kFlights; ++k) wait(flights_[(next_ + k) % kFlights]);
}

void Queue::wait(Flight& flight) {
  if (!flight.busy) return;
  constexpr uint64_t kSecond = 1'000'000'000;
  const vk::Result result = device_->device.waitForFences(*flight.fence, VK_TRUE, 600 * kSecond);
  // What the device still uses must not be freed under it.
  if (result != vk::Result::eSuccess) device_->device.waitIdle();
  flight.busy = false;
  device_->device.resetFences(*flight.fence);
  if (result != vk::Result::eSuccess) throw Failure{"the device did not finish within ten minutes"};
}

void Queue::once(const std::function<void(const vk::raii::CommandBuffer&)>& record) {
  const auto commands = command_buffer();
  commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eOneTimeSubmit));
  everything_before(commands);
  record(commands);
  before_the_host(commands);
  commands.end();
  submit(commands);
  finish();
}

void Queue::everything_before(const vk::raii::CommandBuffer& commands) {
  const auto stages = vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eAllGraphics |
                      vk::PipelineStageFlagBits::eTransfer;
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                  vk::AccessFlagBits::eMemoryRead | vk::AccessFlagBits::eMemoryWrite);
  commands.pipelineBarrier(stages, stages, {}, barrier, {}, {});
}

void Queue::before_the_host(const vk::raii::CommandBuffer& commands) {
  const auto stages = vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eAllGraphics |
                      vk::PipelineStageFlagBits::eTransfer;
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                  vk::AccessFlagBits::eHostRead | vk::AccessFlagBits::eHostWrite);
  commands.pipelineBarrier(stages, vk::PipelineStageFlagBits::eHost, {}, barrier, {}, {});
}

}  // namespace dr::runtime
