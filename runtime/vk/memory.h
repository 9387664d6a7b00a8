// SPDX-License-Identifier: Apache-2.0
// Device memory of a bundle's resources: buffers and images, placed by the bundle's slots.
#pragma once

#include <algorithm>
#include <atomic>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "runtime/data/sizes.h"
#include "runtime/vk/cuda.h"
#include "runtime/vk/device.h"

namespace dr::runtime {

// Bytes that a program has allocated, on the device and on the host for it, and the most that it ever had.
struct Tally {
  std::atomic<int64_t> now = 0, peak = 0;
  void add(int64_t bytes);
};

// One allocation.
class Block {
 public:
  Block() = default;
  // `shared`: with CUDA.
  Block(const DeviceState& device, vk::DeviceSize bytes, uint32_t type, std::shared_ptr<Tally> tally,
        bool shared = false);
  Block(Block&&) noexcept = default;
  Block& operator=(Block&& other) noexcept;
  ~Block() { release(); }
  const vk::raii::DeviceMemory& memory() const { return memory_; }
  vk::DeviceSize bytes() const { return tally_ ? bytes_ : 0; }
  // Where the host sees it; null where that takes a copy.
  std::byte* host() const { return host_; }
  // What CUDA sees, of one that is shared; made when it is first asked for.
  const std::shared_ptr<CudaMemory>& in_cuda(DeviceState& device);

 private:
  void release();
  std::shared_ptr<CudaMemory> in_cuda_;
  vk::raii::DeviceMemory memory_{nullptr};
  vk::DeviceSize bytes_ = 0;
  std::byte* host_ = nullptr;
  std::shared_ptr<Tally> tally_;  // none: nothing is allocated
};

// The content of a resource: one buffer, or several where it is larger than a buffer may be.
struct BufferObject {
  // A buffer, and which bytes of the content it has.
  struct Piece {
    vk::Buffer buffer;
    vk::DeviceSize first = 0, bytes = 0;
  };
  std::vector<vk::raii::Buffer> buffers;
  vk::DeviceSize bytes = 0;
  vk::DeviceSize each =
      0;  // of them, in a buffer that is not the last; three times a power of two if there are several
  std::byte* host = nullptr;  // where the host sees all of it; null where that takes a copy
  std::optional<std::pair<size_t, vk::DeviceSize>> shared;  // block and offset in it, where CUDA may see it
  // Of what fits in one.
  vk::Buffer first() const { return *buffers.front(); }
  bool in_pieces() const { return buffers.size() > 1; }
  Piece piece(size_t k) const { return {*buffers[k], k * each, std::min(each, bytes - k * each)}; }
  std::vector<Piece> pieces() const;
};

// Copies one to the other, of the same size.
void copy_content(const vk::raii::CommandBuffer& commands, const std::vector<BufferObject::Piece>& from,
                  const std::vector<BufferObject::Piece>& to);

// Where CUDA sees the content of a buffer.
struct CudaPlace {
  uint64_t address = 0;
  std::shared_ptr<CudaMemory> held;
};

struct ImageObject {
  vk::raii::Image image{nullptr};
  vk::raii::ImageView all{nullptr};  // every layer, for reading
  Size size;
};

vk::Format format_of(const bundle::TypeT& type);

class Memory {
 public:
  // Of the device at most `limit` bytes; 0: as many as it has. `share`: leaves and outputs of steps with CUDA.
  // `buffer_limit`: bytes that a binding takes at most, and a third of what a buffer has; 0: as many as on the device.
  Memory(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Sizes& sizes, int64_t limit,
         std::shared_ptr<Tally> tally, bool share = false, int64_t buffer_limit = 0);

  // Creates those that are not there yet. Leaves for which the device has no room stay in memory of the host, which it
  // reads directly: inputs first, those with layers before others, large and seldom used ones before others. Fails, by
  // name, when that is not enough.
  void allocate(const std::vector<uint32_t>& resources);
  // Ends with a Failure where one is larger than a value may be.
  void check_sizes(const std::vector<uint32_t>& resources) const;
  bool has(size_t resource) const { return allocated_[resource]; }
  // Of a resource that has memory, as the bundle lays it out; 0 for a tile, whose content stays in its render pass.
  int64_t content_bytes(size_t resource) const;
  const BufferObject& buffer(size_t resource) const { return buffers_[resource]; }
  const ImageObject& image(size_t resource) const { return images_[resource]; }
  // Of a buffer that has memory; nothing where it is not shared.
  std::optional<CudaPlace> in_cuda(size_t resource);
  // What was allocated, on the device or of the host.
  vk::DeviceSize bytes(bool of_host) const;
  // Whether the host sees some of it without a copy.
  bool has_host() const;
  // Leaves in memory of the host, by resource.
  const std::vector<uint32_t>& on_host() const { return on_host_; }
  const std::shared_ptr<Tally>& tally() const { return tally_; }

 private:
  // The memory of a slot, or of the k-th buffers of its resources; the values of steps that are prepared later use it
  // too if they fit.
  using SlotId = std::pair<uint32_t, size_t>;
  struct Slot {
    vk::DeviceSize bytes = 0, alignment = 1, offset = 0;
    uint32_t allowed = UINT32_MAX, type = 0;
    bool of_host = false, of_tiles = false, shared = false;
    size_t block = 0;
    auto kind() const { return std::tuple(type, of_host, shared); }  // slots of one kind stand in one block
  };
  bool has_room(const bundle::ResourceT& resource) const;
  vk::DeviceSize buffer_bytes(uint32_t resource) const;
  std::vector<vk::MemoryRequirements> create_buffer(uint32_t resource);
  vk::MemoryRequirements create_image(uint32_t resource);
  void place(std::map<SlotId, Slot>& slots, const std::vector<uint32_t>& resources);
  void make_room(std::map<SlotId, Slot>& slots, std::vector<SlotId>& added, const std::vector<uint32_t>& resources);
  // Bytes of a heap that are left.
  int64_t room(uint32_t type) const;
  void bind(uint32_t resource, const std::map<SlotId, Slot>& slots);
  std::string largest(const std::vector<uint32_t>& resources) const;
  std::string made_at(uint32_t resource) const;

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Sizes& sizes_;
  int64_t limit_;
  std::shared_ptr<Tally> tally_;
  vk::DeviceSize most_;          // bytes of a buffer
  std::set<uint32_t> whole_;     // resources that one buffer must have: what commands other than shaders read or write
  std::set<uint32_t> shared_;    // slots
  std::vector<bool> allocated_;  // by resource
  std::vector<BufferObject> buffers_;
  std::vector<ImageObject> images_;
  std::map<SlotId, Slot> placed_;
  std::vector<Block> blocks_;
  std::vector<bool> of_host_;  // by block
  std::vector<uint32_t> on_host_;
};

}  // namespace dr::runtime
