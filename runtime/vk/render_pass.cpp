// SPDX-License-Identifier: Apache-2.0
// Draws: render passes of one or several subpasses.
#include <algorithm>
#include <map>

#include "runtime/vk/commands.h"

namespace dr::runtime {

namespace {

using Draws = std::span<const bundle::CommandT* const>;

// Attachments in the order in which subpasses write them; depth last, for a pass of one draw.
struct Attachments {
  std::vector<vk::AttachmentDescription> descriptions;
  std::vector<uint32_t> targets;  // resources
  std::vector<vk::ClearValue> clears;
  std::map<uint32_t, uint32_t> number;  // of a resource
};

Attachments attachments_of(const bundle::BundleT& bundle, Draws draws) {
  Attachments out;
  const auto add = [&](uint32_t resource, vk::Format format, vk::AttachmentStoreOp store, vk::ImageLayout layout) {
    out.number[resource] = static_cast<uint32_t>(out.targets.size());
    out.targets.push_back(resource);
    out.descriptions.emplace_back(vk::AttachmentDescriptionFlags{}, format, vk::SampleCountFlagBits::e1,
                                  vk::AttachmentLoadOp::eClear, store, vk::AttachmentLoadOp::eDontCare,
                                  vk::AttachmentStoreOp::eDontCare, vk::ImageLayout::eUndefined, layout);
  };
  for (const bundle::CommandT* c : draws)
    for (size_t k = 0; k < c->colors.size(); ++k) {
      const uint32_t bits = c->clear[k];
      const bundle::ResourceT& r = *bundle.resources[c->colors[k]];
      const bool tile = r.storage == bundle::Storage::Tile;
      add(c->colors[k], format_of(*r.type), tile ? vk::AttachmentStoreOp::eDontCare : vk::AttachmentStoreOp::eStore,
          vk::ImageLayout::eShaderReadOnlyOptimal);
      out.clears.emplace_back(vk::ClearColorValue(std::array<uint32_t, 4>{bits, bits, bits, bits}));
    }
  if (const int depth = draws.front()->depth; depth >= 0) {
    add(static_cast<uint32_t>(depth), vk::Format::eD32Sfloat, vk::AttachmentStoreOp::eDontCare,
        vk::ImageLayout::eDepthStencilAttachmentOptimal);
    out.clears.emplace_back(vk::ClearDepthStencilValue(1.0f, 0));
  }
  return out;
}

// The layout changes must come after earlier readers and before later ones; the barriers between commands meet
// these. Subpasses wait for the ones before pixel by pixel.
std::vector<vk::SubpassDependency> dependencies_of(Draws draws, bool multiview) {
  using Stage = vk::PipelineStageFlagBits;
  using Flag = vk::AccessFlagBits;
  const auto attach = Stage::eColorAttachmentOutput | Stage::eEarlyFragmentTests | Stage::eLateFragmentTests;
  const auto attach_access = Flag::eColorAttachmentRead | Flag::eColorAttachmentWrite |
                             Flag::eDepthStencilAttachmentRead | Flag::eDepthStencilAttachmentWrite;
  const auto attach_write = Flag::eColorAttachmentWrite | Flag::eDepthStencilAttachmentWrite;
  const auto readers = Stage::eVertexShader | Stage::eFragmentShader | Stage::eComputeShader | Stage::eTransfer;
  // With several layers, each waits for its own.
  const auto local =
      vk::DependencyFlagBits::eByRegion | (multiview ? vk::DependencyFlagBits::eViewLocal : vk::DependencyFlags{});
  std::vector<vk::SubpassDependency> out;
  for (uint32_t s = 0; s < draws.size(); ++s) {
    out.emplace_back(VK_SUBPASS_EXTERNAL, s, attach | readers, attach, attach_write, attach_access);
    out.emplace_back(s, VK_SUBPASS_EXTERNAL, attach | Stage::eFragmentShader, readers | attach, attach_write,
                     Flag::eShaderRead | Flag::eTransferRead | attach_access);
    // Of an attachment that several subpasses use, the last one stores it: it waits for the other readers too.
    for (uint32_t earlier = 0; earlier < s; ++earlier) {
      const auto uses = [&](uint32_t input) {
        const auto &colors = draws[earlier]->colors, &inputs = draws[earlier]->inputs;
        return std::find(colors.begin(), colors.end(), input) != colors.end() ||
               std::find(inputs.begin(), inputs.end(), input) != inputs.end();
      };
      if (std::any_of(draws[s]->inputs.begin(), draws[s]->inputs.end(), uses))
        out.emplace_back(earlier, s, Stage::eColorAttachmentOutput | Stage::eFragmentShader,
                         Stage::eColorAttachmentOutput | Stage::eFragmentShader, Flag::eColorAttachmentWrite,
                         Flag::eInputAttachmentRead | Flag::eColorAttachmentWrite, local);
    }
  }
  return out;
}

// `layers` that are drawn at once.
vk::raii::RenderPass make_render_pass(const vk::raii::Device& device, const Attachments& attachments, Draws draws,
                                      uint32_t layers) {
  // What each subpass writes, reads, and must leave alone since a later one reads it or it is kept.
  struct References {
    std::vector<vk::AttachmentReference> colors, inputs;
    std::vector<uint32_t> preserve;
  };
  std::vector<References> references(draws.size());
  std::vector<vk::SubpassDescription> subpasses;
  vk::AttachmentReference depth({}, vk::ImageLayout::eDepthStencilAttachmentOptimal);
  uint32_t written = 0;
  for (size_t s = 0; s < draws.size(); ++s) {
    References& r = references[s];
    for (const uint32_t color : draws[s]->colors)
      r.colors.emplace_back(attachments.number.at(color), vk::ImageLayout::eColorAttachmentOptimal);
    for (const uint32_t input : draws[s]->inputs)
      r.inputs.emplace_back(attachments.number.at(input), vk::ImageLayout::eShaderReadOnlyOptimal);
    for (uint32_t k = 0; k < written; ++k)
      if (std::none_of(r.inputs.begin(), r.inputs.end(), [&](const auto& i) { return i.attachment == k; }))
        r.preserve.push_back(k);
    written += static_cast<uint32_t>(r.colors.size());
    vk::SubpassDescription subpass;
    subpass.pipelineBindPoint = vk::PipelineBindPoint::eGraphics;
    subpass.setColorAttachments(r.colors);
    subpass.setInputAttachments(r.inputs);
    subpass.setPreserveAttachments(r.preserve);
    if (draws.front()->depth >= 0) {
      depth.attachment = attachments.number.at(static_cast<uint32_t>(draws.front()->depth));
      subpass.pDepthStencilAttachment = &depth;
    }
    subpasses.push_back(subpass);
  }
  const std::vector<vk::SubpassDependency> dependencies = dependencies_of(draws, layers > 1);
  vk::RenderPassCreateInfo info;
  info.setAttachments(attachments.descriptions);
  info.setSubpasses(subpasses);
  info.setDependencies(dependencies);
  const std::vector<uint32_t> views(draws.size(), static_cast<uint32_t>((uint64_t{1} << layers) - 1));
  vk::RenderPassMultiviewCreateInfo multiview;
  multiview.setViewMasks(views);
  if (layers > 1) info.pNext = &multiview;
  return {device, info};
}

struct Subpass {
  Bound bound;
  size_t pipeline = 0;
  std::array<int32_t, 4> push{};
  uint32_t vertices = 0;
};

// Some of the layers.
struct Part {
  vk::RenderPass pass;
  vk::Framebuffer target;
  std::vector<Subpass> subpasses;
};

constexpr vk::ShaderStageFlags kGraphicsStages = vk::ShaderStageFlagBits::eVertex | vk::ShaderStageFlagBits::eFragment;

}  // namespace

std::map<uint32_t, vk::ImageView> Commands::attachment_views(std::span<const uint32_t> resources, uint32_t first,
                                                             uint32_t layers, Size size, const std::string& what) {
  std::map<uint32_t, vk::ImageView> out;
  for (const uint32_t r : resources) {
    const ImageObject& image = memory_.image(r);
    if (image.size.l != size.l || image.size.w != size.w || image.size.h != size.h)
      throw Failure{what + " has an attachment of another extent"};
    const bool depth = bundle_.resources[r]->storage == bundle::Storage::Depth;
    vk::ImageViewCreateInfo view;
    view.image = *image.image;
    view.viewType = vk::ImageViewType::e2DArray;
    view.format = depth ? vk::Format::eD32Sfloat : format_of(*bundle_.resources[r]->type);
    view.subresourceRange = {depth ? vk::ImageAspectFlagBits::eDepth : vk::ImageAspectFlagBits::eColor, 0, 1, first,
                             layers};
    views_.emplace_back(device_->device, view);
    out[r] = *views_.back();
  }
  return out;
}

void Commands::render_pass(Draws draws, std::vector<Primitive>& out) {
  const bundle::CommandT& front = *draws.front();
  const std::string what = "pass '" + front.label + "'";
  const Size size = sizes_.size_of(*front.extent, what);
  const vk::Rect2D area({0, 0}, {static_cast<uint32_t>(size.w), static_cast<uint32_t>(size.h)});
  const vk::PhysicalDeviceLimits& limits = device_->properties.limits;
  if (size.w > limits.maxFramebufferWidth || size.h > limits.maxFramebufferHeight)
    throw DeviceFailure{what + " draws " + std::to_string(size.w) + " x " + std::to_string(size.h) +
                        " pixels, the device allows " + std::to_string(limits.maxFramebufferWidth) + " x " +
                        std::to_string(limits.maxFramebufferHeight)};
  for (const bundle::CommandT* c : draws)
    if (c->colors.size() > limits.maxColorAttachments)
      throw DeviceFailure{what + " writes " + std::to_string(c->colors.size()) +
                          " colour attachments, the device allows " + std::to_string(limits.maxColorAttachments)};
  const Attachments attachments = attachments_of(bundle_, draws);

  Primitive p;
  p.label = front.label;
  for (const bundle::CommandT* c : draws) {
    for (const uint32_t color : c->colors) p.accesses.push_back({color, Use::ColorWrite});
    if (c->depth >= 0) p.accesses.push_back({static_cast<uint32_t>(c->depth), Use::DepthWrite});
    for (const auto& b : c->bindings) p.accesses.push_back({b->resource, Use::GraphicsRead});
  }
  // Shaders that do not count the layers that are drawn at once draw one.
  const bool several = std::ranges::count(bundle_.features, bundle::Feature::Multiview) != 0;
  const auto all = static_cast<uint32_t>(size.l),
             at_once = several ? std::clamp(device_->multiview_views, 1u, 32u) : 1u;
  // A render pass and its pipelines are for a number of layers: that of all parts, or what is left for the last.
  struct Pass {
    vk::RenderPass pass;
    std::vector<size_t> pipelines;
  };
  std::map<uint32_t, Pass> passes;
  std::vector<Part> parts;
  for (uint32_t first = 0; first < all; first += at_once) {
    const uint32_t layers = std::min(at_once, all - first);
    const bool is_new = passes.count(layers) == 0;
    Pass& shared = passes[layers];
    if (is_new) {
      render_passes_.push_back(make_render_pass(device_->device, attachments, draws, layers));
      device_->name(render_passes_.back(), front.label);
      shared.pass = *render_passes_.back();
    }
    const auto views = attachment_views(attachments.targets, first, layers, size, what);
    std::vector<vk::ImageView> targets;
    for (const uint32_t t : attachments.targets) targets.push_back(views.at(t));
    vk::FramebufferCreateInfo info({}, shared.pass);
    info.setAttachments(targets);
    info.width = area.extent.width;
    info.height = area.extent.height;
    info.layers = 1;
    framebuffers_.emplace_back(device_->device, info);
    Part part{shared.pass, *framebuffers_.back(), {}};
    for (uint32_t s = 0; s < draws.size(); ++s) {
      const bundle::CommandT& c = *draws[s];
      std::vector<Descriptor> descriptors;
      for (const auto& b : c.bindings) descriptors.push_back({b->resource, b->texel});
      std::map<uint32_t, vk::ImageView> inputs;
      for (const uint32_t input : c.inputs) inputs[input] = views.at(input);
      Subpass subpass;
      // Input attachments are of some layers, so each part has its descriptors.
      subpass.bound = first > 0 && inputs.empty() ? parts.front().subpasses[s].bound
                                                  : pipelines_.bind(descriptors, kGraphicsStages, inputs);
      if (is_new) shared.pipelines.push_back(pipelines_.graphics(c, subpass.bound, shared.pass, s, area.extent));
      subpass.pipeline = shared.pipelines[s];
      subpass.push = push_of(c);
      subpass.push[0] = static_cast<int32_t>(first);
      const int64_t vertices = sizes_.evaluate(c.elements, what);
      must_be_due(c, vertices);
      subpass.vertices = static_cast<uint32_t>(vertices);
      part.subpasses.push_back(std::move(subpass));
    }
    parts.push_back(std::move(part));
  }
  p.record = [=, this, clears = attachments.clears](const vk::raii::CommandBuffer& commands) {
    for (const Part& part : parts) {
      vk::RenderPassBeginInfo begin(part.pass, part.target, area);
      begin.setClearValues(clears);
      commands.beginRenderPass(begin, vk::SubpassContents::eInline);
      for (size_t s = 0; s < part.subpasses.size(); ++s) {
        const auto& [bound, pipeline, push, vertices] = part.subpasses[s];
        if (s > 0) commands.nextSubpass(vk::SubpassContents::eInline);
        commands.bindPipeline(vk::PipelineBindPoint::eGraphics, pipelines_[pipeline]);
        commands.bindDescriptorSets(vk::PipelineBindPoint::eGraphics, bound.layout, 0, bound.set, {});
        commands.pushConstants<int32_t>(bound.layout, kGraphicsStages, 0, push);
        commands.draw(vertices, 1, 0, 0);
      }
      commands.endRenderPass();
    }
  };
  out.push_back(std::move(p));
}

}  // namespace dr::runtime
