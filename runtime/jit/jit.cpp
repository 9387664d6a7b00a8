// SPDX-License-Identifier: Apache-2.0
// The compiler as a library call.
#include "runtime/jit/jit.h"

#include <set>

#include "compiler/backend/skips.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/driver/driver.h"
#include "compiler/io/program_text.h"
#include "runtime/jit/compile_text.h"

namespace dr::jit {

std::vector<std::string> skip_names() { return {std::begin(backend::kSkips), std::end(backend::kSkips)}; }

io::Result<std::vector<uint8_t>> compile_text(const std::string& name, const std::string& text,
                                              const target::Profile& profile, const Options& options, Told* told) {
  driver::Compilation program(name, text, options);
  program.use_profile(profile);
  const backend::Compiled* done = program.compiled();
  if (!done) return io::Error{program.messages()};
  if (told) {
    if (!program.diagnostics().all().empty()) told->warnings = program.messages();
    std::vector<Skip>& skips = told->skips;
    for (const backend::SkipCount& s : backend::left_out_of_graph(*program.differentiated(), program.left_out()))
      skips.push_back({s.id, s.unit, s.done, s.avoided});
    std::set<uint32_t> slots;
    for (const auto& resource : done->bundle.resources) slots.insert(resource->slot);
    skips.push_back({"slots", "resources", static_cast<int64_t>(slots.size()),
                     static_cast<int64_t>(done->bundle.resources.size() - slots.size())});
    skips.push_back({"shaders", "shaders", static_cast<int64_t>(done->glsl.size() - done->shaders_found),
                     static_cast<int64_t>(done->shaders_found)});
  }
  return bundle::write(done->bundle);
}

io::Result<std::vector<uint8_t>> compile_file(const std::string& path, const Options& options, Told* told) {
  const auto text = io::program_text(path);
  if (!text) return io::Error{"error: " + text.error() + "\n"};
  const auto profile = target::load_profile(options.profile);
  if (const auto* problem = std::get_if<std::string>(&profile)) return io::Error{*problem + "\n"};
  return compile_text(path, *text, std::get<target::Profile>(profile), options, told);
}

std::string cache_folder() { return backend::default_cache_folder().string(); }

}  // namespace dr::jit
