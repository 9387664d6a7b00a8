// SPDX-License-Identifier: Apache-2.0
// Creating and placing buffers and images.
#include "runtime/vk/memory.h"

#include <algorithm>
#include <bit>

#include "compiler/backend/bundle/touched.h"
#include "runtime/data/lines.h"

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

namespace {

// Of a buffer of several: bindings begin at places that every device allows.
constexpr vk::DeviceSize kLeastEach = 3 * 256;

}  // namespace

std::vector<BufferObject::Piece> BufferObject::pieces() const {
  std::vector<Piece> out;
  for (size_t k = 0; k < buffers.size(); ++k) out.push_back(piece(k));
  return out;
}

void copy_content(const vk::raii::CommandBuffer& commands, const std::vector<BufferObject::Piece>& from,
                  const std::vector<BufferObject::Piece>& to) {
  for (const BufferObject::Piece& a : from)
    for (const BufferObject::Piece& b : to) {
      const vk::DeviceSize begin = std::max(a.first, b.first), end = std::min(a.first + a.bytes, b.first + b.bytes);
      if (begin < end)
        commands.copyBuffer(a.buffer, b.buffer, vk::BufferCopy(begin - a.first, begin - b.first, end - begin));
    }
}

Memory::Memory(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Sizes& sizes, int64_t limit,
               std::shared_ptr<Tally> tally, bool share, int64_t buffer_limit)
    : device_(std::move(device)),
      bundle_(bundle),
      sizes_(sizes),
      limit_(limit),
      tally_(std::move(tally)),
      allocated_(bundle.resources.size()),
      buffers_(bundle.resources.size()),
      images_(bundle.resources.size()) {
  // Drivers of processors count the bytes of an allocation in an int, and end in a crash beyond what they say that they
  // allow; others are asked.
  most_ = device_->properties.deviceType == vk::PhysicalDeviceType::eCpu ? device_->largest_block : VK_WHOLE_SIZE;
  if (buffer_limit > 0) most_ = std::min(most_, 3 * std::bit_floor(static_cast<vk::DeviceSize>(buffer_limit)));
  most_ = std::max(most_, kLeastEach);
  for (const auto& step : bundle.steps)
    for (const auto& c : step->commands) {
      for (const int k : {c->indirect, c->left})
        if (k >= 0) whole_.insert(static_cast<uint32_t>(k));
      if (c->kind == bundle::CommandKind::Copy &&
          bundle.resources[static_cast<size_t>(c->source)]->storage == Storage::Image)
        whole_.insert(static_cast<uint32_t>(c->target));
    }
  if (!share || !device_->shares_memory) return;
  for (const auto& leaf : bundle.leaves) shared_.insert(bundle.resources[leaf->resource]->slot);
  for (const auto& step : bundle.steps)
    for (const auto& output : step->outputs) shared_.insert(bundle.resources[output->resource]->slot);
  // Of images only copies can be shared.
  for (const auto& r : bundle.resources)
    if (r->storage != Storage::Buffer) shared_.erase(r->slot);
}

// Whether anything is held in it.
bool Memory::has_room(const bundle::ResourceT& r) const {
  const auto room = r.room.empty() ? std::nullopt : ir::Dim::parse(r.room);
  const auto above = room ? room->evaluate(sizes_.symbols()) : std::nullopt;
  return !above || *above > 0;
}

vk::DeviceSize Memory::buffer_bytes(uint32_t k) const {
  const bundle::ResourceT& r = *bundle_.resources[k];
  const Size s = has_room(r) ? sizes_.size_of(*r.extent, "'" + r.name + "'") : Size{};
  const vk::DeviceSize bytes = static_cast<vk::DeviceSize>(s.count() + elements_behind(r)) *
                               static_cast<vk::DeviceSize>(is_words(r) ? 1 : components_of(*r.type)) * 4;
  // Shaders count words in an int.
  constexpr vk::DeviceSize kMostBytes = vk::DeviceSize{kMaxElements} * 4;
  const vk::DeviceSize most =
      whole_.contains(k) ? std::min(kMostBytes, std::max(most_, device_->largest_block)) : kMostBytes;
  if (bytes > most)
    throw DeviceFailure{"'" + r.name + "' takes " + std::to_string(bytes) + " bytes, the device allows " +
                        std::to_string(most) + " for one value"};
  return bytes;
}

