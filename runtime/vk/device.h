// SPDX-License-Identifier: Apache-2.0
// A Vulkan device and what every program on it shares. Private to the runtime: it includes vulkan_raii.hpp.
#pragma once

#include <array>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>
#include <vulkan/vulkan_raii.hpp>

#include "runtime/data/failure.h"
#include "runtime/runtime.h"

namespace dr::runtime {

class Cuda;

// One that is submitted to, and the family that command buffers are allocated for.
struct DeviceQueue {
  vk::raii::Queue queue{nullptr};
  uint32_t family = 0;
  uint32_t timestamp_bits = 0;  // 0: it has no timestamps
};

struct DeviceState {
  vk::raii::Context context;
  vk::raii::Instance instance{nullptr};
  vk::raii::DebugUtilsMessengerEXT messenger{nullptr};
  vk::raii::PhysicalDevice physical{nullptr};
  vk::raii::Device device{nullptr};
  DeviceQueue graphics;  // and compute
  // For what never draws: the same one, or one that cannot draw. On an H200 a command waits less for the one before it
  // there, and a submission takes some six microseconds less to begin and to end.
  DeviceQueue compute;
  bool pipeline_statistics = false;  // whether it counts what shaders run for
  vk::PhysicalDeviceProperties properties;
  vk::PhysicalDeviceMemoryProperties memory;
  uint32_t multiview_views = 0;      // that one render pass may draw; 0: no multiview
  vk::DeviceSize largest_block = 0;  // bytes that one allocation may have
  bool memory_budget = false;        // the device says how much memory is left
  bool int64 = false, int64_atomics = false, float_atomics = false, subgroup_arithmetic = false,
       subgroup_shuffle = false, debug_names = false,
       shader_statistics = false;  // drivers tell what shaders take, and are asked
  std::mutex queue_lock;           // one thread at a time may submit
  // Whether memory and semaphores may be shared with CUDA, whose device has this UUID; and it, when it was opened.
  bool shares_memory = false;
  std::array<uint8_t, VK_UUID_SIZE> uuid = {};
  std::mutex cuda_lock;
  std::shared_ptr<Cuda> cuda;
  std::mutex messages_lock;
  std::vector<std::string> messages;  // of the validation layer

  // Whether memory of this kind is the host's own, as that of devices that are its processor: it may stay mapped.
  bool is_host_memory(uint32_t type) const;
  uint32_t memory_type(uint32_t allowed, vk::MemoryPropertyFlags wanted, vk::MemoryPropertyFlags preferred) const;
  // Whether one that is allowed is given out only when it must be, for attachments that need not leave the chip.
  bool has_lazy_memory(uint32_t allowed) const;
  // Of the host, for what the device reads directly; nothing where there is none that is allowed.
  std::optional<uint32_t> host_memory_type(uint32_t allowed) const;
  template <class Handle>
  void name(const Handle& handle, const std::string& text) {
    if (!debug_names) return;
    vk::DebugUtilsObjectNameInfoEXT info;
    info.objectType = Handle::objectType;
    info.objectHandle = reinterpret_cast<uint64_t>(static_cast<typename Handle::CType>(*handle));
    info.pObjectName = text.c_str();
    device.setDebugUtilsObjectNameEXT(info);
  }
};

std::shared_ptr<DeviceState> open_device(const DeviceOptions& options);

}  // namespace dr::runtime
