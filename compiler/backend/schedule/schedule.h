// SPDX-License-Identifier: Apache-2.0
// The schedule: which ops run in which pass, and where values live between passes. Made by pack/, rewritten by
// lowering/, checked by check_schedule(), turned into shaders and commands by emit/.
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/ir/graph.h"
#include "compiler/target/profile.h"

namespace dr::backend {

using ResourceId = ir::Id<struct ResourceTag>;

// A value that is stored. See compiler/backend/bundle/bundle.fbs for the layouts.
struct Resource {
  enum class Storage : uint8_t { Buffer, Image, Tile };
  std::string name;
  ir::Type type;
  ir::Extent extent;
  Storage storage = Storage::Buffer;
  int leaf = -1;  // index of the leaf whose memory it is
  bool step_index = false;
  bool entries = false;  // of a raster, faces and tags of all its ranks; see lowering/raster_entries.h
  bool sums = false;     // fixed point sums; see lowering/keep_sums.h
  bool half = false;     // a buffer of float16, two components a word; an element begins with a word

  // Of 32 bits, of an element in a buffer.
  int words() const { return half ? (type.components() + 1) / 2 : type.components(); }
};

// Whether buffers hold two components of a value in a word, without loss: of a vector that `half` made. A scalar takes
// a word in any case, as words are what lanes may write side by side.
bool is_packed(const ir::Graph& graph, ir::ValueId value);

// Lanes that join what they add to one element do so for so many elements of a subgroup, which has so many lanes at
// most.
inline constexpr int kJoinRounds = 2;
inline constexpr uint32_t kMaxJoinedLanes = 128;

// How the sums of a Scatter pass come about; see lowering/scatter.h.
enum class ScatterLowering : uint8_t { Exact, Rows, Atomic };

// A stored value that sums what ops of a Scatter pass scatter: one result, or several that the program adds up.
struct ScatterSum {
  ir::ValueId value;
  std::vector<ir::ValueId> terms;
};

// The sources of each target in ascending order: source s and name k give item s * names() + k, where they name one of
// 0 .. targets - 1. Either the host makes the table of an input, or the device sorts what it computes of an index that
// the step does not change.
struct RowsTable {
  uint32_t leaf =
      0;  // the host: integers in one dimension, and the columns that name targets; sources are its elements
  std::vector<int> columns;
  std::vector<ScatterLeaf> places;  // the device, if there are any: sources are the elements of the pass
  ir::Dim targets;                  // the device: elements of all dimensions

