// SPDX-License-Identifier: Apache-2.0
// Shader modules, descriptor sets, pipelines.
#include "runtime/vk/pipelines.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <iterator>
#include <string_view>
#include <utility>

#include "compiler/backend/bundle/on_all_cores.h"
#include "runtime/cache/pipeline_file.h"

namespace dr::runtime {

using bundle::Storage;

namespace {

// Constants 0, 1, ...; `entries` and `values` must outlive what points to them.
vk::SpecializationInfo specialization(std::span<const int32_t> values,
                                      std::vector<vk::SpecializationMapEntry>& entries) {
  for (uint32_t k = 0; k < values.size(); ++k) entries.emplace_back(k, k * 4, 4);
  vk::SpecializationInfo info;
  info.setMapEntries(entries);
  info.dataSize = values.size_bytes();
  info.pData = values.data();
  return info;
}

}  // namespace

Pipelines::Pipelines(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Memory& memory,
                     std::filesystem::path cache_folder, int64_t buffer_limit)
    : device_(std::move(device)),
      bundle_(bundle),
      memory_(memory),
      cache_folder_(std::move(cache_folder)),
      buffer_limit_(buffer_limit) {
  for (const auto& s : bundle_.shaders) {
    vk::ShaderModuleCreateInfo info;
    info.setCode(s->spirv);
    modules_.emplace_back(device_->device, info);
    device_->name(modules_.back(), s->name);
  }
}

size_t Pipelines::module_of(int shader, const std::vector<bundle::Split>& splits) {
  if (splits.empty()) return static_cast<size_t>(shader);
  const auto [it, is_new] = split_modules_.emplace(std::pair(shader, splits), modules_.size());
  if (!is_new) return it->second;
  const bundle::ShaderT& s = *bundle_.shaders[static_cast<size_t>(shader)];
  const auto split = bundle::split_buffers(s.spirv, splits);
  if (const auto* why = std::get_if<std::string>(&split))
    throw DeviceFailure{"shader '" + s.name + "' cannot have buffers that are bound in parts: it " + *why};
  vk::ShaderModuleCreateInfo info;
  info.setCode(std::get<std::vector<uint32_t>>(split));
  modules_.emplace_back(device_->device, info);
  device_->name(modules_.back(), s.name);
  return it->second;
}

void Pipelines::specialize(const ir::SymbolValues& symbols) {
  values_.clear();
  for (const std::string& s : bundle_.symbols) {
    const auto it = symbols.find(s);
    const int64_t value = it == symbols.end() ? 1 : it->second;
    if (value < 1 || value >= kMaxElements) throw Failure{"symbol '" + s + "' is " + std::to_string(value)};
    values_.push_back(static_cast<int32_t>(value));
  }
  numbers_.clear();
  for (const std::string& number : bundle_.numbers) {
    const ir::Dim dim = ir::Dim::parse(number).value();
    const bool known = std::ranges::all_of(dim.symbols(), [&](const std::string& s) { return symbols.contains(s); });
    if (const auto why = known ? dim.beyond_int(symbols) : std::nullopt) throw Failure{*why};
    numbers_.push_back(known ? static_cast<int32_t>(*dim.evaluate(symbols)) : 1);
  }
}

namespace {

vk::Format texel_format(const bundle::ResourceT& r, uint32_t texel) {
  using F = vk::Format;
  static constexpr F kFormats[3][4] = {{F::eR32Sfloat, F::eR32G32Sfloat, F::eR32G32B32Sfloat, F::eR32G32B32A32Sfloat},
                                       {F::eR32Sint, F::eR32G32Sint, F::eR32G32B32Sint, F::eR32G32B32A32Sint},
                                       {F::eR32Uint, F::eR32G32Uint, F::eR32G32B32Uint, F::eR32G32B32A32Uint}};
  const int scalar = r.type->scalar == bundle::Scalar::Float ? 0 : r.type->scalar == bundle::Scalar::Int ? 1 : 2;
  return kFormats[scalar][texel - 1];
}

// Bytes, or texels, of which the last one may go beyond the value.
vk::DeviceSize units_of(const BufferObject& buffer, uint32_t texel) {
  return texel == 0 ? buffer.bytes : (buffer.bytes + texel * 4 - 1) / (texel * 4);
}

}  // namespace

vk::DeviceSize Pipelines::most_of(const Descriptor& descriptor) const {
  const vk::PhysicalDeviceLimits& l = device_->properties.limits;
  const vk::DeviceSize given = buffer_limit_ > 0 ? static_cast<vk::DeviceSize>(buffer_limit_) : VK_WHOLE_SIZE;
  if (descriptor.texel == 0) return std::min<vk::DeviceSize>(l.maxStorageBufferRange, given);
  const bundle::ResourceT& r = *bundle_.resources[descriptor.resource];
  const auto features = device_->physical.getFormatProperties(texel_format(r, descriptor.texel)).bufferFeatures;
  if (!(features & vk::FormatFeatureFlagBits::eUniformTexelBuffer))
    throw DeviceFailure{
        "'" + r.name + "' is read as texels of " + std::to_string(descriptor.texel) +
        " words, which the device has none of; compile it for this device (a profile with \"lanes_in_turn\": "
        "false)"};
  return std::min<vk::DeviceSize>(l.maxTexelBufferElements, given / (descriptor.texel * 4));
}

std::vector<bundle::Split> Pipelines::splits_of(const std::vector<Descriptor>& descriptors, size_t count) const {
  const vk::PhysicalDeviceLimits& l = device_->properties.limits;
  std::vector<bundle::Split> out;
  for (uint32_t k = 0; k < descriptors.size(); ++k) {
    const auto [resource, texel] = descriptors[k];
    if (bundle_.resources[resource]->storage != Storage::Buffer) continue;
    const BufferObject& buffer = memory_.buffer(resource);
    // A part begins where a binding may.
    const vk::DeviceSize least = texel == 0 ? std::max<vk::DeviceSize>(l.minStorageBufferOffsetAlignment, 16)
                                            : std::max<vk::DeviceSize>(l.minTexelBufferOffsetAlignment / 4, 4),
                         has = units_of(buffer, texel);
    vk::DeviceSize most = std::max(most_of(descriptors[k]), least);
    // None is in two buffers.
    if (buffer.in_pieces())
      most = std::min(most, texel == 3 ? buffer.each / 12 : buffer.each / 3 / std::max(1u, texel * 4));
    if (has <= most) continue;
    assert(most > 0);  // buffers in pieces have room for some of any texel
    const auto log_size = static_cast<uint32_t>(std::bit_width(most) - 1);
    const vk::DeviceSize parts = (has + (vk::DeviceSize{1} << log_size) - 1) >> log_size;
    out.push_back({k, static_cast<uint32_t>(count), static_cast<uint32_t>(parts), log_size});
    count += parts - 1;
  }
  return out;
}

namespace {

// The piece that has this byte.
BufferObject::Piece piece_of(const BufferObject& buffer, vk::DeviceSize byte) {
  return buffer.piece(buffer.in_pieces() ? byte / buffer.each : 0);
}

}  // namespace

vk::BufferView Pipelines::texels(const Descriptor& descriptor, vk::DeviceSize first, vk::DeviceSize count) {
  const bundle::ResourceT& r = *bundle_.resources[descriptor.resource];
  const vk::DeviceSize size = descriptor.texel * 4;
  const BufferObject::Piece piece = piece_of(memory_.buffer(descriptor.resource), first * size);
  const vk::BufferViewCreateInfo info({}, piece.buffer, texel_format(r, descriptor.texel), first * size - piece.first,
                                      count * size);
  views_.emplace_back(device_->device, info);
  device_->name(views_.back(), r.name);
  return *views_.back();
}

Bound Pipelines::bind(const std::vector<Descriptor>& descriptors, vk::ShaderStageFlags stages,
                      const std::map<uint32_t, vk::ImageView>& inputs) {
  const auto& d = device_->device;
  std::vector<vk::DescriptorSetLayoutBinding> bindings;
  for (uint32_t k = 0; k < descriptors.size(); ++k) {
    const auto [resource, texel] = descriptors[k];
    const bool input = inputs.count(resource) != 0;
    const auto type = texel != 0 ? vk::DescriptorType::eUniformTexelBuffer
                      : bundle_.resources[resource]->storage == Storage::Buffer ? vk::DescriptorType::eStorageBuffer
                      : input                                                   ? vk::DescriptorType::eInputAttachment
                                                                                : vk::DescriptorType::eSampledImage;
    bindings.emplace_back(k, type, 1, input ? vk::ShaderStageFlags(vk::ShaderStageFlagBits::eFragment) : stages);
  }
  const std::vector<bundle::Split> splits = splits_of(descriptors, bindings.size());
  for (const bundle::Split& split : splits)
    for (uint32_t part = 1; part < split.parts; ++part)
      bindings.emplace_back(split.more + part - 1, bindings[split.binding].descriptorType, 1, stages);
  must_fit(bindings, !splits.empty());
  const Layouts& layouts = layouts_for(bindings, stages);
  Bound bound{*layouts.pipeline, {}, splits};
  vk::DescriptorSetAllocateInfo allocate(pool_for(bindings));
  allocate.setSetLayouts(*layouts.set);
  sets_.push_back(std::move(vk::raii::DescriptorSets(d, allocate).front()));
  bound.set = *sets_.back();
  const auto write = [&](uint32_t binding, uint32_t k, vk::DeviceSize first, vk::DeviceSize count) {
    const auto [resource, texel] = descriptors[k];
    vk::WriteDescriptorSet one(bound.set, binding, 0, 1, bindings[k].descriptorType);
    vk::DescriptorBufferInfo buffer;
    if (bindings[k].descriptorType == vk::DescriptorType::eStorageBuffer) {
      const BufferObject::Piece piece = piece_of(memory_.buffer(resource), first);
      buffer = vk::DescriptorBufferInfo(piece.buffer, first - piece.first, count);
    }
    const bool input = bindings[k].descriptorType == vk::DescriptorType::eInputAttachment;
    const vk::DescriptorImageInfo image({}, input ? inputs.at(resource) : *memory_.image(resource).all,
                                        vk::ImageLayout::eShaderReadOnlyOptimal);
    vk::BufferView view;
    if (bindings[k].descriptorType == vk::DescriptorType::eUniformTexelBuffer)
      one.setTexelBufferView(view = texels(descriptors[k], first, count));
    else if (bindings[k].descriptorType == vk::DescriptorType::eStorageBuffer)
      one.setBufferInfo(buffer);
    else
      one.setImageInfo(image);
    d.updateDescriptorSets(one, {});
  };
  for (uint32_t k = 0; k < descriptors.size(); ++k) {
    const auto [resource, texel] = descriptors[k];
    const vk::DeviceSize all = units_of(memory_.buffer(resource), texel);
    const auto split = std::ranges::find(splits, k, &bundle::Split::binding);
    if (split == splits.end()) {
      write(k, k, 0, texel == 0 ? VK_WHOLE_SIZE : all);
      continue;
    }
    for (vk::DeviceSize part = 0; part < split->parts; ++part) {
      const vk::DeviceSize first = part << split->log_size, size = vk::DeviceSize{1} << split->log_size;
      write(part == 0 ? k : split->more + static_cast<uint32_t>(part) - 1, k, first, std::min(size, all - first));
    }
  }
  return bound;
}

void Pipelines::must_fit(const std::vector<vk::DescriptorSetLayoutBinding>& bindings, bool in_parts) const {
  const vk::PhysicalDeviceLimits& l = device_->properties.limits;
  using Type = vk::DescriptorType;
  const auto count = [&](std::initializer_list<Type> types) {
    return static_cast<uint32_t>(std::ranges::count_if(
        bindings, [&](const auto& b) { return std::ranges::find(types, b.descriptorType) != types.end(); }));
  };
  const struct {
    const char* what;
    uint32_t found, most;
  } all[] = {{"storage buffers", count({Type::eStorageBuffer}), l.maxPerStageDescriptorStorageBuffers},
             {"sampled images and texel buffers", count({Type::eSampledImage, Type::eUniformTexelBuffer}),
              l.maxPerStageDescriptorSampledImages},
             {"input attachments", count({Type::eInputAttachment}), l.maxPerStageDescriptorInputAttachments},
             {"resources", static_cast<uint32_t>(bindings.size()), l.maxPerStageResources}};
  for (const auto& [what, found, most] : all)
    if (found > most)
      throw DeviceFailure{
          "a shader binds " + std::to_string(found) + " " + what + ", the device allows " + std::to_string(most) +
          (in_parts ? "; buffers beyond its limit of bytes are bound in parts: bind less data, or allow larger buffers"
                    : "; compile the program for this device")};
}

const Pipelines::Layouts& Pipelines::layouts_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings,
                                                 vk::ShaderStageFlags stages) {
  std::vector<uint32_t> key{static_cast<uint32_t>(stages)};
  for (const auto& b : bindings) {
    key.push_back(static_cast<uint32_t>(b.descriptorType));
    key.push_back(static_cast<uint32_t>(b.stageFlags));
  }
  const auto it = layouts_.find(key);
  if (it != layouts_.end()) return it->second;
  vk::DescriptorSetLayoutCreateInfo set_info;
  set_info.setBindings(bindings);
  vk::raii::DescriptorSetLayout set(device_->device, set_info);
  const vk::PushConstantRange push(stages, 0, 16);
  vk::PipelineLayoutCreateInfo pipeline_info;
  pipeline_info.setSetLayouts(*set);
  pipeline_info.setPushConstantRanges(push);
  vk::raii::PipelineLayout pipeline(device_->device, pipeline_info);
  return layouts_.emplace(std::move(key), Layouts{std::move(set), std::move(pipeline)}).first->second;
}

