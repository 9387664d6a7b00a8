// SPDX-License-Identifier: Apache-2.0
// Contents of resources from and to the host.
#pragma once

#include <span>

#include "runtime/vk/memory.h"
#include "runtime/vk/queue.h"

namespace dr::runtime {

class Transfer {
 public:
  Transfer(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Sizes& sizes, const Memory& memory,
           Queue& queue)
      : device_(std::move(device)), bundle_(bundle), sizes_(sizes), memory_(memory), queue_(queue) {}
  // Both wait for the device. The array is of the resource's kind and size.
  void upload(uint32_t resource, const io::Array& array);
  io::Array download(uint32_t resource);
  // A buffer of the host that commands may copy so many bytes to, until the next call of anything here; words() are
  // those, when the device is done.
  const vk::raii::Buffer& readback(vk::DeviceSize bytes);
  std::span<const uint32_t> words() const { return {static_cast<const uint32_t*>(staging_data_), staging_bytes_ / 4}; }
  // Bytes of host-visible memory held.
  vk::DeviceSize bytes() const { return staging_memory_.bytes(); }

 private:
  // Host-visible memory of at least that size, mapped.
  void need_staging(vk::DeviceSize bytes);
  // In memory that the host sees.
  const std::byte* staged(const BufferObject::Piece& piece);

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Sizes& sizes_;
  const Memory& memory_;
  Queue& queue_;
  Block staging_memory_;
  vk::raii::Buffer staging_{nullptr};
  vk::DeviceSize staging_bytes_ = 0;
  void* staging_data_ = nullptr;
};

// Copies an image, which shaders can read before and after, to a buffer of four-byte words.
void copy_image(const vk::raii::CommandBuffer& commands, const ImageObject& image, vk::Buffer to);

}  // namespace dr::runtime
