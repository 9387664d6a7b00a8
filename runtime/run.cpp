// SPDX-License-Identifier: Apache-2.0
// Running steps: what must run is recorded once for each set of clean commands, and submitted as often as the step
// runs.
#include "runtime/state.h"

namespace dr::runtime {

OnDevice::~OnDevice() {
  try {
    queue.finish();
  } catch (...) {  // the device is lost: nothing is under way
  }
}

StepState& Program::State::prepared_step(size_t index) {
  OnDevice& o = objects();
  make_tables();
  StepState& step = o.steps[index];
  if (step.list) return step;
  const bundle::StepT& table = *bundle.steps[index];
  prepare(table);
  upload_counter(index);
  step.primitives = o.commands.primitives(table);
  step.list.emplace(table);
  return step;
}

const Variant& Program::State::recorded(StepState& step, const std::vector<bool>& dirty) {
  if (const auto it = step.variants.find(dirty); it != step.variants.end()) return it->second;
  // Few sets occur: everything at first, the steady part later, and what follows from leaves that the host binds anew.
  constexpr size_t kMaxVariants = 16;
  if (step.variants.size() == kMaxVariants) {
    on_device->queue.finish();
    step.variants.clear();
  }
  Variant variant;
  std::vector<const Primitive*> chosen;
  for (const Primitive& p : step.primitives) {
    const bool runs = dirty[step.list->group_of(p.first)];
    if (runs) chosen.push_back(&p);
    Work& work = runs ? variant.run : variant.skipped;
    work += {1, p.ops, p.bytes};
  }
  variant.commands = on_device->queue.command_buffer();
  variant.commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eSimultaneousUse));
  Queue::everything_before(variant.commands);
  on_device->commands.record(variant.commands, chosen);
  variant.commands.end();
  return step.variants.emplace(dirty, std::move(variant)).first->second;
}

void Program::State::require_run(const std::string& step) const {
  const size_t index = step_index(step);
  if (!on_device || on_device->steps[index].variants.empty()) throw Failure{"step '" + step + "' has not run yet"};
}

void Program::State::count_run(size_t index, const std::vector<bool>& dirty, const Work& run, const Work& skipped) {
  StepState& step = on_device->steps[index];
  step.list->ran(dirty, versions);
  for (const uint32_t leaf : bundle.steps[index]->changes) ++versions[leaf];
  step.counters.run += run;
  step.counters.skipped += skipped;
  ++step.counters.runs;
}

void Program::State::run(const std::string& name, int times) {
  const size_t index = step_index(name);
  StepState& step = prepared_step(index);
  for (int k = 0; k < times; ++k) {
    const std::vector<bool>& dirty = options.cache ? step.list->dirty(versions) : step.list->everything();
    const Variant& variant = recorded(step, dirty);
    on_device->queue.submit(variant.commands);
    count_run(index, dirty, variant.run, variant.skipped);
  }
  on_device->queue.finish();
}

void Program::State::set_runs(const std::string& name, int64_t runs) {
  const size_t index = step_index(name);
  if (runs < 0 || runs > INT32_MAX) throw Failure{"a step cannot have run " + std::to_string(runs) + " times"};
  objects().steps[index].counters.runs = runs;
  upload_counter(index);
}

void Program::State::upload_counter(size_t index) {
  const int counter = bundle.steps[index]->step_index;
  if (counter < 0 || !has_memory(static_cast<size_t>(counter))) return;
  const auto runs = static_cast<int32_t>(on_device->steps[index].counters.runs);
  on_device->transfer.upload(static_cast<uint32_t>(counter), io::Array::from_ints(std::span(&runs, 1)));
}

}  // namespace dr::runtime
