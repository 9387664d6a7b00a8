// SPDX-License-Identifier: Apache-2.0
// Submitting command buffers, and waiting for them.
#pragma once

#include <array>
#include <chrono>
#include <functional>
#include <vector>

#include "runtime/vk/barrier.h"
#include "runtime/vk/cuda.h"
#include "runtime/vk/device.h"

namespace dr::runtime {

// How long a run takes the device, as the queue last saw it.
struct Pace {
  std::chrono::nanoseconds run = std::chrono::nanoseconds::max();
};

class Queue {
 public:
  // `draws`: some of what is submitted draws. What never does waits for no stage of graphics.
  explicit Queue(std::shared_ptr<DeviceState> device, bool draws = true);
  // Memory that queues of one family wrote is lost to those of another one.
  uint32_t family() const { return on_.family; }
  uint32_t timestamp_bits() const { return on_.timestamp_bits; }
  vk::raii::CommandBuffer command_buffer() const;
  // Submissions and the stream of this order wait for each other from now on. It must outlive the queue's use.
  void set_order(CudaOrder* order);
  // Submissions run one after the other, and a few may be under way: beyond that, submit() waits for the oldest.
  // What a submission uses must live until finish(). `times`: the commands run so often, one after the other, and are
  // `runs` runs each; `pace` is brought up to date when they are done. `after` comes once, behind them: a submission of
  // its own would wait for the order's stream, and the stream for it, once more.
  void submit(const vk::raii::CommandBuffer& commands, int times = 1, Pace* pace = nullptr, int runs = 1,
              const std::vector<vk::CommandBuffer>& after = {});
  // How many runs of this pace are worth submitting at once. A GPU does nothing for some seven microseconds
  // between submissions. Long runs go alone, so that no submission takes long.
  static int worth_together(const Pace& pace);
  // How long from their submission on it is worth asking for so many runs again and again, before sleeping until a GPU
  // is done: to be woken up takes longer than a short run does. Without a pace it is a copy.
  static std::chrono::nanoseconds worth_asking(const Pace* pace, int runs);
  // Returns when all that was submitted is done. Fails after ten minutes without an end.
  void finish();
  // Records and runs.
  void once(const std::function<void(const vk::raii::CommandBuffer&)>& record);
  // Makes what earlier submissions and the host wrote visible to what follows.
  void everything_before(const vk::raii::CommandBuffer& commands) const;
  // Before commands that begin with `first`, and use memory in other ways after their own writes of it only. An H200
  // takes a microsecond longer where the numbers of workgroups are among that.
  void everything_before(const vk::raii::CommandBuffer& commands, Scope first) const;
  // Makes what these commands wrote visible to the host.
  void before_the_host(const vk::raii::CommandBuffer& commands) const;

 private:
  void give(const std::vector<vk::CommandBuffer>& commands, vk::Fence fence);
  std::shared_ptr<DeviceState> device_;
  const DeviceQueue& on_;
  vk::PipelineStageFlags stages_;  // of all that is submitted
  CudaOrder* order_ = nullptr;
  vk::raii::CommandPool pool_{nullptr};
  struct Flight {
    vk::raii::Fence fence{nullptr};
    bool busy = false;   // its submission is not known to be done
    bool spent = false;  // its fence was submitted since it was reset
    std::chrono::steady_clock::time_point begin;
    int runs = 1;
    Pace* pace = nullptr;
  };
  // `soon`: whoever waits has nothing else to do.
  void wait(Flight& flight, bool soon);
  bool is_over(const Flight& flight, bool soon) const;
  bool is_gpu() const { return device_->properties.deviceType != vk::PhysicalDeviceType::eCpu; }
  // How many may be under way. A stream's owner submits a few for each frame, and is to be frames ahead.
  static constexpr size_t kFlights = 3, kFlightsInOrder = 8;
  std::array<Flight, kFlightsInOrder> flights_;
  size_t under_way_ = kFlights;
  size_t next_ = 0;                            // the oldest
  std::chrono::steady_clock::time_point end_;  // of the last that is done
};

}  // namespace dr::runtime
