// SPDX-License-Identifier: Apache-2.0
// Descriptors and pipelines of a bundle's shaders.
#pragma once

#include <array>
#include <filesystem>
#include <functional>
#include <map>
#include <set>
#include <span>
#include <string>
#include <tuple>

#include "compiler/backend/bundle/split_buffers.h"
#include "runtime/vk/memory.h"

namespace dr::runtime {

// Resources as a shader sees them.
struct Bound {
  vk::PipelineLayout layout;
  vk::DescriptorSet set;
  std::vector<bundle::Split> splits;  // of buffers that hold more than a binding takes
};

// A resource of the bundle; with `texel`, it is a uniform texel buffer of texels of so many words.
struct Descriptor {
  uint32_t resource = 0;
  uint32_t texel = 0;
};

class Pipelines {
 public:
  // `cache_folder` keeps what the driver wants kept; empty: nothing. `buffer_limit`: bytes that a binding takes at
  // most; 0: as many as on the device.
  Pipelines(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Memory& memory,
            std::filesystem::path cache_folder, int64_t buffer_limit);
  // Shaders that are used from now on see these values of the symbols. A symbol without a value stands in no shader
  // of the step in a way that matters; later steps are recorded later.
  void specialize(const ir::SymbolValues& symbols);
  // `inputs`: the views of the resources that are input attachments; only fragment shaders can have those.
  Bound bind(const std::vector<Descriptor>& descriptors, vk::ShaderStageFlags stages,
             const std::map<uint32_t, vk::ImageView>& inputs = {});
  // These give the number of a pipeline that is there after build().
  // `group`: the invocations of a workgroup; `part_trips`: see Command in bundle.fbs.
  size_t compute(int shader, const Bound& bound, uint32_t group, uint32_t part_trips = 0);
  size_t graphics(const bundle::CommandT& draw, const Bound& bound, vk::RenderPass render_pass, uint32_t subpass,
                  vk::Extent2D size);
  // Makes the pipelines that were asked for, on all cores.
  void build();
  vk::Pipeline operator[](size_t number) const { return *pipelines_[number]; }
  // Of an invocation of a compute shader; 0 where the driver does not tell.
  int registers(size_t number) const;

  const PipelineCounters& counters() const { return counters_; }

 private:
  using Cache = vk::raii::PipelineCache;
  // `values`: of the symbols.
  // All specialization constants, in order.
  std::vector<int32_t> constants(uint32_t group, uint32_t part_trips) const;
  vk::raii::Pipeline make_compute(int shader, size_t module, vk::PipelineLayout layout,
                                  const std::vector<int32_t>& values, const Cache& cache) const;
  // `modules`: of the two stages.
  vk::raii::Pipeline make_graphics(const bundle::CommandT& draw, std::array<size_t, 2> modules,
                                   vk::PipelineLayout layout, vk::RenderPass render_pass, uint32_t subpass,
                                   vk::Extent2D size, const Cache& cache) const;
  struct Layouts {
    vk::raii::DescriptorSetLayout set;
    vk::raii::PipelineLayout pipeline;
  };
  // Into a shader of the device. Throws Failure.
  void must_fit(const std::vector<vk::DescriptorSetLayoutBinding>& bindings, bool in_parts) const;
  // One of each kind, so that passes of one shader have one pipeline.
  const Layouts& layouts_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings, vk::ShaderStageFlags stages);
  vk::DescriptorPool pool_for(const std::vector<vk::DescriptorSetLayoutBinding>& bindings);
  // How many bytes, or texels, one binding takes of it at most.
  vk::DeviceSize most_of(const Descriptor& descriptor) const;
  // Bindings of the further parts of what holds more; `count`: of the bindings without them.
  std::vector<bundle::Split> splits_of(const std::vector<Descriptor>& descriptors, size_t count) const;
  // Texels from `first` on.
  vk::BufferView texels(const Descriptor& descriptor, vk::DeviceSize first, vk::DeviceSize count);
  // Of the shader for buffers in such parts.
  size_t module_of(int shader, const std::vector<bundle::Split>& splits);
  std::string cache_key() const;
  size_t want(std::function<vk::raii::Pipeline(const Cache&)> make);

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Memory& memory_;
  std::filesystem::path cache_folder_;
  PipelineCounters counters_;
  std::set<std::string> written_;                                        // keys of files that were written here
  std::vector<std::function<vk::raii::Pipeline(const Cache&)>> wanted_;  // the last of pipelines_
  std::vector<int32_t> values_;                                          // of the symbols
  std::vector<int32_t> numbers_;                                         // of Bundle.numbers
  int64_t buffer_limit_;
  std::vector<vk::raii::ShaderModule> modules_;  // the bundle's shaders, then those for buffers in parts
  std::map<std::pair<int, std::vector<bundle::Split>>, size_t> split_modules_;
  std::map<std::vector<uint32_t>, Layouts> layouts_;  // by the stages, and type and stages of each binding
  std::vector<vk::raii::Pipeline> pipelines_;
  std::map<std::tuple<size_t, VkPipelineLayout, uint32_t, uint32_t, std::vector<int32_t>>, size_t>
      compute_;  // of pipelines_
  std::vector<vk::raii::DescriptorPool> pools_;
  size_t sets_left_ = 0;  // in the last pool
  std::map<vk::DescriptorType, size_t> left_;
  std::vector<vk::raii::DescriptorSet> sets_;
  std::vector<vk::raii::BufferView> views_;
};

}  // namespace dr::runtime
