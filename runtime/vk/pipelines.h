// SPDX-License-Identifier: Apache-2.0
// Descriptors and pipelines of a bundle's shaders.
#pragma once

#include <span>

#include "runtime/vk/memory.h"

namespace dr::runtime {

// Resources as a shader sees them.
struct Bound {
  vk::PipelineLayout layout;
  vk::DescriptorSet set;
};

class Pipelines {
 public:
  Pipelines(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Memory& memory);
  // Shaders that are used from now on see these values of the symbols. A symbol without a value stands in no shader
  // of the step in a way that matters; later steps are recorded later.
  void specialize(const ir::SymbolValues& symbols);
  // `inputs` of the resources are input attachments, of the layer; only fragment shaders can have those.
  Bound bind(const std::vector<uint32_t>& resources, vk::ShaderStageFlags stages, std::span<const uint32_t> inputs = {},
             size_t layer = 0);
  vk::Pipeline compute(int shader, vk::PipelineLayout layout);
  vk::Pipeline graphics(const bundle::CommandT& draw, vk::PipelineLayout layout, vk::RenderPass render_pass,
                        uint32_t subpass, vk::Extent2D size);

 private:
  vk::SpecializationInfo specialization(std::vector<vk::SpecializationMapEntry>& entries) const;

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Memory& memory_;
  std::vector<int32_t> values_;  // of the symbols
  std::vector<vk::raii::ShaderModule> shaders_;
  std::vector<vk::raii::DescriptorSetLayout> set_layouts_;
  std::vector<vk::raii::PipelineLayout> layouts_;
  std::vector<vk::raii::Pipeline> pipelines_;
  std::vector<vk::raii::DescriptorPool> pools_;
  std::vector<vk::raii::DescriptorSet> sets_;
};

}  // namespace dr::runtime
