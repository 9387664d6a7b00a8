// SPDX-License-Identifier: Apache-2.0
// The graph: what every pass reads and writes. Read this file first.
//
// A *value* is an image: an element type (Type) and an extent (width, height, layers), each a Dim.
// A number is 1x1x1. An *op* makes one or more values from others, element by element unless its entry
// says otherwise. Operands whose extent is the literal 1 on an axis stretch along it; nothing else does.
//
// A graph is pure. Leaves are the only memory: a Leaf op reads what a leaf held when the step began, and
// a step's `updates` say what it holds afterwards. Nothing has an order but the data dependencies; ops of
// a region are listed so that operands come before users.
//
// *Regions* are structured and run once per element of the op's domain (attrs.dims). Inside one, every
// value is taken at the current element: captured values broadcast to the domain, results of inner ops
// have the domain's extent or a smaller one that broadcasts to it. Only element-wise ops, Gather from values
// defined in the root region, and further If/Reduce/Fold ops stand in a region.
// A region ends in `yields`. If, Reduce and Fold say for each result how the yields combine (Yield):
//   Element   one yielded value: If takes the branch's, Fold the last trip's; not allowed in Reduce
//   Sum, Min, Max, ArgMin   one yielded value: Reduce folds it over the trips (0, +inf, -inf, begin-1 when empty)
//   Scatter   two yielded values (index, value), or one that is itself an accumulation: the result is an image of the
//             extent in attrs.dims[3 + 3k ..] (k = running number of Scatter results) that sums the values at the
//             indices. Every element of the domain adds its term, and every trip. The branches of an If choose their
//             form each for itself; one with nothing to add scatters zero to an index out of range. Inside an outer
//             region such a result may only be yielded on as a Scatter; its ValueInfo::accumulation is set.
//
// A Fold is a loop that carries values. It has one or more *sweeps* over one sequence of trips, a region each: the
// first runs through the trips forwards, the second backwards, and so on in turn. A sweep carries *states*: its region
// takes the trip's number, for each earlier sweep the states that it had before that trip, and its own; it yields its
// next ones. What the first yields before them may be a Bool that says that no trip comes after this one, so that the
// trips are those from `begin` on that were run. There are at most as many as the bound says, if there is one. The
// states after the last sweep are the first results, Element each; Sums and Scatters over its trips may follow. A
// program's loops have one sweep; the adjoint of a Fold is one of twice as many. How a later sweep comes by the states
// of an earlier one, by storing or computing them again, is the backend's business.
//   %r = fold %begin, %end, %x ints [64, 1, 1] dims [W, H, 1] yields [element]
//        (%i : int, %s : float[W, H]) { ..; yield %stop, %next }
//
// Floats are IEEE numbers; NaN and Inf propagate. An indexed read out of range is 0, a scatter out of range is
// dropped. Integer division by zero is 0, shifts use the low five bits, conversions saturate: there is no
// undefined behaviour. A pass may assume that ops have no side effects, and may not assume that x - x is 0,
// that x * 0 is 0, or that addition associates. The sign of a zero is not promised: x + 0 may be x.
//
// Ids are dense 32-bit indices, valid for one Graph. Graphs are built by Builder and never changed after.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "compiler/ir/dim.h"
#include "compiler/ir/type.h"
#include "dsl/source/source.h"

namespace dr::ir {

template <class Tag>
struct Id {
  uint32_t index = UINT32_MAX;
  bool valid() const { return index != UINT32_MAX; }
  friend bool operator==(Id, Id) = default;
  friend auto operator<=>(Id, Id) = default;
};
using ValueId = Id<struct ValueTag>;
using OpId = Id<struct OpTag>;
using RegionId = Id<struct RegionTag>;

enum class OpKind : uint8_t {
#define DR_OP(name, text) name,
#include "compiler/ir/op_kinds.def"
#undef DR_OP
};
std::string_view op_name(OpKind kind);
std::optional<OpKind> op_kind(std::string_view name);
std::vector<OpKind> all_op_kinds();

// How a region op's result comes from its yields; see above.
enum class Yield : uint8_t { Element, Sum, Min, Max, ArgMin, Scatter };

// Parameters of an op; which are used is said beside its kind in op_kinds.def.
struct Attrs {
  std::vector<int64_t> ints = {};
  std::vector<double> floats = {};
  std::vector<Dim> dims = {};
  std::vector<Yield> yields = {};  // If, Reduce, Fold: one per result
  std::string text = {};
  friend bool operator==(const Attrs&, const Attrs&) = default;
};

struct ValueInfo {
  Type type;
  Extent extent;
  OpId op;                    // the op that makes it, or invalid for a region parameter
  RegionId region;            // the region whose parameter or op result it is
  uint32_t result_index = 0;  // among the op's results or the region's parameters
  bool accumulation = false;  // a Scatter result inside a region
  std::string name;           // the user's name, or empty
};

struct Op {
  OpKind kind;
  std::vector<ValueId> operands;
  std::vector<ValueId> results;
  std::vector<RegionId> regions;
  Attrs attrs;
  dsl::Span span;
  RegionId parent;
};

struct Region {
  OpId parent;                  // invalid for the root
  std::vector<ValueId> params;  // Reduce: {i}. Fold: see above. Raster: see ops/raster.cpp
  std::vector<OpId> ops;
  std::vector<ValueId> yields;
};

// The memory of a program. `initial` are the components of a value that fills it, empty: bound by the host
// (zero for a State).
struct Leaf {
  enum class Kind : uint8_t { Param, Input, State };
  Kind kind = Kind::Param;
  std::string name;
  Type type;
  Extent extent;
  std::vector<double> initial;
  dsl::Span span;
  // A table that the host makes of another leaf, the faces of a mesh, whenever that one is bound
  // (compiler/topology/topology.h). Empty: the leaf has its data from elsewhere.
  std::string table = {};
  std::string table_of = {};
  bool is_fixed = false;  // the graph is right for the initial value alone: a host may bind no other one
};

struct Output {
  std::string name;
  ValueId value;
};
struct Update {
  uint32_t leaf = 0;  // index into Graph::leaves
  ValueId value;
};

// An entry point: what one run gives and what it changes.
struct Step {
  std::string name;
  std::vector<Output> outputs;
  std::vector<Update> updates;
};

class Graph {
 public:
  std::vector<Leaf> leaves;
  std::vector<Step> steps;