  bool sorted() const { return !places.empty(); }
  int64_t names() const { return static_cast<int64_t>(sorted() ? places.size() : columns.size()); }
};

// Elements that an invocation lists together.
inline constexpr int kListedRun = 32;

// Loops that a dispatch may not take to their end, so that a later one goes on with them (emit/cut.cpp).
struct LoopCut {
  uint32_t part = 0;  // trips of an invocation in a dispatch; 0: not cut
  bool watched =
      false;  // the shader tells whether a loop did not come to its end, as only data, or the program, says so
  bool cuts() const { return part != 0; }
  friend bool operator==(const LoopCut&, const LoopCut&) = default;
};

// Invocations that share a face of the list of large ones at least.
inline constexpr int kLargeTeam = 1024;

// How a raster's compute shaders walk the boxes of faces (emit/face_lists.h).
struct FaceWalk {
  bool lists = false;  // faces whose boxes are not small go on one of two lists
  int small_box = 0;   // boxes of up to so many pixels are walked by the invocation that finds them; 0: none are
  int middle_box = 0;  // and of up to so many by teams of `team` invocations
  int team = 0;
  int middle_invocations = 0, large_invocations = 0;  // that share the faces of a list
  bool watched = false;                               // loops of closures; as of LoopCut
  friend bool operator==(const FaceWalk&, const FaceWalk&) = default;
};

// How the shader of one pass is written; chosen by lowering/choose_code.h.
struct PassCode {
  // Map, or Scatter with a dispatch that lists its active elements: an invocation has 32 elements, one after the other,
  // and lists them together.
  bool lists_in_runs = false;
  // Map: `if`s whose first branch runs in a second dispatch, for the elements that take it (emit/listed.cpp).
  std::vector<ir::OpId> heavy;
  bool heavy_by_subgroups = false;  // lanes of a subgroup take their places on the list together
  uint32_t heavy_apart =
      0;  // a fixed number of invocations, so many lanes apart, share the list; 0: one for each element
  LoopCut cut, heavy_cut;         // Map, Scatter; and of the second dispatch
  bool skips_zeros = false;       // Scatter by float atomics: a zero is not added
  std::vector<ir::ValueId> told;  // Map: of `writes`, those that tell whether they are NaN or Inf (emit/finite.cpp)
  FaceWalk walk;                  // Raster by compute shaders
};

// How all shaders are written; chosen by lowering/choose_code.h.
struct Code {
  bool native = false;          // the float profile `native`
  bool texel_reads = false;     // buffers that a compute shader only reads are uniform texel buffers
  bool hidden_stores = false;   // what is stored stands behind a choice that the driver's compiler cannot foresee
  bool wide_words = false;      // sums and rasters' entries are words of 64 bits, with atomics
  bool layers_at_once = false;  // a render pass draws several layers (multiview)
  uint32_t clears = 0;          // so many small fills, at most, become one dispatch (emit/clears.cpp); 0: fills stay
  uint32_t loop_trips = 0;      // of an invocation, before the device ends its loops; 0: they run on
  // By what is divided (analysis/divisors.h): divisors that the driver's compiler must not see, those that it must not
  // in shaders whose floats are strict, and those that are surely no larger than 2^126.
  std::set<ir::ValueId> hidden_divisors, strict_hidden_divisors, moderate_divisors;
};

// One pass. Its ops are root ops in graph order; what they need from outside is read from resources, what others
// need of them is written to resources.
struct Pass {
  enum class Kind : uint8_t {
    Map,      // element-wise over `domain`: ops, gathers, shifts, regions
    Reduce,   // one ReduceSum/Min/Max
    Scatter,  // ScatterAdd/ScatterMax and region ops with Scatter results, and additions of what they sum
    Raster,   // one Raster
  };
  Kind kind = Kind::Map;
  bool hardware = false;  // Map: fragment shader. Raster: draws
  std::string name;
  // Consecutive passes of one number are one stage: subpasses of a render pass, or a run of dispatches.
  uint32_t stage = 0;
  bool steady = false;  // it depends on what its step changes; the others are the step's prologue
  ir::Extent domain;
  std::vector<ir::OpId> ops;
  std::vector<ir::ValueId> reads;   // stored values it loads, in id order
  std::vector<ir::ValueId> writes;  // values it stores, in id order
  // Map: those of `writes` that are stored only where the scatter that it lists elements for is active, or for the
  // faces that the raster that it sets up lists.
  std::vector<ir::ValueId> partial;
  // Scatter: how, the sums among `writes`, and for Rows the table.
  ScatterLowering scatter = ScatterLowering::Exact;
  std::vector<ScatterSum> sums;
  RowsTable rows;
  std::string no_rows;  // why it has none, where they were asked for
  // Elements that may add something are listed first and only they run: those for which all values of one of these are
  // true or not zero. Empty: all elements run.
  std::vector<std::vector<ir::ValueId>> active;
  bool join_lanes = false;  // Exact: lanes of a subgroup that add to the same element join what they add
  int listed_by = -1;       // the earlier Map pass of the step that lists them; -1: a dispatch of its own does
  // What that pass does at an active element, too: the first run of exact sums, or all of a scatter by float atomics.
  bool joins_lister = false;
  // The first run of exact sums, where the lister does it, keeps what elements add, as far as there is room: the second
  // then need not compute it again.
  bool keeps_terms = false;
  // Raster: the earlier Map pass of the step that its first dispatch runs too; -1: none. See
  // lowering/set_up_in_raster.h.
  int set_up_by = -1;
  bool sets_up_again = false;  // and so does its second one, of each face that it walks
  bool relist = false;         // the first run of an exact pass lists what adds something for the second
  PassCode code;
};

struct StepSchedule {
  std::string name;
  std::vector<Pass> passes;
  std::map<ir::ValueId, ResourceId> stored;  // every stored value of this step, leaves included
  std::vector<std::pair<std::string, ir::ValueId>> outputs;
  std::vector<std::pair<uint32_t, ir::ValueId>> updates;  // leaf index, value
};

struct Schedule {
  std::string after;                // the last pass that ran on it
  std::vector<Resource> resources;  // those of the leaves first, in the graph's order
  std::vector<StepSchedule> steps;
  Code code;
};

// The kind of the pass that runs an op, and the elements over which its shader runs.
Pass::Kind pass_kind(const ir::Op& op);
ir::Extent domain_of(const ir::Graph& graph, const ir::Op& op);

// What is read when a step has run, and so needs memory of its own: outputs, updates and pinned values.
std::set<ir::ValueId> read_afterwards(const ir::Graph& graph, const StepSchedule& step);

// Values that a pass reads as input attachments: those that earlier passes of its stage write, in id order.
std::vector<ir::ValueId> stage_inputs(const StepSchedule& step, size_t pass);

// Which result of its raster a value is.
struct RasterPart {
  size_t rank;
  bool tag;  // or the face
};
RasterPart raster_part(const ir::Graph& graph, ir::ValueId value);

// Takes resources away that no step stores anything in.
void remove_resources(Schedule& schedule, const std::set<uint32_t>& unused);

// What is wrong with a schedule, in one line: a mistake of the compiler, or a limit of the profile that it exceeds.
struct Violation {
  enum class Kind : uint8_t { Unsound, Limit };
  Kind kind = Kind::Unsound;
  std::string text;
  friend bool operator==(const Violation&, const Violation&) = default;
};

// Replays the schedule independently of the packer: every read was written before (or is a leaf), every op's operands
// are at hand, every limit of the profile holds, outputs and updates are stored.
std::vector<Violation> check_schedule(const ir::Graph& graph, const Schedule& schedule, const target::Profile& profile);

// Without the graph; text.h describes the form.
std::string print(const ir::Graph& graph, const Schedule& schedule);

// The kind of a pass in schedules and reports: "fragment", "raster compute" and so on.
const char* kind_name(const Pass& pass);

}  // namespace dr::backend
