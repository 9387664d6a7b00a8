// SPDX-License-Identifier: Apache-2.0
// The compiler as a library call.
#include "runtime/jit/jit.h"

#include <fstream>
#include <sstream>

#include "compiler/backend/compile.h"
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
  backend::CompileOptions compile;
  if (options.lower == "fragment")
    compile.lower = backend::Lower::Fragment;
  else if (options.lower == "compute")
    compile.lower = backend::Lower::Compute;
  else if (options.lower != "auto")
    return "unknown lowering '" + options.lower + "'; there are auto, fragment and compute\n";
  if (options.raster == "hardware")
    compile.raster = backend::RasterLower::Hardware;
  else if (options.raster == "compute")
    compile.raster = backend::RasterLower::Compute;
  else if (options.raster != "auto")
    return "unknown raster lowering '" + options.raster + "'; there are auto, hardware and compute\n";
  if (options.pack == "naive")
    compile.fused = false;
  else if (options.pack != "fused")
    return "unknown packing '" + options.pack + "'; there are fused and naive\n";
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
  auto compiled = backend::compile(ready, std::get<target::Profile>(profile), compile);
  if (const auto* problem = std::get_if<std::string>(&compiled)) return path + ": error: " + *problem + "\n";
  return bundle::write(std::get<backend::Compiled>(compiled).bundle);
}

}  // namespace dr::jit
