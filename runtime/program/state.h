// SPDX-License-Identifier: Apache-2.0
// What a Program holds. Private to the runtime. Functions throw Failure; program.cpp turns it into Results.
#pragma once

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "runtime/cache/moving_leaves.h"
#include "runtime/cache/run_list.h"
#include "runtime/data/warnings.h"
#include "runtime/program/rebuild.h"
#include "runtime/runtime.h"
#include "runtime/vk/commands.h"
#include "runtime/vk/queue.h"
#include "runtime/vk/transfer.h"

namespace dr::runtime {

// Commands of a step recorded for one set of groups that must run.
struct Variant {
  vk::raii::CommandBuffer commands{nullptr};
  static constexpr int kSeveral = 8;
  vk::raii::CommandBuffer several{nullptr};  // so many runs, where that was worth it
  Work run, skipped;
  Pace pace;
};

struct StepState {
  std::vector<Primitive> primitives;  // none: not prepared yet
  std::optional<RunList> list;
  std::optional<MovingLeaves> moving;             // where the program may be built anew
  std::map<std::vector<bool>, Variant> variants;  // by RunList::dirty()
  StepCounters counters;
  bool begun = true;         // a run that may not have come to its end, or there was none
  bool whole = false;        // outputs of the program may have been written to since the last run: nothing is skipped
  bool ended_early = false;  // loops of the last run did

  bool has_outputs() const { return !variants.empty() && !ended_early; }

  // The primitives of the groups that must run, in order.
  std::vector<const Primitive*> chosen(const std::vector<bool>& dirty) const;
};

// Whether users know it by its name: leaves that are made of others', and steps that compute initial values, are the
// runtime's own.
bool is_users(const bundle::LeafT& leaf);
bool is_users(const bundle::StepT& step);
// Whether the step gives the leaf a value without a look at the one that it has.
bool only_writes(const bundle::BundleT& bundle, const bundle::StepT& step, uint32_t leaf);

// Lines of the program behind a primitive of the step: "fit.dr:3".
std::vector<std::string> lines_of(const bundle::BundleT& bundle, const bundle::StepT& step, const Primitive& primitive);

// A copy in a buffer that CUDA sees, of an output that is an image.
struct Mirror {
  Block block;
  vk::raii::Buffer buffer{nullptr};
  vk::raii::CommandBuffer copy{nullptr};
};

// What a program has on the device. Members are destroyed in reverse order.
struct OnDevice {
  OnDevice(const std::shared_ptr<DeviceState>& device, const bundle::BundleT& bundle, const Sizes& sizes,
           const LoadOptions& options, const std::shared_ptr<Tally>& tally)
      : memory(device, bundle, sizes, options.memory_limit, tally, options.share, options.buffer_limit),
        queue(device, std::ranges::any_of(bundle.steps,
                                          [](const auto& step) {
                                            return std::ranges::any_of(step->commands, [](const auto& c) {
                                              return c->kind == bundle::CommandKind::Draw;
                                            });
                                          })),
        transfer(device, bundle, sizes, memory, queue),
        pipelines(device, bundle, memory, options.pipeline_folder, options.buffer_limit),
        commands(device, bundle, sizes, memory, pipelines, options.trusted),
        steps(bundle.steps.size()) {}
  // What failed may have left something under way.
  ~OnDevice();
  Memory memory;
  Queue queue;
  Transfer transfer;
  Pipelines pipelines;
  Commands commands;
  std::vector<StepState> steps;
  std::map<uint32_t, Mirror> mirrors;  // by resource
};

// Views of the program's memory that the host holds.
struct Views {
  std::weak_ptr<void> held;
  bool lent = false;  // since the last run but one began
};

class CompileBeside;

struct Program::State {
  std::shared_ptr<DeviceState> device;  // none: tables only
  bundle::BundleT bundle;
  Sizes sizes;
  std::vector<std::optional<io::Array>> pending;  // by leaf: bound, but without memory on the device yet
  std::map<size_t, io::Array> new_faces;          // by leaf: bound since tables were made of them
  std::map<size_t, io::Array> waiting_faces;      // some of whose tables have sizes that are not known yet
  size_t symbols_of_tables = 0;                   // how many symbols had values when tables were made
  std::vector<uint64_t> versions;                 // by leaf: counts its changes
  std::vector<Views> views;                       // by leaf, and of outputs
  bool broken = false;                            // a change ended half-way
  LoadOptions options;
  Warnings warnings;
  std::shared_ptr<Tally> tally = std::make_shared<Tally>();
  std::shared_ptr<CudaOrder> order;  // with a stream of CUDA, which has seen memory of the program
  std::optional<OnDevice> on_device;
  // Outputs of steps' last runs whose memory is gone or was written since: by the step, the output's name.
  std::map<size_t, std::map<std::string, io::Array>> kept;
  std::set<size_t> spoiled;  // leaves that a run changed whose loops ended early, and that have no other value since
  int rebuilds = 0;
  PipelineCounters pipelines_before;              // of the programs that this one took over from
  std::shared_ptr<CompileBeside> compile_beside;  // of a step that was prepared and those behind it, if it was worth it
  bool has_new_pipelines = false;                 // some step's were in no file
  std::optional<Rebuilder> rebuilder;             // destroyed first: it waits

  // program.cpp: with its tables alone. Throws Failure.
  static std::unique_ptr<State> load(std::shared_ptr<DeviceState> device, std::span<const uint8_t> bytes,
                                     const LoadOptions& options);
  // rebuild.cpp: goes on where `old` is.
  void take_over(State& old);