void Memory::check_sizes(const std::vector<uint32_t>& resources) const {
  for (const uint32_t k : resources) {
    if (bundle_.resources[k]->storage != Storage::Buffer) continue;
    try {
      buffer_bytes(k);
    } catch (const Failure& failure) {
      throw Failure{failure.message + made_at(k), failure.blame};
    }
  }
}

// The lines behind the commands that write a resource.
std::string Memory::made_at(uint32_t k) const {
  std::vector<std::string> lines;
  for (const auto& step : bundle_.steps)
    for (const auto& command : step->commands) {
      const auto touched = bundle::touched_by(*command);
      if (std::ranges::none_of(touched, [&](const auto& t) { return t.written && t.resource == k; })) continue;
      for (const bundle::Line& line : command->lines) {
        std::string text = bundle_.files[line.file()] + ":" + std::to_string(line.line());
        if (std::ranges::find(lines, text) == lines.end()) lines.push_back(std::move(text));
      }
    }
  return lines.empty() ? "" : "; made at " + few_of(lines);
}

std::vector<vk::MemoryRequirements> Memory::create_buffer(uint32_t k) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  BufferObject& object = buffers_[k];
  object.buffers.clear();  // of a try that failed
  object.bytes = object.each = buffer_bytes(k);
  // Bindings of texels of one to four words have each a power of two of them: so many fit in the buffers.
  if (object.bytes > most_ && !whole_.contains(k)) object.each = 3 * std::bit_floor(most_ / 3);
  std::vector<vk::MemoryRequirements> needs;
  vk::BufferCreateInfo info;
  info.usage = vk::BufferUsageFlagBits::eStorageBuffer | vk::BufferUsageFlagBits::eUniformTexelBuffer |
               vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst |
               vk::BufferUsageFlagBits::eIndirectBuffer;
  const vk::ExternalMemoryBufferCreateInfo outside(vk::ExternalMemoryHandleTypeFlagBits::eOpaqueFd);
  if (shared_.contains(r.slot)) info.pNext = &outside;
  for (vk::DeviceSize first = 0; first == 0 || first < object.bytes; first += object.each) {
    // The last words may be read as a texel of four (bundle.fbs).
    info.size = (std::min(object.each, object.bytes - first) + 15) / 16 * 16;
    try {
      object.buffers.emplace_back(d, info);
    } catch (const vk::SystemError&) {
      throw DeviceFailure{"'" + r.name + "' takes " + std::to_string(info.size) +
                          " bytes, more than the device has in one buffer"};
    }
    device_->name(object.buffers.back(), r.name);
    needs.push_back(object.buffers.back().getMemoryRequirements());
    if (object.each == 0) break;
  }
  return needs;
}

