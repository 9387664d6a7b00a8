// SPDX-License-Identifier: Apache-2.0
// The queue of a device.
#include "runtime/vk/queue.h"

#include <algorithm>
#include <stdexcept>
#include <vector>

namespace dr::runtime {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

Queue::Queue(std::shared_ptr<DeviceState> device, bool draws)
    : device_(std::move(device)),
      on_(draws ? device_->graphics : device_->compute),
      stages_(vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eTransfer |
              (draws ? vk::PipelineStageFlagBits::eAllGraphics : vk::PipelineStageFlagBits::eDrawIndirect)) {
  pool_ = vk::raii::CommandPool(
      device_->device, vk::CommandPoolCreateInfo(vk::CommandPoolCreateFlagBits::eResetCommandBuffer, on_.family));
  for (Flight& f : flights_) f.fence = vk::raii::Fence(device_->device, vk::FenceCreateInfo());
}

vk::raii::CommandBuffer Queue::command_buffer() const {
  const vk::CommandBufferAllocateInfo one(*pool_, vk::CommandBufferLevel::ePrimary, 1);
  return std::move(vk::raii::CommandBuffers(device_->device, one).front());
}

void Queue::set_order(CudaOrder* order) {
  finish();
  order_ = order;
  under_way_ = order_ != nullptr ? kFlightsInOrder : kFlights;
  next_ = 0;
}

void Queue::submit(const vk::raii::CommandBuffer& commands, int times, Pace* pace, int runs,
                   const std::vector<vk::CommandBuffer>& after) {
  Flight& flight = flights_[next_];
  wait(flight, false);
  if (flight.spent) device_->device.resetFences(*flight.fence);
  std::vector<vk::CommandBuffer> handles(static_cast<size_t>(times), *commands);
  handles.insert(handles.end(), after.begin(), after.end());
  flight.begin = Clock::now();
  flight.runs = times * runs;
  flight.pace = pace;
  flight.spent = true;
  give(handles, *flight.fence);
  flight.busy = true;
  next_ = (next_ + 1) % under_way_;
  // While the device works: who waits for one run after the other does not wait for this. What fails is tried again
  // when it must be done.
  for (Flight& other : flights_)
    if (!other.busy && other.spent) try {
        device_->device.resetFences(*other.fence);
        other.spent = false;
      } catch (const std::exception&) {
      }
}

void Queue::give(const std::vector<vk::CommandBuffer>& commands, vk::Fence fence) {
  vk::SubmitInfo submit;
  submit.setCommandBuffers(commands);
  if (order_ == nullptr) {
    const std::lock_guard lock(device_->queue_lock);
    return on_.queue.submit(submit, fence);
  }
  const CudaOrder::Values values = order_->before_submission();
  const vk::Semaphore semaphore = order_->semaphore();
  const vk::PipelineStageFlags everything = vk::PipelineStageFlagBits::eAllCommands;
  vk::TimelineSemaphoreSubmitInfo timeline;
  timeline.setWaitSemaphoreValues(values.wait);
  timeline.setSignalSemaphoreValues(values.done);
  submit.setWaitSemaphores(semaphore);
  submit.setWaitDstStageMask(everything);
  submit.setSignalSemaphores(semaphore);
  submit.pNext = &timeline;
  {
    const std::lock_guard lock(device_->queue_lock);
    on_.queue.submit(submit, fence);
  }
  order_->after_submission(values);
}

int Queue::worth_together(const Pace& pace) {
  constexpr nanoseconds kTogether = milliseconds(1);
  constexpr int64_t kMost = 32;
  return static_cast<int>(std::clamp<int64_t>(kTogether / std::max(pace.run, nanoseconds(1)), 1, kMost));
}

void Queue::finish() {
  for (size_t k = 0; k < under_way_; ++k) wait(flights_[(next_ + k) % under_way_], true);
}

void Queue::wait(Flight& flight, bool soon) {
  if (!flight.busy) return;
  // What the device still uses must not be freed under it, whatever becomes of this call.
  struct Idle {
    DeviceState& device;
    bool needed = true;
    ~Idle() {
      if (needed) try {
          const std::lock_guard lock(device.queue_lock);
          device.device.waitIdle();
        } catch (const std::exception&) {  // lost: it uses nothing
        }
    }
  } idle{*device_};
  flight.busy = false;
  if (!is_over(flight, soon)) throw std::runtime_error("the device did not finish within ten minutes");
  idle.needed = false;
  const auto begin = std::max(flight.begin, end_);
  end_ = Clock::now();
  if (flight.pace != nullptr) flight.pace->run = (end_ - begin) / flight.runs;
}

nanoseconds Queue::worth_asking(const Pace* pace, int runs) {
  // From a submission to its first run, and from its last to the fence, some twenty microseconds pass, of which a pace
  // that runs one behind the other have is free. Most copies are of a few words.
  constexpr nanoseconds kShort = milliseconds(1), kAround = std::chrono::microseconds(100);
  if (pace == nullptr) return kAround;
  return pace->run < kShort ? 2 * runs * pace->run + kAround : nanoseconds(0);
}

bool Queue::is_over(const Flight& flight, bool soon) const {
  constexpr nanoseconds kLong = std::chrono::minutes(10);
  const vk::Device& device = *device_->device;
  if (soon && is_gpu())
    for (const auto end = flight.begin + worth_asking(flight.pace, flight.runs); Clock::now() < end;)
      if (device.getFenceStatus(*flight.fence) == vk::Result::eSuccess) return true;
  return device_->device.waitForFences(*flight.fence, VK_TRUE, static_cast<uint64_t>(kLong.count())) ==
         vk::Result::eSuccess;
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

void Queue::everything_before(const vk::raii::CommandBuffer& commands) const {
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                  vk::AccessFlagBits::eMemoryRead | vk::AccessFlagBits::eMemoryWrite);
  commands.pipelineBarrier(stages_, stages_, {}, barrier, {}, {});
}

void Queue::everything_before(const vk::raii::CommandBuffer& commands, Scope first) const {
  // Render passes begin with layouts of images, which are no uses.
  if (stages_ & vk::PipelineStageFlagBits::eAllGraphics) return everything_before(commands);
  if (first.stages == 0) return;
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite, vk::AccessFlags(first.access));
  commands.pipelineBarrier(stages_, vk::PipelineStageFlags(first.stages), {}, barrier, {}, {});
}

void Queue::before_the_host(const vk::raii::CommandBuffer& commands) const {
  const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                  vk::AccessFlagBits::eHostRead | vk::AccessFlagBits::eHostWrite);
  commands.pipelineBarrier(stages_, vk::PipelineStageFlagBits::eHost, {}, barrier, {}, {});
}

}  // namespace dr::runtime