// The last pool, while there is room for these; then a new one.
vk::DescriptorPool Pipelines::pool_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings) {
  constexpr uint32_t kSets = 64, kOfType = 4 * kSets;
  std::map<vk::DescriptorType, uint32_t> need;
  for (const auto& b : bindings) ++need[b.descriptorType];
  const bool room =
      sets_left_ > 0 && std::ranges::all_of(need, [&](const auto& n) { return left_[n.first] >= n.second; });
  if (!room) {
    sets_left_ = kSets;
    std::vector<vk::DescriptorPoolSize> sizes;
    for (const auto type : {vk::DescriptorType::eStorageBuffer, vk::DescriptorType::eUniformTexelBuffer,
                            vk::DescriptorType::eSampledImage, vk::DescriptorType::eInputAttachment}) {
      left_[type] = std::max(kOfType, need[type]);
      sizes.emplace_back(type, static_cast<uint32_t>(left_[type]));
    }
    vk::DescriptorPoolCreateInfo info(vk::DescriptorPoolCreateFlagBits::eFreeDescriptorSet, kSets);
    info.setPoolSizes(sizes);
    pools_.emplace_back(device_->device, info);
  }
  --sets_left_;
  for (const auto& [type, count] : need) left_[type] -= count;
  return *pools_.back();
}

