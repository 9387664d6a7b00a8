// SPDX-License-Identifier: Apache-2.0
// Descriptors and pipelines of a bundle's shaders.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <span>
#include <tuple>

#include "runtime/vk/memory.h"

namespace dr::runtime {

// Resources as a shader sees them.
struct Bound {
  vk::PipelineLayout layout;
  vk::DescriptorSet set;
};

// A resource of the bundle; with `texel`, it is a uniform texel buffer of texels of so many words.
struct Descriptor {
  uint32_t resource = 0;
  uint32_t texel = 0;
};

class Pipelines {
 public:
  // `cache_folder` keeps what the driver wants kept; empty: nothing.
  Pipelines(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Memory& memory,
            std::filesystem::path cache_folder);
  // Shaders that are used from now on see these values of the symbols. A symbol without a value stands in no shader
  // of the step in a way that matters; later steps are recorded later.
  void specialize(const ir::SymbolValues& symbols);
  // `inputs`: the views of the resources that are input attachments; only fragment shaders can have those.
  Bound bind(const std::vector<Descriptor>& descriptors, vk::ShaderStageFlags stages,
             const std::map<uint32_t, vk::ImageView>& inputs = {});
  // These give the number of a pipeline that is there after build().
  // `group`: the invocations of a workgroup; `part_trips`: see Command in bundle.fbs.
  size_t compute(int shader, vk::PipelineLayout layout, uint32_t group, uint32_t part_trips = 0);
  size_t graphics(const bundle::CommandT& draw, vk::PipelineLayout layout, vk::RenderPass render_pass, uint32_t subpass,
                  vk::Extent2D size);
  // Makes the pipelines that were asked for, on all cores.
  void build();
  vk::Pipeline operator[](size_t number) const { return *pipelines_[number]; }

  const PipelineCounters& counters() const { return counters_; }

 private:
  using Cache = vk::raii::PipelineCache;
  // `values`: of the symbols.
  vk::raii::Pipeline make_compute(int shader, vk::PipelineLayout layout, uint32_t group, uint32_t part_trips,
                                  std::vector<int32_t> values, const Cache& cache) const;
  vk::raii::Pipeline make_graphics(const bundle::CommandT& draw, vk::PipelineLayout layout, vk::RenderPass render_pass,
                                   uint32_t subpass, vk::Extent2D size, const Cache& cache) const;
  struct Layouts {
    vk::raii::DescriptorSetLayout set;
    vk::raii::PipelineLayout pipeline;
  };
  // Into a shader of the device. Throws Failure.
  void must_fit(const std::vector<vk::DescriptorSetLayoutBinding>& bindings) const;
  // One of each kind, so that passes of one shader have one pipeline.
  const Layouts& layouts_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings, vk::ShaderStageFlags stages);
  vk::DescriptorPool pool_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings);
  vk::BufferView texels(const Descriptor& descriptor);
  std::string cache_key() const;
  size_t want(std::function<vk::raii::Pipeline(const Cache&)> make);

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Memory& memory_;
  std::filesystem::path cache_folder_;
  PipelineCounters counters_;
  std::vector<std::function<vk::raii::Pipeline(const Cache&)>> wanted_;  // the last of pipelines_
  std::vector<int32_t> values_;                                          // of the symbols
  std::vector<vk::raii::ShaderModule> shaders_;
  std::map<std::vector<uint32_t>, Layouts> layouts_;  // by the stages, and type and stages of each binding
  std::vector<vk::raii::Pipeline> pipelines_;
  std::map<std::tuple<int, VkPipelineLayout, uint32_t, uint32_t, std::vector<int32_t>>, size_t>
      compute_;  // of pipelines_
  std::vector<vk::raii::DescriptorPool> pools_;
  size_t sets_left_ = 0;  // in the last pool
  std::map<vk::DescriptorType, size_t> left_;
  std::vector<vk::raii::DescriptorSet> sets_;
  std::vector<vk::raii::BufferView> views_;
};

}  // namespace dr::runtime
