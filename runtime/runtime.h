// SPDX-License-Identifier: Apache-2.0
// The C++ API: open a device, load a bundle, bind arrays to leaves, run steps, read outputs.
//
//   auto device  = runtime::Device::open({.name = "lavapipe"});
//   auto program = runtime::Program::load(*device, bundle_bytes);
//   program->bind("position", positions);
//   program->run("fit_shape", 100);
//   auto alpha = program->output("fit_shape", "alpha");
//
// Every function that can fail on what the outside gives returns a Result with one sentence, also of an object that was
// moved from; others answer then that there is nothing. Objects are not thread safe.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "compiler/io/array/array.h"
#include "compiler/io/file/result.h"

namespace dr::runtime {

using io::Result;

struct DeviceOptions {
  // Part of the device's name, any case ("lavapipe" also finds Mesa's llvmpipe), or its number in list(); empty: the
  // first.
  std::string name;
  // Core and synchronization validation, where the layer is installed; messages are kept, see validation_messages().
  bool validation = false;
  // Asks drivers what shaders take of a processor, where they tell: see CommandTime::registers.
  bool shader_statistics = false;
};

struct DeviceInfo {
  std::string name;
  std::string kind;         // "cpu", "discrete gpu", ...
  std::string api_version;  // "1.3.230"
  std::string driver;       // its name and version: "llvmpipe Mesa 22.3.6 (LLVM 15.0.6)"
};

// What a device profile wants to know (compiler/target/profile.h has the same names).
struct DeviceLimits {
  uint32_t max_color_attachments, max_per_stage_descriptor_storage_buffers, max_per_stage_descriptor_sampled_images,
      max_per_stage_descriptor_input_attachments, max_per_stage_resources, max_fragment_combined_output_resources,
      max_push_constants_size, max_image_dimension_2d, max_compute_work_group_invocations,
      max_compute_work_group_count_x, max_compute_shared_memory_size, max_multiview_view_count, subgroup_size;
  uint64_t max_storage_buffer_range;
  bool subgroup_arithmetic, subgroup_shuffle, shader_int64, shader_buffer_int64_atomics,
      shader_buffer_float32_atomic_add, fragment_stores_and_atomics, geometry_shader;
};

struct DeviceState;  // the runtime's own

class Device {
 public:
  const std::shared_ptr<DeviceState>& state() const { return state_; }
  static Result<std::vector<DeviceInfo>> list();
  static Result<Device> open(const DeviceOptions& options = {});
  DeviceInfo info() const;
  DeviceLimits limits() const;
  // The name of the built-in profile that fits the device, by the device's name: "lavapipe", "nvidia-h200", or empty.
  std::string profile_name() const;
  // What the validation layer said so far; empty when all is well or it is not on.
  std::vector<std::string> validation_messages() const;
  bool validating() const;
  // Whether it can share memory with CUDA, and the number that CUDA has for it; the error says why there is none.
  bool shares_memory() const;
  Result<int> cuda_device() const;

