// SPDX-License-Identifier: Apache-2.0
#include "runtime/program/compile_beside.h"

#include <algorithm>
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

}  // namespace

CompileBeside::CompileBeside(const DeviceState& device, const bundle::BundleT& bundle, const Sizes& sizes,
                             const LoadOptions& options, std::vector<Step> steps)
    : bundle_(bundle),
      sizes_(sizes),
      options_(only_for_shaders(options)),
      device_(device.properties.deviceName.data()),
      steps_(std::move(steps)) {
  try {
    thread_ = std::thread([this] {
      try {
        compile();
      } catch (...) {  // the run will tell
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
  return compiles_late && !*device.messenger && std::thread::hardware_concurrency() > 1;
}

void CompileBeside::compile() {
  DeviceOptions like;
  like.name = device_;
  OnDevice on(open_device(like), bundle_, sizes_, options_, std::make_shared<Tally>());
  on.pipelines.specialize(sizes_.symbols());
  for (const Step& step : steps_) {
    on.memory.allocate({step.resources.begin(), step.resources.end()});  // untouched memory takes none
    const std::vector<Primitive> primitives = on.commands.primitives(*bundle_.steps[step.index]);
    for (const Primitive& p : primitives | std::views::reverse) {
      if (stop_) return;
      if (p.compile) on.queue.once(p.compile);
    }
  }
}

}  // namespace dr::runtime
