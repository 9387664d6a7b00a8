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
      add(c->colors[k], format_of(*bundle.resources[c->colors[k]]->type), vk::AttachmentStoreOp::eStore,
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
std::vector<vk::SubpassDependency> dependencies_of(Draws draws) {
  using Stage = vk::PipelineStageFlagBits;
  using Flag = vk::AccessFlagBits;
  const auto attach = Stage::eColorAttachmentOutput | Stage::eEarlyFragmentTests | Stage::eLateFragmentTests;
  const auto attach_access = Flag::eColorAttachmentRead | Flag::eColorAttachmentWrite |
                             Flag::eDepthStencilAttachmentRead | Flag::eDepthStencilAttachmentWrite;
  const auto attach_write = Flag::eColorAttachmentWrite | Flag::eDepthStencilAttachmentWrite;
  const auto readers = Stage::eVertexShader | Stage::eFragmentShader | Stage::eComputeShader | Stage::eTransfer;
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
                         Flag::eInputAttachmentRead | Flag::eColorAttachmentWrite, vk::DependencyFlagBits::eByRegion);
    }
  }
  return out;
}

vk::raii::RenderPass make_render_pass(const vk::raii::Device& device, const Attachments& attachments, Draws draws) {
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
  const std::vector<vk::SubpassDependency> dependencies = dependencies_of(draws);
  vk::RenderPassCreateInfo info;
  info.setAttachments(attachments.descriptions);
  info.setSubpasses(subpasses);
  info.setDependencies(dependencies);
  return {device, info};
}

struct Subpass {
  std::vector<Bound> bound;  // one, or one a layer
  size_t pipeline = 0;
  std::array<int32_t, 4> push{};
  uint32_t vertices = 0;
};

constexpr vk::ShaderStageFlags kGraphicsStages = vk::ShaderStageFlagBits::eVertex | vk::ShaderStageFlagBits::eFragment;

}  // namespace

std::vector<vk::Framebuffer> Commands::framebuffers(vk::RenderPass render_pass, std::span<const uint32_t> targets,
                                                    Size size, const std::string& what) {
  std::vector<vk::Framebuffer> out;
  for (size_t l = 0; l < static_cast<size_t>(size.l); ++l) {
    std::vector<vk::ImageView> views;
    for (const uint32_t t : targets) {
      const ImageObject& image = memory_.image(t);
      if (image.size.l != size.l || image.size.w != size.w || image.size.h != size.h)
        throw Failure{what + " has an attachment of another extent"};
      views.push_back(*image.layers[l]);
    }
    vk::FramebufferCreateInfo info({}, render_pass);
    info.setAttachments(views);
    info.width = static_cast<uint32_t>(size.w);
    info.height = static_cast<uint32_t>(size.h);
    info.layers = 1;
    framebuffers_.emplace_back(device_->device, info);
    out.push_back(*framebuffers_.back());
  }
  return out;
}

void Commands::render_pass(Draws draws, std::vector<Primitive>& out) {
  const bundle::CommandT& front = *draws.front();
  const std::string what = "pass '" + front.label + "'";
  const Size size = sizes_.size_of(*front.extent, what);
  const vk::Rect2D area({0, 0}, {static_cast<uint32_t>(size.w), static_cast<uint32_t>(size.h)});
  const Attachments attachments = attachments_of(bundle_, draws);
  render_passes_.push_back(make_render_pass(device_->device, attachments, draws));
  device_->name(render_passes_.back(), front.label);
  const vk::RenderPass pass = *render_passes_.back();
  const std::vector<vk::Framebuffer> targets = framebuffers(pass, attachments.targets, size, what);

  Primitive p;
  p.label = front.label;
  std::vector<Subpass> subpasses;
  for (uint32_t s = 0; s < draws.size(); ++s) {
    const bundle::CommandT& c = *draws[s];
    for (const uint32_t color : c.colors) p.accesses.push_back({color, Use::ColorWrite});
    if (c.depth >= 0) p.accesses.push_back({static_cast<uint32_t>(c.depth), Use::DepthWrite});
    std::vector<Descriptor> descriptors;
    for (const auto& b : c.bindings) {
      descriptors.push_back({b->resource, b->texel});
      p.accesses.push_back({b->resource, Use::GraphicsRead});
    }
    Subpass subpass;
    // Input attachments are of one layer, so each layer has its descriptors.
    for (size_t l = 0; l < (c.inputs.empty() ? 1 : targets.size()); ++l)
      subpass.bound.push_back(pipelines_.bind(descriptors, kGraphicsStages, c.inputs, l));
    subpass.pipeline = pipelines_.graphics(c, subpass.bound.front().layout, pass, s, area.extent);
    subpass.push = push_of(c);
    subpass.vertices = static_cast<uint32_t>(sizes_.evaluate(c.elements, what));
    subpasses.push_back(std::move(subpass));
  }
  p.record = [=, this, clears = attachments.clears](const vk::raii::CommandBuffer& commands) {
    for (size_t l = 0; l < targets.size(); ++l) {
      vk::RenderPassBeginInfo begin(pass, targets[l], area);
      begin.setClearValues(clears);
      commands.beginRenderPass(begin, vk::SubpassContents::eInline);
      for (size_t s = 0; s < subpasses.size(); ++s) {
        const Subpass& subpass = subpasses[s];
        const Bound& bound = subpass.bound[std::min(l, subpass.bound.size() - 1)];
        std::array<int32_t, 4> push = subpass.push;
        push[0] = static_cast<int32_t>(l);
        if (s > 0) commands.nextSubpass(vk::SubpassContents::eInline);
        commands.bindPipeline(vk::PipelineBindPoint::eGraphics, pipelines_[subpass.pipeline]);
        commands.bindDescriptorSets(vk::PipelineBindPoint::eGraphics, bound.layout, 0, bound.set, {});
        commands.pushConstants<int32_t>(bound.layout, kGraphicsStages, 0, push);
        commands.draw(subpass.vertices, 1, 0, 0);
      }
      commands.endRenderPass();
    }
  };
  out.push_back(std::move(p));
}

}  // namespace dr::runtime
