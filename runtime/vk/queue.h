// SPDX-License-Identifier: Apache-2.0
// Submitting command buffers, and waiting for them.
#pragma once

#include <array>
#include <functional>

#include "runtime/vk/device.h"

namespace dr::runtime {

class Queue {
 public:
  explicit Queue(std::shared_ptr<DeviceState> device);
  vk::raii::CommandBuffer command_buffer() const;
  // Submissions run one after the other, and a few may be under way: beyond that, submit() waits for the oldest.
  // What a submission uses must live until finish().
  void submit(const vk::raii::CommandBuffer& commands);
  // Returns when all that was submitted is done. Fails after ten minutes without an end.
  void finish();
  // Records and runs.
  void once(const std::function<void(const vk::raii::CommandBuffer&)>& record);
  // Makes what earlier submissions and the host wrote visible to what follows.
  static void everything_before(const vk::raii::CommandBuffer& commands);
  // Makes what these commands wrote visible to the host.
  static void before_the_host(const vk::raii::CommandBuffer& commands);

 private:
  std::shared_ptr<DeviceState> device_;
  vk::raii::CommandPool pool_{nullptr};
  struct Flight {
    vk::raii::Fence fence{nullptr};
    bool busy = false;
  };
  void wait(Flight& flight);
  static constexpr size_t kFlights = 3;
  std::array<Flight, kFlights> flights_;
  size_t next_ = 0;  // the oldest
};

}  // namespace dr::runtime
