// SPDX-License-Identifier: Apache-2.0
// The op table: everything the compiler knows about an op stands in its OpInfo, one entry an op, in the
// file of its family. Passes, evaluator and printer walk the table and know no op by name, except the region
// ops, which have files of their own.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "compiler/ir/graph.h"

namespace dr::ops {

// How an op relates its operands' elements to its result's.
enum class Shape : uint8_t {
  Source,       // no image operands; any extent (Leaf, Const, Coord, ...)
  Elementwise,  // result element from the operands' elements at the same place
  Image,        // reads operands at other places, or changes the extent (Gather, Shift, Reduce*, Scatter*, Broadcast)
  Region,       // If, Reduce, Raster
  Gradient,     // Grad, Vjp, Cotangent: gone after differentiate
};

// What a type rule sees.
struct InferInput {
  std::span<const ir::ResultType> operands;
  const ir::Attrs& attrs;
};
// The result types, or what is wrong ("operands differ: vec3 and vec4"), one sentence for the verifier.
using InferResult = std::variant<std::vector<ir::ResultType>, std::string>;

// What a type rule sees that looks further: Leaf at the graph's leaves, region ops into their regions, Const at the
// type written on its result, which nothing else tells.
struct GraphInferInput {
  const ir::Graph& graph;
  std::span<const ir::ValueId> operands;
  std::span<const ir::ResultType> operand_types;
  const ir::Attrs& attrs;
  std::span<const ir::RegionId> regions;
  std::optional<ir::Type> written;
};

// Element-wise evaluation in float64 over a batch of `n` elements. Operand and result planes are component-major:
// component c of element i is at [c * n + i]. Integers and Bools are doubles with integral values; integer
// results must already be wrapped to 32 bits.
struct EvalBatch {
  size_t n = 0;
  std::span<const double* const> operands;
  std::span<const ir::Type> operand_types;
  const ir::Attrs& attrs;
  ir::Type result_type;
  double* result = nullptr;
};

// GLSL of an element-wise op: operand expressions in, an expression out. Operands are names or constants, never
// in need of parentheses; the printer stores each result in a variable of its own.
struct GlslInput {
  std::span<const std::string> operands;
  std::span<const ir::Type> operand_types;
  const ir::Attrs& attrs;
  ir::Type result_type;
};

// What an adjoint rule sees: it emits ops that compute the operands' adjoints from the result's.
struct AdjointInput {
  ir::Builder& builder;
  const ir::Attrs& attrs;
  std::span<const ir::ValueId> operands;  // in the graph under construction
  ir::ValueId result;                     // the op's (only) result
  ir::ValueId adjoint;                    // of the result, same type; its extent stretches to the result's
};
// One adjoint an operand, invalid where none flows (integers). Each has the operand's type; its extent may be the
// result's: the walker sums it down to the operand's.
using AdjointOutput = std::vector<ir::ValueId>;

// A point where tests look closer: components of all operands in order, scalars' worth (a vector op gets it spread).
struct TestPoint {
  std::vector<double> operands;
};
// Range from which random test inputs of operand k are drawn.
struct Domain {
  double low = -3;
  double high = 3;
};

// Where an op reads the operands that are images.
enum class Reads : uint8_t {
  AtElement,       // at the place of its result
  Elsewhere,       // all of them at other places
  FirstElsewhere,  // the first one at other places, at the place of its result the others
  PerFace,         // all of them, but for constants, which are written down
};

// The kind of pass that computes an op.
enum class RunsAs : uint8_t { Map, Reduce, Scatter, Raster };

// What becomes of an op of constants. Integers and Bools fold where floats do not.
enum class Folds : uint8_t {
  Integers,  // devices compute floats within a bound only
  Moves,     // a result is an operand's component, or that with another sign
  Rounds,    // one correctly rounded operation
  Never,     // a barrier to passes
};

// Where the result is surely 0.
enum class ZeroWhere : uint8_t {
  Unknown,
  FirstIs,       // where the first operand is
  AllAre,        // where all operands are
  AFactorIs,     // where an operand is and the other one is a finite constant
  BothSidesAre,  // where the second and the third operand are
  BranchesAre,   // where all regions yield 0
  ItsValueIs,    // a constant
};

// Whether loading the result from memory costs less than computing it beside what uses it.
enum class Recompute : uint8_t { Load, OfConstant, Always };

struct OpInfo {
  ir::OpKind kind;
  Shape shape;
  std::string_view doc;  // one line: meaning, policy at singular points

  // Operations a component that a shader takes for it, in additions.
  int cost = 4;
  bool commutes = false;  // the order of two operands changes no bit of the result
  bool moves = false;     // the result's components are components of the operands
  bool light = false;     // computed anew at another place it costs no more than loading it
  Recompute recompute = Recompute::Load;
  Folds folds = Folds::Integers;
  ZeroWhere zero = ZeroWhere::Unknown;
  // Image and Region ops say both; all others read at the element, in a map.
  std::optional<Reads> reads = std::nullopt;
  std::optional<RunsAs> runs_as = std::nullopt;
  // Why no gradient goes through, where it is not that the result is no float. $ is the op's name.
  std::string_view no_gradient = {};
  bool is_function = false;  // programs call it by its name, of floats

  // The type rule: every op has one of these two; ops::infer calls it.
  InferResult (*infer)(const InferInput&) = nullptr;
  InferResult (*infer_in_graph)(const GraphInferInput&) = nullptr;  // Leaf, Const, If, Reduce, Raster

  // Elementwise. The prelude are GLSL functions that `glsl` calls, strict profile, and before them what they call;
  // vector_prelude their overloads for vectors. prelude_of stands instead of both where they depend on the types.
  void (*eval)(const EvalBatch&) = nullptr;
  std::string (*glsl)(const GlslInput&) = nullptr;
  std::vector<std::string_view> prelude = {};
  std::string_view vector_prelude = {};
  std::vector<std::string_view> (*prelude_of)(const GlslInput&) = nullptr;
  // GLSL's own, where the float profile is `native`, and nothing where `glsl` is taken there too.
  std::optional<std::string> (*native)(const GlslInput&) = nullptr;

  // Elementwise, Image. Not differentiable: the adjoint is zero by definition (integers, comparisons, Detach).
  AdjointOutput (*adjoint)(const AdjointInput&) = nullptr;
  bool differentiable = true;

  // For tests: where random operands come from, one an operand where there are floats; points where values are defined
  // and gradients finite; the strict GLSL's distance from float64 in last places (of the larger operand for Mod, off
  // its jumps).
  std::vector<Domain> domains = {};
  std::vector<TestPoint> singular = {};
  double ulp_bound = 4;
};

// The entry of a kind. Every kind has one; a test walks the table for missing fields.
const OpInfo& info(ir::OpKind kind);

// The GLSL functions that an element-wise op calls for these types, in order. Texts that ops share are equal; a shader
// holds each once.
std::vector<std::string_view> prelude(const OpInfo& info, const GlslInput& input);

// Result types of any op, region ops included (their regions must be in `graph`). `written` is the type that the op's
// result already has, where there is one; a Const has its type from nowhere else. ResultType::accumulation depends on
// where the op is to stand and is left to whoever places it (emit_multi does).
InferResult infer(const ir::Graph& graph, ir::OpKind kind, std::span<const ir::ValueId> operands,
                  const ir::Attrs& attrs, std::span<const ir::RegionId> regions,
                  std::optional<ir::Type> written = std::nullopt);

}  // namespace dr::ops
