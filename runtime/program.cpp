// SPDX-License-Identifier: Apache-2.0
// The executor: a bundle's tables become Vulkan objects, a step's commands are recorded once and submitted as
// often as the step runs. There is no policy here: order, resources and sizes are the bundle's.
#include <algorithm>
#include <cstring>
#include <functional>
#include <map>
#include <optional>
#include <set>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/dim.h"
#include "runtime/topology.h"
#include "runtime/vk/barrier.h"
#include "runtime/vk/device.h"

namespace dr::runtime {

namespace {

using bundle::CommandKind;
using bundle::Storage;

constexpr int64_t kMaxElements = int64_t{1} << 31;

vk::Format format_of(const bundle::TypeT& type) {
  static constexpr vk::Format kFormats[3][3] = {
      {vk::Format::eR32Sfloat, vk::Format::eR32G32Sfloat, vk::Format::eR32G32B32A32Sfloat},
      {vk::Format::eR32Sint, vk::Format::eR32G32Sint, vk::Format::eR32G32B32A32Sint},
      {vk::Format::eR32Uint, vk::Format::eR32G32Uint, vk::Format::eR32G32B32A32Uint}};
  const int scalar = type.scalar == bundle::Scalar::Float ? 0 : type.scalar == bundle::Scalar::Int ? 1 : 2;
  return kFormats[scalar][std::min<int>(type.rows, 3) - 1];
}

int components_of(const bundle::TypeT& type) { return type.rows * type.cols; }

io::ElementKind kind_of(const bundle::TypeT& type) {
  switch (type.scalar) {
    case bundle::Scalar::Bool: return io::ElementKind::Bool;
    case bundle::Scalar::Int: return io::ElementKind::Int32;
    case bundle::Scalar::Uint: return io::ElementKind::UInt32;
    case bundle::Scalar::Float: break;
  }
  return io::ElementKind::Float32;
}

std::string extent_text(const bundle::ExtentT& e) { return "[" + e.w + ", " + e.h + ", " + e.l + "]"; }

struct Size {
  int64_t w = 1, h = 1, l = 1;
  int64_t count() const { return w * h * l; }
};

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

struct Recorded {
  vk::raii::CommandBuffer commands{nullptr};
  int count = 0;
};

// Everything a recorded command keeps alive.
struct Objects {
  std::vector<vk::raii::DescriptorSetLayout> set_layouts;
  std::vector<vk::raii::PipelineLayout> layouts;
  std::vector<vk::raii::Pipeline> pipelines;
  std::vector<vk::raii::RenderPass> render_passes;
  std::vector<vk::raii::Framebuffer> framebuffers;
  std::vector<vk::raii::DescriptorPool> pools;
  std::vector<vk::raii::DescriptorSet> sets;
};

// One primitive to record: what it touches, and how.
struct Primitive {
  std::string label;
  std::vector<Access> accesses;
  std::function<void(const vk::raii::CommandBuffer&)> record;
};

struct StepState {
  std::optional<Recorded> recorded;
  int64_t runs = 0;
};

}  // namespace

struct Program::State {
  std::shared_ptr<DeviceState> device;
  bundle::BundleT bundle;
  ir::SymbolValues symbols;
  std::map<std::string, std::string, std::less<>> symbol_origin;
  std::vector<std::optional<io::Array>> pending;  // by leaf: bound, but without memory on the device yet
  std::vector<bool> allocated;                    // by resource
  std::map<size_t, io::Array> new_faces;          // by leaf: bound since tables were made of them

  std::vector<BufferObject> buffers;  // by resource, empty for images
  std::vector<ImageObject> images;
  // The memory of a slot; the values of steps that are prepared later use it too if they fit.
  struct Slot {
    vk::DeviceSize bytes = 0, alignment = 1, offset = 0;
    uint32_t allowed = UINT32_MAX, type = 0;
    size_t block = 0;
  };
  std::map<uint32_t, Slot> placed;
  std::vector<Block> blocks;
  vk::raii::CommandPool command_pool{nullptr};
  vk::raii::Fence fence{nullptr};
  std::vector<vk::raii::ShaderModule> shaders;
  BufferObject staging;
  Block staging_memory;
  void* staging_data = nullptr;
  Objects objects;
  std::vector<StepState> steps;
  std::vector<int32_t> specialization;
  // The destructor runs after the members above are gone in reverse order; the device outlives them by the shared
  // pointer.

  const vk::raii::Device& vk_device() const { return device->device; }

  int64_t evaluate(const std::string& expression, const std::string& what) const {
    const auto dim = ir::Dim::parse(expression);
    const auto value = dim ? dim->evaluate(symbols) : std::nullopt;
    if (!value) throw Failure{"the extent '" + expression + "' of " + what + " has no value: bind its symbols"};
    if (*value < 1 || *value > kMaxElements)
      throw Failure{"the extent '" + expression + "' of " + what + " is " + std::to_string(*value) +
                    ", which is not between 1 and 2^31"};
    return *value;
  }
  Size size_of(const bundle::ExtentT& e, const std::string& what) const {
    const Size s{evaluate(e.w, what), evaluate(e.h, what), evaluate(e.l, what)};
    if (s.w > kMaxElements / s.h || s.w * s.h > kMaxElements / s.l)
      throw Failure{what + " has more than 2^31 elements"};
    return s;
  }

  int leaf_index(const std::string& name) const {
    for (size_t k = 0; k < bundle.leaves.size(); ++k)
      if (bundle.leaves[k]->name == name) return static_cast<int>(k);
    std::string all;
    for (const auto& l : bundle.leaves) all += (all.empty() ? "" : ", ") + l->name;
    throw Failure{"there is no leaf '" + name + "'; there are: " + all};
  }
  int step_index(const std::string& name) const {
    for (size_t k = 0; k < bundle.steps.size(); ++k)
      if (bundle.steps[k]->name == name) return static_cast<int>(k);
    std::string all;
    for (const auto& s : bundle.steps) all += (all.empty() ? "" : ", ") + s->name;
    throw Failure{"there is no step '" + name + "'; there are: " + all};
  }

  void set_symbol(const std::string& symbol, int64_t value, const std::string& origin) {
    const auto it = symbols.find(symbol);
    if (it == symbols.end()) {
      symbols[symbol] = value;
      symbol_origin[symbol] = origin;
    } else if (it->second != value) {
      throw Failure{"'" + symbol + "' is " + std::to_string(it->second) + " by " + symbol_origin[symbol] + ", but " +
                    std::to_string(value) + " by " + origin};
    }
  }

  void bind(const std::string& name, const io::Array& data) {
    const auto index = static_cast<size_t>(leaf_index(name));
    const bundle::LeafT& leaf = *bundle.leaves[index];
    if (leaf.table_of >= 0)
      throw Failure{"leaf '" + name + "' is made from '" + bundle.leaves[static_cast<size_t>(leaf.table_of)]->name +
                    "'; bind that instead"};
    assign(index, data);
  }

  // Tables of topologies whose faces were bound.
  void make_tables() {
    for (const auto& [leaf, data] : std::exchange(new_faces, {})) {
      const auto tables = topology_tables(bundle, leaf, data, symbols);
      if (!tables) throw Failure{tables.error()};
      for (const auto& [table, numbers] : *tables) assign(table, numbers);
    }
  }

