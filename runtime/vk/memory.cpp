// SPDX-License-Identifier: Apache-2.0
// Creating and placing buffers and images.
#include "runtime/vk/memory.h"

#include <algorithm>

namespace dr::runtime {

using bundle::Storage;

vk::Format format_of(const bundle::TypeT& type) {
  static constexpr vk::Format kFormats[3][3] = {
      {vk::Format::eR32Sfloat, vk::Format::eR32G32Sfloat, vk::Format::eR32G32B32A32Sfloat},
      {vk::Format::eR32Sint, vk::Format::eR32G32Sint, vk::Format::eR32G32B32A32Sint},
      {vk::Format::eR32Uint, vk::Format::eR32G32Uint, vk::Format::eR32G32B32A32Uint}};
  const int scalar = type.scalar == bundle::Scalar::Float ? 0 : type.scalar == bundle::Scalar::Int ? 1 : 2;
  return kFormats[scalar][std::min<int>(type.rows, 3) - 1];
}

vk::MemoryRequirements Memory::create_buffer(uint32_t k) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  const Size s = sizes_.size_of(*r.extent, "'" + r.name + "'");
  const vk::DeviceSize bytes =
      static_cast<vk::DeviceSize>(s.count()) *
      static_cast<vk::DeviceSize>(r.role == bundle::Role::Scratch ? 1 : components_of(*r.type)) * 4;
  if (bytes > device_->properties.limits.maxStorageBufferRange)
    throw Failure{"'" + r.name + "' takes " + std::to_string(bytes) + " bytes, the device allows " +
                  std::to_string(device_->properties.limits.maxStorageBufferRange) + " in one buffer"};
  vk::BufferCreateInfo info;
  info.size = bytes;
  info.usage = vk::BufferUsageFlagBits::eStorageBuffer | vk::BufferUsageFlagBits::eTransferSrc |
               vk::BufferUsageFlagBits::eTransferDst | vk::BufferUsageFlagBits::eIndirectBuffer;
  buffers_[k].buffer = vk::raii::Buffer(d, info);
  buffers_[k].bytes = bytes;
  device_->name(buffers_[k].buffer, r.name);
  return buffers_[k].buffer.getMemoryRequirements();
}

vk::MemoryRequirements Memory::create_image(uint32_t k) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  const Size s = sizes_.size_of(*r.extent, "'" + r.name + "'");
  const auto limit = static_cast<int64_t>(device_->properties.limits.maxImageDimension2D);
  if (s.w > limit || s.h > limit || s.l > static_cast<int64_t>(device_->properties.limits.maxImageArrayLayers))
    throw Failure{"'" + r.name + "' is an image of " + std::to_string(s.w) + " x " + std::to_string(s.h) + " x " +
                  std::to_string(s.l) + ", the device allows " + std::to_string(limit) + " on a side"};
  vk::ImageCreateInfo info;
  info.imageType = vk::ImageType::e2D;
  const bool depth = r.storage == Storage::Depth;
  info.format = depth ? vk::Format::eD32Sfloat : format_of(*r.type);
  info.extent = vk::Extent3D(static_cast<uint32_t>(s.w), static_cast<uint32_t>(s.h), 1);
  info.mipLevels = 1;
  info.arrayLayers = static_cast<uint32_t>(s.l);
  info.usage = depth ? vk::ImageUsageFlags(vk::ImageUsageFlagBits::eDepthStencilAttachment)
                     : vk::ImageUsageFlagBits::eColorAttachment | vk::ImageUsageFlagBits::eSampled |
                           vk::ImageUsageFlagBits::eInputAttachment | vk::ImageUsageFlagBits::eTransferSrc;
  images_[k].image = vk::raii::Image(d, info);
  images_[k].size = s;
  device_->name(images_[k].image, r.name);
  return images_[k].image.getMemoryRequirements();
}

void Memory::allocate(const std::vector<uint32_t>& wanted) {
  std::vector<uint32_t> resources;
  for (const uint32_t r : wanted)
    if (!allocated_[r]) resources.push_back(r);
  if (resources.empty()) return;
  // Sizes of the slots first, then their offsets, then one allocation a memory type.
  std::map<uint32_t, Slot> slots;
  for (const uint32_t k : resources) {
    const bundle::ResourceT& r = *bundle_.resources[k];
    const vk::MemoryRequirements need = r.storage == Storage::Buffer ? create_buffer(k) : create_image(k);
    Slot& slot = slots[r.slot];
    slot.bytes = std::max(slot.bytes, need.size);
    // Buffers and images in one block must not share a page of this granularity.
    slot.alignment = std::max({slot.alignment, need.alignment, device_->properties.limits.bufferImageGranularity});
    slot.allowed &= need.memoryTypeBits;
  }
  place(slots, resources);
  for (const uint32_t k : resources) {
    bind(k, slots.at(bundle_.resources[k]->slot));
    allocated_[k] = true;
  }
}

