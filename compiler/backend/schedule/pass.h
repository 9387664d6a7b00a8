// SPDX-License-Identifier: Apache-2.0
// A pass: ops that run together, and what only passes of its kind have.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "compiler/backend/analysis/scatter_leaves.h"
#include "compiler/ir/graph.h"
#include "compiler/ops/op.h"

namespace dr::backend {

// One function for each kind of a variant, for std::visit: it does not compile where one is missing.
template <class... Functions>
struct Overloaded : Functions... {
  using Functions::operator()...;
};
template <class... Functions>
Overloaded(Functions...) -> Overloaded<Functions...>;  // clang before 17 does not deduce it

// A pass by its place in its step.
using PassId = ir::Id<struct PassTag>;
inline PassId pass_id(size_t place) { return {static_cast<uint32_t>(place)}; }

// The kind of the pass that runs an op. A map and a raster run in a compute shader or are drawn.
using PassKind = ops::RunsAs;

// Loops that a dispatch may not take to their end, so that a later one goes on with them (emit/cut.cpp).
struct LoopCut {
  uint32_t part = 1;     // trips of an invocation in a dispatch
  bool watched = false;  // the shader tells whether a loop did not come to its end, as only data, or the program, says
};

// ---- Maps: element-wise over the domain: ops, gathers, shifts, regions ----

// Reads that the invocations of a workgroup do together.
struct GroupReads {
  std::array<int, 3> group{1, 1, 1};  // invocations of a workgroup
  ir::OpId loop;                      // they read for so many trips of this loop at a time
  int trips = 1;
  std::vector<ir::OpId> gathers;  // these, in order

  int invocations() const { return group[0] * group[1] * group[2]; }
};

// Elements that an invocation computes side by side, so that it reads once what they have in common; see
// lowering/block_loops.h.
inline constexpr int kMostBlock = 64;
struct Block {
  std::array<int, 3> each{1, 1, 1};  // along x, y and layers
  std::optional<GroupReads> together;

