// SPDX-License-Identifier: Apache-2.0
// The public functions: there is no policy here, and exceptions stay inside.
#include <algorithm>
#include <cstdio>

#include "compiler/backend/bundle/check_shaders.h"
#include "compiler/backend/bundle/entries.h"
#include "compiler/ir/initial_step.h"
#include "runtime/program/check_trips.h"
#include "runtime/program/state.h"

namespace dr::runtime {

namespace {

// Every public function: exceptions stay inside. `broken` is called where the device or the machine failed.
template <class F, class Broken>
auto guarded(F&& f, Broken&& broken) -> Result<decltype(f())> {
  try {
    if constexpr (std::is_void_v<decltype(f())>) {
      f();
      return {};
    } else {
      return f();
    }
  } catch (const Failure& failure) {
    return failure.error();
  } catch (const vk::DeviceLostError&) {
    broken();
    return io::Error{"the device was lost while it ran a step; open it and load the program again", io::Blame::Device};
  } catch (const vk::SystemError& e) {
    broken();
    return io::Error{std::string("Vulkan reports: ") + e.what(), io::Blame::Device};
  } catch (const std::bad_alloc&) {
    broken();
    return io::Error{"this machine has not enough memory for the program's data", io::Blame::Device};
  } catch (const std::exception& e) {
    broken();
    return io::Error{e.what(), io::Blame::Device};
  }
}
template <class F>
auto guarded(F&& f) -> Result<decltype(f())> {
  return guarded(f, [] {});
}

// For functions that change what the program has on the device: when they end early, it is not known what that is.
auto breaks(std::unique_ptr<Program::State>& state) {
  return [&state] {
    if (state && state->on_device) state->broken = true;
  };
}

// What functions that give no Result answer from when the program was moved from: tables of nothing.
const Program::State kNothing;

// Faces and tags of a raster's entries (see RasterResults in bundle.fbs): face 0, tag 0, face 1, ...
std::vector<io::Array> parts_of_entries(const io::Array& entries, size_t ranks) {
  const auto count = static_cast<int64_t>(ranks);
  if (entries.kind != io::ElementKind::UInt32 || entries.components != 2 || entries.layers % count != 0)
    throw Failure{"the bundle's raster entries are no entries"};
  std::vector<io::Array> out;
  const auto words = entries.as<uint32_t>();
  const int64_t size = entries.size() / count;
  for (int64_t k = 0; k < count; ++k) {
    std::vector<int32_t> face, tag;
    for (int64_t i = k * size; i < (k + 1) * size; ++i) {
      const uint32_t low = words[static_cast<size_t>(2 * i)], high = words[static_cast<size_t>(2 * i + 1)];
      const bool none = high == 0xffffffffu;
      face.push_back(none ? -1 : static_cast<int32_t>(low >> 4 | high << 28));
      tag.push_back(none ? 0 : static_cast<int32_t>(low & 15));
    }
    for (const std::vector<int32_t>& part : {face, tag})
      out.push_back(io::Array::from<int32_t>(part, 1, entries.width, entries.height, entries.layers / count));
  }
  return out;
}

// Face and tag where bits say if there is a face, in a picture so wide.
std::vector<io::Array> parts_of_bits(const io::Array& bits, int64_t width) {
  if (bits.kind != io::ElementKind::UInt32 || bits.components != 1 ||
      bits.width != (width + bundle::kBitsOfWord - 1) / bundle::kBitsOfWord)
    throw Failure{"the bundle's raster bits are no bits"};
  const auto words = bits.as<uint32_t>();
  const int64_t rows = bits.height * bits.layers;
  std::vector<int32_t> face;
  for (int64_t row = 0; row < rows; ++row)
    for (int64_t x = 0; x < width; ++x) {
      const uint32_t word = words[static_cast<size_t>(row * bits.width + x / bundle::kBitsOfWord)];
      face.push_back((word >> (x % bundle::kBitsOfWord) & 1) != 0 ? bundle::kSomeFace : -1);
    }
  const std::vector<int32_t> tag(face.size());
  return {io::Array::from<int32_t>(face, 1, width, bits.height, bits.layers),
          io::Array::from<int32_t>(tag, 1, width, bits.height, bits.layers)};
}

std::string output_text(const std::string& step, const std::string& name) {
  return "output '" + step + "." + name + "'";
}
std::string leaf_text(const std::string& name) { return "leaf '" + name + "'"; }

// Whether the device has what a bundle's shaders need.
bool has(const DeviceState& device, bundle::Feature feature) {
  switch (feature) {
    case bundle::Feature::ShaderInt64:
    case bundle::Feature::ShaderBufferInt64Atomics: return device.int64_atomics;
    case bundle::Feature::SubgroupArithmetic: return device.subgroup_arithmetic;
    case bundle::Feature::SubgroupShuffle: return device.subgroup_shuffle;
    case bundle::Feature::Multiview: return device.multiview_views > 0;
    case bundle::Feature::ShaderBufferFloat32AtomicAdd: return device.float_atomics;
  }
  return false;
}

}  // namespace

io::Array HostArray::copied() const {
  if (data == nullptr) return {};
  auto bytes = static_cast<int64_t>(io::scalar_size(kind));
  for (const int64_t n : {int64_t{components}, width, height, layers}) {
    if (n < 1 || n > io::kMaxArrayBytes / bytes) return {};
    bytes *= n;
  }
  const auto* from = static_cast<const std::byte*>(data);
  return {kind, components, width, height, layers, {from, from + bytes}};
}

void warn_on_stderr(const std::string& warning) { std::fprintf(stderr, "dressi: warning: %s\n", warning.c_str()); }

// A view is looked at when it is given, now and then: what it shows later is not known.
std::optional<HostArray> Program::State::seen(const std::string& what, std::optional<HostArray> view) {
  if (view)
    warnings.now_and_then([&] {
      warnings.look(what, io::Scalars{view->kind, view->components, view->width, view->height, view->layers,
                                      static_cast<const std::byte*>(view->data)});
    });
  return view;
}

Work& Work::operator+=(const Work& other) {
  commands += other.commands;
  ops += other.ops;
  bytes += other.bytes;
  return *this;
}

PipelineCounters& PipelineCounters::operator+=(const PipelineCounters& other) {
  made += other.made;
  kept += other.kept;
  return *this;
}

Program::State& Program::state() {
  if (!state_) throw Failure{"the program is empty: it was moved from"};
  if (state_->broken)
    throw DeviceFailure{
        "the program cannot go on: the device or the machine failed while it was changed; load it again"};
  return *state_;
}
const Program::State& Program::known() const { return state_ ? *state_ : kNothing; }

Program::Program() : state_(std::make_unique<State>()) {}
Program::Program(Program&&) noexcept = default;
Program& Program::operator=(Program&&) noexcept = default;
Program::~Program() = default;

std::unique_ptr<Program::State> Program::State::load(std::shared_ptr<DeviceState> device,
                                                     std::span<const uint8_t> bytes, const LoadOptions& options) {
  auto bundle = bundle::read(bytes);
  if (const auto* problem = std::get_if<std::string>(&bundle)) throw Failure{*problem};
  auto state = std::make_unique<State>();
  state->device = std::move(device);
  state->bundle = std::move(std::get<bundle::BundleT>(bundle));
  state->pending.resize(state->bundle.leaves.size());
  state->versions.assign(state->bundle.leaves.size(), 1);
  state->views.resize(state->bundle.leaves.size() + 1);
  state->options = options;
  state->warnings = Warnings(options.warn);
  if (options.store_all)
    for (const auto& r : state->bundle.resources)
      if (r->storage == bundle::Storage::Tile) r->storage = bundle::Storage::Image;
  if (!state->device) return state;
  for (const bundle::Feature feature : state->bundle.features)
    if (!has(*state->device, feature))
      throw DeviceFailure{"the bundle was built for profile '" + state->bundle.profile + "' and needs the feature '" +
                          bundle::word(EnumNameFeature(feature)) +
                          "', which the device lacks; build it for the device's own profile"};
  if (!options.trusted) {
    const DeviceState& d = *state->device;
    const bundle::ShaderLimits limits{.shared_bytes = d.properties.limits.maxComputeSharedMemorySize,
                                      .group_invocations = d.properties.limits.maxComputeWorkGroupInvocations,
                                      .int64 = d.int64,
                                      .int64_atomics = d.int64_atomics,
                                      .float_atomics = d.float_atomics,
                                      .subgroups = d.subgroup_arithmetic,
                                      .shuffles = d.subgroup_shuffle,
                                      .multiview = d.multiview_views > 0};
    if (const std::string problem = check_shaders(state->bundle, limits); !problem.empty())
      throw Failure{"the bundle is not sound: " + problem};
  }
  return state;
}

Result<Program> Program::load(const Device& device, std::span<const uint8_t> bytes, const LoadOptions& options) {
  return guarded([&] {
    Program program;
    if (!device.state()) throw Failure{"the device is empty: it was moved from"};
    program.state_ = State::load(device.state(), bytes, options);
    if (const auto problem = check_trips(program.state_->bundle, device.profile_name())) throw DeviceFailure{*problem};
    if (options.cache && options.rebuild && options.memory_limit == 0) program.state_->rebuilder.emplace();
    return program;
  });
}

Result<Program> Program::describe(std::span<const uint8_t> bytes) {
  return guarded([&] {
    Program program;
    program.state_ = State::load(nullptr, bytes, {});
    return program;
  });
}

bool Program::is_input(const std::string& leaf) const {
  for (const auto& l : known().bundle.leaves)
    if (l->name == leaf) return l->kind == bundle::LeafKind::Input;
  return false;
}

std::vector<std::string> Program::steps() const {
  std::vector<std::string> out;
  for (const auto& s : known().bundle.steps)
    if (is_users(*s)) out.push_back(s->name);
  return out;
}

std::vector<Program::LeafInfo> Program::leaves() const {
  std::vector<LeafInfo> out;
  for (const auto& l : known().bundle.leaves)
    if (is_users(*l)) out.push_back({l->name, components_of(*l->type), kind_of(*l->type)});
  return out;
}

std::vector<std::string> Program::needed_leaves(const std::string& step) const {
  const State& s = known();
  std::vector<std::string> out;
  std::set<std::string> seen{step};  // and steps that compute initial values
  const auto add = [&](const auto& again, const bundle::StepT& one) -> void {
    std::vector<uint32_t> leaves = one.leaves;
    for (const std::string& symbol : one.symbols)
      if (const auto faces = s.faces_of(symbol)) leaves.push_back(*faces);
    for (const uint32_t k : leaves) {
      const bundle::LeafT& leaf = *s.bundle.leaves[s.bound_for(k)];
      if (std::ranges::find(out, leaf.name) == out.end()) out.push_back(leaf.name);
      const auto initial = s.any_step(ir::initial_step_of(leaf.name));
      if (initial && seen.insert(s.bundle.steps[*initial]->name).second) again(again, *s.bundle.steps[*initial]);
    }
  };
  if (const auto index = s.any_step(step)) add(add, *s.bundle.steps[*index]);
  return out;
}

std::vector<std::string> Program::resources() const {
  std::vector<std::string> out;
  for (const auto& r : known().bundle.resources) out.push_back(r->name);
  return out;
}

Result<void> Program::bind(const std::string& leaf, const io::Array& data) {
  return guarded([&] { state().bind(leaf, data); });
}

Result<void> Program::bind(const std::string& leaf, const HostArray& data) {
  return guarded([&] {
    const size_t index = state().leaf_index(leaf);
    if (data.data == nullptr) throw Failure{"leaf '" + leaf + "': the array has no data"};
    if (state().write(index, data)) return;
    const io::Array copy = data.copied();
    if (copy.empty())
      throw Failure{"leaf '" + leaf + "': the array has " + std::to_string(data.width) + " x " +
                    std::to_string(data.height) + " x " + std::to_string(data.layers) + " elements of " +
                    std::to_string(data.components) + " components"};
    state().bind(leaf, copy);
  });
}

Result<void> Program::bind_symbol(const std::string& symbol, int64_t value) {
  return guarded([&] {
    const std::vector<std::string>& all = state().bundle.symbols;
    if (std::find(all.begin(), all.end(), symbol) == all.end()) {
      std::string names;
      for (const std::string& s : all) names += (names.empty() ? "" : ", ") + s;
      throw Failure{"there is no symbol '" + symbol + "'; there are: " + names};
    }
    if (value < 1 || value >= kMaxElements)
      throw Failure{"symbol '" + symbol + "' is " + std::to_string(value) + ", which is not between 1 and 2^31"};
    state().sizes.set(symbol, value, "the symbol's own binding");
  });
}

// Before a run, since the arrays of the one before are copied then.
void Program::take_rebuilt() {
  if (!state().rebuilder || !state().rebuilder->ready() || state().has_views()) return;
  auto next = state().rebuilder->take();
  if (!Rebuilder::same_names(next->bundle, state_->bundle)) return;  // it is another program
  next->take_over(*state_);
  state_ = std::move(next);
}

Result<void> Program::run(const std::string& step, int times) {
  return guarded(
      [&] {
        if (times < 1) throw Failure{"a step runs once or more often, found " + std::to_string(times)};
        for (int done = 0; done < times;) {
          take_rebuilt();
          done += state().run(step, times - done);
        }
        state().hear_of_not_finite(step);
      },
      breaks(state_));
}

Result<void> Program::cuda_stream(void* stream) {
  return guarded([&] { state().in_order().set_stream(stream); });
}

Result<void> Program::cuda_wait(void* stream) {
  return guarded([&] { state().in_order().let_wait(stream); });
}

Result<CudaArray> Program::cuda_leaf(const std::string& name) {
  return guarded([&] {
    State& s = state();
    const auto index = s.leaf_index(name);
    if (s.comes_from_host(index)) throw Failure{"leaf '" + name + "' is not shared: its data comes from the host"};
    s.in_order();
    s.prepare_leaf(index);
    return s.in_cuda(s.bundle.leaves[index]->resource, index);
  });
}

Result<CudaArray> Program::cuda_output(const std::string& step, const std::string& name) {
  return guarded([&] {
    State& s = state();
    const size_t index = s.step_index(step);
    const uint32_t resource = s.output_of(index, name);
    s.require_run(step);
    return s.in_cuda(resource, s.bundle.leaves.size());
  });
}

Result<void> Program::cuda_run(const std::string& step, std::span<const Named> leaves, std::span<const Named> outputs) {
  return guarded(
      [&] {
        if (!step.empty()) take_rebuilt();
        for (const auto& [name, data] : leaves) state().copy_from_cuda(state().leaf_index(name), data);
        if (!step.empty()) state().in_order();
        while (!step.empty() && state().run(step, 1, false) < 1) take_rebuilt();
        for (const auto& [name, to] : outputs) state().copy_to_cuda(step, name, to);
      },
      breaks(state_));
}

bool Program::comes_from_host(const std::string& leaf) const {
  const State& s = known();
  for (size_t k = 0; k < s.bundle.leaves.size(); ++k)
    if (s.bundle.leaves[k]->name == leaf) return s.comes_from_host(k);
  return false;
}

Result<std::vector<CommandTime>> Program::timed_run(const std::string& step) {
  return guarded([&] { return state().timed_run(step); }, breaks(state_));
}

Result<std::optional<NotFinite>> Program::checked_run(const std::string& step) {
  return guarded([&] { return state().checked_run(step); }, breaks(state_));
}

Result<std::vector<std::string>> Program::told_not_finite(const std::string& step) {
  return guarded([&] { return state().told_not_finite(step); }, breaks(state_));
}

Result<void> Program::set_runs(const std::string& step, int64_t runs) {
  return guarded([&] { state().set_runs(step, runs); }, breaks(state_));
}

int Program::rebuilds() const { return known().rebuilds; }

PipelineCounters Program::pipelines() const {
  PipelineCounters all = known().pipelines_before;
  if (known().on_device) all += known().on_device->pipelines.counters();
  return all;
}

StepCounters Program::counters(const std::string& step) const {
  if (!known().on_device) return {};
  for (size_t k = 0; k < known().bundle.steps.size(); ++k)
    if (known().bundle.steps[k]->name == step) return known().on_device->steps[k].counters;
  return {};
}

std::vector<std::string> Program::outputs(const std::string& step) const {
  std::vector<std::string> out;
  for (const auto& s : known().bundle.steps)
    if (s->name == step)
      for (const auto& o : s->outputs) out.push_back(o->name);
  return out;
}

bool Program::changes(const std::string& step, const std::string& leaf) const {
  for (const auto& s : known().bundle.steps)
    if (s->name == step)
      return std::ranges::any_of(s->changes, [&](uint32_t k) { return known().bundle.leaves[k]->name == leaf; });
  return false;
}

Program::LeafInfo Program::output_info(const std::string& step, const std::string& name) const {
  for (const auto& s : known().bundle.steps)
    for (const auto& o : s->outputs)
      if (s->name == step && o->name == name) {
        const bundle::TypeT& type = *known().bundle.resources[o->resource]->type;
        return {name, components_of(type), kind_of(type)};
      }
  return {name, 0, io::ElementKind::Float32};
}

Result<io::Array> Program::output(const std::string& step, const std::string& name) {
  return guarded([&]() -> io::Array {
    State& s = state();
    const size_t index = s.step_index(step);
    for (const auto& o : s.bundle.steps[index]->outputs)
      if (o->name == name) {
        const io::Array* kept = s.kept_output(index, name);
        if (kept == nullptr) s.require_run(step);
        io::Array out = kept != nullptr ? *kept : s.on_device->transfer.download(o->resource);
        s.warnings.look(output_text(step, name), out);
        return out;
      }
    throw Failure{"step '" + step + "' has no output '" + name + "'"};
  });
}

Result<std::vector<std::vector<io::Array>>> Program::rasters(const std::string& step) {
  return guarded([&] {
    State& s = state();
    const auto& table = *s.bundle.steps[s.step_index(step)];
    s.require_run(step);
    std::vector<std::vector<io::Array>> out;
    for (const auto& raster : table.rasters) {
      const auto download = [&](uint32_t r) { return s.on_device->transfer.download(r); };
      const uint32_t first = raster->resources[0];
      if (!raster->width.empty()) {
        out.push_back(parts_of_bits(download(first), s.sizes.evaluate(raster->width, "a raster's width")));
      } else if (s.bundle.resources[first]->type->rows == 2) {
        out.push_back(parts_of_entries(download(first), raster->resources.size() / 2));
      } else {
        out.emplace_back();
        std::ranges::transform(raster->resources, std::back_inserter(out.back()), download);
      }
    }
    return out;
  });
}

Result<std::vector<std::pair<std::string, io::Array>>> Program::pins(const std::string& step) {
  return guarded([&] {
    State& s = state();
    s.require_run(step);
    std::vector<std::pair<std::string, io::Array>> out;
    for (const auto& pin : s.bundle.steps[s.step_index(step)]->pins)
      out.emplace_back(pin->name, s.on_device->transfer.download(pin->resource));
    return out;
  });
}

Result<io::Array> Program::leaf(const std::string& name) {
  return guarded(
      [&] {
        State& s = state();
        const auto index = s.leaf_index(name);
        s.prepare_leaf(index);
        io::Array out = s.on_device->transfer.download(s.bundle.leaves[index]->resource);
        s.warnings.look(leaf_text(name), out);
        return out;
      },
      breaks(state_));
}

Result<std::optional<HostArray>> Program::leaf_view(const std::string& name) {
  return guarded(
      [&]() -> std::optional<HostArray> {
        State& s = state();
        const auto index = s.leaf_index(name);
        s.prepare_leaf(index);
        if (s.bundle.leaves[index]->is_fixed) return std::nullopt;  // nobody may write there
        s.keep_outputs(s.bundle.leaves[index]->resource);
        return s.seen(leaf_text(name), s.view(s.bundle.leaves[index]->resource, index));
      },
      breaks(state_));
}

Result<std::optional<HostArray>> Program::output_view(const std::string& step, const std::string& name) {
  return guarded([&]() -> std::optional<HostArray> {
    State& s = state();
    const size_t index = s.step_index(step);
    for (const auto& o : s.bundle.steps[index]->outputs) {
      if (o->name != name) continue;
      if (s.kept_output(index, name) != nullptr || s.is_leaf(o->resource)) return std::nullopt;
      s.require_run(step);
      return s.seen(output_text(step, name), s.view(o->resource, s.bundle.leaves.size()));
    }
    throw Failure{"step '" + step + "' has no output '" + name + "'"};
  });
}

Result<io::Array> Program::resource(const std::string& name) {
  return guarded([&]() -> io::Array {
    State& s = state();
    for (uint32_t k = 0; k < s.bundle.resources.size(); ++k) {
      if (s.bundle.resources[k]->name != name) continue;
      if (!s.has_memory(k)) throw Failure{"'" + name + "' has no value: no step that uses it has run yet"};
      for (uint32_t other = 0; other < s.bundle.resources.size(); ++other)
        if (other != k && s.bundle.resources[other]->slot == s.bundle.resources[k]->slot)
          throw Failure{"'" + name + "' shares its memory with '" + s.bundle.resources[other]->name +
                        "': make it an output to read it"};
      return s.on_device->transfer.download(k);
    }
    throw Failure{"there is no resource '" + name + "'"};
  });
}

MemoryUse Program::memory_use() const {
  const State& s = known();
  MemoryUse use;
  use.peak = s.tally->peak;
  if (!s.on_device) return use;
  const Memory& memory = s.on_device->memory;
  use.device = static_cast<int64_t>(memory.bytes(false));
  use.host = static_cast<int64_t>(memory.bytes(true) + s.on_device->transfer.bytes());
  for (const auto& leaf : s.bundle.leaves)
    if (std::ranges::count(memory.on_host(), leaf->resource) != 0) use.host_leaves.push_back(leaf->name);
  return use;
}

Result<int> Program::command_count(const std::string& step) {
  return guarded([&] { return static_cast<int>(state().prepared_step(state().step_index(step)).primitives.size()); },
                 breaks(state_));
}

}  // namespace dr::runtime