  void assign(size_t index, const io::Array& data) {
    const bundle::LeafT& leaf = *bundle.leaves[index];
    const std::string origin = "leaf '" + leaf.name + "'";
    if (data.components != components_of(*leaf.type))
      throw Failure{origin + " has " + std::to_string(components_of(*leaf.type)) +
                    " components an element, the data has " + std::to_string(data.components)};
    auto converted = data.converted(kind_of(*leaf.type));
    if (!converted) throw Failure{origin + ": " + converted.error()};
    const std::pair<const std::string*, int64_t> axes[] = {
        {&leaf.extent->w, data.width}, {&leaf.extent->h, data.height}, {&leaf.extent->l, data.layers}};
    const char* const axis_names[] = {"width", "height", "number of layers"};
    for (size_t a = 0; a < 3; ++a) {
      const auto dim = ir::Dim::parse(*axes[a].first);
      if (const auto symbol = dim->as_symbol())
        set_symbol(*symbol, axes[a].second, origin);
      else if (const auto value = dim->evaluate(symbols); value && *value != axes[a].second)
        throw Failure{origin + " has a " + axis_names[a] + " of " + std::to_string(axes[a].second) + ", expected " +
                      *axes[a].first + " = " + std::to_string(*value)};
    }
    if (std::ranges::any_of(bundle.leaves, [&](const auto& l) { return l->table_of == static_cast<int>(index); }))
      new_faces.insert_or_assign(index, *converted);
    if (has_memory(leaf.resource))
      upload(leaf.resource, *converted);
    else
      pending[index] = std::move(converted).value();
  }

  bool has_memory(size_t resource) const { return resource < allocated.size() && allocated[resource]; }

  // What does not wait for sizes.
  void create_objects() {
    if (!device) throw Failure{"the program was loaded without a device"};
    if (!allocated.empty()) return;
    allocated.resize(bundle.resources.size());
    buffers.resize(bundle.resources.size());
    images.resize(bundle.resources.size());
    steps.resize(bundle.steps.size());
    const auto& d = vk_device();
    command_pool = vk::raii::CommandPool(
        d, vk::CommandPoolCreateInfo(vk::CommandPoolCreateFlagBits::eResetCommandBuffer, device->family));
    fence = vk::raii::Fence(d, vk::FenceCreateInfo());
    for (const auto& s : bundle.shaders) {
      vk::ShaderModuleCreateInfo info;
      info.setCode(s->spirv);
      shaders.emplace_back(d, info);
      device->name(shaders.back(), s->name);
    }
  }

  bool is_bound(size_t leaf) const {
    const bundle::LeafT& l = *bundle.leaves[leaf];
    return pending[leaf] || has_memory(l.resource) || !l.initial.empty() || l.kind == bundle::LeafKind::State;
  }

  // What a command touches, in memory of its own.
  static void collect(const bundle::CommandT& c, std::set<uint32_t>& out) {
    for (const auto& b : c.bindings) out.insert(b->resource);
    out.insert(c.colors.begin(), c.colors.end());
    for (const int index : {c.depth, c.source, c.target, c.scratch_a, c.scratch_b})
      if (index >= 0) out.insert(static_cast<uint32_t>(index));
  }

  // Memory and contents for a step: what only other steps need may stay unbound.
  void prepare(const bundle::StepT& step) {
    create_objects();
    make_tables();
    std::string missing;
    size_t count = 0;
    for (const uint32_t k : step.leaves)
      if (!is_bound(k)) {
        const int faces = bundle.leaves[k]->table_of;
        const bundle::LeafT& leaf = *bundle.leaves[faces >= 0 ? static_cast<uint32_t>(faces) : k];
        if (missing.find("'" + leaf.name + "' ") != std::string::npos) continue;
        missing += (count++ == 0 ? "" : ", ") + ("'" + leaf.name + "' " + extent_text(*leaf.extent));
      }
    if (count > 0)
      throw Failure{std::string("step '") + step.name + "' needs data for " + (count == 1 ? "leaf " : "leaves ") +
                    missing + (count == 1 ? ", which is not bound" : ", which are not bound")};
    for (const std::string& symbol : step.symbols)
      if (symbols.count(symbol) == 0)
        throw Failure{"symbol '" + symbol + "' has no value: bind a leaf that has it, or the symbol itself"};
    // A symbol without a value stands in no shader of the step in a way that matters; later steps are recorded later.
    specialization.clear();
    for (const std::string& s : bundle.symbols) {
      const auto it = symbols.find(s);
      const int64_t value = it == symbols.end() ? 1 : it->second;
      if (value < 1 || value >= kMaxElements) throw Failure{"symbol '" + s + "' is " + std::to_string(value)};
      specialization.push_back(static_cast<int32_t>(value));
    }
    std::set<uint32_t> resources;
    for (const auto& c : step.commands) collect(*c, resources);
    for (const auto& o : step.outputs) resources.insert(o->resource);
    for (const auto& p : step.pins) resources.insert(p->resource);
    for (const auto& r : step.rasters) resources.insert(r->resources.begin(), r->resources.end());
    for (const uint32_t k : step.leaves) resources.insert(bundle.leaves[k]->resource);
    if (step.step_index >= 0) resources.insert(static_cast<uint32_t>(step.step_index));
    give_memory(resources);
  }

  void prepare_leaf(size_t leaf) {
    create_objects();
    if (!is_bound(leaf)) throw Failure{"leaf '" + bundle.leaves[leaf]->name + "' is not bound"};
    give_memory({bundle.leaves[leaf]->resource});
  }

  // Allocates those that have no memory yet, and fills the leaves among them.
  void give_memory(const std::set<uint32_t>& wanted) {
    std::vector<uint32_t> resources;
    for (const uint32_t r : wanted)
      if (!allocated[r]) resources.push_back(r);
    if (resources.empty()) return;
    std::vector<size_t> leaves;
    for (size_t k = 0; k < bundle.leaves.size(); ++k)
      if (std::find(resources.begin(), resources.end(), bundle.leaves[k]->resource) != resources.end())
        leaves.push_back(k);
    for (const size_t k : leaves)
      if (pending[k]) {
        const Size s = size_of(*bundle.leaves[k]->extent, "leaf '" + bundle.leaves[k]->name + "'");
        const io::Array& data = *pending[k];
        if (data.width != s.w || data.height != s.h || data.layers != s.l)
          throw Failure{"leaf '" + bundle.leaves[k]->name + "' has data of " + std::to_string(data.width) + " x " +
                        std::to_string(data.height) + " x " + std::to_string(data.layers) + ", expected " +
                        std::to_string(s.w) + " x " + std::to_string(s.h) + " x " + std::to_string(s.l)};
      }
    allocate(resources);
    for (const uint32_t r : resources) allocated[r] = true;
    for (const size_t k : leaves) {
      const bundle::LeafT& leaf = *bundle.leaves[k];
      if (pending[k]) {
        upload(leaf.resource, *pending[k]);
        pending[k].reset();
        continue;
      }
      const Size s = size_of(*leaf.extent, "leaf '" + leaf.name + "'");
      const int n = components_of(*leaf.type);
      std::vector<double> values(static_cast<size_t>(s.count() * n), 0.0);
      if (!leaf.initial.empty())
        for (size_t i = 0; i < values.size(); ++i) values[i] = leaf.initial[i % static_cast<size_t>(n)];
      auto array = io::Array::from_doubles(values, n, s.w, s.h, s.l).converted(kind_of(*leaf.type));
      if (!array) throw Failure{"leaf '" + leaf.name + "': " + array.error()};
      upload(leaf.resource, *array);
    }
  }