  // state.cpp: leaves and memory
  size_t leaf_index(const std::string& name) const;
  size_t step_index(const std::string& name) const;               // of a user's
  std::optional<size_t> any_step(const std::string& name) const;  // also one that computes an initial value
  void bind(const std::string& name, const io::Array& data);
  void prepare_leaf(size_t leaf);
  // Whether the data went right into the leaf's memory: it has some, the host sees it, and the data is as there.
  bool write(size_t leaf, const HostArray& data);
  // What a step's last run gave, if that is not in its memory any more.
  const io::Array* kept_output(size_t step, const std::string& name) const;
  // Before a leaf's memory is written: outputs that are the leaf itself stay what the last run read.
  void keep_outputs(uint32_t resource);
  // Of a resource whose memory the host sees; nothing where a copy is needed. `holder` is its place in `views`.
  std::optional<HostArray> view(size_t resource, size_t holder);
  // Whether it is a leaf's memory, where what is done to a view of an output must not end up.
  bool is_leaf(size_t resource) const;
  // The view, which is warned of if it is `what` and not finite.
  std::optional<HostArray> seen(const std::string& what, std::optional<HostArray> view);
  bool has_views() const;
  // Memory and contents for a step: what only other steps need may stay unbound.
  void prepare(const bundle::StepT& step);
  // Memory without contents, pipelines and commands for a step, whose symbols have values.
  void make_ready(size_t step);
  // Compiles what the step and those behind it need on a second device, unless that goes on already.
  void begin_compile_beside(size_t step);
  // The leaf that users bind: of a table the faces that it is made of.
  uint32_t bound_for(uint32_t leaf) const;
  // The faces whose topology gives the symbol its value, if it is such a one.
  std::optional<uint32_t> faces_of(const std::string& symbol) const;
  // The step that fills the leaf, where it has no data and its initial value is computed.
  std::optional<size_t> initial_step(size_t leaf) const;
  bool has_memory(size_t resource) const { return on_device && on_device->memory.has(resource); }
  // What does not wait for sizes.
  OnDevice& objects();
  // Tables of topologies whose faces were bound.
  void make_tables();

  // run.cpp: steps
  StepState& prepared_step(size_t index);
  // Runs the step that computes the leaf's initial value, if that is needed.
  void fill(size_t leaf);
  void count_written();
  // By group of the step's commands.
  const std::vector<bool>& must_run(StepState& step) const;
  Variant& recorded(StepState& step, const std::vector<bool>& dirty);
  vk::raii::CommandBuffer record(const StepState& step, const std::vector<bool>& dirty, int times);
  // Submits as many runs as are worth it, `most` at most; says how many. `after` goes with them if they are `most`.
  int submit(const StepState& step, const std::vector<bool>& dirty, Variant& variant, int most,
             const std::vector<vk::CommandBuffer>& after);
  void require_run(const std::string& step) const;
  // Whether the step's counter has room for so many runs.
  void require_counts(size_t index, int times) const;
  // Says how often: less than asked for when the program was built anew meanwhile. `wait`: for the device.
  int run(const std::string& step, int times, bool wait = true);
  // One run is on its way, and saw this state.
  void leave_zeros(const bundle::StepT& table);
  void count_run(size_t index, const std::vector<bool>& dirty, const Work& run, const Work& skipped);
  // Loops whose trips nothing bounds may end before their time: then what ran is not the step, and nobody may read what
  // it left.
  void require_whole_loops(size_t index);
  void require_whole(size_t leaf) const;
  // Whether such a word was set; clears it.
  bool watch(uint32_t word);
  std::vector<std::string> told_not_finite(const std::string& step);
  // Warns of what passes left, as told_not_finite() has it, now and then.
  void hear_of_not_finite(const std::string& step);
  std::vector<CommandTime> timed_run(const std::string& step);
  std::optional<NotFinite> checked_run(const std::string& step);
  void set_runs(const std::string& step, int64_t runs);

  // shared.cpp: with CUDA
  CudaOrder& in_order();
  // Of a resource that has memory; `holder` is its place in `views`, if it is lent.
  CudaArray in_cuda(uint32_t resource, std::optional<size_t> holder);
  void copy_from_cuda(size_t leaf, const HostArray& data);
  void copy_to_cuda(const std::string& step, const std::string& output, const HostArray& to);
  uint32_t output_of(size_t step, const std::string& name) const;
  bool comes_from_host(size_t leaf) const;
  // What brings up to date, after a run, what CUDA sees of the step's images.
  std::vector<vk::CommandBuffer> mirror_copies(size_t step) const;

 private:
  // The program's step_index on the device, from the counters.
  void upload_counter(size_t step);
  void assign(size_t leaf, const io::Array& data);
  void check_tables(size_t faces, const io::Array& data) const;
  // The sizes that data of this shape gives, if it may be the leaf's.
  template <class Array>
  Sizes sizes_with(size_t leaf, const Array& data) const;
  Mirror& mirror_of(uint32_t resource);
  bool has_tables(size_t leaf) const;
  // What a step's commands, results and leaves live in.
  std::set<uint32_t> resources_of(const bundle::StepT& step) const;
  bool is_bound(size_t leaf) const;
  io::Array initial_value(size_t leaf) const;
  // What a step takes, also for the initial values that are computed for it.
  struct Needs {
    std::set<uint32_t> leaves, resources;  // leaves: those that are read
    std::set<std::string> symbols;
  };
  void collect_needs(const bundle::StepT& step, Needs& needs) const;
  // Gives those of them that have no memory.
  std::vector<uint32_t> check_memory(const std::set<uint32_t>& wanted) const;
  void give_memory(const std::set<uint32_t>& wanted);
};

}  // namespace dr::runtime