size_t Pipelines::want(std::function<vk::raii::Pipeline(const Cache&)> make) {
  wanted_.push_back(std::move(make));
  pipelines_.emplace_back(nullptr);
  return pipelines_.size() - 1;
}

size_t Pipelines::compute(int shader, const Bound& bound, uint32_t group, uint32_t part_trips) {
  const size_t module = module_of(shader, bound.splits);
  const vk::PipelineLayout layout = bound.layout;
  const auto [it, is_new] =
      compute_.emplace(std::tuple(module, static_cast<VkPipelineLayout>(layout), group, part_trips, values_), 0);
  if (is_new)
    it->second = want([=, this, values = constants(group, part_trips)](const Cache& cache) {
      return make_compute(shader, module, layout, values, cache);
    });
  return it->second;
}

size_t Pipelines::graphics(const bundle::CommandT& draw, const Bound& bound, vk::RenderPass render_pass,
                           uint32_t subpass, vk::Extent2D size) {
  const std::array modules{module_of(draw.vertex, bound.splits), module_of(draw.fragment, bound.splits)};
  return want([=, this, &draw, layout = bound.layout](const Cache& cache) {
    return make_graphics(draw, modules, layout, render_pass, subpass, size, cache);
  });
}

// Device, driver, shaders and the values of symbols; the rest of a pipeline's state follows from the bundle's tables.
std::string Pipelines::cache_key() const {
  const auto& p = device_->properties;
  std::string key(reinterpret_cast<const char*>(p.pipelineCacheUUID.data()), VK_UUID_SIZE);
  std::vector<uint64_t> parts;
  for (const auto& s : bundle_.shaders) parts.push_back(bundle::checksum(s->spirv.data(), s->spirv.size() * 4));
  parts.push_back(bundle::checksum(values_.data(), values_.size() * 4));
  const uint64_t shaders = bundle::checksum(parts.data(), parts.size() * sizeof(uint64_t));
  for (const uint64_t number : {uint64_t{p.vendorID}, uint64_t{p.deviceID}, uint64_t{p.driverVersion}, shaders})
    key += " " + std::to_string(number);
  return key;
}

