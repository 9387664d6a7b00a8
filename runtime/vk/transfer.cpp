// SPDX-License-Identifier: Apache-2.0
// Staging.
#include "runtime/vk/transfer.h"

#include <cstring>

namespace dr::runtime {

using bundle::Storage;

void Transfer::need_staging(vk::DeviceSize bytes) {
  if (staging_.bytes >= bytes) return;
  const auto& d = device_->device;
  staging_data_ = nullptr;
  staging_.buffer = vk::raii::Buffer(nullptr);
  staging_memory_ = {};
  staging_.bytes = 0;
  vk::BufferCreateInfo info;
  info.size = bytes;
  info.usage = vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst;
  staging_.buffer = vk::raii::Buffer(d, info);
  const auto need = staging_.buffer.getMemoryRequirements();
  const auto visible = vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
  // Reading back from uncached memory is slow.
  const uint32_t type = device_->memory_type(need.memoryTypeBits, visible, vk::MemoryPropertyFlagBits::eHostCached);
  staging_memory_ = Block(*device_, need.size, type, memory_.tally());
  staging_.buffer.bindMemory(*staging_memory_.memory(), 0);
  staging_data_ = staging_memory_.host();
  if (staging_data_ == nullptr) staging_data_ = staging_memory_.memory().mapMemory(0, VK_WHOLE_SIZE);
  staging_.bytes = bytes;
}

const vk::raii::Buffer& Transfer::readback(vk::DeviceSize bytes) {
  need_staging(bytes);
  return staging_.buffer;
}

void Transfer::upload(uint32_t resource, const io::Array& array) {
  const vk::DeviceSize bytes = memory_.buffer(resource).bytes;
  if (static_cast<vk::DeviceSize>(array.scalar_count()) * 4 != bytes)
    throw Failure{"the data of '" + bundle_.resources[resource]->name + "' has another size than its buffer"};
  std::byte* to = memory_.buffer(resource).host;
  if (to == nullptr) {
    need_staging(bytes);
    to = static_cast<std::byte*>(staging_data_);
  } else {
    queue_.finish();
  }
  if (array.kind == io::ElementKind::Bool) {
    auto* words = reinterpret_cast<uint32_t*>(to);
    for (size_t i = 0; i < array.bytes.size(); ++i) words[i] = array.bytes[i] != std::byte{0} ? 1 : 0;
  } else {
    std::memcpy(to, array.bytes.data(), array.bytes.size());
  }
  if (memory_.buffer(resource).host != nullptr) return;
  queue_.once([&](const vk::raii::CommandBuffer& c) {
    c.copyBuffer(*staging_.buffer, *memory_.buffer(resource).buffer, vk::BufferCopy(0, 0, bytes));
  });
}

void copy_image(const vk::raii::CommandBuffer& c, const ImageObject& image, vk::Buffer to) {
  const vk::ImageSubresourceRange range(vk::ImageAspectFlagBits::eColor, 0, 1, 0, static_cast<uint32_t>(image.size.l));
  const auto shaders_stages = vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eFragmentShader |
                              vk::PipelineStageFlagBits::eVertexShader;
  vk::ImageMemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite, vk::AccessFlagBits::eTransferRead,
                                 vk::ImageLayout::eShaderReadOnlyOptimal, vk::ImageLayout::eTransferSrcOptimal,
                                 VK_QUEUE_FAMILY_IGNORED, VK_QUEUE_FAMILY_IGNORED, *image.image, range);
  c.pipelineBarrier(
      shaders_stages | vk::PipelineStageFlagBits::eColorAttachmentOutput | vk::PipelineStageFlagBits::eTransfer,
      vk::PipelineStageFlagBits::eTransfer, {}, {}, {}, barrier);
  vk::BufferImageCopy region;
  region.imageSubresource = {vk::ImageAspectFlagBits::eColor, 0, 0, static_cast<uint32_t>(image.size.l)};
  region.imageExtent = vk::Extent3D(static_cast<uint32_t>(image.size.w), static_cast<uint32_t>(image.size.h), 1);
  c.copyImageToBuffer(*image.image, vk::ImageLayout::eTransferSrcOptimal, to, region);
  barrier.srcAccessMask = vk::AccessFlagBits::eTransferRead;
  barrier.dstAccessMask = vk::AccessFlagBits::eShaderRead;
  std::swap(barrier.oldLayout, barrier.newLayout);
  c.pipelineBarrier(vk::PipelineStageFlagBits::eTransfer, shaders_stages, {}, {}, {}, barrier);
}

void Transfer::copy_to_staging(uint32_t resource, vk::DeviceSize bytes) {
  need_staging(bytes);
  queue_.once([&](const vk::raii::CommandBuffer& c) {
    if (bundle_.resources[resource]->storage == Storage::Image)
      copy_image(c, memory_.image(resource), *staging_.buffer);
    else
      c.copyBuffer(*memory_.buffer(resource).buffer, *staging_.buffer, vk::BufferCopy(0, 0, bytes));
  });
}

io::Array Transfer::download(uint32_t resource) {
  const bundle::ResourceT& r = *bundle_.resources[resource];
  if (r.storage == Storage::Depth) throw Failure{"'" + r.name + "' is a depth image"};
  if (r.storage == Storage::Tile) throw Failure{"'" + r.name + "' is not kept: make it an output to read it"};
  const int n = is_words(r) ? 1 : components_of(*r.type);
  const Size size = sizes_.size_of(*r.extent, r.name);
  const bool image = r.storage == Storage::Image;
  const int stored = image && n == 3 ? 4 : n;
  const auto bytes = static_cast<vk::DeviceSize>(size.count() * stored * 4);
  const std::byte* host = image ? nullptr : memory_.buffer(resource).host;
  if (host == nullptr)
    copy_to_staging(resource, bytes);
  else
    queue_.finish();
  io::Array out = io::Array::zeros(kind_of(*r.type), n, size.w, size.h, size.l);
  const auto* words =
      reinterpret_cast<const uint32_t*>(host != nullptr ? host : static_cast<std::byte*>(staging_data_));
  const size_t width = io::scalar_size(out.kind);
  if (width == 4 && stored == n) {
    std::memcpy(out.bytes.data(), words, bytes);
    return out;
  }
  for (int64_t e = 0; e < size.count(); ++e)
    for (int c = 0; c < n; ++c) {
      const uint32_t word = words[e * stored + c];
      std::byte* to = out.bytes.data() + static_cast<size_t>(e * n + c) * width;
      if (width == 1)
        *to = std::byte{word != 0};
      else
        std::memcpy(to, &word, 4);
    }
  return out;
}

}  // namespace dr::runtime
