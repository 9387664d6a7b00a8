// SPDX-License-Identifier: Apache-2.0
// What a Program holds. Private to the runtime. Functions throw Failure; program.cpp turns it into Results.
#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "runtime/run_list.h"
#include "runtime/runtime.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/queue.h"
#include "runtime/vk/transfer.h"

namespace dr::runtime {

// Commands of a step recorded for one set of groups that must run.
struct Variant {
  vk::raii::CommandBuffer commands{nullptr};
  Work run, skipped;
};

struct StepState {
  std::vector<Primitive> primitives;  // none: not prepared yet
  std::optional<RunList> list;
  std::map<std::vector<bool>, Variant> variants;  // by RunList::dirty()
  StepCounters counters;
};

// What a program has on the device. Members are destroyed in reverse order.
struct OnDevice {
  OnDevice(const std::shared_ptr<DeviceState>& device, const bundle::BundleT& bundle, const Sizes& sizes,
           const std::string& cache_folder)
      : memory(device, bundle, sizes),
        queue(device),
        transfer(device, bundle, sizes, memory, queue),
        pipelines(device, bundle, memory, cache_folder),
        commands(device, bundle, sizes, memory, pipelines),
        steps(bundle.steps.size()) {}
  // What failed may have left something under way.
  ~OnDevice();
  Memory memory;
  Queue queue;
  Transfer transfer;
  Pipelines pipelines;
  Commands commands;
  std::vector<StepState> steps;
};

struct Program::State {
  std::shared_ptr<DeviceState> device;  // none: tables only
  bundle::BundleT bundle;
  Sizes sizes;
  std::vector<std::optional<io::Array>> pending;  // by leaf: bound, but without memory on the device yet
  std::map<size_t, io::Array> new_faces;          // by leaf: bound since tables were made of them
  std::map<size_t, io::Array> waiting_faces;      // some of whose tables have sizes that are not known yet
  size_t symbols_of_tables = 0;                   // how many symbols had values when tables were made
  std::vector<uint64_t> versions;                 // by leaf: counts its changes
  LoadOptions options;
  std::optional<OnDevice> on_device;

  // state.cpp: leaves and memory
  size_t leaf_index(const std::string& name) const;
  size_t step_index(const std::string& name) const;
  void bind(const std::string& name, const io::Array& data);
  void prepare_leaf(size_t leaf);
  // Memory and contents for a step: what only other steps need may stay unbound.
  void prepare(const bundle::StepT& step);
  bool has_memory(size_t resource) const { return on_device && on_device->memory.has(resource); }
  // What does not wait for sizes.
  OnDevice& objects();
  // Tables of topologies whose faces were bound.
  void make_tables();

  // run.cpp: steps
  StepState& prepared_step(size_t index);
  const Variant& recorded(StepState& step, const std::vector<bool>& dirty);
  void require_run(const std::string& step) const;
  void run(const std::string& step, int times);
  // One run is on its way, and saw this state.
  void count_run(size_t index, const std::vector<bool>& dirty, const Work& run, const Work& skipped);
  std::vector<CommandTime> timed_run(const std::string& step);
  void set_runs(const std::string& step, int64_t runs);

 private:
  // The program's step_index on the device, from the counters.
  void upload_counter(size_t step);
  void assign(size_t leaf, const io::Array& data);
  bool is_bound(size_t leaf) const;
  void give_memory(const std::set<uint32_t>& wanted);
};

}  // namespace dr::runtime
