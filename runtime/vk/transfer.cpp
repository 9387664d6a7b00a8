// SPDX-License-Identifier: Apache-2.0
// Staging.
#include "runtime/vk/transfer.h"

#include <cstring>

namespace dr::runtime {

using bundle::Storage;

void Transfer::need_staging(vk::DeviceSize bytes) {
  if (staging_bytes_ >= bytes) return;
  const auto& d = device_->device;
  staging_data_ = nullptr;
  staging_ = vk::raii::Buffer(nullptr);
  staging_memory_ = {};
  staging_bytes_ = 0;
  vk::BufferCreateInfo info;
  info.size = bytes;
  info.usage = vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst;
  staging_ = vk::raii::Buffer(d, info);
  const auto need = staging_.getMemoryRequirements();
  const auto visible = vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
  // Reading back from uncached memory is slow.
  const uint32_t type = device_->memory_type(need.memoryTypeBits, visible, vk::MemoryPropertyFlagBits::eHostCached);
  staging_memory_ = Block(*device_, need.size, type, memory_.tally());
  staging_.bindMemory(*staging_memory_.memory(), 0);
  staging_data_ = staging_memory_.host();
  if (staging_data_ == nullptr) staging_data_ = staging_memory_.memory().mapMemory(0, VK_WHOLE_SIZE);
  staging_bytes_ = bytes;
}

const vk::raii::Buffer& Transfer::readback(vk::DeviceSize bytes) {
  need_staging(bytes);
  return staging_;
}

void Transfer::upload(uint32_t resource, const io::Array& array) {
  const vk::DeviceSize bytes = memory_.buffer(resource).bytes;
  if (static_cast<vk::DeviceSize>(array.scalar_count()) * 4 != bytes)
    throw Failure{"the data of '" + bundle_.resources[resource]->name + "' has another size than its buffer"};
  const BufferObject& buffer = memory_.buffer(resource);
  // Words from the first on, to where the host sees them.
  const auto put = [&](std::byte* to, vk::DeviceSize first, vk::DeviceSize count) {
    if (array.kind == io::ElementKind::Bool) {
      auto* words = reinterpret_cast<uint32_t*>(to);
      for (size_t i = 0; i < count; ++i) words[i] = array.bytes[first + i] != std::byte{0} ? 1 : 0;
    } else {
      std::memcpy(to, array.bytes.data() + 4 * first, 4 * count);
    }
  };
  if (buffer.host != nullptr) {
    queue_.finish();
    return put(buffer.host, 0, bytes / 4);
  }
  for (const BufferObject::Piece& piece : buffer.pieces()) {
    need_staging(piece.bytes);
    put(static_cast<std::byte*>(staging_data_), piece.first / 4, piece.bytes / 4);
    queue_.once([&](const vk::raii::CommandBuffer& c) {
      c.copyBuffer(*staging_, piece.buffer, vk::BufferCopy(0, 0, piece.bytes));
    });
  }
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

const std::byte* Transfer::staged(const BufferObject::Piece& piece) {
  need_staging(piece.bytes);
  queue_.once([&](const vk::raii::CommandBuffer& c) {
    c.copyBuffer(piece.buffer, *staging_, vk::BufferCopy(0, 0, piece.bytes));
  });
  return static_cast<const std::byte*>(staging_data_);
}

namespace {

// Leaves a raster's entries of other epochs empty, and takes away what lies behind (Role::EpochEntries).
void leave_one_epoch(io::Array& entries) {
  const auto elements = static_cast<size_t>(entries.size());
  std::vector<uint32_t> words(entries.bytes.size() / 4);
  std::memcpy(words.data(), entries.bytes.data(), entries.bytes.size());
  const uint32_t epoch = words[2 * elements];
  words.resize(2 * elements);
  for (size_t k = 0; k < words.size(); k += 2)
    if (words[k + 1] >> 28 != epoch) words[k] = words[k + 1] = 0xffffffffu;
  entries.bytes.resize(4 * words.size());
  std::memcpy(entries.bytes.data(), words.data(), entries.bytes.size());
}

}  // namespace

io::Array Transfer::download(uint32_t resource) {
  const bundle::ResourceT& r = *bundle_.resources[resource];
  if (r.storage == Storage::Depth) throw Failure{"'" + r.name + "' is a depth image"};
  if (r.storage == Storage::Tile) throw Failure{"'" + r.name + "' is not kept: make it an output to read it"};
  const int n = is_words(r) ? 1 : components_of(*r.type);
  const Size size = sizes_.size_of(*r.extent, r.name);
  io::Array out = io::Array::zeros(kind_of(*r.type), n, size.w, size.h, size.l);
  // Words from the first on.
  const auto take = [&](const std::byte* from, vk::DeviceSize first, vk::DeviceSize count) {
    if (io::scalar_size(out.kind) == 4) {
      std::memcpy(out.bytes.data() + 4 * first, from, 4 * count);
      return;
    }
    const auto* words = reinterpret_cast<const uint32_t*>(from);
    for (size_t i = 0; i < count; ++i) out.bytes[first + i] = std::byte{words[i] != 0};
  };
  if (r.storage == Storage::Buffer) {
    const BufferObject& buffer = memory_.buffer(resource);
    const bool epochs = r.role == bundle::Role::EpochEntries;
    if (epochs) out.bytes.resize(buffer.bytes);
    if (buffer.host != nullptr) {
      queue_.finish();
      take(buffer.host, 0, buffer.bytes / 4);
    } else {
      for (const BufferObject::Piece& piece : buffer.pieces()) take(staged(piece), piece.first / 4, piece.bytes / 4);
    }
    if (epochs) leave_one_epoch(out);
    return out;
  }
  const int stored = n == 3 ? 4 : n;
  need_staging(static_cast<vk::DeviceSize>(size.count() * stored * 4));
  queue_.once([&](const vk::raii::CommandBuffer& c) { copy_image(c, memory_.image(resource), *staging_); });
  const auto* words = static_cast<const std::byte*>(staging_data_);
  if (stored == n) {
    take(words, 0, static_cast<vk::DeviceSize>(size.count() * n));
    return out;
  }
  for (int64_t e = 0; e < size.count(); ++e)
    take(words + e * stored * 4, static_cast<vk::DeviceSize>(e * n), static_cast<vk::DeviceSize>(n));
  return out;
}

}  // namespace dr::runtime
