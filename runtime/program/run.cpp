// SPDX-License-Identifier: Apache-2.0
// Running steps: what must run is recorded once for each set of clean commands, and submitted as often as the step
// runs.
#include <algorithm>

#include "runtime/data/lines.h"
#include "runtime/program/compile_beside.h"
#include "runtime/program/state.h"

namespace dr::runtime {

OnDevice::~OnDevice() {
  try {
    queue.finish();
  } catch (...) {  // the device is lost: nothing is under way
  }
}

std::vector<const Primitive*> StepState::chosen(const std::vector<bool>& dirty) const {
  std::vector<const Primitive*> out;
  for (const Primitive& p : primitives)
    if (dirty[list->group_of(p.first)]) out.push_back(&p);
  return out;
}

StepState& Program::State::prepared_step(size_t index) {
  OnDevice& o = objects();
  make_tables();
  StepState& step = o.steps[index];
  const bundle::StepT& table = *bundle.steps[index];
  for (const size_t k : spoiled)
    if (const auto leaf = static_cast<uint32_t>(k);
        std::ranges::find(table.leaves, leaf) != table.leaves.end() && !only_writes(bundle, table, leaf))
      require_whole(k);
  const bool is_new = !step.list;
  if (is_new) prepare(table);
  count_written();
  if (is_new) {
    make_ready(index);
    upload_counter(index);
  }
  if (step.begun) leave_zeros(table);
  step.begun = false;
  return step;
}

// What runs leave for the next one is there before the first, and after one that came to no end.
void Program::State::leave_zeros(const bundle::StepT& table) {
  std::vector<vk::Buffer> buffers;
  for (const uint32_t r : resources_of(table))
    if (const bundle::Role role = bundle.resources[r]->role;
        role == bundle::Role::Guess || role == bundle::Role::Zeros || role == bundle::Role::EpochEntries)
      for (const BufferObject::Piece& piece : on_device->memory.buffer(r).pieces()) buffers.push_back(piece.buffer);
  if (buffers.empty()) return;
  on_device->queue.once([&](const vk::raii::CommandBuffer& commands) {
    for (const vk::Buffer buffer : buffers) commands.fillBuffer(buffer, 0, VK_WHOLE_SIZE, 0);
  });
}

void Program::State::fill(size_t leaf) {
  const std::optional<size_t> index = initial_step(leaf);
  if (!index) return;
  StepState& step = prepared_step(*index);
  const std::vector<bool>& dirty = must_run(step);
  Variant& variant = recorded(step, dirty);
  step.begun = true;
  submit(step, dirty, variant, 1, {});
  step.begun = false;
  count_run(*index, dirty, variant.run, variant.skipped);
  on_device->queue.finish();
  require_whole_loops(*index);
}

void Program::State::make_ready(size_t index) {
  const bundle::StepT& table = *bundle.steps[index];
  OnDevice& o = objects();
  const std::set<uint32_t> resources = resources_of(table);
  o.memory.allocate({resources.begin(), resources.end()});  // what has none yet
  for (const auto& c : table.commands)
    for (const int word : {c->watch, c->finite})
      if (word >= 0) watch(static_cast<uint32_t>(word));
  o.pipelines.specialize(sizes.symbols());
  StepState& step = o.steps[index];
  const PipelineCounters before = o.pipelines.counters();
  step.primitives = o.commands.primitives(table);
  const PipelineCounters& now = o.pipelines.counters();
  const bool is_new = now.made > before.made && now.kept == before.kept;
  has_new_pipelines = has_new_pipelines || is_new;  // lavapipe's data is that of any pipeline from the first on
  if (options.compile_beside && has_new_pipelines && CompileBeside::is_worth_it(*device)) begin_compile_beside(index);
  step.list.emplace(table);
  if (rebuilder) step.moving.emplace(table.leaves);
}

void Program::State::begin_compile_beside(size_t index) {
  if (compile_beside && compile_beside->has(index)) return compile_beside->arrive(index);
  compile_beside.reset();
  std::vector<CompileBeside::Step> steps = {{index, resources_of(*bundle.steps[index])}};
  auto next = std::ranges::find(options.steps, bundle.steps[index]->name);
  if (next == options.steps.end()) next = options.steps.begin();  // it fills a leaf, before all others
  for (; next != options.steps.end(); ++next) {
    const auto found = std::ranges::find(bundle.steps, *next, [](const auto& s) { return s->name; });
    const auto k = static_cast<size_t>(found - bundle.steps.begin());
    if (found != bundle.steps.end() && std::ranges::find(steps, k, &CompileBeside::Step::index) == steps.end())
      steps.push_back({k, resources_of(**found)});
  }
  compile_beside = std::make_shared<CompileBeside>(*device, bundle, sizes, options, std::move(steps));
}

vk::raii::CommandBuffer Program::State::record(const StepState& step, const std::vector<bool>& dirty, int times) {
  auto commands = on_device->queue.command_buffer();
  commands.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eSimultaneousUse));
  const std::vector<const Primitive*> once = step.chosen(dirty);
  std::vector<const Primitive*> all;
  for (int k = 0; k < times; ++k) all.insert(all.end(), once.begin(), once.end());
  on_device->queue.everything_before(commands, on_device->commands.first_uses(all));
  on_device->commands.record(commands, all);
  // What only copies read is made visible by them.
  if (on_device->memory.has_host()) on_device->queue.before_the_host(commands);
  commands.end();
  return commands;
}