vk::MemoryRequirements Memory::create_image(uint32_t k) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  const Size s = sizes_.size_of(*r.extent, "'" + r.name + "'");
  const auto limit = static_cast<int64_t>(device_->properties.limits.maxImageDimension2D);
  if (s.w > limit || s.h > limit || s.l > static_cast<int64_t>(device_->properties.limits.maxImageArrayLayers))
    throw DeviceFailure{"'" + r.name + "' is an image of " + std::to_string(s.w) + " x " + std::to_string(s.h) + " x " +
                        std::to_string(s.l) + ", the device allows " + std::to_string(limit) + " on a side"};
  vk::ImageCreateInfo info;
  info.imageType = vk::ImageType::e2D;
  const bool depth = r.storage == Storage::Depth;
  info.format = depth ? vk::Format::eD32Sfloat : format_of(*r.type);
  info.extent = vk::Extent3D(static_cast<uint32_t>(s.w), static_cast<uint32_t>(s.h), 1);
  info.mipLevels = 1;
  info.arrayLayers = static_cast<uint32_t>(s.l);
  info.usage = depth ? vk::ImageUsageFlags(vk::ImageUsageFlagBits::eDepthStencilAttachment)
                     : vk::ImageUsageFlagBits::eColorAttachment | vk::ImageUsageFlagBits::eInputAttachment |
                           (r.storage == Storage::Tile
                                ? vk::ImageUsageFlags(vk::ImageUsageFlagBits::eTransientAttachment)
                                : vk::ImageUsageFlagBits::eSampled | vk::ImageUsageFlagBits::eTransferSrc);
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
  std::map<SlotId, Slot> slots;
  for (const uint32_t k : resources) {
    const bundle::ResourceT& r = *bundle_.resources[k];
    const auto needs = r.storage == Storage::Buffer ? create_buffer(k) : std::vector{create_image(k)};
    for (size_t part = 0; part < needs.size(); ++part) {
      const vk::MemoryRequirements& need = needs[part];
      Slot& slot = slots[{r.slot, part}];
      slot.bytes = std::max(slot.bytes, need.size);
      // Buffers and images in one block must not share a page of this granularity.
      slot.alignment = std::max({slot.alignment, need.alignment, device_->properties.limits.bufferImageGranularity});
      slot.allowed &= need.memoryTypeBits;
      slot.of_tiles = r.storage == Storage::Tile;
      slot.shared = shared_.contains(r.slot);
    }
  }
  place(slots, resources);
  for (const uint32_t k : resources) {
    bind(k, slots);
    allocated_[k] = true;
  }
}

// Gives each slot an offset in a block: those that are there already, or new ones.
void Memory::place(std::map<SlotId, Slot>& slots, const std::vector<uint32_t>& resources) {
  std::vector<SlotId> added;
  for (auto& [index, slot] : slots) {
    // What another step's values have may do for this step's too.
    if (const auto it = placed_.find(index); it != placed_.end()) {
      const Slot& has = it->second;
      if (has.bytes >= slot.bytes && has.offset % slot.alignment == 0 && (slot.allowed >> has.type & 1) != 0) {
        slot = has;
        continue;
      }
    }
    // Tiles may need no memory at all: then the device has a kind that it gives out when it must.
    const auto preferred = slot.of_tiles && device_->has_lazy_memory(slot.allowed)
                               ? vk::MemoryPropertyFlagBits::eLazilyAllocated
                               : vk::MemoryPropertyFlagBits::eDeviceLocal;
    slot.type = device_->memory_type(slot.allowed, {}, preferred);
    added.push_back(index);
  }
  make_room(slots, added, resources);
  // Those of one kind stand side by side, in as few blocks as the device makes that large.
  std::vector<std::pair<decltype(Slot().kind()), vk::DeviceSize>> planned;  // kinds and bytes
  std::map<decltype(Slot().kind()), size_t> last;                           // of a kind, in `planned`
  for (const SlotId& index : added) {
    Slot& slot = slots.at(index);
    auto it = last.find(slot.kind());
    const auto offset = [&] {
      return (planned[it->second].second + slot.alignment - 1) / slot.alignment * slot.alignment;
    };
    if (it == last.end() || offset() + slot.bytes > device_->largest_block) {
      it = last.insert_or_assign(slot.kind(), planned.size()).first;
      planned.emplace_back(slot.kind(), 0);
    }
    slot.offset = offset();
    slot.block = blocks_.size() + it->second;
    planned[it->second].second = slot.offset + slot.bytes;
  }
  for (const auto& [kind, bytes] : planned) {
    const auto& [type, of_host, shared] = kind;
    try {
      blocks_.emplace_back(*device_, bytes, type, tally_, shared);
    } catch (const vk::SystemError&) {
      throw DeviceFailure{"the device has no memory for " + std::to_string(bytes) + " bytes; the largest values are " +
                          largest(resources)};
    }
    of_host_.push_back(of_host);
  }
  for (const SlotId& index : added) placed_[index] = slots.at(index);
}

