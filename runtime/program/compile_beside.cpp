// SPDX-License-Identifier: Apache-2.0
#include "runtime/program/compile_beside.h"

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
                             const LoadOptions& options, size_t step, std::set<uint32_t> resources)
    : bundle_(bundle),
      sizes_(sizes),
      options_(only_for_shaders(options)),
      device_(device.properties.deviceName.data()),
      step_(step),
      resources_(std::move(resources)) {
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
  on.memory.allocate({resources_.begin(), resources_.end()});  // untouched memory takes none
  on.pipelines.specialize(sizes_.symbols());
  const std::vector<Primitive> primitives = on.commands.primitives(*bundle_.steps[step_]);
  for (const Primitive& p : primitives | std::views::reverse) {
    if (stop_) return;
    if (p.compile) on.queue.once(p.compile);
  }
}

}  // namespace dr::runtime