 private:
  std::shared_ptr<DeviceState> state_;
};

// Compiles a program anew: the bundle of the same leaves, steps and results, in which what depends on the leaves
// `moving`, by step, stands apart from what does not. Called from another thread; an error means: stay as you are, and
// so does a bundle of others.
using Moving = std::map<std::string, std::set<std::string>>;
using Rebuild = std::function<Result<std::vector<uint8_t>>(const Moving& moving)>;

// "dressi: warning: ..."
void warn_on_stderr(const std::string& warning);

struct LoadOptions {
  // The bundle comes from somebody whom the user trusts as a programmer, or was compiled just now: its shaders go to
  // the driver as they are. Otherwise they are validated, and compared with the bundle's tables and the device.
  bool trusted = false;
  // The reactive cache: leaves out the commands of a step whose results are there already, since nothing that they
  // depend on changed. Results have the same bits without it.
  bool cache = true;
  // Makes more of the cache, where there is a compiler (jit::rebuilder): when the same leaves changed before each of
  // the last `rebuild_after` runs of a step, and so commands run that others' leaves have a part in, the program is
  // built anew beside the runs, and takes over between two of them. Results have the same bits.
  Rebuild rebuild = {};
  int rebuild_after = 8;
  bool rebuild_beside = true;  // false: the run waits for it
  // Records a step's commands once for each set of those that must run, rather than before each run.
  bool reuse_commands = true;
  // Where the driver's pipelines are kept between runs; empty: nowhere. A damaged file there does no harm.
  std::string pipeline_folder = {};
  // A driver that compiles shaders late, one after the other, compiles some beside a first run: lavapipe, on more than
  // one core, where the folder above holds nothing of them.
  bool compile_beside = false;
  // The steps that will run, in order, as far as that is known: beside the first run of one of them, and the runs
  // behind it, those of the next ones are compiled, too.
  std::vector<std::string> steps = {};
  // Bytes of device memory that may be taken; 0: what the device has. Leaves beyond that stay in memory of the host,
  // which the device reads directly, inputs with layers first; that is decided when a step that needs them first runs.
  // With a limit no program is built anew, since two would stand side by side.
  int64_t memory_limit = 0;
  // Bytes that one binding of a shader takes, and a third of what one buffer has; 0: as many as the device allows.
  // Values that hold more are bound in parts, in several buffers where one is too small, and shaders look which one an
  // element is in; results have the same bits. For tests.
  int64_t buffer_limit = 0;
  // Stores the values, too, that only their render pass needs, so that checked_run() sees them.
  bool store_all = false;
  // Leaves and outputs stand in memory that CUDA sees, on devices that can: see Program::cuda_leaf.
  bool share = false;
  // Told once of each output and leaf that is read and holds a NaN or Inf, and of each pass that left one: a line on
  // stderr. Called by the thread that calls the program. It must not throw: what it throws is dropped. Empty: nobody is
  // told, and nothing looked at.
  std::function<void(const std::string&)> warn = warn_on_stderr;
};

// What commands (dispatches, render passes, copies, fills) amount to.
struct Work {
  int64_t commands = 0;
  int64_t ops = 0;    // of the program's graph
  int64_t bytes = 0;  // sizes of what the commands read and write, each counted once a command
  Work& operator+=(const Work& other);
};

struct StepCounters {
  int64_t runs = 0;
  Work run, skipped;     // in all runs together
  int64_t recorded = 0;  // runs whose commands were recorded for them; the others took recorded ones
};

// Pipelines made, and those of them that the driver had kept in a file (LoadOptions::pipeline_folder) of a program
// before: it had nothing to add to the file then.
struct PipelineCounters {
  int64_t made = 0, kept = 0;
  PipelineCounters& operator+=(const PipelineCounters& other);
};

// Bytes that a program holds: all that it allocated of Vulkan.
struct MemoryUse {
  int64_t device = 0;
  int64_t host = 0;                      // leaves that the device reads there, and what data passes through
  int64_t peak = 0;                      // the most of both together so far
  std::vector<std::string> host_leaves;  // those that the device had no room for
};

// Time on the device of one command, in one run of its step.
struct CommandTime {
  std::string label;
  double nanoseconds = 0;
  int64_t ops = 0, bytes = 0;      // as in Work
  std::vector<std::string> lines;  // of the program: "fit.dr:3"
  // Of a dispatch that runs for listed elements alone: "active", those of a scatter that may add something, or
  // "branches", those that take a heavy branch; how many are listed, and of how many.
  std::string list;
  int64_t listed = 0, elements = 0;
  // Of a dispatch: invocations of a workgroup, and registers of an invocation, 0 where the driver does not tell. A
  // processor runs as many invocations at a time as it has registers for.
  int group = 0, registers = 0;
  // Of draws: pixels that fragment shaders ran for, those of covered fragments and of helpers; 0 where the device does
  // not count.
  int64_t fragments = 0;
};

// A NaN or Inf that a run stored.
struct NotFinite {
  std::string label, value;        // of the command that wrote it, and of what it wrote
  io::Place place;                 // its first element that is not finite
  std::vector<std::string> lines;  // of the program: "fit.dr:3"
};

// An array in memory that is somebody else's, laid out as an io::Array.
struct HostArray {
  io::ElementKind kind = io::ElementKind::Float32;
  int components = 1;
  int64_t width = 1, height = 1, layers = 1;
  void* data = nullptr;
  std::shared_ptr<void> held = {};  // of a view: says that it is in use
  // Empty where there is no data, or an extent that is none or beyond io::kMaxArrayBytes.
  io::Array copied() const;
};

// Memory of a leaf or an output as CUDA sees it: `array.data` is an address of CUDA.
struct CudaArray {
  HostArray array;
  int64_t stride = 1;  // scalars from one element to the next, which may be more than its components
};

class Program {
 public:
  // The bundle's bytes, as drc wrote them.
  static Result<Program> load(const Device& device, std::span<const uint8_t> bundle, const LoadOptions& options = {});
  // The tables alone, without a device: leaves(), steps(), outputs() answer, nothing runs.
  static Result<Program> describe(std::span<const uint8_t> bundle);
  struct State;  // the runtime's own
  Program(Program&&) noexcept;
  Program& operator=(Program&&) noexcept;
  ~Program();

  std::vector<std::string> steps() const;
  struct LeafInfo {
    std::string name;
    int components;
    io::ElementKind kind;
  };
  std::vector<LeafInfo> leaves() const;
  bool is_input(const std::string& leaf) const;
  // The leaves that a step reads or changes, and those that their initial values are computed from. Those that are read
  // must be bound before it runs, unless they have initial values.
  std::vector<std::string> needed_leaves(const std::string& step) const;

