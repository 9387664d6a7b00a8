// SPDX-License-Identifier: Apache-2.0
#include "runtime/program/compile_beside.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <ranges>
#include <string_view>
#include <system_error>
#include <utility>

namespace dr::runtime {

namespace {

LoadOptions only_for_shaders(const LoadOptions& options) {
  LoadOptions out;
  out.trusted = true;  // it was looked at
  out.buffer_limit = options.buffer_limit;
  return out;
}

// Whether Mesa keeps what it compiles, as it does unless it is told not to, or cannot write there.
bool keeps_files() {
  for (const char* name : {"MESA_SHADER_CACHE_DISABLE", "MESA_GLSL_CACHE_DISABLE"})
    if (const char* off = std::getenv(name); off != nullptr && std::string_view("1tTyY").find(*off) < 5) return false;
  std::filesystem::path folder;
  for (const char* name : {"MESA_SHADER_CACHE_DIR", "MESA_GLSL_CACHE_DIR", "XDG_CACHE_HOME", "HOME"})
    if (const char* path = std::getenv(name); folder.empty() && path != nullptr) folder = path;
  // It makes the last folders itself.
  std::error_code ignored;
  while (!folder.empty() && !std::filesystem::exists(folder, ignored) && folder != folder.parent_path())
    folder = folder.parent_path();
  return std::filesystem::is_directory(folder, ignored) && access(folder.c_str(), W_OK) == 0;
}

}  // namespace

CompileBeside::CompileBeside(const DeviceState& device, const bundle::BundleT& bundle, const Sizes& sizes,
                             const LoadOptions& options, std::vector<Step> steps)
    : bundle_(bundle),
      sizes_(sizes),
      options_(only_for_shaders(options)),
      device_(device.properties.deviceName.data()),
      steps_(std::move(steps)),
      arrived_(steps_.front().index) {
  try {
    thread_ = std::thread([this] {
      try {
        compile();
      } catch (...) {  // the run will tell
        give_back();
      }
    });
  } catch (const std::system_error&) {  // no thread is left
  }
}

CompileBeside::~CompileBeside() {
  stop_ = true;
  wait();
}

bool CompileBeside::has(size_t step) const { return std::ranges::find(steps_, step, &Step::index) != steps_.end(); }

void CompileBeside::wait() {
  if (thread_.joinable()) thread_.join();
}

bool CompileBeside::is_worth_it(const DeviceState& device) {
  // SwiftShader compiles when pipelines are made. Messages of a validation layer are told for one device.
  const bool compiles_late = std::string_view(device.properties.deviceName.data()).starts_with("llvmpipe");
  return compiles_late && keeps_files() && !*device.messenger && std::thread::hardware_concurrency() > 1;
}

void CompileBeside::compile() {
  DeviceOptions like;
  like.name = device_;
  OnDevice on(open_device(like), bundle_, sizes_, options_, std::make_shared<Tally>());
  on.pipelines.specialize(sizes_.symbols());
  for (const Step& step : steps_) {
    on.memory.allocate({step.resources.begin(), step.resources.end()});  // untouched memory takes none
    const std::vector<Primitive> primitives = on.commands.primitives(*bundle_.steps[step.index]);
    const auto first = std::ranges::find_if(primitives, [](const Primitive& p) { return bool{p.compile}; });
    for (const Primitive& p : primitives | std::views::reverse) {
      if (stop_) return;
      if (!p.compile || !take(step.index, &p == &*first)) continue;
      on.queue.once(p.compile);
      give_back();
    }
  }
}

bool CompileBeside::take(size_t step, bool is_first) {
  const std::lock_guard lock(lock_);
  if (!is_first) return true;
  if (step == arrived_) return false;
  first_in_work_ = step;
  return true;
}

void CompileBeside::give_back() {
  const std::lock_guard lock(lock_);
  first_in_work_.reset();
  changed_.notify_all();
}

void CompileBeside::arrive(size_t step) {
  std::unique_lock lock(lock_);
  arrived_ = step;
  changed_.wait(lock, [&] { return first_in_work_ != step; });
}

}  // namespace dr::runtime