  vk::DeviceSize buffer_bytes(const bundle::ResourceT& r) const {
    const Size s = size_of(*r.extent, "'" + r.name + "'");
    return static_cast<vk::DeviceSize>(s.count()) *
           static_cast<vk::DeviceSize>(r.role == bundle::Role::Scratch ? 1 : components_of(*r.type)) * 4;
  }

  void allocate(const std::vector<uint32_t>& resources) {
    const auto& d = vk_device();
    // Sizes of the slots first, then their offsets, then one allocation a memory type.
    std::map<uint32_t, Slot> slots;
    for (const uint32_t k : resources) {
      const bundle::ResourceT& r = *bundle.resources[k];
      vk::MemoryRequirements need;
      if (r.storage == Storage::Buffer) {
        const vk::DeviceSize bytes = buffer_bytes(r);
        if (bytes > device->properties.limits.maxStorageBufferRange)
          throw Failure{"'" + r.name + "' takes " + std::to_string(bytes) + " bytes, the device allows " +
                        std::to_string(device->properties.limits.maxStorageBufferRange) + " in one buffer"};
        vk::BufferCreateInfo info;
        info.size = bytes;
        info.usage = vk::BufferUsageFlagBits::eStorageBuffer | vk::BufferUsageFlagBits::eTransferSrc |
                     vk::BufferUsageFlagBits::eTransferDst;
        buffers[k].buffer = vk::raii::Buffer(d, info);
        buffers[k].bytes = bytes;
        device->name(buffers[k].buffer, r.name);
        need = buffers[k].buffer.getMemoryRequirements();
      } else {
        const Size s = size_of(*r.extent, "'" + r.name + "'");
        const auto limit = static_cast<int64_t>(device->properties.limits.maxImageDimension2D);
        if (s.w > limit || s.h > limit || s.l > static_cast<int64_t>(device->properties.limits.maxImageArrayLayers))
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
        images[k].image = vk::raii::Image(d, info);
        images[k].size = s;
        device->name(images[k].image, r.name);
        need = images[k].image.getMemoryRequirements();
      }
      Slot& slot = slots[r.slot];
      slot.bytes = std::max(slot.bytes, need.size);
      // Buffers and images in one block must not share a page of this granularity.
      slot.alignment = std::max({slot.alignment, need.alignment, device->properties.limits.bufferImageGranularity});
      slot.allowed &= need.memoryTypeBits;
    }
    std::map<uint32_t, vk::DeviceSize> sizes;  // by memory type
    std::vector<uint32_t> added;
    for (auto& [index, slot] : slots) {
      // What another step's values have may do for this step's too.
      if (const auto it = placed.find(index); it != placed.end()) {
        const Slot& has = it->second;
        if (has.bytes >= slot.bytes && has.offset % slot.alignment == 0 && (slot.allowed >> has.type & 1) != 0) {
          slot = has;
          continue;
        }
      }
      slot.type = device->memory_type(slot.allowed, {}, vk::MemoryPropertyFlagBits::eDeviceLocal);
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
        block.memory = vk::raii::DeviceMemory(d, vk::MemoryAllocateInfo(bytes, type));
      } catch (const vk::SystemError&) {
        throw Failure{"the device has no memory for " + std::to_string(bytes) + " bytes; the largest values are " +
                      largest_resources(resources)};
      }
      block_of[type] = blocks.size();
      blocks.push_back(std::move(block));
    }
    for (uint32_t index : added) {
      slots[index].block = block_of[slots[index].type];
      placed[index] = slots[index];
    }
    for (const uint32_t k : resources) {
      const bundle::ResourceT& r = *bundle.resources[k];
      const Slot& slot = slots.at(r.slot);
      const vk::DeviceMemory memory = *blocks[slot.block].memory;
      if (r.storage == Storage::Buffer) {
        buffers[k].buffer.bindMemory(memory, slot.offset);
        continue;
      }
      images[k].image.bindMemory(memory, slot.offset);
      vk::ImageViewCreateInfo view;
      view.image = *images[k].image;
      const bool depth = r.storage == Storage::Depth;
      view.format = depth ? vk::Format::eD32Sfloat : format_of(*r.type);
      view.subresourceRange = {depth ? vk::ImageAspectFlagBits::eDepth : vk::ImageAspectFlagBits::eColor, 0, 1, 0,
                               static_cast<uint32_t>(images[k].size.l)};
      view.viewType = vk::ImageViewType::e2DArray;
      images[k].all = vk::raii::ImageView(d, view);
      view.viewType = vk::ImageViewType::e2D;
      view.subresourceRange.layerCount = 1;
      for (uint32_t l = 0; l < static_cast<uint32_t>(images[k].size.l); ++l) {
        view.subresourceRange.baseArrayLayer = l;
        images[k].layers.emplace_back(d, view);
      }
    }
  }

  std::string largest_resources(const std::vector<uint32_t>& resources) const {
    std::vector<std::pair<int64_t, std::string>> all;
    for (const uint32_t k : resources) {
      const bundle::ResourceT& r = *bundle.resources[k];
      const Size s = size_of(*r.extent, r.name);
      all.emplace_back(-s.count() * components_of(*r.type) * 4, r.name);
    }
    std::sort(all.begin(), all.end());
    std::string text;
    for (size_t k = 0; k < std::min<size_t>(3, all.size()); ++k)
      text += (k ? ", " : "") + all[k].second + " (" + std::to_string(-all[k].first) + ")";
    return text;
  }

  // Host-visible memory of at least that size, mapped.
  void need_staging(vk::DeviceSize bytes) {
    if (staging.bytes >= bytes) return;
    const auto& d = vk_device();
    staging_data = nullptr;
    staging.buffer = vk::raii::Buffer(nullptr);
    staging_memory.memory = vk::raii::DeviceMemory(nullptr);
    vk::BufferCreateInfo info;
    info.size = bytes;
    info.usage = vk::BufferUsageFlagBits::eTransferSrc | vk::BufferUsageFlagBits::eTransferDst;
    staging.buffer = vk::raii::Buffer(d, info);
    staging.bytes = bytes;
    const auto need = staging.buffer.getMemoryRequirements();
    const auto visible = vk::MemoryPropertyFlagBits::eHostVisible | vk::MemoryPropertyFlagBits::eHostCoherent;
    // Reading back from uncached memory is slow.
    const uint32_t type = device->memory_type(need.memoryTypeBits, visible, vk::MemoryPropertyFlagBits::eHostCached);
    staging_memory.memory = vk::raii::DeviceMemory(d, vk::MemoryAllocateInfo(need.size, type));
    staging_memory.bytes = need.size;
    staging.buffer.bindMemory(*staging_memory.memory, 0);
    staging_data = staging_memory.memory.mapMemory(0, VK_WHOLE_SIZE);
  }

  void submit_and_wait(const vk::raii::CommandBuffer& commands) {
    vk::SubmitInfo submit;
    const vk::CommandBuffer handle = *commands;
    submit.setCommandBuffers(handle);
    device->queue.submit(submit, *fence);
    constexpr uint64_t kSecond = 1'000'000'000;
    if (vk_device().waitForFences(*fence, VK_TRUE, 600 * kSecond) != vk::Result::eSuccess) {
      vk_device().waitIdle();  // what the device still uses must not be freed under it
      throw Failure{"the device did not finish within ten minutes"};
    }
    vk_device().resetFences(*fence);
  }