  int elements() const { return each[0] * each[1] * each[2]; }
  // Elements of a workgroup that reads together, else of an invocation.
  std::array<int, 3> box() const {
    if (!together) return each;
    return {each[0] * together->group[0], each[1] * together->group[1], each[2] * together->group[2]};
  }
};

// `if`s whose first branch runs in a second dispatch, for the elements that take it (emit/listed.cpp); or a select, for
// all of its condition.
struct HeavyBranches {
  std::vector<ir::OpId> ops;
  // `if`s whose condition is unlikely: a third dispatch has them, for the elements of the second one that take them.
  std::vector<ir::OpId> unlikely;
  bool by_subgroups = false;   // lanes of a subgroup take their places on the list together
  uint32_t apart = 0;          // a fixed number of invocations, so many lanes apart, share the list; 0: one an element
  bool shares_loops = false;   // the lanes between share an element's loops that combine integers
  std::optional<LoopCut> cut;  // of the second dispatch
};

// Elements that an invocation lists together.
inline constexpr int kListedRun = 32;

// Elements that an invocation takes in turn, at most: what it does for all of them is then a small part of its work.
inline constexpr int kMostInTurn = 32;

// Invocations of a workgroup that joins what it adds: few, or many, which have fewer registers each.
inline constexpr int kJoiningGroup = 256, kLargeJoiningGroup = 512;

// How the shader is written; chosen by lowering/choose_code.h.
struct MapCode {
  bool lists_in_runs = false;  // an invocation has kListedRun elements, one after the other, and lists them together
  bool in_tiles = false;       // lanes that follow each other have elements of a square, not of a row
  int each = 1;                // elements of an invocation at most, one after the other; the host chooses (strides.cpp)
  std::optional<HeavyBranches> heavy;
  std::optional<LoopCut> cut;
  int joining_group = kJoiningGroup;  // where scatters join what workgroups add; elsewhere the host chooses
  std::vector<ir::ValueId> told;      // those of `writes` that tell whether they are NaN or Inf (emit/finite.cpp)
};

// An update whose elements stay as they are where no gradient comes (schedule/rest.h): it does not run for elements
// that `gradient` adds nothing to, whose memory is zero, and that it would leave as they are. Of a scatter by sorted
// rows, which does not run for them either, these have no row. One by atomics wakes those that it adds to: they are
// stepped from then on. Those that do not rest are listed, or have a bit, or blocks (bundle::kRestingBlock) that hold
// such are marked.
struct AtRest {
  PassId gradient;
  std::vector<ir::ValueId> memory;  // values of states, old ones
  bool lists_in_runs = false;       // as of MapCode, of what lists the others
  bool in_bits = false;             // they are marked, each by a bit; the update goes from bit to bit
  bool in_blocks = false;           // their blocks are marked
  // Marked ones only: gathers whose results are zero, too, at an element that rests, as what a level of a pyramid adds
  // is. The update looks at them in each run.
  std::vector<ir::OpId> gathers;
  bool is_marked() const { return in_bits || in_blocks; }
};

// By a compute shader.
struct MapPass {
  // Those of `writes` that are stored only where the scatter that it lists elements for is active, or for the faces
  // that the raster that it sets up lists.
  std::vector<ir::ValueId> partial;
  std::optional<AtRest> rest;
  std::optional<Block> block;
  MapCode code;
};

// By a fragment shader.
struct FragmentPass {};

// ---- One ReduceSum/Min/Max ----

// Invocations of a workgroup, where eight share what one folds otherwise (emit/reduce.cpp).
inline constexpr int kReducingGroup = 512;

struct ReducePass {
  bool in_teams = false;
};

// ---- Scatters: ScatterAdd/ScatterMax and region ops with Scatter results, and additions of what they sum ----

// A stored value that sums what ops of the pass scatter: one result, or several that the program adds up.
struct ScatterSum {
  ir::ValueId value;
  std::vector<ir::ValueId> terms;
};

// Elements may add something for which all values of one of these are true or not zero.
using Clauses = std::vector<std::vector<ir::ValueId>>;

// A dispatch of the scatter's own that lists elements; `in_runs`: as a map does (MapCode).
struct OwnList {
  bool in_runs = false;
};

// Elements that may add something are listed first and only they run.
struct ActiveList {
  Clauses clauses;
  std::variant<OwnList, PassId> listed_by;  // an earlier map pass of the step, where it is no dispatch of its own
};

// A run by a dispatch of the scatter's own.
struct OwnRun {
  std::optional<ActiveList> active;  // none: all elements run
};

// The map pass that lists the active elements does at them what the run does.
struct JoinedRun {
  Clauses clauses;
  PassId lister;
};

// Lanes that join what they add to one element do so for so many elements of a subgroup, which has so many lanes at
// most.
inline constexpr int kJoinRounds = 2;
inline constexpr uint32_t kMaxJoinedLanes = 128;

struct OwnFirstRun : OwnRun {
  bool relists = false;  // it lists what adds something for the second
  // Listed elements where one of these is zero add nothing. A dispatch lists the others for it.
  std::vector<ir::ValueId> nonzero;
};
struct JoinedFirstRun : JoinedRun {
  // It keeps what elements add, as far as there is room: the second then need not compute it again.
  bool keeps_terms = false;
  bool again = false;  // the second run computes what the map does again, and needs no list
  bool asks = false;   // an invocation between both asks whether a guess was wrong: if none was, the second has none
};

// Invocations that share an element's loops, at most: where many elements are listed, each has one.
inline constexpr int kLoopShares = 8;

// Float sums in fixed point, by two runs: the first finds the largest contribution, the second adds.
struct ExactScatter {
  std::variant<OwnFirstRun, JoinedFirstRun> first_run;
  bool guesses = false;  // the first run adds by the exponent of the step's run before, the second where it was wrong
  bool joins_lanes = false;   // lanes of a subgroup list elements, and find the largest contribution, together
  bool joins_parts = false;   // those that add to the same element join what they add
  bool joins_groups = false;  // where a map adds, the invocations of a workgroup do (emit/group_sums.cpp)
  bool shares_loops = false;  // several invocations share an element's loops that only scatter
  bool joins_pairs = false;   // where the second run adds, two lanes beside each other do (emit/pair_sums.cpp)
  // Of so many lanes of a subgroup, those that follow each other and add to the same element join what they add; 0:
  // none.
  int joins_runs = 0;
  std::string no_rows;  // why it has no table of rows, where one was asked for
  std::optional<LoopCut> cut;
};

// The host makes the table of an input: integers in one dimension, and the columns that name targets; sources are its
// elements.
struct RowsOfLeaf {
  uint32_t leaf = 0;
  std::vector<int> columns;
};

// The device sorts what it computes of indices that the step does not change; sources are the elements of the pass.
struct SortedRows {
  std::vector<ScatterLeaf> places;
};

// As gathers: the sources of each target in ascending order. Source s and name k give item s * names() + k, where they
// name one of 0 .. targets - 1.
struct RowsScatter {
  std::variant<RowsOfLeaf, SortedRows> table;
  ir::Dim targets;  // sorted: elements of all dimensions
  int lanes = 1;    // beside each other that share a target's items

