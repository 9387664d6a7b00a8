// SPDX-License-Identifier: Apache-2.0
// The compiler as a library call.
#include "runtime/jit/jit.h"

#include <fstream>
#include <sstream>

#include "compiler/backend/compile.h"
#include "compiler/backend/shader_cache.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "compiler/target/profile.h"
#include "dsl/diagnostic.h"

namespace dr::jit {

std::variant<std::vector<uint8_t>, std::string> compile_file(const std::string& path, const Options& options) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return "cannot read '" + path + "'\n";
  std::stringstream text;
  text << file.rdbuf();
  auto compile = backend::compile_options(options.lower, options.raster, options.pack, options.ablate, options.scatter);
  if (const auto* problem = std::get_if<std::string>(&compile)) return *problem + "\n";
  const auto profile = target::load_profile(options.profile);
  if (const auto* problem = std::get_if<std::string>(&profile)) return *problem + "\n";

  dsl::SourceManager sources;
  dsl::DiagnosticList diagnostics;
  const auto graph =
      lower::lower(sources, sources.add(path, text.str()), {options.include_dirs, options.defines}, diagnostics);
  if (!graph) return dsl::format(diagnostics, sources);
  passes::PipelineOptions pipeline;
  pipeline.verify_each = false;
  const ir::Graph ready = passes::run_passes(*graph, passes::default_passes(), pipeline);
  std::get<backend::CompileOptions>(compile).sources = &sources;
  std::get<backend::CompileOptions>(compile).cache_folder = backend::default_cache_folder();
  auto compiled =
      backend::compile(ready, std::get<target::Profile>(profile), std::get<backend::CompileOptions>(compile));
  if (const auto* problem = std::get_if<std::string>(&compiled)) return path + ": error: " + *problem + "\n";
  return bundle::write(std::get<backend::Compiled>(compiled).bundle);
}

std::string cache_folder() { return backend::default_cache_folder().string(); }

}  // namespace dr::jit