  void once(const std::function<void(const vk::raii::CommandBuffer&)>& record) {
    auto commands =
        std::move(vk::raii::CommandBuffers(
                      vk_device(), vk::CommandBufferAllocateInfo(*command_pool, vk::CommandBufferLevel::ePrimary, 1))
                      .front());
    commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eOneTimeSubmit));
    everything_before(commands);
    record(commands);
    commands.end();
    submit_and_wait(commands);
  }

  // Makes what earlier submissions and the host wrote visible to what follows.
  static void everything_before(const vk::raii::CommandBuffer& commands) {
    const auto stages = vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eAllGraphics |
                        vk::PipelineStageFlagBits::eTransfer;
    const vk::MemoryBarrier barrier(vk::AccessFlagBits::eMemoryWrite,
                                    vk::AccessFlagBits::eMemoryRead | vk::AccessFlagBits::eMemoryWrite);
    commands.pipelineBarrier(stages, stages, {}, barrier, {}, {});
  }

  void upload(uint32_t resource, const io::Array& array) {
    const vk::DeviceSize bytes = buffers[resource].bytes;
    if (static_cast<vk::DeviceSize>(array.scalar_count()) * 4 != bytes)
      throw Failure{"the data of '" + bundle.resources[resource]->name + "' has another size than its buffer"};
    need_staging(bytes);
    if (array.kind == io::ElementKind::Bool) {
      auto* words = static_cast<uint32_t*>(staging_data);
      for (size_t i = 0; i < array.bytes.size(); ++i) words[i] = array.bytes[i] != std::byte{0} ? 1 : 0;
    } else {
      std::memcpy(staging_data, array.bytes.data(), array.bytes.size());
    }
    once([&](const vk::raii::CommandBuffer& c) {
      c.copyBuffer(*staging.buffer, *buffers[resource].buffer, vk::BufferCopy(0, 0, bytes));
    });
  }

  void copy_image(const vk::raii::CommandBuffer& c, uint32_t resource, vk::Buffer to) const {
    const ImageObject& image = images[resource];
    const vk::ImageSubresourceRange range(vk::ImageAspectFlagBits::eColor, 0, 1, 0,
                                          static_cast<uint32_t>(image.size.l));
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

  io::Array download(uint32_t resource) {
    const bundle::ResourceT& r = *bundle.resources[resource];
    if (r.storage == Storage::Depth) throw Failure{"'" + r.name + "' is a depth image"};
    const int n = r.role == bundle::Role::Scratch ? 1 : components_of(*r.type);
    const Size size = size_of(*r.extent, r.name);
    const bool image = r.storage == Storage::Image;
    const int stored = image && n == 3 ? 4 : n;
    const auto bytes = static_cast<vk::DeviceSize>(size.count() * stored * 4);
    need_staging(bytes);
    once([&](const vk::raii::CommandBuffer& c) {
      if (image)
        copy_image(c, resource, *staging.buffer);
      else
        c.copyBuffer(*buffers[resource].buffer, *staging.buffer, vk::BufferCopy(0, 0, bytes));
      c.pipelineBarrier(vk::PipelineStageFlagBits::eTransfer, vk::PipelineStageFlagBits::eHost, {},
                        vk::MemoryBarrier(vk::AccessFlagBits::eTransferWrite, vk::AccessFlagBits::eHostRead), {}, {});
    });
    io::Array out = io::Array::zeros(kind_of(*r.type), n, size.w, size.h, size.l);
    const auto* words = static_cast<const uint32_t*>(staging_data);
    const size_t width = io::scalar_size(out.kind);
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

  // --- recording ---

  vk::SpecializationInfo specialization_info(std::vector<vk::SpecializationMapEntry>& entries) const {
    for (uint32_t k = 0; k < specialization.size(); ++k) entries.emplace_back(k, k * 4, 4);
    vk::SpecializationInfo info;
    info.setMapEntries(entries);
    info.dataSize = specialization.size() * 4;
    info.pData = specialization.data();
    return info;
  }

  struct Bound {
    vk::PipelineLayout layout;
    vk::DescriptorSet set;
  };
  struct Subpass {
    std::vector<Bound> bound;  // one, or one a layer
    vk::Pipeline pipeline;
    std::array<int32_t, 4> push{};
    uint32_t vertices = 0;
  };
  static constexpr vk::ShaderStageFlags kGraphicsStages =
      vk::ShaderStageFlagBits::eVertex | vk::ShaderStageFlagBits::eFragment;

  // `inputs` of the resources are input attachments, of the layer; only fragment shaders can have those.
  Bound bind_resources(const std::vector<uint32_t>& resources, vk::ShaderStageFlags stages,
                       std::span<const uint32_t> inputs = {}, size_t layer = 0) {
    const auto& d = vk_device();
    std::vector<vk::DescriptorSetLayoutBinding> bindings;
    std::vector<vk::DescriptorPoolSize> sizes;
    for (uint32_t k = 0; k < resources.size(); ++k) {
      const bool input = std::find(inputs.begin(), inputs.end(), resources[k]) != inputs.end();
      const auto type = bundle.resources[resources[k]]->storage == Storage::Buffer ? vk::DescriptorType::eStorageBuffer
                        : input ? vk::DescriptorType::eInputAttachment
                                : vk::DescriptorType::eSampledImage;
      bindings.emplace_back(k, type, 1, input ? vk::ShaderStageFlags(vk::ShaderStageFlagBits::eFragment) : stages);
      sizes.emplace_back(type, 1);
    }
    vk::DescriptorSetLayoutCreateInfo layout_info;
    layout_info.setBindings(bindings);
    objects.set_layouts.emplace_back(d, layout_info);
    const vk::DescriptorSetLayout set_layout = *objects.set_layouts.back();
    const vk::PushConstantRange push(stages, 0, 16);
    vk::PipelineLayoutCreateInfo pipeline_layout;
    pipeline_layout.setSetLayouts(set_layout);
    pipeline_layout.setPushConstantRanges(push);
    objects.layouts.emplace_back(d, pipeline_layout);
    Bound bound{*objects.layouts.back(), {}};
    if (sizes.empty()) sizes.emplace_back(vk::DescriptorType::eStorageBuffer, 1);  // a pool must have a size
    vk::DescriptorPoolCreateInfo pool(vk::DescriptorPoolCreateFlagBits::eFreeDescriptorSet, 1);
    pool.setPoolSizes(sizes);
    objects.pools.emplace_back(d, pool);
    vk::DescriptorSetAllocateInfo allocate(*objects.pools.back());
    allocate.setSetLayouts(set_layout);
    objects.sets.push_back(std::move(vk::raii::DescriptorSets(d, allocate).front()));
    bound.set = *objects.sets.back();
    for (uint32_t k = 0; k < resources.size(); ++k) {
      const uint32_t r = resources[k];
      vk::WriteDescriptorSet write(bound.set, k, 0, 1, bindings[k].descriptorType);
      const vk::DescriptorBufferInfo buffer(*buffers[r].buffer, 0, VK_WHOLE_SIZE);
      const bool input = bindings[k].descriptorType == vk::DescriptorType::eInputAttachment;
      const vk::DescriptorImageInfo image({}, input ? *images[r].layers.at(layer) : *images[r].all,
                                          vk::ImageLayout::eShaderReadOnlyOptimal);
      if (bindings[k].descriptorType == vk::DescriptorType::eStorageBuffer)
        write.setBufferInfo(buffer);
      else
        write.setImageInfo(image);
      d.updateDescriptorSets(write, {});
    }
    return bound;
  }

  vk::Pipeline compute_pipeline(int shader, vk::PipelineLayout layout) {
    std::vector<vk::SpecializationMapEntry> entries;
    const auto specialize = specialization_info(entries);
    vk::ComputePipelineCreateInfo info;
    info.stage = vk::PipelineShaderStageCreateInfo({}, vk::ShaderStageFlagBits::eCompute,
                                                   *shaders[static_cast<size_t>(shader)], "main", &specialize);
    info.layout = layout;
    objects.pipelines.emplace_back(vk_device(), nullptr, info);
    device->name(objects.pipelines.back(), bundle.shaders[static_cast<size_t>(shader)]->name);
    return *objects.pipelines.back();
  }

  static Use compute_use(bundle::Access access) {
    switch (access) {
      case bundle::Access::Read: return Use::ComputeRead;
      case bundle::Access::Write: return Use::ComputeWrite;
      case bundle::Access::ReadWrite: break;
    }
    return Use::ComputeReadWrite;
  }

  static void record_dispatch(const vk::raii::CommandBuffer& c, vk::Pipeline pipeline, const Bound& bound,
                              std::array<int32_t, 4> push, int64_t elements) {
    constexpr int64_t kGroup = 64, kMaxGroups = 65535;
    const int64_t groups = (elements + kGroup - 1) / kGroup;
    const int64_t x = std::min(groups, kMaxGroups), y = (groups + x - 1) / x;
    c.bindPipeline(vk::PipelineBindPoint::eCompute, pipeline);
    c.bindDescriptorSets(vk::PipelineBindPoint::eCompute, bound.layout, 0, bound.set, {});
    c.pushConstants<int32_t>(bound.layout, vk::ShaderStageFlagBits::eCompute, 0, push);
    c.dispatch(static_cast<uint32_t>(x), static_cast<uint32_t>(y), 1);
  }

  static std::array<int32_t, 4> push_of(const bundle::CommandT& c) {
    std::array<int32_t, 4> push{};
    for (size_t k = 0; k < c.push.size(); ++k) push[k + 1] = c.push[k];
    return push;
  }

  void add_dispatch(const bundle::CommandT& c, std::vector<Primitive>& out) {
    std::vector<uint32_t> resources;
    Primitive p;
    p.label = c.label;
    for (const auto& b : c.bindings) {
      resources.push_back(b->resource);
      p.accesses.push_back({b->resource, compute_use(b->access)});
    }
    const Bound bound = bind_resources(resources, vk::ShaderStageFlagBits::eCompute);
    const vk::Pipeline pipeline = compute_pipeline(c.compute, bound.layout);
    const int64_t elements = evaluate(c.elements, "pass '" + c.label + "'");
    // Invocations are counted in an int, and the last row of workgroups may be partly idle.
    if (elements > kMaxElements - (int64_t{1} << 23))
      throw Failure{"pass '" + c.label + "' has " + std::to_string(elements) + " invocations, about 2^31 is the most"};
    p.record = [=, push = push_of(c)](const vk::raii::CommandBuffer& commands) {
      record_dispatch(commands, pipeline, bound, push, elements);
    };
    out.push_back(std::move(p));
  }

  void add_reduce(const bundle::CommandT& c, std::vector<Primitive>& out) {
    const int64_t outs = evaluate(c.outs, "pass '" + c.label + "'");
    int64_t n = evaluate(c.count, "pass '" + c.label + "'");
    const uint32_t scratch[] = {static_cast<uint32_t>(c.scratch_a), static_cast<uint32_t>(c.scratch_b)};
    for (int stage = 0;; ++stage) {
      const int64_t partials = (n + 63) / 64;
      const uint32_t target = partials == 1 ? static_cast<uint32_t>(c.target) : scratch[stage % 2];
      Primitive p;
      p.label = c.label + " stage " + std::to_string(stage);
      std::vector<uint32_t> resources;
      if (stage == 0)
        for (const auto& b : c.bindings) resources.push_back(b->resource);
      else
        resources.push_back(scratch[(stage - 1) % 2]);
      for (uint32_t r : resources) p.accesses.push_back({r, Use::ComputeRead});
      resources.push_back(target);
      p.accesses.push_back({target, Use::ComputeWrite});
      const Bound bound = bind_resources(resources, vk::ShaderStageFlagBits::eCompute);
      const vk::Pipeline pipeline = compute_pipeline(stage == 0 ? c.compute : c.next, bound.layout);
      const std::array<int32_t, 4> push{0, static_cast<int32_t>(n), static_cast<int32_t>(partials), 0};
      p.record = [=](const vk::raii::CommandBuffer& commands) {
        record_dispatch(commands, pipeline, bound, push, outs * partials);
      };
      out.push_back(std::move(p));
      if (partials == 1) return;
      n = partials;
    }
  }

  // A Draw and those that join it: one render pass a layer, with a subpass for each.
  void add_render_pass(std::span<const bundle::CommandT* const> draws, std::vector<Primitive>& out) {
    const auto& d = vk_device();
    const bundle::CommandT& front = *draws.front();
    const std::string what = "pass '" + front.label + "'";
    const Size size = size_of(*front.extent, what);
    Primitive p;
    p.label = front.label;

    // Attachments in the order in which subpasses write them; depth last, for a pass of one draw.
    std::vector<vk::AttachmentDescription> attachments;
    std::vector<uint32_t> targets;
    std::vector<vk::ClearValue> clears;
    std::map<uint32_t, uint32_t> attachment_of;  // resource -> attachment
    for (const bundle::CommandT* c : draws) {
      for (size_t k = 0; k < c->colors.size(); ++k) {
        const uint32_t color = c->colors[k], bits = c->clear[k];
        attachment_of[color] = static_cast<uint32_t>(attachments.size());
        attachments.emplace_back(
            vk::AttachmentDescriptionFlags{}, format_of(*bundle.resources[color]->type), vk::SampleCountFlagBits::e1,
            vk::AttachmentLoadOp::eClear, vk::AttachmentStoreOp::eStore, vk::AttachmentLoadOp::eDontCare,
            vk::AttachmentStoreOp::eDontCare, vk::ImageLayout::eUndefined, vk::ImageLayout::eShaderReadOnlyOptimal);
        targets.push_back(color);
        clears.emplace_back(vk::ClearColorValue(std::array<uint32_t, 4>{bits, bits, bits, bits}));
        p.accesses.push_back({color, Use::ColorWrite});
      }
    }
    const vk::AttachmentReference depth(static_cast<uint32_t>(attachments.size()),
                                        vk::ImageLayout::eDepthStencilAttachmentOptimal);
    if (front.depth >= 0) {
      attachments.emplace_back(vk::AttachmentDescriptionFlags{}, vk::Format::eD32Sfloat, vk::SampleCountFlagBits::e1,
                               vk::AttachmentLoadOp::eClear, vk::AttachmentStoreOp::eDontCare,
                               vk::AttachmentLoadOp::eDontCare, vk::AttachmentStoreOp::eDontCare,
                               vk::ImageLayout::eUndefined, vk::ImageLayout::eDepthStencilAttachmentOptimal);
      targets.push_back(static_cast<uint32_t>(front.depth));
      clears.emplace_back(vk::ClearDepthStencilValue(1.0f, 0));
      p.accesses.push_back({static_cast<uint32_t>(front.depth), Use::DepthWrite});
    }

    // What each subpass writes, reads, and must leave alone since a later one reads it or it is kept.
    struct References {
      std::vector<vk::AttachmentReference> colors, inputs;
      std::vector<uint32_t> preserve;
    };
    std::vector<References> references(draws.size());
    std::vector<vk::SubpassDescription> subpasses;
    uint32_t written = 0;
    for (size_t s = 0; s < draws.size(); ++s) {
      References& r = references[s];
      for (uint32_t color : draws[s]->colors)
        r.colors.emplace_back(attachment_of.at(color), vk::ImageLayout::eColorAttachmentOptimal);
      for (uint32_t input : draws[s]->inputs)
        r.inputs.emplace_back(attachment_of.at(input), vk::ImageLayout::eShaderReadOnlyOptimal);
      for (uint32_t k = 0; k < written; ++k)
        if (std::none_of(r.inputs.begin(), r.inputs.end(), [&](const auto& i) { return i.attachment == k; }))
          r.preserve.push_back(k);
      written += static_cast<uint32_t>(r.colors.size());
      vk::SubpassDescription subpass;
      subpass.pipelineBindPoint = vk::PipelineBindPoint::eGraphics;
      subpass.setColorAttachments(r.colors);
      subpass.setInputAttachments(r.inputs);
      subpass.setPreserveAttachments(r.preserve);
      if (front.depth >= 0) subpass.pDepthStencilAttachment = &depth;
      subpasses.push_back(subpass);
    }
    // The layout changes must come after earlier readers and before later ones; the barriers between commands meet
    // these. Subpasses wait for the ones before pixel by pixel.
    const auto attach = vk::PipelineStageFlagBits::eColorAttachmentOutput |
                        vk::PipelineStageFlagBits::eEarlyFragmentTests | vk::PipelineStageFlagBits::eLateFragmentTests;
    const auto attach_access = vk::AccessFlagBits::eColorAttachmentRead | vk::AccessFlagBits::eColorAttachmentWrite |
                               vk::AccessFlagBits::eDepthStencilAttachmentRead |
                               vk::AccessFlagBits::eDepthStencilAttachmentWrite;
    const auto attach_write =
        vk::AccessFlagBits::eColorAttachmentWrite | vk::AccessFlagBits::eDepthStencilAttachmentWrite;
    const auto readers = vk::PipelineStageFlagBits::eVertexShader | vk::PipelineStageFlagBits::eFragmentShader |
                         vk::PipelineStageFlagBits::eComputeShader | vk::PipelineStageFlagBits::eTransfer;
    std::vector<vk::SubpassDependency> dependencies;
    for (uint32_t s = 0; s < draws.size(); ++s) {
      dependencies.emplace_back(VK_SUBPASS_EXTERNAL, s, attach | readers, attach, attach_write, attach_access);
      dependencies.emplace_back(s, VK_SUBPASS_EXTERNAL, attach | vk::PipelineStageFlagBits::eFragmentShader,
                                readers | attach, attach_write,
                                vk::AccessFlagBits::eShaderRead | vk::AccessFlagBits::eTransferRead | attach_access);
      // Of an attachment that several subpasses use, the last one stores it: it waits for the other readers too.
      for (uint32_t earlier = 0; earlier < s; ++earlier) {
        const auto uses = [&](uint32_t input) {
          const auto &colors = draws[earlier]->colors, &inputs = draws[earlier]->inputs;
          return std::find(colors.begin(), colors.end(), input) != colors.end() ||
                 std::find(inputs.begin(), inputs.end(), input) != inputs.end();
        };
        if (std::any_of(draws[s]->inputs.begin(), draws[s]->inputs.end(), uses))
          dependencies.emplace_back(
              earlier, s,
              vk::PipelineStageFlagBits::eColorAttachmentOutput | vk::PipelineStageFlagBits::eFragmentShader,
              vk::PipelineStageFlagBits::eColorAttachmentOutput | vk::PipelineStageFlagBits::eFragmentShader,
              vk::AccessFlagBits::eColorAttachmentWrite,
              vk::AccessFlagBits::eInputAttachmentRead | vk::AccessFlagBits::eColorAttachmentWrite,
              vk::DependencyFlagBits::eByRegion);
      }
    }
    vk::RenderPassCreateInfo pass_info;
    pass_info.setAttachments(attachments);
    pass_info.setSubpasses(subpasses);
    pass_info.setDependencies(dependencies);
    objects.render_passes.emplace_back(d, pass_info);
    const vk::RenderPass render_pass = *objects.render_passes.back();
    device->name(objects.render_passes.back(), front.label);

    const vk::Rect2D area({0, 0}, {static_cast<uint32_t>(size.w), static_cast<uint32_t>(size.h)});
    std::vector<vk::Framebuffer> framebuffers;
    for (size_t l = 0; l < static_cast<size_t>(size.l); ++l) {
      std::vector<vk::ImageView> views;
      for (uint32_t t : targets) {
        if (images[t].layers.size() != static_cast<size_t>(size.l) || images[t].size.w != size.w ||
            images[t].size.h != size.h)
          throw Failure{what + " has an attachment of another extent"};
        views.push_back(*images[t].layers[l]);
      }
      vk::FramebufferCreateInfo framebuffer({}, render_pass);
      framebuffer.setAttachments(views);
      framebuffer.width = area.extent.width;
      framebuffer.height = area.extent.height;
      framebuffer.layers = 1;
      objects.framebuffers.emplace_back(d, framebuffer);
      framebuffers.push_back(*objects.framebuffers.back());
    }

    std::vector<Subpass> recorded;
    for (uint32_t s = 0; s < draws.size(); ++s) {
      const bundle::CommandT& c = *draws[s];
      std::vector<uint32_t> resources;
      for (const auto& b : c.bindings) {
        resources.push_back(b->resource);
        p.accesses.push_back({b->resource, Use::GraphicsRead});
      }
      Subpass subpass;
      // Input attachments are of one layer, so each layer has its descriptors.
      for (size_t l = 0; l < (c.inputs.empty() ? 1 : framebuffers.size()); ++l)
        subpass.bound.push_back(bind_resources(resources, kGraphicsStages, c.inputs, l));
      subpass.pipeline = graphics_pipeline(c, subpass.bound.front().layout, render_pass, s, area.extent);
      subpass.push = push_of(c);
      subpass.vertices = static_cast<uint32_t>(evaluate(c.elements, what));
      recorded.push_back(std::move(subpass));
    }
    p.record = [=](const vk::raii::CommandBuffer& commands) {
      for (size_t l = 0; l < framebuffers.size(); ++l) {
        vk::RenderPassBeginInfo begin(render_pass, framebuffers[l], area);
        begin.setClearValues(clears);
        commands.beginRenderPass(begin, vk::SubpassContents::eInline);
        for (size_t s = 0; s < recorded.size(); ++s) {
          const Subpass& subpass = recorded[s];
          const Bound& bound = subpass.bound[std::min(l, subpass.bound.size() - 1)];
          std::array<int32_t, 4> push = subpass.push;
          push[0] = static_cast<int32_t>(l);
          if (s > 0) commands.nextSubpass(vk::SubpassContents::eInline);
          commands.bindPipeline(vk::PipelineBindPoint::eGraphics, subpass.pipeline);
          commands.bindDescriptorSets(vk::PipelineBindPoint::eGraphics, bound.layout, 0, bound.set, {});
          commands.pushConstants<int32_t>(bound.layout, kGraphicsStages, 0, push);
          commands.draw(subpass.vertices, 1, 0, 0);
        }
        commands.endRenderPass();
      }
    };
    out.push_back(std::move(p));
  }

  vk::Pipeline graphics_pipeline(const bundle::CommandT& c, vk::PipelineLayout layout, vk::RenderPass render_pass,
                                 uint32_t subpass, vk::Extent2D size) {
    std::vector<vk::SpecializationMapEntry> entries;
    const auto specialize = specialization_info(entries);
    const vk::PipelineShaderStageCreateInfo stage_infos[] = {
        {{}, vk::ShaderStageFlagBits::eVertex, *shaders[static_cast<size_t>(c.vertex)], "main", &specialize},
        {{}, vk::ShaderStageFlagBits::eFragment, *shaders[static_cast<size_t>(c.fragment)], "main", &specialize}};
    const vk::PipelineVertexInputStateCreateInfo no_vertices;
    const vk::PipelineInputAssemblyStateCreateInfo triangles({}, vk::PrimitiveTopology::eTriangleList);
    const vk::Viewport viewport(0, 0, static_cast<float>(size.width), static_cast<float>(size.height), 0, 1);
    const vk::Rect2D area({0, 0}, size);
    const vk::PipelineViewportStateCreateInfo viewports({}, 1, &viewport, 1, &area);
    vk::PipelineRasterizationStateCreateInfo rasterization;
    rasterization.lineWidth = 1;
    const vk::PipelineMultisampleStateCreateInfo one_sample({}, vk::SampleCountFlagBits::e1);
    vk::PipelineDepthStencilStateCreateInfo depth_test;
    depth_test.depthTestEnable = depth_test.depthWriteEnable = c.depth >= 0;
    depth_test.depthCompareOp = vk::CompareOp::eLess;
    vk::PipelineColorBlendAttachmentState no_blend;
    no_blend.colorWriteMask = vk::ColorComponentFlagBits::eR | vk::ColorComponentFlagBits::eG |
                              vk::ColorComponentFlagBits::eB | vk::ColorComponentFlagBits::eA;
    const std::vector<vk::PipelineColorBlendAttachmentState> blends(c.colors.size(), no_blend);
    vk::PipelineColorBlendStateCreateInfo blend;
    blend.setAttachments(blends);
    vk::GraphicsPipelineCreateInfo info;
    info.setStages(stage_infos);
    info.pVertexInputState = &no_vertices;
    info.pInputAssemblyState = &triangles;
    info.pViewportState = &viewports;
    info.pRasterizationState = &rasterization;
    info.pMultisampleState = &one_sample;
    info.pDepthStencilState = &depth_test;
    info.pColorBlendState = &blend;
    info.layout = layout;
    info.renderPass = render_pass;
    info.subpass = subpass;
    objects.pipelines.emplace_back(vk_device(), nullptr, info);
    device->name(objects.pipelines.back(), c.label);
    return *objects.pipelines.back();
  }

  void add_fill(const bundle::CommandT& c, std::vector<Primitive>& out) {
    Primitive p{c.label, {{static_cast<uint32_t>(c.target), Use::TransferWrite}}, {}};
    const vk::Buffer target = *buffers[static_cast<size_t>(c.target)].buffer;
    p.record = [target, value = c.value](const vk::raii::CommandBuffer& commands) {
      commands.fillBuffer(target, 0, VK_WHOLE_SIZE, value);
    };
    out.push_back(std::move(p));
  }

  void add_copy(const bundle::CommandT& c, std::vector<Primitive>& out) {
    const auto from = static_cast<uint32_t>(c.source), to = static_cast<uint32_t>(c.target);
    Primitive p{c.label, {{from, Use::TransferRead}, {to, Use::TransferWrite}}, {}};
    const vk::Buffer target = *buffers[to].buffer;
    if (bundle.resources[from]->storage == Storage::Image) {
      if (bundle.resources[from]->type->rows == 3)
        throw Failure{"command '" + c.label + "' copies an image of three components"};
      p.record = [this, from, target](const vk::raii::CommandBuffer& commands) { copy_image(commands, from, target); };
    } else {
      if (buffers[from].bytes != buffers[to].bytes)
        throw Failure{"command '" + c.label + "' copies between sizes that differ"};
      const vk::Buffer source = *buffers[from].buffer;
      p.record = [=, bytes = buffers[from].bytes](const vk::raii::CommandBuffer& commands) {
        commands.copyBuffer(source, target, vk::BufferCopy(0, 0, bytes));
      };
    }
    out.push_back(std::move(p));
  }

  Recorded record(const bundle::StepT& step) {
    std::vector<Primitive> primitives;
    for (size_t k = 0; k < step.commands.size(); ++k) {
      const bundle::CommandT& c = *step.commands[k];
      switch (c.kind) {
        case CommandKind::Dispatch: add_dispatch(c, primitives); break;
        case CommandKind::Draw: {
          std::vector<const bundle::CommandT*> draws{&c};
          while (k + 1 < step.commands.size() && step.commands[k + 1]->joins) draws.push_back(step.commands[++k].get());
          add_render_pass(draws, primitives);
          break;
        }
        case CommandKind::Fill: add_fill(c, primitives); break;
        case CommandKind::Copy: add_copy(c, primitives); break;
        case CommandKind::Reduce: add_reduce(c, primitives); break;
      }
    }
    std::vector<std::vector<Access>> accesses;
    for (const Primitive& p : primitives) {
      accesses.push_back(p.accesses);
      // Resources that share memory wait for each other.
      for (Access& a : accesses.back()) a.resource = bundle.resources[a.resource]->slot;
    }
    const std::vector<Barrier> barriers = plan_barriers(accesses);
    Recorded out;
    out.count = static_cast<int>(primitives.size());
    out.commands =
        std::move(vk::raii::CommandBuffers(
                      vk_device(), vk::CommandBufferAllocateInfo(*command_pool, vk::CommandBufferLevel::ePrimary, 1))
                      .front());
    out.commands.begin(vk::CommandBufferBeginInfo());
    everything_before(out.commands);
    for (size_t k = 0; k < primitives.size(); ++k) {
      const Barrier& b = barriers[k];
      if (b.from.stages != 0) {
        const vk::MemoryBarrier memory(vk::AccessFlags(b.from.access), vk::AccessFlags(b.to.access));
        out.commands.pipelineBarrier(vk::PipelineStageFlags(b.from.stages), vk::PipelineStageFlags(b.to.stages), {},
                                     memory, {}, {});
      }
      if (device->debug_names) {
        vk::DebugUtilsLabelEXT label;
        label.pLabelName = primitives[k].label.c_str();
        out.commands.beginDebugUtilsLabelEXT(label);
      }
      primitives[k].record(out.commands);
      if (device->debug_names) out.commands.endDebugUtilsLabelEXT();
    }
    out.commands.end();
    return out;
  }

  StepState& recorded_step(const std::string& name) {
    const auto index = static_cast<size_t>(step_index(name));
    create_objects();
    StepState& step = steps[index];
    if (step.recorded) return step;
    prepare(*bundle.steps[index]);
    step.recorded = record(*bundle.steps[index]);
    return step;
  }

  void require_run(const std::string& step) const {
    const auto index = static_cast<size_t>(step_index(step));
    if (index >= steps.size() || steps[index].runs == 0) throw Failure{"step '" + step + "' has not run yet"};
  }

  void run(const std::string& name, int times) {
    StepState& step = recorded_step(name);
    const int counter = bundle.steps[static_cast<size_t>(step_index(name))]->step_index;
    for (int k = 0; k < times; ++k) {
      if (counter >= 0) {
        const auto value = static_cast<int32_t>(step.runs);
        upload(static_cast<uint32_t>(counter), io::Array::from_ints(std::span(&value, 1)));
      }
      submit_and_wait(step.recorded->commands);
      ++step.runs;
    }
  }
};

namespace {

// Every public function: exceptions stay inside.
template <class F>
auto guarded(F&& f) -> Result<decltype(f())> {
  try {
    if constexpr (std::is_void_v<decltype(f())>) {
      f();
      return {};
    } else {
      return f();
    }
  } catch (const Failure& failure) {
    return io::Error{failure.message};
  } catch (const vk::DeviceLostError&) {
    return io::Error{"the device was lost while it ran a step"};
  } catch (const vk::SystemError& e) {
    return io::Error{std::string("Vulkan reports: ") + e.what()};
  } catch (const std::bad_alloc&) {
    return io::Error{"this machine has not enough memory for the program's data"};
  }
}

}  // namespace

Program::Program() : state_(std::make_unique<State>()) {}
Program::Program(Program&&) noexcept = default;
Program& Program::operator=(Program&&) noexcept = default;
Program::~Program() = default;

Result<Program> Program::load(const Device& device, std::span<const uint8_t> bytes) {
  auto bundle = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&bundle)) return io::Error{*problem};
  Program program;
  State& s = *program.state_;
  s.device = device.state_;
  s.bundle = std::move(std::get<bundle::BundleT>(bundle));
  for (const std::string& feature : s.bundle.features) {
    const bool known = feature == "shader_int64" || feature == "shader_buffer_int64_atomics";
    if (!known) return io::Error{"the bundle needs the feature '" + feature + "', which this runtime does not know"};
    if (!s.device->int64_atomics)
      return io::Error{"the bundle was built for profile '" + s.bundle.profile + "' and needs the feature '" + feature +
                       "', which the device lacks; build it for the device's own profile"};
  }
  s.pending.resize(s.bundle.leaves.size());
  return program;
}

