// SPDX-License-Identifier: Apache-2.0
// A run of a step with timestamps around its commands, which also looks at how long the lists are that dispatches run
// for.
#include <algorithm>

#include "runtime/program/state.h"

namespace dr::runtime {

std::vector<std::string> lines_of(const bundle::BundleT& bundle, const bundle::StepT& step, const Primitive& p) {
  std::vector<std::string> out;
  for (size_t c = p.first; c < p.first + p.count; ++c)
    for (const bundle::Line& line : step.commands[c]->lines)
      out.push_back(bundle.files[line.file()] + ":" + std::to_string(line.line()));
  return out;
}

namespace {

constexpr vk::DeviceSize kListBytes = bundle::kListHead * sizeof(uint32_t);

// Where blocks of elements are marked (compiler/backend/emit/at_rest.cpp), a workgroup of the update has as many
// invocations as a block has elements.
bool goes_by_marks(const bundle::CommandT& command, const bundle::ResourceT& list) {
  return list.list == bundle::ListKind::Stepped && command.group == bundle::kRestingBlock;
}

// The list that a dispatch runs for, if it does. A dispatch that walks a list in a loop takes no size from it.
std::optional<uint32_t> list_of(const bundle::BundleT& bundle, const bundle::CommandT& command, const Primitive& p) {
  for (const Use use : {Use::IndirectRead, Use::ComputeRead, Use::ComputeReadWrite})
    for (const Access& a : p.accesses) {
      const bundle::ResourceT& r = *bundle.resources[a.resource];
      const bool listed = use == Use::ComputeReadWrite ? goes_by_marks(command, r) : r.list != bundle::ListKind::None;
      if (a.use == use && listed) return a.resource;
    }
  return std::nullopt;
}

}  // namespace

std::vector<CommandTime> Program::State::timed_run(const std::string& name) {
  const size_t index = step_index(name);
  StepState& step = prepared_step(index);
  require_counts(index, 1);
  const uint32_t bits = on_device->queue.timestamp_bits();
  if (bits == 0) throw DeviceFailure{"the device's queue takes no times"};
  const std::vector<bool> dirty = must_run(step);
  const Variant& variant = recorded(step, dirty);
  const std::vector<const Primitive*> chosen = step.chosen(dirty);
  const bundle::StepT& table = *bundle.steps[index];
  const auto stamps = static_cast<uint32_t>(2 * chosen.size());
  if (stamps == 0) {
    count_run(index, dirty, variant.run, variant.skipped);
    return {};
  }
  // By command: its list, and where the device counts its fragments.
  std::vector<std::optional<uint32_t>> lists, draws;
  uint32_t list_count = 0, draw_count = 0;
  for (const Primitive* p : chosen) {
    lists.push_back(list_of(bundle, *table.commands[p->first], *p));
    if (lists.back()) ++list_count;
    const bool counts = device->pipeline_statistics && table.commands[p->first]->kind == bundle::CommandKind::Draw;
    draws.push_back(counts ? std::optional(draw_count++) : std::nullopt);
  }
  const vk::raii::Buffer& heads = on_device->transfer.readback(std::max(1u, list_count) * kListBytes);
  const vk::raii::QueryPool pool(device->device, vk::QueryPoolCreateInfo({}, vk::QueryType::eTimestamp, stamps));
  std::optional<vk::raii::QueryPool> fragments;
  if (draw_count > 0)
    fragments.emplace(device->device,
                      vk::QueryPoolCreateInfo({}, vk::QueryType::ePipelineStatistics, draw_count,
                                              vk::QueryPipelineStatisticFlagBits::eFragmentShaderInvocations));
  step.begun = true;
  on_device->queue.once([&](const vk::raii::CommandBuffer& commands) {
    vk::DeviceSize head_at = 0;
    const auto stamp = [&](size_t k) {
      commands.writeTimestamp(vk::PipelineStageFlagBits::eBottomOfPipe, *pool, static_cast<uint32_t>(k));
    };
    const auto begin = [&](size_t k) {
      if (k == chosen.size()) return;
      if (draws[k]) commands.beginQuery(**fragments, *draws[k], {});
      stamp(2 * k);
    };
    commands.resetQueryPool(*pool, 0, stamps);
    if (fragments) commands.resetQueryPool(**fragments, 0, draw_count);
    begin(0);
    on_device->commands.record_apart(commands, chosen, [&](size_t k) {
      stamp(2 * k + 1);
      if (draws[k]) commands.endQuery(**fragments, *draws[k]);
      if (lists[k]) {
        on_device->queue.everything_before(commands);
        commands.copyBuffer(on_device->memory.buffer(*lists[k]).first(), *heads,
                            vk::BufferCopy(0, head_at, kListBytes));
        head_at += kListBytes;
        on_device->queue.everything_before(commands);
      }
      begin(k + 1);
    });
    commands.pipelineBarrier(vk::PipelineStageFlagBits::eTransfer, vk::PipelineStageFlagBits::eHost, {},
                             vk::MemoryBarrier(vk::AccessFlagBits::eTransferWrite, vk::AccessFlagBits::eHostRead), {},
                             {});
  });
  step.begun = false;
  ++step.counters.recorded;
  count_run(index, dirty, variant.run, variant.skipped);
  const auto read = pool.getResults<uint64_t>(0, stamps, stamps * sizeof(uint64_t), sizeof(uint64_t),
                                              vk::QueryResultFlagBits::e64 | vk::QueryResultFlagBits::eWait);
  if (read.first != vk::Result::eSuccess) throw DeviceFailure{"the device gave no times"};
  const std::vector<uint64_t>& ticks = read.second;
  const uint64_t mask = bits >= 64 ? UINT64_MAX : (uint64_t{1} << bits) - 1;
  const auto nanoseconds = [&](uint32_t from, uint32_t to) {
    return static_cast<double>((ticks[to] - ticks[from]) & mask) *
           static_cast<double>(device->properties.limits.timestampPeriod);
  };
  std::vector<uint64_t> drawn;
  if (fragments)
    drawn = fragments
                ->getResults<uint64_t>(0, draw_count, draw_count * sizeof(uint64_t), sizeof(uint64_t),
                                       vk::QueryResultFlagBits::e64 | vk::QueryResultFlagBits::eWait)
                .second;
  std::span<const uint32_t> list_heads = on_device->transfer.words();
  std::vector<CommandTime> out;
  for (uint32_t k = 0; k < chosen.size(); ++k) {
    CommandTime& t = out.emplace_back();
    t.label = chosen[k]->label;
    t.nanoseconds = nanoseconds(2 * k, 2 * k + 1);
    t.ops = chosen[k]->ops;
    t.bytes = chosen[k]->bytes;
    t.lines = lines_of(bundle, table, *chosen[k]);
    t.group = chosen[k]->group;
    if (chosen[k]->pipeline >= 0)
      t.registers = on_device->pipelines.registers(static_cast<size_t>(chosen[k]->pipeline));
    if (draws[k]) t.fragments = static_cast<int64_t>(drawn[*draws[k]]);
    if (!lists[k]) continue;
    const bundle::CommandT& command = *table.commands[chosen[k]->first];
    const bundle::ResourceT& elements = *bundle.resources[*lists[k]];
    t.list = bundle::word(EnumNameListKind(elements.list));
    t.listed = int64_t{list_heads[bundle::kListEnd]} - 1;
    const bool marked = elements.list == bundle::ListKind::Stepped && command.indirect < 0;
    t.elements = marked                  ? int64_t{list_heads[0]}
                 : command.indirect >= 0 ? sizes.evaluate(command.elements, "pass '" + command.label + "'")
                                         : sizes.evaluate(elements.extent->w, elements.name) - bundle::kListHead;
    list_heads = list_heads.subspan(bundle::kListHead);
  }
  require_whole_loops(index);
  return out;
}

}  // namespace dr::runtime
