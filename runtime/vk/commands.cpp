// SPDX-License-Identifier: Apache-2.0
// Dispatches, reductions, fills and copies; the list, and recording it.
#include "runtime/vk/commands.h"

#include <algorithm>

#include "compiler/backend/bundle/touched.h"
#include "runtime/vk/queue.h"
#include "runtime/vk/transfer.h"

namespace dr::runtime {

using bundle::CommandKind;
using bundle::Storage;

namespace {

Use compute_use(bundle::Access access) {
  switch (access) {
    case bundle::Access::Read: return Use::ComputeRead;
    case bundle::Access::Write: return Use::ComputeWrite;
    case bundle::Access::ReadWrite: break;
  }
  return Use::ComputeReadWrite;
}

constexpr uint32_t kGroup = 64;
constexpr vk::DeviceSize kLeftBytes = 16;  // of the numbers of workgroups of a dispatch that goes on

// A workgroup of 64 spreads few elements over many processors; where there are enough anyway, starting so many
// workgroups takes longer than their work. Invocations that may take several elements, up to `each`, are spread by
// smaller ones while they are few.
uint32_t group_size(const vk::PhysicalDeviceProperties& device, int64_t elements, uint32_t each) {
  constexpr uint32_t kLargeGroup = 256, kSmallGroup = 16;
  constexpr int64_t kFew = 4096;
  if (each > 1 && elements < kFew) return kSmallGroup;
  const int64_t many = int64_t{1} << (device.deviceType == vk::PhysicalDeviceType::eCpu ? 12 : 18);
  const bool large = elements >= many && device.limits.maxComputeWorkGroupInvocations >= kLargeGroup &&
                     device.limits.maxComputeWorkGroupSize[0] >= kLargeGroup;
  return large ? kLargeGroup : kGroup;
}

// `each`: elements that an invocation may take at most.
int64_t invocations_for(int64_t elements, uint32_t each) {
  const int64_t taken = std::clamp<int64_t>(elements / bundle::kLeastInvocations, 1, std::max(each, 1u));
  return (elements + taken - 1) / taken;
}

void record_dispatch(const vk::raii::CommandBuffer& c, vk::Pipeline pipeline, const Bound& bound,
                     std::array<int32_t, 4> push, int64_t elements, uint32_t group, vk::Buffer indirect = {},
                     vk::DeviceSize offset = 0) {
  constexpr int64_t kMaxGroups = 65535;
  const int64_t groups = (elements + group - 1) / group;
  const int64_t x = std::min(groups, kMaxGroups), y = (groups + kMaxGroups - 1) / kMaxGroups;
  c.bindPipeline(vk::PipelineBindPoint::eCompute, pipeline);
  c.bindDescriptorSets(vk::PipelineBindPoint::eCompute, bound.layout, 0, bound.set, {});
  c.pushConstants<int32_t>(bound.layout, vk::ShaderStageFlagBits::eCompute, 0, push);
  if (indirect)
    c.dispatchIndirect(indirect, offset);
  else
    c.dispatch(static_cast<uint32_t>(x), static_cast<uint32_t>(y), 1);
}

void record_barrier(const vk::raii::CommandBuffer& commands, const Barrier& b) {
  if (b.from.stages == 0) return;
  const vk::MemoryBarrier memory(vk::AccessFlags(b.from.access), vk::AccessFlags(b.to.access));
  commands.pipelineBarrier(vk::PipelineStageFlags(b.from.stages), vk::PipelineStageFlags(b.to.stages), {}, memory, {},
                           {});
}

}  // namespace

std::array<int32_t, 4> push_of(const bundle::CommandT& c) {
  std::array<int32_t, 4> push{};
  for (size_t k = 0; k < c.push.size(); ++k) push[k + 1] = c.push[k];
  return push;
}

void Commands::must_be_due(const bundle::CommandT& c, int64_t invocations) const {
  const std::string what = "pass '" + c.label + "' has " + std::to_string(invocations) + " invocations, ";
  // They are counted in an int, and the last row of workgroups may be partly idle.
  if (invocations > kMaxElements - (int64_t{1} << 23)) throw Failure{what + "about 2^31 is the most"};
  constexpr int64_t kAnyway = int64_t{1} << 24, kForEachWord = 64;
  if (trusted_ || invocations <= kAnyway) return;
  int64_t words = 0;
  for (const bundle::Touched& t : bundle::touched_by(c)) words += memory_.content_bytes(t.resource) / 4;
  if (invocations / kForEachWord > words)
    throw Failure{what + "but touches " + std::to_string(words) +
                  " words only; if the bundle comes from somebody whom you trust, give --trusted"};
}

void Commands::dispatch(const bundle::CommandT& c, std::vector<Primitive>& out) {
  std::vector<Descriptor> descriptors;
  Primitive p;
  p.label = c.label;
  if (!c.count.empty()) {
    const auto words = ir::Dim::parse(c.count);
    p.bytes = 4 * (words ? words->evaluate(sizes_.symbols()) : std::nullopt).value_or(0);
  }
  for (const auto& b : c.bindings) {
    descriptors.push_back({b->resource, b->texel});
    p.accesses.push_back({b->resource, compute_use(b->access)});
  }
  const Bound bound = pipelines_.bind(descriptors, vk::ShaderStageFlagBits::eCompute);
  const int64_t elements = sizes_.evaluate(c.elements, "pass '" + c.label + "'");
  must_be_due(c, elements);
  if (!c.faces.empty())
    if (const int64_t faces = sizes_.evaluate(c.faces, "pass '" + c.label + "'"); faces > bundle::kMostListed)
      throw Failure{"pass '" + c.label + "' has " + std::to_string(faces) +
                    " faces, too many for a 'raster' with 'listed': " + "let it keep the nearest ones, with 'nearest'"};
  vk::Buffer indirect;
  if (c.indirect >= 0) {
    const BufferObject& sizes = memory_.buffer(static_cast<size_t>(c.indirect));
    if (sizes.bytes < sizeof(vk::DispatchIndirectCommand))
      throw Failure{"pass '" + c.label + "' is as large as a buffer says that is too small for it"};
    indirect = sizes.first();
    p.accesses.push_back({static_cast<uint32_t>(c.indirect), Use::IndirectRead});
  }
  const int64_t invocations = invocations_for(elements, c.each);
  const uint32_t group = c.group != 0 ? c.group
                         : indirect   ? bundle::kIndirectGroup
                                      : group_size(device_->properties, invocations, c.each);
  const int64_t parts = parts_of(c);
  const size_t pipeline = pipelines_.compute(c.compute, bound, group, parts > 1 ? c.part_trips : 0);
  p.pipeline = static_cast<int>(pipeline), p.group = static_cast<int>(group);
  p.compile = compiling(pipeline, bound, group);
  vk::DeviceSize offset = 0;
  for (int64_t part = 1; part <= parts; ++part) {
    std::array<int32_t, 4> push = push_of(c);
    push[0] = static_cast<int32_t>(parts == 1 ? 0 : part == parts ? -part : part);
    if (part == 2) {
      p.accesses.push_back({static_cast<uint32_t>(c.left), Use::IndirectRead});
      indirect = memory_.buffer(static_cast<size_t>(c.left)).first();
    }
    const auto odd = static_cast<vk::DeviceSize>(part % 2);
    if (part > 1) offset = kLeftBytes * odd;
    if (part < parts) out.push_back(clear_left(c, kLeftBytes * (1 - odd)));
    p.record = [=, this](const vk::raii::CommandBuffer& commands) {
      record_dispatch(commands, pipelines_[pipeline], bound, push, invocations, group, indirect, offset);
    };
    out.push_back(p);
    p.compile = nullptr;  // the parts have one shader
  }
}

std::function<void(const vk::raii::CommandBuffer&)> Commands::compiling(size_t pipeline, const Bound& bound,
                                                                        uint32_t group) const {
  return [=, this](const vk::raii::CommandBuffer& commands) {
    record_dispatch(commands, pipelines_[pipeline], bound, {}, 0, group);
  };
}

// No workgroups for the next dispatch of a command, until loops of this one stop before their end.
Primitive Commands::clear_left(const bundle::CommandT& c, vk::DeviceSize offset) const {
  const BufferObject& left = memory_.buffer(static_cast<size_t>(c.left));
  if (left.bytes < 2 * kLeftBytes) throw Failure{"pass '" + c.label + "' goes on as a buffer says that is too small"};
  Primitive p;
  p.label = c.label + " left";
  p.accesses = {{static_cast<uint32_t>(c.left), Use::TransferWrite}};
  p.bytes = kLeftBytes;
  p.record = [offset, buffer = left.first()](const vk::raii::CommandBuffer& commands) {
    commands.fillBuffer(buffer, offset, kLeftBytes, 0);
  };
  return p;
}

// How many dispatches a command is.
int64_t Commands::parts_of(const bundle::CommandT& c) const {
  if (c.trips.empty()) return 1;
  const auto dim = ir::Dim::parse(c.trips);
  auto trips = dim ? dim->evaluate(sizes_.symbols()) : std::nullopt;
  constexpr int64_t kMaxParts = 1 << 20;
  if (trips && *trips <= c.most_trips) return 1;
  // What data decides on may promise any number: the shader tells where so many were not enough.
  constexpr int64_t kMaxWatchedParts = 1 << 13;
  if (trips && c.part_trips == 0)
    throw DeviceFailure{
        "the loops of pass '" + c.label + "' may take " + std::to_string(*trips) +
        " trips in an invocation, the device lets them have " + std::to_string(c.most_trips) +
        ", and those of a sum by rows or in a function of a 'raster' cannot be taken in parts: promise fewer "
        "trips with 'max', or sum with '--scatter exact'"};
  if (c.watch >= 0) {
    if (!trips || *trips > kMaxWatchedParts * c.part_trips) return kMaxWatchedParts;
    *trips += c.most_trips;  // for loops that are not among them
  }
  if (!trips || *trips > kMaxParts * c.part_trips)
    throw DeviceFailure{
        "the loops of pass '" + c.label + "' may take " + (trips ? std::to_string(*trips) : "over 2^63") +
        " trips in an invocation, the device is given " + std::to_string(kMaxParts * c.part_trips) + " at most"};
  return (*trips + c.part_trips - 1) / c.part_trips;
}

void Commands::reduce(const bundle::CommandT& c, std::vector<Primitive>& out) {
  const int64_t outs = sizes_.evaluate(c.outs, "pass '" + c.label + "'");
  int64_t n = sizes_.evaluate(c.count, "pass '" + c.label + "'");
  const uint32_t scratch[] = {static_cast<uint32_t>(c.scratch_a), static_cast<uint32_t>(c.scratch_b)};
  if (outs > kMaxElements / n) throw Failure{"pass '" + c.label + "' has more than 2^31 inputs"};
  constexpr int64_t kEach = 64, kMostLanes = 64;  // inputs of an invocation, and invocations of a partial
  for (int stage = 0;; ++stage) {
    const int64_t partials = (n + kEach * kMostLanes - 1) / (kEach * kMostLanes);
    int64_t lanes = 1;
    while (lanes < kMostLanes && lanes * kEach < n) lanes *= 2;
    const int64_t team = c.group != 0 ? bundle::kReducingTeam : 1;  // invocations that share kEach inputs
    const int64_t invocations = outs * partials * lanes * team;
    const uint32_t target = partials == 1 ? static_cast<uint32_t>(c.target) : scratch[stage % 2];
    must_be_due(c, invocations);
    if (memory_.buffer(target).bytes / 4 < static_cast<vk::DeviceSize>(outs * partials))
      throw Failure{"pass '" + c.label + "' has more results than '" + bundle_.resources[target]->name + "' holds"};
    Primitive p;
    p.label = c.label + " stage " + std::to_string(stage);
    std::vector<Descriptor> descriptors;
    if (stage == 0)
      for (const auto& b : c.bindings) descriptors.push_back({b->resource, b->texel});
    else
      descriptors.push_back({scratch[(stage - 1) % 2], 0});
    for (const Descriptor& read : descriptors) p.accesses.push_back({read.resource, Use::ComputeRead});
    descriptors.push_back({target, 0});
    p.accesses.push_back({target, Use::ComputeWrite});
    const Bound bound = pipelines_.bind(descriptors, vk::ShaderStageFlagBits::eCompute);
    const uint32_t group = c.group != 0 ? c.group : group_size(device_->properties, invocations, 1);
    const size_t pipeline = pipelines_.compute(stage == 0 ? c.compute : c.next, bound, group);
    p.pipeline = static_cast<int>(pipeline), p.group = static_cast<int>(group);
    const std::array<int32_t, 4> push{0, static_cast<int32_t>(n), static_cast<int32_t>(partials), 0};
    p.record = [=, this](const vk::raii::CommandBuffer& commands) {
      record_dispatch(commands, pipelines_[pipeline], bound, push, invocations, group);
    };
    p.compile = compiling(pipeline, bound, group);
    out.push_back(std::move(p));
    if (partials == 1) return;
    n = partials;
  }
}

void Commands::fill(const bundle::CommandT& c, std::vector<Primitive>& out) {
  Primitive p;
  p.label = c.label;
  p.accesses = {{static_cast<uint32_t>(c.target), Use::TransferWrite}};
  const BufferObject& target = memory_.buffer(static_cast<size_t>(c.target));
  const vk::DeviceSize bytes =
      c.elements.empty()
          ? VK_WHOLE_SIZE
          : std::min(4 * static_cast<vk::DeviceSize>(sizes_.evaluate(c.elements, "pass '" + c.label + "'")),
                     target.bytes);
  if (!c.elements.empty()) p.bytes = static_cast<int64_t>(bytes);
  p.record = [pieces = target.pieces(), bytes, value = c.value](const vk::raii::CommandBuffer& commands) {
    for (const BufferObject::Piece& piece : pieces)
      if (bytes == VK_WHOLE_SIZE)
        commands.fillBuffer(piece.buffer, 0, VK_WHOLE_SIZE, value);
      else if (piece.first < bytes || piece.first == 0)
        commands.fillBuffer(piece.buffer, 0, std::min(piece.bytes, bytes - piece.first), value);
  };
  out.push_back(std::move(p));
}

void Commands::copy(const bundle::CommandT& c, std::vector<Primitive>& out) {
  const auto from = static_cast<uint32_t>(c.source), to = static_cast<uint32_t>(c.target);
  Primitive p;
  p.label = c.label;
  p.accesses = {{from, Use::TransferRead}, {to, Use::TransferWrite}};
  if (bundle_.resources[from]->storage == Storage::Image) {
    if (bundle_.resources[from]->type->rows == 3)
      throw Failure{"command '" + c.label + "' copies an image of three components"};
    p.record = [&image = memory_.image(from), target = memory_.buffer(to).first()](
                   const vk::raii::CommandBuffer& commands) { copy_image(commands, image, target); };
  } else {
    if (memory_.buffer(from).bytes != memory_.buffer(to).bytes)
      throw Failure{"command '" + c.label + "' copies between sizes that differ"};
    p.record = [source = memory_.buffer(from).pieces(), target = memory_.buffer(to).pieces()](
                   const vk::raii::CommandBuffer& commands) { copy_content(commands, source, target); };
  }
  out.push_back(std::move(p));
}

std::vector<Primitive> Commands::primitives(const bundle::StepT& step) {
  std::vector<Primitive> primitives;
  for (size_t k = 0; k < step.commands.size(); ++k) {
    const bundle::CommandT& c = *step.commands[k];
    const size_t first = k, begin = primitives.size();
    switch (c.kind) {
      case CommandKind::Dispatch: dispatch(c, primitives); break;
      case CommandKind::Draw: {
        std::vector<const bundle::CommandT*> draws{&c};
        while (k + 1 < step.commands.size() && step.commands[k + 1]->joins) draws.push_back(step.commands[++k].get());
        render_pass(draws, primitives);
        break;
      }
      case CommandKind::Fill: fill(c, primitives); break;
      case CommandKind::Copy: copy(c, primitives); break;
      case CommandKind::Reduce: reduce(c, primitives); break;
    }
    for (size_t p = begin; p < primitives.size(); ++p) {
      primitives[p].first = first;
      primitives[p].count = k + 1 - first;
      if (primitives[p].bytes > 0) continue;
      for (const Access& a : primitives[p].accesses) primitives[p].bytes += memory_.content_bytes(a.resource);
    }
    for (size_t j = first; j <= k; ++j) primitives[begin].ops += step.commands[j]->ops;
  }
  pipelines_.build();
  return primitives;
}

std::vector<std::vector<Access>> Commands::accesses(std::span<const Primitive* const> primitives) const {
  std::vector<std::vector<Access>> out;
  for (const Primitive* p : primitives) {
    out.push_back(p->accesses);
    for (Access& a : out.back()) a.resource = bundle_.resources[a.resource]->slot;
  }
  return out;
}

void Commands::record(const vk::raii::CommandBuffer& commands, std::span<const Primitive* const> primitives) const {
  const std::vector<std::vector<Access>> all = accesses(primitives);
  const std::vector<std::vector<size_t>> levels = by_level(all);
  std::vector<std::vector<Access>> of_levels;
  for (const std::vector<size_t>& level : levels) {
    std::vector<Access>& together = of_levels.emplace_back();
    for (const size_t k : level) together.insert(together.end(), all[k].begin(), all[k].end());
  }
  const std::vector<Barrier> barriers = plan_barriers(of_levels);
  for (size_t level = 0; level < levels.size(); ++level) {
    record_barrier(commands, barriers[level]);
    for (const size_t k : levels[level]) record_one(commands, *primitives[k]);
  }
}

void Commands::record_apart(const vk::raii::CommandBuffer& commands, std::span<const Primitive* const> primitives,
                            const std::function<void(size_t)>& after_each) const {
  const std::vector<Barrier> barriers = plan_barriers(accesses(primitives));
  for (size_t k = 0; k < primitives.size(); ++k) {
    record_barrier(commands, barriers[k]);
    record_one(commands, *primitives[k]);
    after_each(k);
  }
}

void Commands::record_one(const vk::raii::CommandBuffer& commands, const Primitive& primitive) const {
  if (device_->debug_names) {
    vk::DebugUtilsLabelEXT label;
    label.pLabelName = primitive.label.c_str();
    commands.beginDebugUtilsLabelEXT(label);
  }
  primitive.record(commands);
  if (device_->debug_names) commands.endDebugUtilsLabelEXT();
}

}  // namespace dr::runtime