  // Gives a leaf its data; the first time this also gives values to the symbols of its extent, which later data must
  // keep. What fails changes nothing.
  Result<void> bind(const std::string& leaf, const io::Array& data);
  // Gives a symbol its value where no leaf does.
  Result<void> bind_symbol(const std::string& symbol, int64_t value);
  // Runs a step, `times` times without waiting in between. The first run allocates, compiles and records. Returns when
  // the device is done. Where a loop takes more trips than the device gives one, that is told when the runs are over:
  // they count, but what they left is refused, the step's results until it runs again, and leaves that it changes until
  // they are bound again.
  Result<void> run(const std::string& step, int times = 1);
  // How often the step counts as having run: the program's step_index in the next run. 0 at first.
  Result<void> set_runs(const std::string& step, int64_t runs);
  // What its runs did and left out so far.
  StepCounters counters(const std::string& step) const;
  // How often it was built anew.
  int rebuilds() const;
  PipelineCounters pipelines() const;
  // Runs the step once, and takes the time on the device of each command that runs: of none that the cache leaves out.
  // Waiting for each command to end takes time too: the sum is more than the whole.
  Result<std::vector<CommandTime>> timed_run(const std::string& step);
  // Runs all commands of the step once, also those that the cache would leave out, one by one, and reads back every
  // float that they store (see LoadOptions::store_all): the first that is NaN or Inf, if there is one. The step runs to
  // its end either way. For debugging: slow.
  Result<std::optional<NotFinite>> checked_run(const std::string& step);
  // What of the step left a NaN or Inf in a leaf, or in an output of one element, since this was asked last: pass and
  // lines ("update (fit.dr:3)"), one for each pass. Bare sums and scatters do not say so, nor
  // passes that have no buffer to spare on the device. With LoadOptions::warn runs ask now and then themselves.
  Result<std::vector<std::string>> told_not_finite(const std::string& step);
  // Results of the step's last run.
  Result<io::Array> output(const std::string& step, const std::string& name);
  std::vector<std::string> outputs(const std::string& step) const;
  // Whether the step gives the leaf a value.
  bool changes(const std::string& step, const std::string& leaf) const;
  // What an output is made of; no components where there is none of that name.
  LeafInfo output_info(const std::string& step, const std::string& name) const;
  // The leaf's content.
  Result<io::Array> leaf(const std::string& name);
  // The memory itself that a leaf, or an output of the step's last run, has on a device that is the host's processor;
  // nothing where a copy is needed. The program must outlive it. What is written to a leaf counts in the next run:
  // while a view of it is held nothing that depends on the leaf is skipped, nor anything while one of an output is.
  // Another run overwrites an output.
  Result<std::optional<HostArray>> leaf_view(const std::string& name);
  Result<std::optional<HostArray>> output_view(const std::string& step, const std::string& name);
  // As bind(), without a copy in between where the leaf has memory already that the host sees.
  Result<void> bind(const std::string& leaf, const HostArray& data);
  // ---- With CUDA, of a program that was loaded with LoadOptions::share. Errors say what is in the way ----
  // The stream (a CUstream) whose work runs of the program wait for, and which waits for them: neither holds up the
  // host. 0 at first, the default one.
  Result<void> cuda_stream(void* stream);
  // Another stream waits for all runs so far.
  Result<void> cuda_wait(void* stream);
  // As leaf_view() and output_view(); an output may be a copy that each run of its step makes anew.
  Result<CudaArray> cuda_leaf(const std::string& name);
  Result<CudaArray> cuda_output(const std::string& step, const std::string& name);
  // Copies arrays of CUDA to leaves, runs the step (none: an empty name) and copies outputs to arrays of CUDA, all on
  // the stream: it returns before any of it is done.
  using Named = std::pair<std::string, HostArray>;
  Result<void> cuda_run(const std::string& step, std::span<const Named> leaves, std::span<const Named> outputs);
  // Whether a leaf's data must come from the host: faces that tables are made of, and bools.
  bool comes_from_host(const std::string& leaf) const;
  // The discrete decisions of the step's last run: for each raster its faces and tags, rank by rank. They and pins are
  // there until another step runs or the program is built anew.
  Result<std::vector<std::vector<io::Array>>> rasters(const std::string& step);
  // The values that the program pins and the step's last run stored, by the names of compiler/ir/pins.h.
  Result<std::vector<std::pair<std::string, io::Array>>> pins(const std::string& step);
  // A stored value by the name of its resource ("raster", "raster_2" and so on), unless it shares its memory with
  // others: for tests and debugging.
  Result<io::Array> resource(const std::string& name);
  std::vector<std::string> resources() const;
  MemoryUse memory_use() const;
  // How many commands (dispatches, render passes, copies, fills) one run of the whole step submits.
  Result<int> command_count(const std::string& step);

 private:
  Program();
  friend struct Inside;  // of measurements of the runtime
  void take_rebuilt();
  State& state();              // throws where there is none
  const State& known() const;  // one without tables where there is none
  std::unique_ptr<State> state_;
};

}  // namespace dr::runtime
