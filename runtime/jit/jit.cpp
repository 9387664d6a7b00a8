// SPDX-License-Identifier: Apache-2.0
// The compiler as a library call.
#include "runtime/jit/jit.h"

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include "compiler/backend/compile.h"
#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "dsl/diagnostic.h"
#include "runtime/jit/compile_text.h"

namespace dr::jit {

std::vector<std::string> skip_names() { return {std::begin(backend::kSkips), std::end(backend::kSkips)}; }

std::variant<std::vector<uint8_t>, std::string> compile_text(const std::string& name, const std::string& text,
                                                             const target::Profile& profile, const Options& options,
                                                             std::vector<Skip>* skips) {
  auto compile = backend::compile_options(options.lower, options.raster, options.pack, options.ablate, options.scatter,
                                          options.float_profile);
  if (const auto* problem = std::get_if<std::string>(&compile)) return *problem + "\n";
  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  auto defines = options.defines;
  for (auto& define : backend::skip_defines(options.ablate, profile)) defines.insert(std::move(define));
  const auto graph = lower::lower(sources, sources.add(name, text), {options.include_dirs, defines}, diagnostics);
  if (!graph) return dsl::format(diagnostics, sources);
  passes::PipelineOptions pipeline;
  pipeline.verify_each = false;
  pipeline.skips = backend::pass_skips(options.ablate);
  passes::Skips::LeftOut left_out;
  pipeline.skips.left_out = &left_out;
  const ir::Graph ready = passes::run_passes(*graph, passes::default_passes(), pipeline);
  std::get<backend::CompileOptions>(compile).lines = backend::SourceLines(ready, sources);
  if (options.shader_cache) std::get<backend::CompileOptions>(compile).cache_folder = backend::default_cache_folder();
  auto compiled = backend::compile(ready, profile, std::get<backend::CompileOptions>(compile));
  if (const auto* problem = std::get_if<std::string>(&compiled)) return name + ": error: " + *problem + "\n";
  const auto& done = std::get<backend::Compiled>(compiled);
  if (skips) {
    for (const backend::SkipCount& s : backend::left_out_of_graph(ready, left_out))
      skips->push_back({s.id, s.unit, s.done, s.avoided});
    std::set<uint32_t> slots;
    for (const auto& resource : done.bundle.resources) slots.insert(resource->slot);
    skips->push_back({"slots", "resources", static_cast<int64_t>(slots.size()),
                      static_cast<int64_t>(done.bundle.resources.size() - slots.size())});
    skips->push_back({"shaders", "shaders", static_cast<int64_t>(done.glsl.size() - done.shaders_found),
                      static_cast<int64_t>(done.shaders_found)});
  }
  return bundle::write(done.bundle);
}

std::variant<std::vector<uint8_t>, std::string> compile_file(const std::string& path, const Options& options,
                                                             std::vector<Skip>* skips) {
  // A folder opens like an empty file.
  if (std::filesystem::is_directory(path)) return "cannot read '" + path + "': it is a folder\n";
  std::ifstream file(path, std::ios::binary);
  if (!file) return "cannot read '" + path + "'\n";
  std::stringstream text;
  text << file.rdbuf();
  const auto profile = target::load_profile(options.profile);
  if (const auto* problem = std::get_if<std::string>(&profile)) return *problem + "\n";
  return compile_text(path, text.str(), std::get<target::Profile>(profile), options, skips);
}

std::string cache_folder() { return backend::default_cache_folder().string(); }

}  // namespace dr::jit
