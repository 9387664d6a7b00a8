// SPDX-License-Identifier: Apache-2.0
// A run of a step with timestamps between its commands.
#include "runtime/state.h"

namespace dr::runtime {

std::vector<std::string> lines_of(const bundle::BundleT& bundle, const bundle::StepT& step, const Primitive& p) {
  std::vector<std::string> out;
  for (size_t c = p.first; c < p.first + p.count; ++c)
    for (const bundle::Line& line : step.commands[c]->lines)
      out.push_back(bundle.files[line.file()] + ":" + std::to_string(line.line()));
  return out;
}

std::vector<CommandTime> Program::State::timed_run(const std::string& name) {
  const size_t index = step_index(name);
  StepState& step = prepared_step(index);
  if (device->timestamp_bits == 0) throw Failure{"the device's queue takes no times"};
  const std::vector<bool> dirty = options.cache ? step.list->dirty(versions) : step.list->everything();
  const Variant& variant = recorded(step, dirty);
  const std::vector<const Primitive*> chosen = step.chosen(dirty);
  const auto stamps = static_cast<uint32_t>(chosen.size() + 1);
  const vk::raii::QueryPool pool(device->device, vk::QueryPoolCreateInfo({}, vk::QueryType::eTimestamp, stamps));
  on_device->queue.once([&](const vk::raii::CommandBuffer& commands) {
    const auto stamp = [&](uint32_t k) { commands.writeTimestamp(vk::PipelineStageFlagBits::eBottomOfPipe, *pool, k); };
    commands.resetQueryPool(*pool, 0, stamps);
    stamp(0);
    on_device->commands.record(commands, chosen, [&](size_t k) { stamp(static_cast<uint32_t>(k + 1)); });
  });
  count_run(index, dirty, variant.run, variant.skipped);

  const auto [result, ticks] = pool.getResults<uint64_t>(0, stamps, stamps * sizeof(uint64_t), sizeof(uint64_t),
                                                         vk::QueryResultFlagBits::e64 | vk::QueryResultFlagBits::eWait);
  if (result != vk::Result::eSuccess) throw Failure{"the device gave no times"};
  const uint64_t mask = device->timestamp_bits >= 64 ? UINT64_MAX : (uint64_t{1} << device->timestamp_bits) - 1;
  const auto nanoseconds = [&](uint32_t from, uint32_t to) {
    return static_cast<double>((ticks[to] - ticks[from]) & mask) *
           static_cast<double>(device->properties.limits.timestampPeriod);
  };
  std::vector<CommandTime> out;
  for (uint32_t k = 0; k < chosen.size(); ++k)
    out.push_back({chosen[k]->label, nanoseconds(k, k + 1), chosen[k]->ops, chosen[k]->bytes,
                   lines_of(bundle, *bundle.steps[index], *chosen[k])});
  return out;
}

}  // namespace dr::runtime