int64_t Memory::room(uint32_t type) const {
  if (limit_ > 0) return limit_ - static_cast<int64_t>(bytes(false));
  const uint32_t heap = device_->memory.memoryTypes[type].heapIndex;
  if (device_->memory_budget) {
    const auto now =
        device_->physical
            .getMemoryProperties2<vk::PhysicalDeviceMemoryProperties2, vk::PhysicalDeviceMemoryBudgetPropertiesEXT>();
    const auto& budget = now.get<vk::PhysicalDeviceMemoryBudgetPropertiesEXT>();
    return static_cast<int64_t>(budget.heapBudget[heap]) - tally_->now;
  }
  return static_cast<int64_t>(device_->memory.memoryHeaps[heap].size) - static_cast<int64_t>(bytes(false));
}

void Memory::make_room(std::map<SlotId, Slot>& slots, std::vector<SlotId>& added,
                       const std::vector<uint32_t>& resources) {
  int64_t missing = 0;
  for (const SlotId& index : added)
    missing += static_cast<int64_t>(slots.at(index).bytes + slots.at(index).alignment - 1);
  if (added.empty()) return;
  missing -= room(slots.at(added.front()).type);
  if (missing <= 0) return;
  struct Candidate {
    bool param, flat;
    double bytes_a_use;
    uint32_t resource;
    auto order() const { return std::tuple(param, flat, -bytes_a_use, resource); }
  };
  std::vector<Candidate> candidates;
  for (const auto& leaf : bundle_.leaves) {
    double bytes = 0;
    for (const SlotId& index : added)
      if (index.first == bundle_.resources[leaf->resource]->slot) bytes += static_cast<double>(slots.at(index).bytes);
    if (bytes == 0) continue;
    int uses = 1;
    for (const auto& step : bundle_.steps)
      for (const auto& c : step->commands)
        uses += static_cast<int>(
            std::ranges::count_if(c->bindings, [&](const auto& b) { return b->resource == leaf->resource; }));
    candidates.push_back({leaf->kind != bundle::LeafKind::Input, sizes_.evaluate(leaf->extent->l, leaf->name) == 1,
                          bytes / uses, leaf->resource});
  }
  std::ranges::sort(candidates, {}, &Candidate::order);
  for (const Candidate& c : candidates) {
    if (missing <= 0) break;
    bool moves = false;
    for (const SlotId& index : added) {
      Slot& slot = slots.at(index);
      if (index.first != bundle_.resources[c.resource]->slot) continue;
      const auto type = device_->host_memory_type(slot.allowed);
      if (!type) continue;
      slot.type = *type;
      slot.of_host = true;
      slot.shared = false;
      moves = true;
      missing -= static_cast<int64_t>(slot.bytes + slot.alignment - 1);
    }
    if (moves) on_host_.push_back(c.resource);
  }
  if (missing > 0 && limit_ > 0)
    throw DeviceFailure{"the program needs " + std::to_string(missing) +
                        " bytes of device memory more than the limit of " + std::to_string(limit_) +
                        "; the largest values are " + largest(resources)};
}

