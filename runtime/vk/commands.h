// SPDX-License-Identifier: Apache-2.0
// A step's commands as primitives: what each touches, and how it is recorded.
#pragma once

#include <array>
#include <functional>

#include "runtime/vk/barrier.h"
#include "runtime/vk/pipelines.h"

namespace dr::runtime {

// One primitive to record: a dispatch, a render pass, a fill or a copy.
struct Primitive {
  std::string label;
  std::vector<Access> accesses;
  size_t first = 0, count = 1;   // commands of the step behind it: several for a render pass
  int64_t ops = 0;               // of the graph
  int pipeline = -1, group = 0;  // of a dispatch
  int64_t bytes = 0;             // that it touches: of whole resources, but for what clears the head of some
  std::function<void(const vk::raii::CommandBuffer&)> record;
  std::function<void(const vk::raii::CommandBuffer&)> compile;  // see Commands::compiling
};

class Commands {
 public:
  Commands(std::shared_ptr<DeviceState> device, const bundle::BundleT& bundle, const Sizes& sizes, const Memory& memory,
           Pipelines& pipelines, bool trusted)
      : device_(std::move(device)),
        bundle_(bundle),
        sizes_(sizes),
        memory_(memory),
        pipelines_(pipelines),
        trusted_(trusted) {}

  // Resources of the step have memory; symbols have values.
  std::vector<Primitive> primitives(const bundle::StepT& step);
  // What primitives in order wait for before they use memory first.
  Scope first_uses(std::span<const Primitive* const> primitives) const {
    return runtime::first_uses(accesses(primitives));
  }
  // Some of a step's primitives in order, of several runs too: those that need not wait for each other run beside each
  // other.
  void record(const vk::raii::CommandBuffer& commands, std::span<const Primitive* const> primitives) const;
  // One after the other, with the barriers that they need; `after_each` is recorded after each.
  void record_apart(const vk::raii::CommandBuffer& commands, std::span<const Primitive* const> primitives,
                    const std::function<void(size_t)>& after_each) const;

 private:
  // What each touches, by memory: resources that share some wait for each other.
  std::vector<std::vector<Access>> accesses(std::span<const Primitive* const> primitives) const;
  void record_one(const vk::raii::CommandBuffer& commands, const Primitive& primitive) const;
  // So many invocations are no mistake: each has something to read or to write. Throws Failure.
  void must_be_due(const bundle::CommandT& command, int64_t invocations) const;
  void dispatch(const bundle::CommandT& command, std::vector<Primitive>& out);
  int64_t parts_of(const bundle::CommandT& command) const;
  // Records a dispatch of no workgroup: it does nothing, but drivers that compile late do it then.
  std::function<void(const vk::raii::CommandBuffer&)> compiling(size_t pipeline, const Bound& bound,
                                                                uint32_t group) const;
  Primitive clear_left(const bundle::CommandT& command, vk::DeviceSize offset) const;
  void reduce(const bundle::CommandT& command, std::vector<Primitive>& out);
  void fill(const bundle::CommandT& command, std::vector<Primitive>& out);
  void copy(const bundle::CommandT& command, std::vector<Primitive>& out);
  // A Draw and those that join it: render passes of as many layers as the device draws at once, with a subpass for
  // each.
  void render_pass(std::span<const bundle::CommandT* const> draws, std::vector<Primitive>& out);
  // Layers of images, as attachments: views by resource.
  std::map<uint32_t, vk::ImageView> attachment_views(std::span<const uint32_t> resources, uint32_t first,
                                                     uint32_t layers, Size size, const std::string& what);

  std::shared_ptr<DeviceState> device_;
  const bundle::BundleT& bundle_;
  const Sizes& sizes_;
  const Memory& memory_;
  Pipelines& pipelines_;
  bool trusted_;
  std::vector<vk::raii::RenderPass> render_passes_;
  std::vector<vk::raii::Framebuffer> framebuffers_;
  std::vector<vk::raii::ImageView> views_;
};

// Push constants a, b, c of a command; the first is the layer.
std::array<int32_t, 4> push_of(const bundle::CommandT& command);

}  // namespace dr::runtime
