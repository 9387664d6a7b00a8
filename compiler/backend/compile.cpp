// SPDX-License-Identifier: Apache-2.0
// Pack, check, generate, assemble.
#include "compiler/backend/compile.h"

#include <algorithm>
#include <atomic>
#include <limits>
#include <optional>
#include <thread>

#include "compiler/backend/emit/generator.h"
#include "compiler/backend/lowering/keep_in_tiles.h"
#include "compiler/backend/lowering/keep_sums.h"
#include "compiler/backend/lowering/list_where_computed.h"
#include "compiler/backend/lowering/raster_entries.h"
#include "compiler/backend/lowering/set_up_in_raster.h"
#include "compiler/backend/lowering/update_in_place.h"
#include "compiler/backend/plan/dependencies.h"
#include "compiler/backend/plan/plan_memory.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/backend/spirv/spirv.h"
#include "compiler/ir/print.h"

namespace dr::backend {

namespace {

// What a raster or scatter shader binds depends on the program alone: too much of it is a limit met, told by name.
std::optional<std::string> over_limit(const bundle::BundleT& bundle, const target::Profile& profile) {
  for (const auto& step : bundle.steps)
    for (const auto& c : step->commands) {
      const auto count = [&](bool texels) {
        return static_cast<uint32_t>(std::count_if(c->bindings.begin(), c->bindings.end(), [&](const auto& b) {
          return bundle.resources[b->resource]->storage == bundle::Storage::Buffer && (b->texel != 0) == texels;
        }));
      };
      const uint32_t buffers = count(false), texels = count(true);
      if (texels > profile.max_per_stage_descriptor_sampled_images)
        return "pass '" + c->label + "' reads " + std::to_string(texels) + " texel buffers, profile '" + profile.name +
               "' allows " + std::to_string(profile.max_per_stage_descriptor_sampled_images) + " with sampled images";
      if (buffers > profile.max_per_stage_descriptor_storage_buffers)
        return "pass '" + c->label + "' binds " + std::to_string(buffers) + " storage buffers, profile '" +
               profile.name + "' allows " + std::to_string(profile.max_per_stage_descriptor_storage_buffers);
      const bool fragment = c->fragment >= 0;
      if (fragment && buffers + c->colors.size() > profile.max_fragment_combined_output_resources)
        return "pass '" + c->label + "' binds " + std::to_string(buffers) + " storage buffers and " +
               std::to_string(c->colors.size()) + " colour attachments in a fragment shader, profile '" + profile.name +
               "' allows " + std::to_string(profile.max_fragment_combined_output_resources) + " together";
      if (c->colors.size() > profile.max_color_attachments)
        return "pass '" + c->label + "' writes " + std::to_string(c->colors.size()) + " colour attachments, profile '" +
               profile.name + "' allows " + std::to_string(profile.max_color_attachments);
    }
  return std::nullopt;
}

// Words are counted by an int in shaders. Symbols as small as they can be.
std::optional<std::string> too_large(const bundle::BundleT& bundle) {
  ir::SymbolValues ones;
  for (const std::string& symbol : bundle.symbols) ones[symbol] = 1;
  for (const auto& r : bundle.resources) {
    ir::Dim words = r->role == bundle::Role::Scratch ? 1 : r->type->rows * r->type->cols;
    for (const std::string* axis : {&r->extent->w, &r->extent->h, &r->extent->l})
      words = words * ir::Dim::parse(*axis).value_or(ir::Dim(1));
    const auto count = words.evaluate(ones);
    if (!count || *count > std::numeric_limits<int32_t>::max())
      return "'" + r->name + "' takes " + (count ? std::to_string(*count) : "more than 2^63") +
             " words, a buffer has fewer than 2^31";
  }
  return std::nullopt;
}

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

std::variant<Compiled, std::string> compile(const ir::Graph& graph, const target::Profile& profile,
                                            const CompileOptions& options) {
  Compiled out;
  out.schedule = pack(graph, profile, pack_options(profile, options));
  if (auto problem = legalize_scatter(graph, profile, options.scatter, options.stages, out.schedule)) return *problem;
  if (!options.list_active)
    for (StepSchedule& step : out.schedule.steps)
      for (Pass& pass : step.passes) pass.active.clear(), pass.relist = false;
  update_in_place(graph, out.schedule);
  keep_in_tiles(graph, out.schedule);
  list_where_computed(graph, profile, out.schedule);
  keep_entries(graph, profile, out.schedule);
  keep_sums(graph, out.schedule);
  set_up_in_raster(graph, profile, out.schedule);
  if (const auto problems = check_schedule(graph, out.schedule, profile); !problems.empty()) {
    std::string all;
    for (const std::string& p : problems) all += (all.empty() ? "" : "\n") + p;
    return all;
  }
  bundle::BundleT& bundle = out.bundle;
  const PackOptions packing = pack_options(profile, options);
  bundle.version = bundle::kVersion;
  bundle.profile = profile.name;
  bundle.float_profile = options.native_floats ? "native" : "strict";
  const bool naive = !packing.fused && !packing.recompute && !packing.stages;
  bundle.lowering = std::string(naive ? "naive," : "fused,") + (packing.fragment ? "fragment," : "compute,") +
                    (packing.hardware_raster ? "hardware" : "compute");
  Generator generator(graph, out.schedule, profile, {options.lines, options.list_branches, options.native_floats});
  generator.process(bundle, out.glsl);
  find_dependencies(bundle);
  generator.clear_together();
  plan_memory(bundle);
  if (!options.share_memory)
    for (uint32_t k = 0; k < bundle.resources.size(); ++k) bundle.resources[k]->slot = k;
  if (const auto problems = check_memory(bundle); !problems.empty()) DR_ICE(problems.front());
  bundle.graph = ir::print(graph);
  if (!options.lines.files().empty()) bundle.op_lines = options.lines.in_text_order(graph);
  if (auto limit = over_limit(bundle, profile)) return *limit;
  if (auto large = too_large(bundle)) return *large;

  // Shaders are independent; results go to fixed places, so the bytes do not depend on the number of threads.
  std::vector<std::variant<std::vector<uint32_t>, std::string>> modules(out.glsl.size());
  std::atomic<size_t> next{0};
  const ShaderCache cache(options.cache_folder);
  auto work = [&] {
    for (size_t k = next++; k < out.glsl.size(); k = next++) modules[k] = assemble(out.glsl[k], cache);
  };
  std::vector<std::thread> threads;
  for (unsigned t = 1; t < std::max(1u, std::thread::hardware_concurrency()); ++t) threads.emplace_back(work);
  work();
  for (std::thread& t : threads) t.join();
  out.shaders_found = cache.found();
  if (cache.has_stored()) cache.trim();  // a cache that has not grown is not too large
  bool wide = false, float_atomics = false, subgroups = false, multiview = false;
  for (size_t k = 0; k < modules.size(); ++k) {
    if (const auto* problem = std::get_if<std::string>(&modules[k]))
      DR_ICE("generated shader '" + out.glsl[k].names.front() + "' is refused: " + *problem + "\n" +
             numbered(out.glsl[k].source));
    auto shader = std::make_unique<bundle::ShaderT>();
    shader->name = out.glsl[k].names.front();
    shader->stage = out.glsl[k].stage;
    shader->spirv = std::move(std::get<std::vector<uint32_t>>(modules[k]));
    bundle.shaders.push_back(std::move(shader));
    const auto uses = [&](const char* extension) { return out.glsl[k].source.find(extension) != std::string::npos; };
    wide = wide || uses("GL_EXT_shader_atomic_int64");
    float_atomics = float_atomics || uses("GL_EXT_shader_atomic_float");
    subgroups = subgroups || uses("GL_KHR_shader_subgroup_arithmetic");
    multiview = multiview || uses("GL_EXT_multiview");
  }
  if (wide) bundle.features = {"shader_int64", "shader_buffer_int64_atomics"};
  if (subgroups) bundle.features.push_back("subgroup_arithmetic");
  if (multiview) bundle.features.push_back("multiview");
  if (float_atomics) bundle.features.push_back("shader_buffer_float32_atomic_add");
  return out;
}

}  // namespace dr::backend
