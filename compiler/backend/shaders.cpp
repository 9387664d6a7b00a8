// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/shaders.h"

#include <algorithm>
#include <limits>

#include "compiler/backend/bundle/on_all_cores.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/backend/spirv/spirv.h"

namespace dr::backend {

std::optional<Limit> bindings_over_limit(const bundle::BundleT& bundle, const target::Profile& profile) {
  for (const auto& step : bundle.steps)
    for (const auto& c : step->commands) {
      const auto count = [&](bool texels) {
        return static_cast<uint32_t>(std::count_if(c->bindings.begin(), c->bindings.end(), [&](const auto& b) {
          return bundle.resources[b->resource]->storage == bundle::Storage::Buffer && (b->texel != 0) == texels;
        }));
      };
      const uint32_t buffers = count(false), texels = count(true);
      if (texels > profile.max_per_stage_descriptor_sampled_images)
        return Limit{"pass '" + c->label + "' reads " + std::to_string(texels) + " texel buffers, profile '" +
                     profile.name + "' allows " + std::to_string(profile.max_per_stage_descriptor_sampled_images) +
                     " with sampled images"};
      if (buffers > profile.max_per_stage_descriptor_storage_buffers)
        return Limit{"pass '" + c->label + "' binds " + std::to_string(buffers) + " storage buffers, profile '" +
                     profile.name + "' allows " + std::to_string(profile.max_per_stage_descriptor_storage_buffers)};
      const auto written = static_cast<uint32_t>(
          std::ranges::count_if(c->bindings, [](const auto& b) { return b->access != bundle::Access::Read; }));
      if (c->fragment >= 0 && written + c->colors.size() > profile.max_fragment_combined_output_resources)
        return Limit{"pass '" + c->label + "' writes " + std::to_string(written) + " storage buffers and " +
                     std::to_string(c->colors.size()) + " colour attachments in a fragment shader, profile '" +
                     profile.name + "' allows " + std::to_string(profile.max_fragment_combined_output_resources) +
                     " together"};
      if (c->colors.size() > profile.max_color_attachments)
        return Limit{"pass '" + c->label + "' writes " + std::to_string(c->colors.size()) +
                     " colour attachments, profile '" + profile.name + "' allows " +
                     std::to_string(profile.max_color_attachments)};
    }
  return std::nullopt;
}

// Symbols as small as they can be.
std::optional<Limit> words_over_limit(const bundle::BundleT& bundle) {
  ir::SymbolValues ones;
  for (const std::string& symbol : bundle.symbols) ones[symbol] = 1;
  for (const auto& r : bundle.resources) {
    ir::Dim words = is_words(*r) ? 1 : r->type->rows * r->type->cols;
    for (const std::string* axis : {&r->extent->w, &r->extent->h, &r->extent->l})
      words = words * ir::Dim::parse(*axis).value_or(ir::Dim(1));
    words = words + ir::Dim(elements_behind(*r) * r->type->rows * r->type->cols);
    const auto count = words.evaluate(ones);
    if (!count || *count > std::numeric_limits<int32_t>::max())
      return Limit{"'" + r->name + "' takes " + (count ? std::to_string(*count) : "more than 2^63") +
                   " words, a buffer has fewer than 2^31"};
  }
  return std::nullopt;
}

namespace {

std::string numbered(const std::string& source) {
  std::string out;
  size_t line = 1, begin = 0;
  while (begin < source.size()) {
    const size_t end = std::min(source.find('\n', begin), source.size());
    out += std::to_string(line++) + ": " + source.substr(begin, end - begin) + "\n";
    begin = end + 1;
  }
  return out;
}

}  // namespace

void assemble_shaders(const std::filesystem::path& cache_folder, Compiled& compiled) {
  const std::vector<GlslShader>& glsl = compiled.glsl;
  bundle::BundleT& bundle = compiled.bundle;
  // Shaders are independent; results go to fixed places, so the bytes do not depend on the number of threads.
  std::vector<std::variant<std::vector<uint32_t>, std::string>> modules(glsl.size());
  const ShaderCache cache(cache_folder);
  std::vector<AssembleTimes> times(glsl.size());
  bundle::on_all_cores(glsl.size(), [&](size_t k) { modules[k] = assemble(glsl[k], cache, &times[k]); });
  for (const AssembleTimes& t : times) {
    compiled.times.cache += t.cache;
    compiled.times.glslang += t.glslang;
    compiled.times.inlining += t.inlining;
    compiled.times.validation += t.validation;
  }
  compiled.shaders_found = cache.found();
  if (cache.has_stored()) cache.trim();  // a cache that has not grown is not too large
  bool wide = false, float_atomics = false, subgroups = false, shuffles = false, multiview = false;
  for (size_t k = 0; k < modules.size(); ++k) {
    if (const auto* problem = std::get_if<std::string>(&modules[k]))
      DR_ICE("generated shader '" + glsl[k].names.front() + "' is refused: " + *problem + "\n" +
             numbered(glsl[k].source));
    auto shader = std::make_unique<bundle::ShaderT>();
    shader->name = glsl[k].names.front();
    shader->stage = glsl[k].stage;
    shader->spirv = std::move(std::get<std::vector<uint32_t>>(modules[k]));
    bundle.shaders.push_back(std::move(shader));
    const auto uses = [&](const char* extension) { return glsl[k].extensions.contains(extension); };
    wide = wide || uses("GL_EXT_shader_atomic_int64");
    float_atomics = float_atomics || uses("GL_EXT_shader_atomic_float");
    subgroups = subgroups || uses("GL_KHR_shader_subgroup_arithmetic");
    shuffles = shuffles || uses("GL_KHR_shader_subgroup_shuffle");
    multiview = multiview || uses("GL_EXT_multiview");
  }
  using bundle::Feature;  // in the order that they have there
  const auto need = [&](bool used, Feature feature) {
    if (used) bundle.features.push_back(feature);
  };
  need(wide, Feature::ShaderInt64);
  need(wide, Feature::ShaderBufferInt64Atomics);
  need(subgroups, Feature::SubgroupArithmetic);
  need(multiview, Feature::Multiview);
  need(float_atomics, Feature::ShaderBufferFloat32AtomicAdd);
  need(shuffles, Feature::SubgroupShuffle);
}

}  // namespace dr::backend
