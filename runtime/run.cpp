// SPDX-License-Identifier: Apache-2.0
// Running steps: commands are recorded once and submitted as often as the step runs.
#include "runtime/state.h"

namespace dr::runtime {

StepState& Program::State::recorded_step(size_t index) {
  OnDevice& o = objects();
  StepState& step = o.steps[index];
  if (step.commands) return step;
  prepare(*bundle.steps[index]);
  step.primitives = o.commands.primitives(*bundle.steps[index]);
  vk::raii::CommandBuffer commands = o.queue.command_buffer();
  commands.begin(vk::CommandBufferBeginInfo());
  Queue::everything_before(commands);
  o.commands.record(commands, step.primitives);
  commands.end();
  step.commands = std::move(commands);
  return step;
}

void Program::State::require_run(const std::string& step) const {
  const size_t index = step_index(step);
  if (!on_device || on_device->steps[index].runs == 0) throw Failure{"step '" + step + "' has not run yet"};
}

void Program::State::run(const std::string& name, int times) {
  const size_t index = step_index(name);
  StepState& step = recorded_step(index);
  const int counter = bundle.steps[index]->step_index;
  for (int k = 0; k < times; ++k) {
    if (counter >= 0) {
      const auto value = static_cast<int32_t>(step.runs);
      on_device->transfer.upload(static_cast<uint32_t>(counter), io::Array::from_ints(std::span(&value, 1)));
    }
    on_device->queue.submit_and_wait(*step.commands);
    ++step.runs;
  }
}

}  // namespace dr::runtime