Result<Program> Program::describe(std::span<const uint8_t> bytes) {
  auto bundle = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&bundle)) return io::Error{*problem};
  Program program;
  program.state_->bundle = std::move(std::get<bundle::BundleT>(bundle));
  program.state_->pending.resize(program.state_->bundle.leaves.size());
  return program;
}

bool Program::is_input(const std::string& leaf) const {
  for (const auto& l : state_->bundle.leaves)
    if (l->name == leaf) return l->kind == bundle::LeafKind::Input;
  return false;
}

std::vector<std::string> Program::steps() const {
  std::vector<std::string> out;
  for (const auto& s : state_->bundle.steps) out.push_back(s->name);
  return out;
}

std::vector<Program::LeafInfo> Program::leaves() const {
  std::vector<LeafInfo> out;
  for (const auto& l : state_->bundle.leaves) out.push_back({l->name, components_of(*l->type), kind_of(*l->type)});
  return out;
}

std::vector<std::string> Program::needed_leaves(const std::string& step) const {
  std::vector<std::string> out;
  for (const auto& s : state_->bundle.steps)
    if (s->name == step)
      for (uint32_t leaf : s->leaves) out.push_back(state_->bundle.leaves[leaf]->name);
  return out;
}

std::vector<std::string> Program::resources() const {
  std::vector<std::string> out;
  for (const auto& r : state_->bundle.resources) out.push_back(r->name);
  return out;
}