void Memory::bind(uint32_t k, const std::map<SlotId, Slot>& slots) {
  const auto& d = device_->device;
  const bundle::ResourceT& r = *bundle_.resources[k];
  if (r.storage == Storage::Buffer) {
    BufferObject& object = buffers_[k];
    for (size_t part = 0; part < object.buffers.size(); ++part) {
      const Slot& slot = slots.at({r.slot, part});
      object.buffers[part].bindMemory(*blocks_[slot.block].memory(), slot.offset);
    }
    if (object.in_pieces()) return;
    const Slot& slot = slots.at({r.slot, 0});
    if (std::byte* host = blocks_[slot.block].host()) object.host = host + slot.offset;
    if (slot.shared) object.shared = std::pair(slot.block, slot.offset);
    return;
  }
  const Slot& slot = slots.at({r.slot, 0});
  images_[k].image.bindMemory(*blocks_[slot.block].memory(), slot.offset);
  vk::ImageViewCreateInfo view;
  view.image = *images_[k].image;
  const bool depth = r.storage == Storage::Depth;
  view.format = depth ? vk::Format::eD32Sfloat : format_of(*r.type);
  view.subresourceRange = {depth ? vk::ImageAspectFlagBits::eDepth : vk::ImageAspectFlagBits::eColor, 0, 1, 0,
                           static_cast<uint32_t>(images_[k].size.l)};
  view.viewType = vk::ImageViewType::e2DArray;
  images_[k].all = vk::raii::ImageView(d, view);
}

std::string Memory::largest(const std::vector<uint32_t>& resources) const {
  std::vector<std::pair<int64_t, std::string>> all;
  for (const uint32_t k : resources) {
    const bundle::ResourceT& r = *bundle_.resources[k];
    if (!has_room(r)) continue;
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
  if (r.storage == Storage::Tile) return 0;
  const int words = r.storage == Storage::Depth ? 1 : r.type->rows == 3 ? 4 : r.type->rows;
  return images_[resource].size.count() * words * 4;
}

vk::DeviceSize Memory::bytes(bool of_host) const {
  vk::DeviceSize bytes = 0;
  for (size_t k = 0; k < blocks_.size(); ++k)
    if (of_host_[k] == of_host) bytes += blocks_[k].bytes();
  return bytes;
}

bool Memory::has_host() const {
  return std::ranges::any_of(blocks_, [](const Block& block) { return block.host() != nullptr; });
}

void Tally::add(int64_t bytes) {
  const int64_t sum = now += bytes;
  for (int64_t most = peak; most < sum && !peak.compare_exchange_weak(most, sum);) {
  }
}

std::optional<CudaPlace> Memory::in_cuda(size_t resource) {
  const auto& place = buffers_[resource].shared;
  if (!place) return std::nullopt;
  const auto& memory = blocks_[place->first].in_cuda(*device_);
  return CudaPlace{memory->address() + place->second, memory};
}

Block::Block(const DeviceState& device, vk::DeviceSize bytes, uint32_t type, std::shared_ptr<Tally> tally, bool shared)
    : bytes_(bytes), tally_(std::move(tally)) {
  const vk::ExportMemoryAllocateInfo outside(vk::ExternalMemoryHandleTypeFlagBits::eOpaqueFd);
  memory_ = vk::raii::DeviceMemory(device.device, vk::MemoryAllocateInfo(bytes, type, shared ? &outside : nullptr));
  if (device.is_host_memory(type)) host_ = static_cast<std::byte*>(memory_.mapMemory(0, VK_WHOLE_SIZE));
  tally_->add(static_cast<int64_t>(bytes));
}

Block& Block::operator=(Block&& other) noexcept {
  release();
  in_cuda_ = std::move(other.in_cuda_);
  memory_ = std::move(other.memory_);
  bytes_ = other.bytes_;
  host_ = other.host_;
  tally_ = std::move(other.tally_);
  return *this;
}

const std::shared_ptr<CudaMemory>& Block::in_cuda(DeviceState& device) {
  if (!in_cuda_) {
    const int file = device.device.getMemoryFdKHR({*memory_, vk::ExternalMemoryHandleTypeFlagBits::eOpaqueFd});
    in_cuda_ = std::make_shared<CudaMemory>(Cuda::of(device), file, bytes_);
  }
  return in_cuda_;
}

void Block::release() {
  if (!tally_) return;
  in_cuda_.reset();
  memory_ = nullptr;
  tally_->add(-static_cast<int64_t>(bytes_));
  tally_.reset();
}

}  // namespace dr::runtime
