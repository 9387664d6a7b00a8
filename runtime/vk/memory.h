// SPDX-License-Identifier: Apache-2.0
// Device memory of a bundle's resources: buffers and images, placed by the bundle's slots.
#pragma once

#include <map>
#include <vector>

#include "runtime/sizes.h"
#include "runtime/vk/device.h"

namespace dr::runtime {

// Memory of one purpose: several objects in one allocation.
struct Block {
  vk::raii::DeviceMemory memory{nullptr};
  vk::DeviceSize bytes = 0;
};

struct BufferObject {
  vk::raii::Buffer buffer{nullptr};
  vk::DeviceSize bytes = 0;
};

struct ImageObject {
  vk::raii::Image image{nullptr};
  vk::raii::ImageView all{nullptr};         // every layer, for reading
  std::vector<vk::raii::ImageView> layers;  // one each, for attachments
  Size size;
};

vk::Format format_of(const bundle::TypeT& type);

class Memory {
 public:
  Memory(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Sizes& sizes)
      : device_(std::move(device)),
        bundle_(bundle),
        sizes_(sizes),
        allocated_(bundle.resources.size()),
        buffers_(bundle.resources.size()),
        images_(bundle.resources.size()) {}

  // Creates those that are not there yet. Fails, by name, on what the device has no room for.
  void allocate(const std::vector<uint32_t>& resources);
  bool has(size_t resource) const { return allocated_[resource]; }
  // Of a resource that has memory, as the bundle lays it out.
  int64_t content_bytes(size_t resource) const;
  const BufferObject& buffer(size_t resource) const { return buffers_[resource]; }
  const ImageObject& image(size_t resource) const { return images_[resource]; }
  vk::DeviceSize bytes() const;

 private:
  // The memory of a slot; the values of steps that are prepared later use it too if they fit.
  struct Slot {
    vk::DeviceSize bytes = 0, alignment = 1, offset = 0;
    uint32_t allowed = UINT32_MAX, type = 0;
    size_t block = 0;
  };
  vk::MemoryRequirements create_buffer(uint32_t resource);
  vk::MemoryRequirements create_image(uint32_t resource);
  void place(std::map<uint32_t, Slot>& slots, const std::vector<uint32_t>& resources);
  void bind(uint32_t resource, const Slot& slot);
  std::string largest(const std::vector<uint32_t>& resources) const;

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Sizes& sizes_;
  std::vector<bool> allocated_;  // by resource
  std::vector<BufferObject> buffers_;
  std::vector<ImageObject> images_;
  std::map<uint32_t, Slot> placed_;
  std::vector<Block> blocks_;
};

}  // namespace dr::runtime