void Pipelines::build() {
  if (wanted_.empty()) return;
  const std::string key = cache_key();
  const PipelineFile file(cache_folder_, key);
  const std::vector<uint8_t> known = file.read();
  vk::PipelineCacheCreateInfo info;
  info.initialDataSize = known.size();
  info.pInitialData = known.data();
  const Cache cache(device_->device, info);
  const size_t first = pipelines_.size() - wanted_.size();
  const std::vector<std::function<vk::raii::Pipeline(const Cache&)>> wanted = std::exchange(wanted_, {});
  try {
    bundle::on_all_cores(wanted.size(), [&](size_t k) { pipelines_[first + k] = wanted[k](cache); });
  } catch (...) {
    std::erase_if(compute_, [&](const auto& one) { return one.second >= first; });
    throw;
  }
  const auto made = static_cast<int64_t>(wanted.size());
  const std::vector<uint8_t> data = cache.getData();
  if (data != known) {
    file.write(data);
    written_.insert(key);
  }
  // What lavapipe wants kept is the same for any pipelines: a file of one's own says nothing of others.
  counters_ += {made, known.empty() || written_.contains(key) ? 0 : made};
}

std::vector<int32_t> Pipelines::constants(uint32_t group, uint32_t part_trips) const {
  std::vector<int32_t> out;
  out.reserve(values_.size() + 2 + numbers_.size());
  std::ranges::copy(values_, std::back_inserter(out));
  for (const uint32_t of_dispatch : {group, part_trips}) out.push_back(static_cast<int32_t>(of_dispatch));
  std::ranges::copy(numbers_, std::back_inserter(out));
  return out;
}