Result<void> Program::bind(const std::string& leaf, const io::Array& data) {
  return guarded([&] { state_->bind(leaf, data); });
}

Result<void> Program::bind_symbol(const std::string& symbol, int64_t value) {
  return guarded([&] {
    const std::vector<std::string>& all = state_->bundle.symbols;
    if (std::find(all.begin(), all.end(), symbol) == all.end()) {
      std::string names;
      for (const std::string& s : all) names += (names.empty() ? "" : ", ") + s;
      throw Failure{"there is no symbol '" + symbol + "'; there are: " + names};
    }
    state_->set_symbol(symbol, value, "the symbol's own binding");
  });
}

Result<void> Program::run(const std::string& step, int times) {
  return guarded([&] { state_->run(step, times); });
}

std::vector<std::string> Program::outputs(const std::string& step) const {
  std::vector<std::string> out;
  for (const auto& s : state_->bundle.steps)
    if (s->name == step)
      for (const auto& o : s->outputs) out.push_back(o->name);
  return out;
}

Result<io::Array> Program::output(const std::string& step, const std::string& name) {
  return guarded([&]() -> io::Array {
    State& s = *state_;
    const auto& table = *s.bundle.steps[static_cast<size_t>(s.step_index(step))];
    for (const auto& o : table.outputs)
      if (o->name == name) {
        if (!s.has_memory(o->resource)) throw Failure{"step '" + step + "' has not run yet"};
        return s.download(o->resource);
      }
    throw Failure{"step '" + step + "' has no output '" + name + "'"};
  });
}

