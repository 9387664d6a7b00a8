// SPDX-License-Identifier: Apache-2.0
// The schedule: which ops run in which pass, and where values live between passes. Made by pack/, rewritten by
// lowering/, checked by check_schedule(), turned into shaders and commands by emit/.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "compiler/backend/schedule/pass.h"
#include "compiler/ir/graph.h"
#include "compiler/ir/raster.h"
#include "compiler/target/profile.h"

namespace dr::backend {

using ResourceId = ir::Id<struct ResourceTag>;

// A value that is stored. See compiler/backend/bundle/bundle.fbs for the layouts.
struct Resource {
  // What it is: a buffer of one of eleven kinds, or an image.
  enum class Storage : uint8_t {
    Leaf,          // the memory of the leaf with its number
    StepIndex,     // the counter of a step's runs
    Buffer,        // a word a component
    Halves,        // float16, two components a word; an element begins with a word
    Entries,       // of a raster, faces and tags of all its ranks; see lowering/raster_entries.h
    EpochEntries,  // cleared once in several runs; see lowering/clear_by_epochs.h
    Bits,          // of a raster, whether pixels see a face, 32 of a row in a word; see lowering/raster_entries.h
    Sums,          // fixed point sums; see lowering/keep_sums.h
    EmptiedSums,   // that their reader leaves zeros; see lowering/empty_sums.h
    ListedSums,    // that the map which lists what reads them clears there; see lowering/clear_where_listed.h
    Emptied,       // sums by float atomics, a word a component, that their reader leaves zeros
    Image,
    Tile,  // an image that never leaves its render pass
  };
  std::string name;
  ir::Type type;
  ir::Extent extent;
  Storage storage = Storage::Buffer;

  bool is(Storage one) const { return storage == one; }
  bool is_entries() const { return is(Storage::Entries) || is(Storage::EpochEntries); }
  bool is_sums() const { return is(Storage::Sums) || is(Storage::EmptiedSums) || is(Storage::ListedSums); }
  bool is_emptied() const { return is(Storage::EmptiedSums) || is(Storage::Emptied); }
  bool is_buffer() const { return storage != Storage::Image && storage != Storage::Tile; }
  // Of 32 bits, of an element in a buffer.
  int words() const { return is(Storage::Halves) ? (type.components() + 1) / 2 : type.components(); }
  void leave_image() {
    if (is(Storage::Image)) storage = Storage::Buffer;
  }
};

// Whether buffers hold two components of a value in a word, without loss: of a vector that `half` made. A scalar takes
// a word in any case, as words are what lanes may write side by side.
bool is_packed(const ir::Graph& graph, ir::ValueId value);

// How all shaders are written; chosen by lowering/choose_code.h.
struct Code {
  bool native = false;          // the float profile `native`
  bool texel_reads = false;     // buffers that a compute shader only reads are uniform texel buffers
  bool hidden_stores = false;   // what is stored stands behind a choice that the driver's compiler cannot foresee
  bool hidden_zeros = false;    // so do constants that are zero: drivers take a NaN or Inf times zero for zero
  bool no_else = false;         // a branch otherwise is an `if` of its own
  bool divides_by_any = false;  // quotients by divisors beyond 2^126 are right, as processors' are
  bool wide_words = false;      // sums and rasters' entries are words of 64 bits, with atomics
  bool layers_at_once = false;  // a render pass draws several layers (multiview)
  uint32_t clears = 0;          // so many small fills, at most, become one dispatch (emit/clears.cpp); 0: fills stay
  uint32_t loop_trips = 0;      // of an invocation, before the device ends its loops; 0: they run on
  // By what is divided (analysis/divisors.h): divisors that the driver's compiler must not see, those that it must not
  // in shaders whose floats are strict, and those that are surely no larger than 2^126.
  std::set<ir::ValueId> hidden_divisors, strict_hidden_divisors, moderate_divisors;
};

struct StepSchedule {
  std::string name;
  std::vector<Pass> passes;
  std::map<ir::ValueId, ResourceId> stored;  // every stored value of this step, leaves included
  std::vector<std::pair<std::string, ir::ValueId>> outputs;
  std::vector<std::pair<uint32_t, ir::ValueId>> updates;  // leaf index, value

  Pass& pass(PassId id) { return passes[id.index]; }
  const Pass& pass(PassId id) const { return passes[id.index]; }
};

struct Schedule {
  std::string after;                // the last pass that ran on it
  std::vector<Resource> resources;  // those of the leaves first, in the graph's order
  std::vector<StepSchedule> steps;
  Code code;
};

// The scatters of a step that a map pass lists elements for.
std::vector<const Pass*> listed_for(const StepSchedule& step, PassId map);
// The raster whose faces it sets up; null: there is none.
const Pass* set_up_for(const StepSchedule& step, PassId map);

// What the invocations of a workgroup read together at a time, in bytes; nothing where that is no part of an image that
// can be told.
std::optional<int64_t> shared_bytes(const ir::Graph& graph, const Block& block);

// The kind of the pass that runs an op, and the elements over which its shader runs.
PassKind pass_kind(const ir::Op& op);
ir::Extent domain_of(const ir::Graph& graph, const ir::Op& op);

// What is read when a step has run, and so needs memory of its own: outputs, updates and pinned values.
std::set<ir::ValueId> read_afterwards(const ir::Graph& graph, const StepSchedule& step);

// Values that a pass reads as input attachments: those that earlier passes of its stage write, in id order.
std::vector<ir::ValueId> stage_inputs(const StepSchedule& step, size_t pass);

// Which result of its raster a value is.
struct RasterPart {
  size_t rank;
  ir::RasterResult what;
};
RasterPart raster_part(const ir::Graph& graph, ir::ValueId value);

// Takes those of these resources away that no step stores anything in.
void remove_resources(Schedule& schedule, std::set<uint32_t> unused);

// What is wrong with a schedule, in one line: a mistake of the compiler, or a limit of the profile that it exceeds.
struct Violation {
  enum class Kind : uint8_t { Unsound, Limit };
  Kind kind = Kind::Unsound;
  std::string text;
  std::vector<ir::OpId> ops = {};  // of the pass that it is about
  bool of_buffers = false;         // it binds too many, where passes of other ops may fit
  friend bool operator==(const Violation&, const Violation&) = default;
};

// Replays the schedule independently of the packer: every read was written before (or is a leaf), every op's operands
// are at hand, every limit of the profile holds, outputs and updates are stored.
std::vector<Violation> check_schedule(const ir::Graph& graph, const Schedule& schedule, const target::Profile& profile);

// Without the graph; text.h describes the form.
std::string print(const ir::Graph& graph, const Schedule& schedule);

}  // namespace dr::backend