// Gives each slot an offset in a block: those that are there already, or new ones.
void Memory::place(std::map<uint32_t, Slot>& slots, const std::vector<uint32_t>& resources) {
  std::map<uint32_t, vk::DeviceSize> sizes;  // by memory type
  std::vector<uint32_t> added;
  for (auto& [index, slot] : slots) {
    // What another step's values have may do for this step's too.
    if (const auto it = placed_.find(index); it != placed_.end()) {
      const Slot& has = it->second;
      if (has.bytes >= slot.bytes && has.offset % slot.alignment == 0 && (slot.allowed >> has.type & 1) != 0) {
        slot = has;
        continue;
      }
    }
    slot.type = device_->memory_type(slot.allowed, {}, vk::MemoryPropertyFlagBits::eDeviceLocal);
    vk::DeviceSize& size = sizes[slot.type];
    slot.offset = (size + slot.alignment - 1) / slot.alignment * slot.alignment;
    size = slot.offset + slot.bytes;
    added.push_back(index);
  }
  std::map<uint32_t, size_t> block_of;
  for (const auto& [type, bytes] : sizes) {
    Block block;
    block.bytes = bytes;
    try {
      block.memory = vk::raii::DeviceMemory(device_->device, vk::MemoryAllocateInfo(bytes, type));
    } catch (const vk::SystemError&) {
      throw Failure{"the device has no memory for " + std::to_string(bytes) + " bytes; the largest values are " +
                    largest(resources)};
    }
    block_of[type] = blocks_.size();
    blocks_.push_back(std::move(block));
  }
  for (uint32_t index : added) {
    slots[index].block = block_of[slots[index].type];
    placed_[index] = slots[index];
  }
}

void Memory::bind(uint32_t k, const Slot& slot) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  const vk::DeviceMemory memory = *blocks_[slot.block].memory;
  if (r.storage == Storage::Buffer) {
    buffers_[k].buffer.bindMemory(memory, slot.offset);
    return;
  }
  images_[k].image.bindMemory(memory, slot.offset);
  vk::ImageViewCreateInfo view;
  view.image = *images_[k].image;
  const bool depth = r.storage == Storage::Depth;
  view.format = depth ? vk::Format::eD32Sfloat : format_of(*r.type);
  view.subresourceRange = {depth ? vk::ImageAspectFlagBits::eDepth : vk::ImageAspectFlagBits::eColor, 0, 1, 0,
                           static_cast<uint32_t>(images_[k].size.l)};
  view.viewType = vk::ImageViewType::e2DArray;
  images_[k].all = vk::raii::ImageView(d, view);
  view.viewType = vk::ImageViewType::e2D;
  view.subresourceRange.layerCount = 1;
  for (uint32_t l = 0; l < static_cast<uint32_t>(images_[k].size.l); ++l) {
    view.subresourceRange.baseArrayLayer = l;
    images_[k].layers.emplace_back(d, view);
  }
}

std::string Memory::largest(const std::vector<uint32_t>& resources) const {
  std::vector<std::pair<int64_t, std::string>> all;
  for (const uint32_t k : resources) {
    const bundle::ResourceT& r = *bundle_.resources[k];
    const Size s = sizes_.size_of(*r.extent, r.name);
    all.emplace_back(-s.count() * components_of(*r.type) * 4, r.name);
  }
  std::sort(all.begin(), all.end());
  std::string text;
  for (size_t k = 0; k < std::min<size_t>(3, all.size()); ++k)
    text += (k ? ", " : "") + all[k].second + " (" + std::to_string(-all[k].first) + ")";
  return text;
}

int64_t Memory::content_bytes(size_t resource) const {
  const bundle::ResourceT& r = *bundle_.resources[resource];
  if (r.storage == Storage::Buffer) return static_cast<int64_t>(buffers_[resource].bytes);
  const int words = r.storage == Storage::Depth ? 1 : r.type->rows == 3 ? 4 : r.type->rows;
  return images_[resource].size.count() * words * 4;
}

vk::DeviceSize Memory::bytes() const {
  vk::DeviceSize bytes = 0;
  for (const Block& b : blocks_) bytes += b.bytes;
  return bytes;
}

}  // namespace dr::runtime