Result<std::vector<std::vector<io::Array>>> Program::rasters(const std::string& step) {
  return guarded([&] {
    State& s = *state_;
    const auto& table = *s.bundle.steps[static_cast<size_t>(s.step_index(step))];
    s.require_run(step);
    std::vector<std::vector<io::Array>> out;
    for (const auto& raster : table.rasters) {
      out.emplace_back();
      for (uint32_t r : raster->resources) out.back().push_back(s.download(r));
    }
    return out;
  });
}

Result<std::vector<std::pair<std::string, io::Array>>> Program::pins(const std::string& step) {
  return guarded([&] {
    State& s = *state_;
    s.require_run(step);
    std::vector<std::pair<std::string, io::Array>> out;
    for (const auto& pin : s.bundle.steps[static_cast<size_t>(s.step_index(step))]->pins)
      out.emplace_back(pin->name, s.download(pin->resource));
    return out;
  });
}

Result<io::Array> Program::leaf(const std::string& name) {
  return guarded([&] {
    State& s = *state_;
    const auto index = static_cast<size_t>(s.leaf_index(name));
    s.prepare_leaf(index);
    return s.download(s.bundle.leaves[index]->resource);
  });
}

Result<io::Array> Program::resource(const std::string& name) {
  return guarded([&]() -> io::Array {
    State& s = *state_;
    for (uint32_t k = 0; k < s.bundle.resources.size(); ++k) {
      if (s.bundle.resources[k]->name != name) continue;
      if (!s.has_memory(k)) throw Failure{"'" + name + "' has no value: no step that uses it has run yet"};
      for (uint32_t other = 0; other < s.bundle.resources.size(); ++other)
        if (other != k && s.bundle.resources[other]->slot == s.bundle.resources[k]->slot)
          throw Failure{"'" + name + "' shares its memory with '" + s.bundle.resources[other]->name +
                        "': make it an output to read it"};
      return s.download(k);
    }
    throw Failure{"there is no resource '" + name + "'"};
  });
}

int64_t Program::allocated_bytes() const {
  vk::DeviceSize bytes = state_->staging_memory.bytes;
  for (const Block& b : state_->blocks) bytes += b.bytes;
  return static_cast<int64_t>(bytes);
}

Result<int> Program::command_count(const std::string& step) {
  return guarded([&] { return state_->recorded_step(step).recorded->count; });
}

}  // namespace dr::runtime