int Program::State::submit(const StepState& step, const std::vector<bool>& dirty, Variant& variant, int most,
                           const std::vector<vk::CommandBuffer>& after) {
  constexpr int kSeveral = Variant::kSeveral;
  const int together = std::min(Queue::worth_together(variant.pace), most);
  const int times = together < kSeveral ? together : together - together % kSeveral;
  const std::vector<vk::CommandBuffer> last = times == most ? after : std::vector<vk::CommandBuffer>();
  if (times < kSeveral) {
    on_device->queue.submit(variant.commands, times, &variant.pace, 1, last);
  } else {
    if (!*variant.several) variant.several = record(step, dirty, kSeveral);
    on_device->queue.submit(variant.several, times / kSeveral, &variant.pace, kSeveral, last);
  }
  return times;
}

// The host may have written to what it has views of, also just before it gave the last one back.
void Program::State::count_written() {
  if (views.back().lent)
    for (StepState& step : on_device->steps) step.whole = true;  // steps share memory
  for (size_t k = 0; k < views.size(); ++k) {
    if (!views[k].lent) continue;
    if (k < versions.size()) ++versions[k];
    views[k].lent = !views[k].held.expired();
  }
}

const std::vector<bool>& Program::State::must_run(StepState& step) const {
  return options.cache && !step.whole ? step.list->dirty(versions) : step.list->everything();
}

Variant& Program::State::recorded(StepState& step, const std::vector<bool>& dirty) {
  if (const auto it = step.variants.find(dirty); it != step.variants.end()) return it->second;
  // Few sets occur: everything at first, the steady part later, and what follows from leaves that the host binds anew.
  constexpr size_t kMaxVariants = 16;
  if (step.variants.size() == kMaxVariants) {
    on_device->queue.finish();
    step.variants.clear();
  }
  Variant variant;
  for (const Primitive& p : step.primitives) {
    Work& work = dirty[step.list->group_of(p.first)] ? variant.run : variant.skipped;
    work += {1, p.ops, p.bytes};
  }
  variant.commands = record(step, dirty, 1);
  return step.variants.emplace(dirty, std::move(variant)).first->second;
}

void Program::State::require_run(const std::string& step) const {
  const size_t index = step_index(step);
  if (!on_device || on_device->steps[index].variants.empty())
    throw Failure{"step '" + step + "' has not run yet" + (rebuilds > 0 ? " since the program was built anew" : "")};
  if (on_device->steps[index].ended_early)
    throw Failure{"loops of the last run of step '" + step + "' ended early: it left no results"};
}

void Program::State::count_run(size_t index, const std::vector<bool>& dirty, const Work& run, const Work& skipped) {
  StepState& step = on_device->steps[index];
  if (step.moving) step.moving->begin_run(versions);
  step.list->ran(dirty, versions);
  step.whole = step.ended_early = false;
  for (const uint32_t leaf : bundle.steps[index]->changes) {
    ++versions[leaf];
    spoiled.erase(leaf);
  }
  step.counters.run += run;
  step.counters.skipped += skipped;
  ++step.counters.runs;
  kept.erase(index);
  if (!step.moving) return;
  step.moving->end_run(versions);
  rebuilder->watch(*this, index, *step.moving);
}

