// SPDX-License-Identifier: Apache-2.0
// Putting vectors and matrices together and taking them apart; the products and norms of vectors.
#include <algorithm>

#include "compiler/ops/families.h"
#include "compiler/ops/prelude.h"
#include "compiler/ops/rules.h"

namespace dr::ops {

using namespace rules;

namespace {

bool is_size(int64_t n) { return n >= 2 && n <= 4; }

InferResult infer_splat(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  const Type type = in.operands[0].type;
  if (!type.is_scalar()) return "a " + type.str() + " does not fill a vector";
  if (!is_size(in.attrs.ints[0])) return "vectors have 2 to 4 components";
  return one(ir::vec(static_cast<int>(in.attrs.ints[0]), type.scalar), in.operands[0].extent);
}

InferResult infer_compose(const InferInput& in) {
  if (std::string wrong = expect_ints(in.attrs, 2); !wrong.empty()) return wrong;
  const int64_t rows = in.attrs.ints[0], cols = in.attrs.ints[1];
  if (!is_size(rows) || (cols != 1 && !is_size(cols)))
    return "vectors have 2 to 4 components, matrices as many columns of them";
  const bool is_matrix = cols > 1;
  if (std::string wrong = expect_operands(in, static_cast<size_t>(is_matrix ? cols : rows)); !wrong.empty())
    return wrong;
  const Scalar scalar = is_matrix ? Scalar::Float : in.operands[0].type.scalar;
  const Type part{scalar, static_cast<uint8_t>(is_matrix ? rows : 1), 1};
  const Type type{scalar, static_cast<uint8_t>(rows), static_cast<uint8_t>(cols)};
  for (const ResultType& operand : in.operands) {
    if (operand.type != part) return "a " + type.str() + " is made of " + part.str() + ", not of " + operand.type.str();
  }
  auto extent = common_extent(in.operands);
  if (auto* wrong = std::get_if<std::string>(&extent)) return std::move(*wrong);
  return one(type, std::get<Extent>(extent));
}

InferResult infer_extract(const InferInput& in) {
  if (std::string wrong = expect_operands(in, 1); !wrong.empty()) return wrong;
  if (std::string wrong = expect_ints(in.attrs, 1); !wrong.empty()) return wrong;
  const Type type = in.operands[0].type;
  if (type.is_scalar()) return "a " + type.str() + " has no components";
  const int64_t parts = type.is_matrix() ? type.cols : type.rows;
  if (in.attrs.ints[0] < 0 || in.attrs.ints[0] >= parts)
    return "a " + type.str() + " has no part " + std::to_string(in.attrs.ints[0]);
  return one(type.is_matrix() ? type.column() : type.element(), in.operands[0].extent);
}

InferResult infer_dot(const InferInput& in) {
  InferResult same = same_types(in, 2, kFloats);
  if (auto* types = std::get_if<std::vector<ResultType>>(&same)) (*types)[0].type = ir::kFloat;
  return same;
}

InferResult infer_length(const InferInput& in) {
  InferResult same = same_types(in, 1, kFloats);
  if (auto* types = std::get_if<std::vector<ResultType>>(&same)) (*types)[0].type = ir::kFloat;
  return same;
}

// Copies the operands' planes one behind the other, over and over, from plane `first` on.
void eval_planes(const EvalBatch& e, size_t first) {
  const auto planes = static_cast<size_t>(e.result_type.components());
  size_t plane = 0;
  while (plane < planes) {
    for (size_t k = 0; k < e.operands.size() && plane < planes; ++k) {
      const size_t count = std::min(static_cast<size_t>(e.operand_types[k].components()) - first, planes - plane);
      std::copy_n(e.operands[k] + first * e.n, count * e.n, e.result + plane * e.n);
      plane += count;
    }
  }
}

void eval_dot(const EvalBatch& e) {
  const auto planes = static_cast<size_t>(e.operand_types[0].components());
  std::fill_n(e.result, e.n, 0.0);
  for (size_t c = 0; c < planes; ++c) {
    for (size_t i = 0; i < e.n; ++i) e.result[i] += e.operands[0][c * e.n + i] * e.operands[1][c * e.n + i];
  }
}

// A vector as scaled * 2^exponent with squares in range.
struct Scaled {
  double length = 0;  // of the scaled vector
  int exponent = 0;
};
double scaled(double x, int exponent) { return exponent == 0 ? x : std::scalbn(x, exponent); }

Scaled scaled_length(const EvalBatch& e, size_t i) {
  const auto planes = static_cast<size_t>(e.operand_types[0].components());
  double largest = 0;
  for (size_t c = 0; c < planes; ++c) largest = std::max(largest, std::abs(e.operands[0][c * e.n + i]));
  Scaled result;
  // Squares of what lies between neither overflow nor vanish, and scaling by powers of two changes no bit.
  constexpr double kSmall = 0x1p-400, kLarge = 0x1p400;
  if (largest > 0 && std::isfinite(largest) && (largest < kSmall || largest > kLarge))
    result.exponent = std::ilogb(largest);
  double sum = 0;
  for (size_t c = 0; c < planes; ++c) {
    const double x = scaled(e.operands[0][c * e.n + i], -result.exponent);
    sum += x * x;
  }
  result.length = std::sqrt(sum);
  return result;
}

void eval_length(const EvalBatch& e) {
  for (size_t i = 0; i < e.n; ++i) {
    const Scaled found = scaled_length(e, i);
    e.result[i] = scaled(found.length, found.exponent);
  }
}

void eval_normalize(const EvalBatch& e) {
  const auto planes = static_cast<size_t>(e.result_type.components());
  for (size_t i = 0; i < e.n; ++i) {
    const Scaled found = scaled_length(e, i);
    for (size_t c = 0; c < planes; ++c) {
      const double x = scaled(e.operands[0][c * e.n + i], -found.exponent);
      e.result[c * e.n + i] = found.length == 0 ? 0.0 : x / found.length;
    }
  }
}

AdjointOutput compose_adjoint(const AdjointInput& in) {
  AdjointOutput adjoints;
  for (size_t k = 0; k < in.operands.size(); ++k)
    adjoints.push_back(extract(in.builder, in.adjoint, static_cast<int>(k)));
  return adjoints;
}

AdjointOutput extract_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const Type type = b.value(in.operands[0]).type;
  const auto parts = static_cast<size_t>(type.is_matrix() ? type.cols : type.rows);
  std::vector<ValueId> operands(parts, zero_like(b, in.adjoint));
  operands[static_cast<size_t>(in.attrs.ints[0])] = in.adjoint;
  return {compose(b, operands, type)};
}

AdjointOutput dot_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  return {smul(b, in.adjoint, in.operands[1]), smul(b, in.adjoint, in.operands[0])};
}

