// SPDX-License-Identifier: Apache-2.0
// A run of a whole step, command by command, that looks at all that is stored.
#include <algorithm>

#include "runtime/program/state.h"

namespace dr::runtime {

std::optional<NotFinite> Program::State::checked_run(const std::string& name) {
  const size_t index = step_index(name);
  StepState& step = prepared_step(index);
  require_counts(index, 1);
  const std::vector<bool> dirty = step.list->everything();
  const Variant& variant = recorded(step, dirty);
  const std::vector<const Primitive*> chosen = step.chosen(dirty);

  // A value is whole after the last command that writes it, and its memory is not used for another one before that.
  std::map<uint32_t, size_t> first_write, last_write;
  for (size_t k = 0; k < chosen.size(); ++k)
    for (const Access& a : chosen[k]->accesses) {
      const bundle::ResourceT& r = *bundle.resources[a.resource];
      const bool holds_floats = !is_words(r) && r.storage != bundle::Storage::Depth &&
                                r.storage != bundle::Storage::Tile && r.type->scalar == bundle::Scalar::Float;
      if (!writes(a.use) || !holds_floats) continue;
      first_write.try_emplace(a.resource, k);
      last_write[a.resource] = k;
    }
  // The step runs to its end whatever is found, so that what it leaves behind is that of a run.
  std::optional<NotFinite> found;
  step.begun = true;
  for (size_t k = 0; k < chosen.size(); ++k) {
    // What no element of the list stores is what was there before.
    for (const auto& [resource, first] : first_write) {
      if (first != k || !bundle.resources[resource]->partial) continue;
      io::Array zero = on_device->transfer.download(resource);
      std::ranges::fill(zero.bytes, std::byte{0});
      on_device->transfer.upload(resource, zero);
    }
    on_device->queue.once([&](const vk::raii::CommandBuffer& commands) {
      on_device->commands.record(commands, std::span(chosen).subspan(k, 1));
    });
    for (const auto& [resource, last] : last_write) {
      if (last != k || found) continue;
      if (const auto place = io::first_not_finite(on_device->transfer.download(resource)))
        found = {chosen[k]->label, bundle.resources[resource]->name, *place,
                 lines_of(bundle, *bundle.steps[index], *chosen[k])};
    }
  }
  step.begun = false;
  ++step.counters.recorded;
  count_run(index, dirty, variant.run, variant.skipped);
  require_whole_loops(index);
  return found;
}

}  // namespace dr::runtime
