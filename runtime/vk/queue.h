// SPDX-License-Identifier: Apache-2.0
// Submitting command buffers, and waiting for them.
#pragma once

#include <functional>

#include "runtime/vk/device.h"

namespace dr::runtime {

class Queue {
 public:
  explicit Queue(std::shared_ptr<DeviceState> device);
  vk::raii::CommandBuffer command_buffer() const;
  void submit_and_wait(const vk::raii::CommandBuffer& commands);
  // Records and runs.
  void once(const std::function<void(const vk::raii::CommandBuffer&)>& record);
  // Makes what earlier submissions and the host wrote visible to what follows.
  static void everything_before(const vk::raii::CommandBuffer& commands);

 private:
  std::shared_ptr<DeviceState> device_;
  vk::raii::CommandPool pool_{nullptr};
  vk::raii::Fence fence_{nullptr};
};

}  // namespace dr::runtime