// (g - n (n . g)) / |v|, and 0 at v = 0. The inner product is made of strong-zero products: a g of 0 gives 0 whatever n
// is.
AdjointOutput normalize_adjoint(const AdjointInput& in) {
  Builder& b = in.builder;
  const ValueId n = in.result;
  const ValueId along = emit(b, OpKind::Dot, {smul(b, in.adjoint, n), like(b, n, 1.0)});
  const ValueId across = sub(b, in.adjoint, smul(b, along, n));
  // Divided, not multiplied by 1 / |v|: that overflows for the shortest vectors, where `across` is as good as 0.
  const ValueId length = apply(b, OpKind::Length, in.operands[0]);
  const ValueId none = apply(b, OpKind::Equal, length, zero_like(b, length));
  // By 1 where the length is NaN, as `across` is then but for a g of 0. What is dropped must not depend on g: the
  // gradient is linear in it, and a forward derivative is its transpose.
  const ValueId some = apply(b, OpKind::Less, zero_like(b, length), length);
  const ValueId divisor = splat(b, select(b, some, length, like(b, length, 1.0)), b.value(n).type.rows);
  return {drop_where(b, none, div(b, across, divisor))};
}

}  // namespace

std::vector<OpInfo> vector_ops() {
  return {
      {.kind = OpKind::Splat,
       .shape = Shape::Elementwise,
       .doc = "A vector whose components are all x.",
       .cost = 0,
       .moves = true,
       .light = true,
       .recompute = Recompute::Always,
       .folds = Folds::Moves,
       .zero = ZeroWhere::FirstIs,
       .infer = infer_splat,
       .eval = [](const EvalBatch& e) { eval_planes(e, 0); },
       .glsl = [](const GlslInput& in) { return call(in.result_type.str(), in); },
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {emit(in.builder, OpKind::Dot, {in.adjoint, like(in.builder, in.adjoint, 1.0)})};
       },
       .domains = {{-3, 3}},
       .singular = {{{0}}},
       .ulp_bound = 0},
      {.kind = OpKind::Compose,
       .shape = Shape::Elementwise,
       .doc = "A vector of scalars, a matrix of columns.",
       .cost = 0,
       .moves = true,
       .light = true,
       .recompute = Recompute::Always,
       .folds = Folds::Moves,
       .zero = ZeroWhere::AllAre,
       .infer = infer_compose,
       .eval = [](const EvalBatch& e) { eval_planes(e, 0); },
       .glsl = [](const GlslInput& in) { return call(in.result_type.str(), in); },
       .adjoint = compose_adjoint,
       .domains = {{-3, 3}, {-3, 3}, {-3, 3}, {-3, 3}},
       .ulp_bound = 0},
      {.kind = OpKind::Extract,
       .shape = Shape::Elementwise,
       .doc = "A component of a vector, a column of a matrix.",
       .cost = 0,
       .moves = true,
       .light = true,
       .recompute = Recompute::Always,
       .folds = Folds::Moves,
       .zero = ZeroWhere::FirstIs,
       .infer = infer_extract,
       .eval =
           [](const EvalBatch& e) {
             const auto index = static_cast<size_t>(e.attrs.ints[0]);
             eval_planes(e, e.operand_types[0].is_matrix() ? index * e.operand_types[0].rows : index);
           },
       .glsl =
           [](const GlslInput& in) {
             const int64_t index = in.attrs.ints[0];
             if (in.operand_types[0].is_matrix()) return in.operands[0] + "[" + std::to_string(index) + "]";
             return in.operands[0] + "." + "xyzw"[index];
           },
       .adjoint = extract_adjoint,
       .domains = {{-3, 3}},
       .ulp_bound = 0},
      {.kind = OpKind::Dot,
       .shape = Shape::Elementwise,
       .doc = "Inner product, summed in the order of the components (vec4: in pairs).",
       .cost = 2,
       .zero = ZeroWhere::AFactorIs,
       .infer = infer_dot,
       .eval = eval_dot,
       .glsl = function<"dr_dot">,
       .prelude = {glsl::kDot},
       .native = [](const GlslInput& in) -> std::optional<std::string> {
         if (in.operand_types[0].is_scalar()) return std::nullopt;
         return "dot(" + in.operands[0] + ", " + in.operands[1] + ")";
       },
       .adjoint = dot_adjoint,
       .domains = {{0.1, 3}, {0.1, 3}},  // without cancellation
       .singular = {{{0, 0}}, {{0, 1}}},
       .ulp_bound = 4},
      {.kind = OpKind::Length,
       .shape = Shape::Elementwise,
       .doc = "Length, scaled so that nothing overflows on the way. Derivative 0 at 0.",
       .infer = infer_length,
       .eval = eval_length,
       .glsl = function<"dr_length">,
       .prelude = {glsl::kDot, glsl::kLargest, glsl::kLength},
       .adjoint = [](const AdjointInput& in) -> AdjointOutput {
         return {smul(in.builder, in.adjoint, apply(in.builder, OpKind::Normalize, in.operands[0]))};
       },
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{1e-30}}, {{1e30}}},
       .ulp_bound = 4},
      {.kind = OpKind::Normalize,
       .shape = Shape::Elementwise,
       .doc = "The vector of length 1 in x's direction. Value and derivative 0 at 0.",
       .infer = component_wise<1, kFloats>,
       .eval = eval_normalize,
       .glsl = function<"dr_normalize">,
       .prelude = {glsl::kDot, glsl::kLargest, glsl::kNormalize},
       .adjoint = normalize_adjoint,
       .domains = {{-3, 3}},
       .singular = {{{0}}, {{1e-30}}, {{1e30}}},
       .ulp_bound = 6},
  };
}

}  // namespace dr::ops
