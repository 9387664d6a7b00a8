// SPDX-License-Identifier: Apache-2.0
// Memory of a program that CUDA sees, and runs in the order of one of its streams.
#include <algorithm>

#include "runtime/program/state.h"

namespace dr::runtime {

CudaOrder& Program::State::in_order() {
  if (order) return *order;
  if (!options.share) throw Failure{"the program was not loaded to share its memory with CUDA"};
  OnDevice& o = objects();
  auto cuda = Cuda::of(*device);
  order = std::make_shared<CudaOrder>(device, std::move(cuda));
  o.queue.set_order(order.get());  // what follows is in order
  return *order;
}

bool Program::State::comes_from_host(size_t leaf) const {
  return has_tables(leaf) || kind_of(*bundle.leaves[leaf]->type) == io::ElementKind::Bool;
}

CudaArray Program::State::in_cuda(uint32_t resource, std::optional<size_t> holder) {
  in_order();
  const bundle::ResourceT& r = *bundle.resources[resource];
  const io::ElementKind kind = kind_of(*r.type);
  if (kind == io::ElementKind::Bool) throw Failure{"'" + r.name + "' is made of bools, which take a word each here"};
  const int components = components_of(*r.type);
  const Size size = sizes.size_of(*r.extent, r.name);
  CudaArray out{{kind, components, size.w, size.h, size.l}, components};
  std::shared_ptr<void> held;
  const bool is_copy = holder == bundle.leaves.size() && is_leaf(resource);
  if (auto place = is_copy ? std::nullopt : on_device->memory.in_cuda(resource)) {
    out.array.data = reinterpret_cast<void*>(place->address);
    held = std::move(place->held);
  } else if (r.storage == bundle::Storage::Tile || r.storage == bundle::Storage::Depth) {
    throw Failure{"'" + r.name + "' is not kept: make it an output"};
  } else {
    const auto& memory = mirror_of(resource).block.in_cuda(*device);
    out.array.data = reinterpret_cast<void*>(memory->address());
    held = memory;
    if (r.storage == bundle::Storage::Image && components == 3) out.stride = 4;
  }
  if (!holder) return out;
  // One token for all views, which also keeps what CUDA has of the memory.
  out.array.held = views[*holder].held.lock();
  if (!out.array.held) views[*holder].held = out.array.held = std::make_shared<std::vector<std::shared_ptr<void>>>();
  static_cast<std::vector<std::shared_ptr<void>>*>(out.array.held.get())->push_back(std::move(held));
  views[*holder].lent = true;
  return out;
}

// Made, and filled, when it is first asked for.
Mirror& Program::State::mirror_of(uint32_t resource) {
  if (const auto it = on_device->mirrors.find(resource); it != on_device->mirrors.end()) return it->second;
  const bundle::ResourceT& r = *bundle.resources[resource];
  Mirror mirror;
  const vk::ExternalMemoryBufferCreateInfo outside(vk::ExternalMemoryHandleTypeFlagBits::eOpaqueFd);
  vk::BufferCreateInfo info({}, static_cast<vk::DeviceSize>(on_device->memory.content_bytes(resource)),
                            vk::BufferUsageFlagBits::eTransferDst);
  info.pNext = &outside;
  mirror.buffer = vk::raii::Buffer(device->device, info);
  const auto need = mirror.buffer.getMemoryRequirements();
  mirror.block =
      Block(*device, need.size, device->memory_type(need.memoryTypeBits, {}, vk::MemoryPropertyFlagBits::eDeviceLocal),
            tally, true);
  mirror.buffer.bindMemory(*mirror.block.memory(), 0);
  mirror.copy = on_device->queue.command_buffer();
  mirror.copy.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eSimultaneousUse));
  on_device->queue.everything_before(mirror.copy);
  if (r.storage == bundle::Storage::Image)
    copy_image(mirror.copy, on_device->memory.image(resource), *mirror.buffer);
  else
    copy_content(mirror.copy, on_device->memory.buffer(resource).pieces(), {{*mirror.buffer, 0, info.size}});
  mirror.copy.end();
  on_device->queue.submit(mirror.copy);
  return on_device->mirrors.emplace(resource, std::move(mirror)).first->second;
}

std::vector<vk::CommandBuffer> Program::State::mirror_copies(size_t step) const {
  std::vector<vk::CommandBuffer> copies;
  if (on_device->mirrors.empty()) return copies;
  for (const auto& output : bundle.steps[step]->outputs)
    if (const auto it = on_device->mirrors.find(output->resource); it != on_device->mirrors.end())
      copies.push_back(*it->second.copy);
  return copies;
}

void Program::State::copy_from_cuda(size_t index, const HostArray& data) {
  const bundle::LeafT& leaf = *bundle.leaves[index];
  if (leaf.table_of >= 0) throw Failure{"leaf '" + leaf.name + "' is made from another; bind that instead"};
  if (comes_from_host(index))
    throw Failure{"leaf '" + leaf.name + "' takes data of the host: " +
                  (has_tables(index) ? "tables are made of it there" : "it is made of bools")};
  if (data.kind != kind_of(*leaf.type))
    throw Failure{"leaf '" + leaf.name + "' takes scalars of another type from CUDA"};
  if (data.data == nullptr) throw Failure{"leaf '" + leaf.name + "': the array has no data"};
  Sizes agreed = sizes_with(index, data);
  in_order();
  sizes = std::move(agreed);
  ++versions[index];
  spoiled.erase(index);
  pending[index].reset();
  if (!has_memory(leaf.resource)) on_device->memory.allocate({leaf.resource});
  const CudaArray to = in_cuda(leaf.resource, std::nullopt);
  const auto bytes = static_cast<size_t>(data.width * data.height * data.layers * data.components) * 4;
  const auto address = [](const HostArray& array) { return reinterpret_cast<uint64_t>(array.data); };
  order->cuda().copy({address(to.array), bytes}, {address(data), bytes}, bytes, 1, order->stream());
}

uint32_t Program::State::output_of(size_t step, const std::string& name) const {
  for (const auto& o : bundle.steps[step]->outputs)
    if (o->name == name) return o->resource;
  throw Failure{"step '" + bundle.steps[step]->name + "' has no output '" + name + "'"};
}

void Program::State::copy_to_cuda(const std::string& step, const std::string& output, const HostArray& to) {
  const uint32_t resource = output_of(step_index(step), output);
  require_run(step);
  const CudaArray from = in_cuda(resource, std::nullopt);
  const HostArray& has = from.array;
  if (to.kind != has.kind || to.components != has.components || to.width != has.width || to.height != has.height ||
      to.layers != has.layers)
    throw Failure{"output '" + output + "' has another type or size than the array for it"};
  const auto address = [](const HostArray& array) { return reinterpret_cast<uint64_t>(array.data); };
  const auto count = static_cast<size_t>(has.width * has.height * has.layers);
  const auto bytes = static_cast<size_t>(has.components) * 4;
  order->cuda().copy({address(to), bytes}, {address(has), static_cast<size_t>(from.stride) * 4}, bytes, count,
                     order->stream());
}

}  // namespace dr::runtime
