// SPDX-License-Identifier: Apache-2.0
// Shader modules, descriptor sets, pipelines.
#include "runtime/vk/pipelines.h"

#include <algorithm>
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
                     std::filesystem::path cache_folder)
    : device_(std::move(device)), bundle_(bundle), memory_(memory), cache_folder_(std::move(cache_folder)) {
  for (const auto& s : bundle_.shaders) {
    vk::ShaderModuleCreateInfo info;
    info.setCode(s->spirv);
    shaders_.emplace_back(device_->device, info);
    device_->name(shaders_.back(), s->name);
  }
}

void Pipelines::specialize(const ir::SymbolValues& symbols) {
  values_.clear();
  for (const std::string& s : bundle_.symbols) {
    const auto it = symbols.find(s);
    const int64_t value = it == symbols.end() ? 1 : it->second;
    if (value < 1 || value >= kMaxElements) throw Failure{"symbol '" + s + "' is " + std::to_string(value)};
    values_.push_back(static_cast<int32_t>(value));
  }
}

// All of a buffer as texels.
vk::BufferView Pipelines::texels(const Descriptor& descriptor) {
  using F = vk::Format;
  static constexpr F kFormats[3][4] = {{F::eR32Sfloat, F::eR32G32Sfloat, F::eR32G32B32Sfloat, F::eR32G32B32A32Sfloat},
                                       {F::eR32Sint, F::eR32G32Sint, F::eR32G32B32Sint, F::eR32G32B32A32Sint},
                                       {F::eR32Uint, F::eR32G32Uint, F::eR32G32B32Uint, F::eR32G32B32A32Uint}};
  const bundle::ResourceT& r = *bundle_.resources[descriptor.resource];
  const int scalar = r.type->scalar == bundle::Scalar::Float ? 0 : r.type->scalar == bundle::Scalar::Int ? 1 : 2;
  const F format = kFormats[scalar][descriptor.texel - 1];
  const vk::DeviceSize size = descriptor.texel * 4, count = memory_.buffer(descriptor.resource).bytes / size;
  const auto features = device_->physical.getFormatProperties(format).bufferFeatures;
  const vk::DeviceSize most =
      features & vk::FormatFeatureFlagBits::eUniformTexelBuffer ? device_->properties.limits.maxTexelBufferElements : 0;
  if (count == 0 || count > most)
    throw Failure{"'" + r.name + "' is read as " + std::to_string(count) + " texels of " +
                  std::to_string(descriptor.texel) + " words, the device allows " + std::to_string(most) +
                  "; compile it for this device (a profile with \"lanes_in_turn\": false)"};
  const vk::BufferViewCreateInfo info({}, *memory_.buffer(descriptor.resource).buffer, format, 0, count * size);
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
  must_fit(bindings);
  const Layouts& layouts = layouts_for(bindings, stages);
  Bound bound{*layouts.pipeline, {}};
  vk::DescriptorSetAllocateInfo allocate(pool_for(bindings));
  allocate.setSetLayouts(*layouts.set);
  sets_.push_back(std::move(vk::raii::DescriptorSets(d, allocate).front()));
  bound.set = *sets_.back();
  for (uint32_t k = 0; k < descriptors.size(); ++k) {
    const uint32_t r = descriptors[k].resource;
    vk::WriteDescriptorSet write(bound.set, k, 0, 1, bindings[k].descriptorType);
    const vk::DescriptorBufferInfo buffer(*memory_.buffer(r).buffer, 0, VK_WHOLE_SIZE);
    const bool input = bindings[k].descriptorType == vk::DescriptorType::eInputAttachment;
    const vk::DescriptorImageInfo image({}, input ? inputs.at(r) : *memory_.image(r).all,
                                        vk::ImageLayout::eShaderReadOnlyOptimal);
    vk::BufferView view;
    if (bindings[k].descriptorType == vk::DescriptorType::eUniformTexelBuffer)
      write.setTexelBufferView(view = texels(descriptors[k]));
    else if (bindings[k].descriptorType == vk::DescriptorType::eStorageBuffer)
      write.setBufferInfo(buffer);
    else
      write.setImageInfo(image);
    d.updateDescriptorSets(write, {});
  }
  return bound;
}

void Pipelines::must_fit(const std::vector<vk::DescriptorSetLayoutBinding>& bindings) const {
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
      throw Failure{"a shader binds " + std::to_string(found) + " " + what + ", the device allows " +
                    std::to_string(most) + "; compile the program for this device"};
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

size_t Pipelines::compute(int shader, vk::PipelineLayout layout, uint32_t group, uint32_t part_trips) {
  const auto [it, is_new] =
      compute_.emplace(std::tuple(shader, static_cast<VkPipelineLayout>(layout), group, part_trips, values_), 0);
  if (is_new)
    it->second = want([=, this, values = values_](const Cache& cache) {
      return make_compute(shader, layout, group, part_trips, values, cache);
    });
  return it->second;
}

size_t Pipelines::graphics(const bundle::CommandT& draw, vk::PipelineLayout layout, vk::RenderPass render_pass,
                           uint32_t subpass, vk::Extent2D size) {
  return want(
      [=, this, &draw](const Cache& cache) { return make_graphics(draw, layout, render_pass, subpass, size, cache); });
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
  const PipelineFile file(cache_folder_, cache_key());
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
  const bool kept = !known.empty() && data == known;
  counters_ += {made, kept ? made : 0};
  if (data != known) file.write(data);
}

vk::raii::Pipeline Pipelines::make_compute(int shader, vk::PipelineLayout layout, uint32_t group, uint32_t part_trips,
                                           std::vector<int32_t> values, const Cache& cache) const {
  std::vector<vk::SpecializationMapEntry> entries;
  values.push_back(static_cast<int32_t>(group));
  values.push_back(static_cast<int32_t>(part_trips));
  const auto specialize = specialization(values, entries);
  vk::ComputePipelineCreateInfo info;
  info.stage = vk::PipelineShaderStageCreateInfo({}, vk::ShaderStageFlagBits::eCompute,
                                                 *shaders_[static_cast<size_t>(shader)], "main", &specialize);
  info.layout = layout;
  vk::raii::Pipeline pipeline(device_->device, cache, info);
  device_->name(pipeline, bundle_.shaders[static_cast<size_t>(shader)]->name);
  return pipeline;
}

vk::raii::Pipeline Pipelines::make_graphics(const bundle::CommandT& c, vk::PipelineLayout layout,
                                            vk::RenderPass render_pass, uint32_t subpass, vk::Extent2D size,
                                            const Cache& cache) const {
  std::vector<vk::SpecializationMapEntry> entries;
  const auto specialize = specialization(values_, entries);
  const vk::PipelineShaderStageCreateInfo stage_infos[] = {
      {{}, vk::ShaderStageFlagBits::eVertex, *shaders_[static_cast<size_t>(c.vertex)], "main", &specialize},
      {{}, vk::ShaderStageFlagBits::eFragment, *shaders_[static_cast<size_t>(c.fragment)], "main", &specialize}};
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