  const SortedRows* sorted() const { return std::get_if<SortedRows>(&table); }
  int64_t names() const;
  ir::Dim items(const ir::Extent& domain) const;  // of a layer, where the host makes the table
};

// By float atomics.
struct AtomicScatter {
  std::variant<OwnRun, JoinedRun> run;
  bool skips_zeros = false;  // a zero is not added
  std::optional<LoopCut> cut;
};

// Float sums of few elements, in bins (analysis/bins.h): one run adds.
struct BinnedScatter {
  std::variant<OwnRun, JoinedRun> run;
  bool joins_parts = false;  // lanes of a subgroup that add to the same bins join what they add
  std::string no_rows;       // why it has no table of rows, where one was asked for
  std::optional<LoopCut> cut;
};

// How sums come about, in the order of ScatterPass::how; see lowering/scatter.h.
enum class ScatterLowering : uint8_t { Exact, Rows, Atomic, Binned };

struct ScatterPass {
  std::vector<ScatterSum> sums;  // those among `writes`
  std::variant<ExactScatter, RowsScatter, AtomicScatter, BinnedScatter> how;

  ScatterLowering lowering() const;
  const ExactScatter* exact() const { return std::get_if<ExactScatter>(&how); }
  ExactScatter* exact() { return std::get_if<ExactScatter>(&how); }
  const BinnedScatter* binned() const { return std::get_if<BinnedScatter>(&how); }
  const RowsScatter& rows() const { return std::get<RowsScatter>(how); }

  const OwnRun* own_run() const;        // null where it has none
  const JoinedRun* joined_run() const;  // likewise
  const ActiveList* active_list() const;
  ActiveList* active_list();
  const Clauses& clauses() const;        // of the elements that run; empty: all do
  std::optional<PassId> lister() const;  // the map pass that lists them
  bool leaves_list() const;              // that pass makes a list, for a run of the scatter's own
  // Joins the lister's dispatch; there is a list, and a map pass makes it.
  void join_lister();