int Program::State::run(const std::string& name, int times, bool wait) {
  const size_t index = step_index(name);
  StepState& step = prepared_step(index);
  require_counts(index, times);
  const std::vector<vk::CommandBuffer> copies = mirror_copies(index);
  int done = 0;
  // What was built anew takes over between two runs, unless views hold the memory here.
  while (done < times && !(rebuilder && rebuilder->ready() && !has_views())) {
    const std::vector<bool>& dirty = must_run(step);
    bool known = step.variants.count(dirty) != 0;
    if (known && !options.reuse_commands) {
      on_device->queue.finish();
      step.variants.erase(dirty);
      known = false;
    }
    if (!known) ++step.counters.recorded;
    Variant& variant = recorded(step, dirty);
    // What no run of the step changes is clean from the second run on.
    const bool alike = options.reuse_commands && (done > 0 || !options.cache);
    const int left = times - done, most = alike ? left : 1;
    step.begun = true;
    const int now = submit(step, dirty, variant, most, most == left ? copies : std::vector<vk::CommandBuffer>());
    step.begun = false;
    for (int k = 0; k < now; ++k) count_run(index, dirty, variant.run, variant.skipped);
    done += now;
  }
  if (wait || std::ranges::any_of(bundle.steps[index]->commands, [](const auto& c) { return c->watch >= 0; })) {
    on_device->queue.finish();
    require_whole_loops(index);
  }
  return done;
}

void Program::State::require_counts(size_t index, int times) const {
  const int64_t runs = on_device->steps[index].counters.runs;
  if (runs > INT32_MAX - int64_t{times})
    throw Failure{"step '" + bundle.steps[index]->name + "' has run " + std::to_string(runs) +
                  " times; it cannot run " + std::to_string(times) + " times more, as its counter ends at 2^31 - 1"};
}

bool Program::State::watch(uint32_t word) {
  io::Array unfinished = on_device->transfer.download(word);
  if (std::ranges::all_of(unfinished.bytes, [](std::byte b) { return b == std::byte{0}; })) return false;
  std::ranges::fill(unfinished.bytes, std::byte{0});
  on_device->transfer.upload(word, unfinished);
  return true;
}

namespace {

// A command by its label, and its lines: "'update' (fit.dr:3)".
std::string named(const bundle::BundleT& bundle, const bundle::CommandT& c) {
  std::vector<std::string> lines;
  for (const bundle::Line& line : c.lines)
    lines.push_back(bundle.files[line.file()] + ":" + std::to_string(line.line()));
  return "'" + c.label + "'" + (lines.empty() ? "" : " (" + few_of(lines) + ")");
}

}  // namespace

std::vector<std::string> Program::State::told_not_finite(const std::string& name) {
  const size_t index = step_index(name);
  std::vector<std::string> out;
  if (!on_device || on_device->steps[index].primitives.empty()) return out;
  std::set<int> seen;  // a pass of two commands has one word
  for (const auto& c : bundle.steps[index]->commands)
    if (c->finite >= 0 && seen.insert(c->finite).second && watch(static_cast<uint32_t>(c->finite)))
      out.push_back(named(bundle, *c));
  return out;
}

void Program::State::hear_of_not_finite(const std::string& name) {
  warnings.now_and_then([&] {
    const int64_t runs = on_device->steps[step_index(name)].counters.runs;
    for (const std::string& pass : told_not_finite(name))
      warnings.once("pass " + pass,
                    "pass " + pass + " left a NaN or Inf by run " + std::to_string(runs) + " of step '" + name + "'");
  });
}

void Program::State::require_whole_loops(size_t index) {
  const bundle::StepT& step = *bundle.steps[index];
  const bundle::CommandT* early = nullptr;
  for (const auto& c : step.commands)
    if (c->watch >= 0 && watch(static_cast<uint32_t>(c->watch)) && early == nullptr) early = c.get();
  if (early == nullptr) return;
  spoiled.insert(step.changes.begin(), step.changes.end());
  on_device->steps[index].ended_early = on_device->steps[index].whole = true;
  throw DeviceFailure{
      "a loop of pass " + named(bundle, *early) +
      " takes more trips than this device gives one whose range depends on data: say how many it takes at "
      "most, as in reduce(sum, i in a..b, max = 1000000)"};
}

void Program::State::require_whole(size_t leaf) const {
  if (spoiled.contains(leaf))
    throw Failure{"leaf '" + bundle.leaves[leaf]->name +
                  "' was changed by a run whose loops ended early: bind it again"};
}

void Program::State::set_runs(const std::string& name, int64_t runs) {
  const size_t index = step_index(name);
  if (runs < 0 || runs > INT32_MAX) throw Failure{"a step cannot have run " + std::to_string(runs) + " times"};
  int64_t& counted = objects().steps[index].counters.runs;
  if (counted == runs) return;  // the device counts with it
  counted = runs;
  upload_counter(index);
}

void Program::State::upload_counter(size_t index) {
  const int counter = bundle.steps[index]->step_index;
  if (counter < 0 || !has_memory(static_cast<size_t>(counter))) return;
  const auto runs = static_cast<int32_t>(on_device->steps[index].counters.runs);
  on_device->transfer.upload(static_cast<uint32_t>(counter), io::Array::from_ints(std::span(&runs, 1)));
}

}  // namespace dr::runtime