  const ValueInfo& value(ValueId id) const { return values_[id.index]; }
  const Op& op(OpId id) const { return ops_[id.index]; }
  const Region& region(RegionId id) const { return regions_[id.index]; }
  RegionId root() const { return RegionId{0}; }
  size_t value_count() const { return values_.size(); }
  size_t op_count() const { return ops_.size(); }
  size_t region_count() const { return regions_.size(); }
  std::optional<uint32_t> leaf_index(std::string_view name) const;
  std::optional<uint32_t> step_index(std::string_view name) const;

 private:
  friend class Builder;
  std::vector<ValueInfo> values_;
  std::vector<Op> ops_;
  std::vector<Region> regions_{1};
};

// The type and extent of a result.
struct ResultType {
  Type type;
  Extent extent;
  bool accumulation = false;
};

// Appends ops to a graph under construction. It knows no op's meaning: result types are given. Use
// ops::emit (compiler/ops/emit.h), which infers them.
class Builder {
 public:
  Builder() = default;
  explicit Builder(Graph graph) : graph_(std::move(graph)) {}

  // Appends to the current region. Regions of the op must have been built with begin_region/end_region.
  OpId add(OpKind kind, std::vector<ValueId> operands, std::span<const ResultType> results, Attrs attrs = {},
           std::vector<RegionId> regions = {}, dsl::Span span = {});
  // Opens a region with parameters; ops go into it until end_region, which sets what it yields.
  RegionId begin_region(std::span<const ResultType> params);
  void end_region(std::vector<ValueId> yields);
  RegionId current_region() const { return stack_.back(); }
  // Runs `append` with the root as current region: what it appends stands before the ops whose regions are open.
  void at_root(const std::function<void()>& append) {
    std::vector<RegionId> open{RegionId{0}};
    open.swap(stack_);
    append();
    open.swap(stack_);
  }

  // Takes ops out of a region, whose results nothing names any more.
  void remove(RegionId region, const std::function<bool(OpId)>& is_unused) {
    std::erase_if(graph_.regions_[region.index].ops, is_unused);
  }

  // Memory for so many ops, to spare growing.
  void reserve(size_t ops);
  void set_name(ValueId id, std::string name) { graph_.values_[id.index].name = std::move(name); }
  void set_span(const dsl::Span& span) { span_ = span; }  // given to ops added without one
  const Graph& graph() const { return graph_; }
  Graph& graph() { return graph_; }
  const ValueInfo& value(ValueId id) const { return graph_.value(id); }
  Graph finish() && { return std::move(graph_); }

 private:
  Graph graph_;
  std::vector<RegionId> stack_{RegionId{0}};
  dsl::Span span_;
};

// Old value -> new value while a graph is rewritten.
class ValueMap {
 public:
  explicit ValueMap(size_t count) : to_(count) {}
  ValueId operator[](ValueId old) const { return to_[old.index]; }
  void set(ValueId old, ValueId now) { to_[old.index] = now; }
  bool has(ValueId old) const { return old.index < to_.size() && to_[old.index].valid(); }

 private:
  std::vector<ValueId> to_;
};

// Copies one op of `from`, regions and all, to the builder's current region; operands and captures go through
// `map` (those it lacks are an internal error), results are entered in it. Names and spans are kept.
void copy_op(const Graph& from, OpId op, Builder& to, ValueMap& map);

// Values that a region (and regions inside it) uses but does not define, in id order.
std::vector<ValueId> captures(const Graph& graph, RegionId region);
// What an op uses of the region that it stands in, and of those around it: its operands, and what its regions capture.
std::vector<ValueId> needs_of(const Graph& graph, const Op& op);

// Which ops of the root region are needed for these roots (all steps when empty), by OpId index.
std::vector<bool> live_ops(const Graph& graph, std::span<const ValueId> roots);

// Internal error: prints file, line and message to stderr and aborts. For broken invariants only.
[[noreturn]] void internal_error(const char* file, int line, const std::string& message);
#define DR_ICE(message) ::dr::ir::internal_error(__FILE__, __LINE__, (message))
#define DR_ASSERT(condition)                           \
  do {                                                 \
    if (!(condition)) DR_ICE("violated: " #condition); \
  } while (false)

}  // namespace dr::ir