  bool relists() const;
  const std::vector<ir::ValueId>& nonzero() const;  // see OwnFirstRun
  bool keeps_terms() const;
  bool runs_again() const;  // see JoinedFirstRun::again
  bool asks() const;        // see JoinedFirstRun::asks
  bool guesses() const { return exact() != nullptr && exact()->guesses; }
  bool joins_lanes() const { return exact() != nullptr && exact()->joins_lanes; }
  bool shares_loops() const { return exact() != nullptr && exact()->shares_loops; }
  bool joins_groups() const { return exact() != nullptr && exact()->joins_groups; }
  bool joins_pairs() const { return exact() != nullptr && exact()->joins_pairs; }
  int joins_runs() const { return exact() == nullptr ? 0 : exact()->joins_runs; }
  bool joins_parts() const;
  const std::string& no_rows() const;
  std::optional<LoopCut> cut() const;
};

// ---- One Raster ----

// The earlier map pass of the step that a raster's first dispatch runs, too. Its second one computes of each face that
// it walks what it needs and is not stored; see set_up_again in schedule/trips.h and lowering/set_up_in_raster.h.
struct FaceSetup {
  PassId pass;
};

// Invocations that share a face of the list of large ones at least.
inline constexpr int kLargeTeam = 1024;

// A mesh has few faces where its picture has more pixels for each: most of its boxes are then not small.
inline constexpr int kPixelsOfFew = 32;

// Lists of faces whose boxes are not small.
struct FaceBins {
  int small_box = 0;   // boxes of up to so many pixels are walked by the invocation that finds them; 0: none are
  int few_box = 0;     // the same where the picture has more than `kPixelsOfFew` pixels a face; 0: small_box
  int middle_box = 0;  // and of up to so many by teams of `team` invocations
  int team = 0;
  int middle_invocations = 0, large_invocations = 0;  // that share the faces of a list
};

// An invocation takes up to `each` faces. If there are any `shown`, it looks at all of them first and goes on with
// those alone for which these hold: without one of them, a face is culled. Else all lanes would set up and walk
// whatever one beside them does.
struct FacesInTurn {
  std::vector<ir::ValueId> shown;  // computed by the pass that sets up
  int each = 0;
};

// How compute shaders walk the boxes of faces (emit/face_lists.h).
struct FaceWalk {
  std::optional<FaceBins> lists;
  std::optional<FacesInTurn> in_turn;
  // Bits of the pixels that faces are looked for at, a word of 32 read at once; see analysis/raster_parts.h. Lanes that
  // share a face then share words, not pixels.
  std::optional<ir::ValueId> wanted;
  bool watched = false;  // loops of closures; as of LoopCut
};

// By compute shaders.
struct RasterPass {
  std::optional<FaceSetup> setup;
  FaceWalk walk;
  // Where it writes bits, the value that is the same words, which no pass computes; see analysis/raster_parts.h.
  std::optional<ir::ValueId> rows;
};

// By draws.
struct DrawnRasterPass {};

// Its ops are root ops in graph order; what they need from outside is read from resources, what others need of them is
// written to resources.
struct Pass {
  std::string name;
  // Consecutive passes of one number are one stage: subpasses of a render pass, or a run of dispatches.
  uint32_t stage = 0;
  bool steady = false;  // it depends on what its step changes; the others are the step's prologue
  ir::Extent domain;
  std::vector<ir::OpId> ops;
  std::vector<ir::ValueId> reads;   // stored values it loads, in id order
  std::vector<ir::ValueId> writes;  // values it stores, in id order
  std::variant<MapPass, FragmentPass, ReducePass, ScatterPass, RasterPass, DrawnRasterPass> of_kind;

  PassKind kind() const;
  bool is_drawn() const { return is<FragmentPass>() || is<DrawnRasterPass>(); }
  template <class Kind>
  bool is() const {
    return std::holds_alternative<Kind>(of_kind);
  }
  // Null where the pass is of another kind.
  template <class Kind>
  Kind* as() {
    return std::get_if<Kind>(&of_kind);
  }
  template <class Kind>
  const Kind* as() const {
    return std::get_if<Kind>(&of_kind);
  }
  // Of a pass that is known to be of that kind.
  template <class Kind>
  const Kind& get() const {
    DR_ASSERT(is<Kind>());
    return *as<Kind>();
  }
  template <class Kind>
  Kind& get() {
    DR_ASSERT(is<Kind>());
    return *as<Kind>();
  }

  std::optional<PassId> lister() const;  // of a scatter
  const FaceSetup* setup() const;        // of a raster
};

// The kind of a pass in schedules and reports: "fragment", "raster compute" and so on.
const char* kind_name(const Pass& pass);

}  // namespace dr::backend
