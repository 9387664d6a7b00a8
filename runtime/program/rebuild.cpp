// SPDX-License-Identifier: Apache-2.0
// When it may help, the building itself, and how the new program takes over.
#include "runtime/program/rebuild.h"

#include <algorithm>

#include "runtime/program/state.h"

namespace dr::runtime {

namespace {

bool has(const std::vector<uint32_t>& sorted, uint32_t leaf) {
  return std::binary_search(sorted.begin(), sorted.end(), leaf);
}

// Ops that a run of the step takes when these leaves changed before it.
int64_t ops_of_run(const bundle::StepT& step, const std::vector<uint32_t>& moving) {
  int64_t ops = 0;
  for (const auto& c : step.commands)
    if (c->steady || std::ranges::any_of(c->leaves, [&](uint32_t leaf) { return has(moving, leaf); })) ops += c->ops;
  return ops;
}

// Whether some command runs for these leaves that would not for others of its own.
bool mixes(const bundle::StepT& step, const std::vector<uint32_t>& moving) {
  return std::ranges::any_of(step.commands, [&](const auto& c) {
    const auto count = std::ranges::count_if(c->leaves, [&](uint32_t leaf) { return has(moving, leaf); });
    return !c->steady && count > 0 && count < std::ranges::ssize(c->leaves);
  });
}

struct Job {
  std::shared_ptr<DeviceState> device;
  LoadOptions options;
  std::shared_ptr<Tally> tally;
  Sizes sizes;
  std::vector<std::string> prepared;  // steps
  Moving moving;
  std::string step;
  int64_t ops = 0;  // that it takes now
};

// Nothing, when it is no better or cannot be.
std::unique_ptr<Program::State> build(const Job& job) try {
  const auto bytes = job.options.rebuild(job.moving);
  if (!bytes) return nullptr;
  LoadOptions options = job.options;
  options.trusted = true;  // compiled just now
  auto state = Program::State::load(job.device, *bytes, options);
  const auto index = state->any_step(job.step);
  if (!index) return nullptr;
  const bundle::StepT& step = *state->bundle.steps[*index];
  std::vector<uint32_t> moving;
  for (uint32_t k = 0; k < state->bundle.leaves.size(); ++k)
    if (job.moving.at(job.step).count(state->bundle.leaves[k]->name) != 0) moving.push_back(k);
  if (ops_of_run(step, moving) >= job.ops) return nullptr;
  state->sizes = job.sizes;
  state->tally = job.tally;
  state->rebuilder.emplace(job.moving);
  for (const std::string& name : job.prepared) {
    const auto prepared = state->any_step(name);
    if (!prepared) return nullptr;
    state->make_ready(*prepared);
  }
  return state;
} catch (const Failure&) {
  return nullptr;  // such as no memory for both
} catch (...) {    // whatever the caller's function throws
  return nullptr;
}

}  // namespace

Rebuilder::~Rebuilder() = default;

void Rebuilder::watch(const Program::State& program, size_t index, const MovingLeaves& moving) {
  const LoadOptions& options = program.options;
  if (busy_ || ready_ || moving.runs() < options.rebuild_after) return;
  const bundle::StepT& step = *program.bundle.steps[index];
  std::set<std::string> names;
  for (const uint32_t leaf : moving.moving()) names.insert(program.bundle.leaves[leaf]->name);
  const auto now = built_for_.find(step.name);
  const bool apart = now != built_for_.end() && !now->second.empty();
  if (apart ? now->second == names : names.empty()) return;
  if (!tried_.emplace(index, names).second || (!apart && !mixes(step, moving.moving()))) return;

  Job job{program.device,
          options,
          program.tally,
          program.sizes,
          {},
          built_for_,
          step.name,
          ops_of_run(step, moving.moving())};
  job.moving[step.name] = names;
  for (size_t k = 0; k < program.bundle.steps.size(); ++k)
    if (program.on_device->steps[k].list) job.prepared.push_back(program.bundle.steps[k]->name);
  busy_ = true;
  const auto work = [this, job = std::move(job)] {
    built_ = build(job);
    ready_ = built_ != nullptr;
    busy_ = false;
  };
  if (options.rebuild_beside)
    thread_ = std::jthread(work);
  else
    work();
}

std::unique_ptr<Program::State> Rebuilder::take() {
  if (thread_.joinable()) thread_.join();
  ready_ = false;
  return std::move(built_);
}

bool Rebuilder::same_names(const bundle::BundleT& a, const bundle::BundleT& b) {
  const auto names = [](const bundle::BundleT& bundle) {
    std::set<std::string> out;
    const auto add = [&](const std::string& name, const bundle::TypeT& type, const bundle::ExtentT& extent) {
      out.insert(name + " " + bundle::word(EnumNameScalar(type.scalar)) + std::to_string(type.rows) + "x" +
                 std::to_string(type.cols) + "[" + extent.w + ", " + extent.h + ", " + extent.l + "]");
    };
    for (const auto& leaf : bundle.leaves) add(leaf->name, *leaf->type, *leaf->extent);
    for (const auto& step : bundle.steps) {
      out.insert("step " + step->name);
      for (const auto& o : step->outputs) {
        const bundle::ResourceT& resource = *bundle.resources[o->resource];
        add("output " + step->name + "." + o->name, *resource.type, *resource.extent);
      }
    }
    return out;
  };
  return names(a) == names(b);
}

void Program::State::take_over(State& old) {
  old.on_device->queue.finish();
  sizes = old.sizes;
  rebuilds = old.rebuilds + 1;
  warnings = std::move(old.warnings);
  pipelines_before = old.pipelines_before;
  pipelines_before += old.on_device->pipelines.counters();
  // Contents of leaves: from memory to memory, where no tables are made of them and both programs draw, or neither.
  const bool same_family = objects().queue.family() == old.on_device->queue.family();
  std::vector<std::pair<uint32_t, uint32_t>> copies;  // resources, from and to
  std::vector<uint32_t> lacking;
  for (size_t k = 0; k < bundle.leaves.size(); ++k) {
    const bundle::LeafT& leaf = *bundle.leaves[k];
    const auto found = std::ranges::find_if(old.bundle.leaves, [&](const auto& l) { return l->name == leaf.name; });
    if (found == old.bundle.leaves.end()) continue;
    const auto was = static_cast<size_t>(found - old.bundle.leaves.begin());
    versions[k] = old.versions[was];
    if (old.spoiled.contains(was)) spoiled.insert(k);
    if (leaf.table_of >= 0) continue;
    if (old.pending[was]) {
      assign(k, *old.pending[was]);
    } else if (old.has_memory((*found)->resource)) {
      if (has_tables(k) || !same_family) {
        assign(k, old.on_device->transfer.download((*found)->resource));
        continue;
      }
      copies.emplace_back((*found)->resource, leaf.resource);
      if (!has_memory(leaf.resource)) lacking.push_back(leaf.resource);
    }
  }
  objects().memory.allocate(lacking);
  order = old.order;
  on_device->queue.set_order(order.get());
  on_device->queue.once([&](const vk::raii::CommandBuffer& commands) {
    for (const auto& [from, to] : copies)
      copy_content(commands, old.on_device->memory.buffer(from).pieces(), on_device->memory.buffer(to).pieces());
  });
  // Steps by name; what their last runs gave stays readable until they run again.
  for (size_t k = 0; k < bundle.steps.size(); ++k) {
    const size_t was = *old.any_step(bundle.steps[k]->name);
    on_device->steps[k].counters = old.on_device->steps[was].counters;
    upload_counter(k);
    if (const auto it = old.kept.find(was); it != old.kept.end()) kept[k] = std::move(it->second);
    if (old.on_device->steps[was].has_outputs())
      for (const auto& o : old.bundle.steps[was]->outputs)
        if (kept_output(k, o->name) == nullptr) kept[k].emplace(o->name, old.on_device->transfer.download(o->resource));
  }
}

}  // namespace dr::runtime