vk::raii::Pipeline Pipelines::make_compute(int shader, size_t module, vk::PipelineLayout layout,
                                           const std::vector<int32_t>& values, const Cache& cache) const {
  std::vector<vk::SpecializationMapEntry> entries;
  const auto specialize = specialization(values, entries);
  vk::ComputePipelineCreateInfo info;
  info.stage =
      vk::PipelineShaderStageCreateInfo({}, vk::ShaderStageFlagBits::eCompute, *modules_[module], "main", &specialize);
  info.layout = layout;
  if (device_->shader_statistics) info.flags = vk::PipelineCreateFlagBits::eCaptureStatisticsKHR;
  vk::raii::Pipeline pipeline(device_->device, cache, info);
  device_->name(pipeline, bundle_.shaders[static_cast<size_t>(shader)]->name);
  return pipeline;
}

int Pipelines::registers(size_t number) const {
  if (!device_->shader_statistics) return 0;
  // As NVIDIA's driver, Mesa's for AMD and Mesa's for Intel call them.
  constexpr std::string_view kNames[] = {"Register Count", "VGPRs", "Max live registers"};
  for (const auto& s : device_->device.getPipelineExecutableStatisticsKHR({*pipelines_[number], 0}))
    if (std::ranges::find(kNames, std::string_view(s.name.data())) != std::end(kNames))
      return static_cast<int>(s.value.u64);
  return 0;
}

vk::raii::Pipeline Pipelines::make_graphics(const bundle::CommandT& c, std::array<size_t, 2> modules,
                                            vk::PipelineLayout layout, vk::RenderPass render_pass, uint32_t subpass,
                                            vk::Extent2D size, const Cache& cache) const {
  std::vector<vk::SpecializationMapEntry> entries;
  const std::vector<int32_t> values = constants(0, 0);
  const auto specialize = specialization(values, entries);
  const vk::PipelineShaderStageCreateInfo stage_infos[] = {
      {{}, vk::ShaderStageFlagBits::eVertex, *modules_[modules[0]], "main", &specialize},
      {{}, vk::ShaderStageFlagBits::eFragment, *modules_[modules[1]], "main", &specialize}};
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
  vk::raii::Pipeline pipeline(device_->device, cache, info);
  device_->name(pipeline, c.label);
  return pipeline;
}

}  // namespace dr::runtime
