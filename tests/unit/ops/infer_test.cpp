// SPDX-License-Identifier: Apache-2.0
// Type rules: what they accept and what they refuse, with the sentence that they say.
#include <string>

#include "compiler/ops/emit.h"
#include "tests/catch.h"

using namespace dr;
using ir::Attrs;
using ir::Builder;
using ir::Dim;
using ir::Extent;
using ir::kBool;
using ir::kFloat;
using ir::kInt;
using ir::kUint;
using ir::OpKind;
using ir::RegionId;
using ir::ResultType;
using ir::Scalar;
using ir::Type;
using ir::ValueId;
using ir::vec;
using ir::Yield;

namespace {

const Dim W = Dim::symbol("W"), H = Dim::symbol("H"), L = Dim::symbol("L"), V = Dim::symbol("V");
const Type kMat3{Scalar::Float, 3, 3};
const Type kMat2x3{Scalar::Float, 3, 2};

ResultType image(Type type, Dim w = 1, Dim h = 1, Dim l = 1) { return {.type = type, .extent = {w, h, l}}; }

Attrs attributes(std::vector<int64_t> ints, std::vector<Dim> dims = {}) {
  Attrs attrs;
  attrs.ints = std::move(ints);
  attrs.dims = std::move(dims);
  return attrs;
}

// "vec3[V]" or the refusal in quotes.
std::string text(const ops::InferResult& inferred) {
  if (const auto* wrong = std::get_if<std::string>(&inferred)) return "'" + *wrong + "'";
  std::string result;
  for (const ResultType& type : std::get<std::vector<ResultType>>(inferred)) {
    result += (result.empty() ? "" : ", ") + type.type.str() + type.extent.str();
  }
  return result;
}

std::string infer(OpKind kind, const std::vector<ResultType>& operands, const Attrs& attrs = {}) {
  return text(ops::info(kind).infer({.operands = operands, .attrs = attrs}));
}

bool refuses(OpKind kind, const std::vector<ResultType>& operands, const Attrs& attrs = {}) {
  return infer(kind, operands, attrs).starts_with("'");
}

}  // namespace

TEST_CASE("arithmetic takes one type and stretches extents of 1") {
  CHECK(infer(OpKind::Add, {image(vec(3), V), image(vec(3))}) == "vec3[V]");
  CHECK(infer(OpKind::Add, {image(kFloat, 1, H), image(kFloat, W, 1, L)}) == "float[W, H, L]");
  CHECK(infer(OpKind::Mul, {image(kInt, 4), image(kInt, 4)}) == "int[4]");
  CHECK(infer(OpKind::Clamp, {image(kUint, W), image(kUint), image(kUint)}) == "uint[W]");
  CHECK(infer(OpKind::Add, {image(vec(3)), image(vec(4))}) == "'operands differ: vec3 and vec4'");
  CHECK(infer(OpKind::Add, {image(kFloat), image(kInt)}) == "'operands differ: float and int'");
  CHECK(infer(OpKind::Mul, {image(vec(3)), image(kFloat)}) == "'operands differ: vec3 and float'");
  CHECK(infer(OpKind::Add, {image(kFloat, W), image(kFloat, V)}) == "'extents do not agree: [W] and [V]'");
  CHECK(infer(OpKind::Add, {image(kFloat, 2), image(kFloat, 3)}) == "'extents do not agree: [2] and [3]'");
  CHECK(infer(OpKind::Add, {image(kBool), image(kBool)}) == "'does not take bool'");
  CHECK(infer(OpKind::Add, {image(kFloat)}) == "'expected 2 operands, found 1'");
  CHECK(infer(OpKind::Neg, {}) == "'expected 1 operands, found 0'");
}

TEST_CASE("matrices take part in little") {
  for (const OpKind kind : {OpKind::Add, OpKind::Sub, OpKind::SMul})
    CHECK(infer(kind, {image(kMat3), image(kMat3, V)}) == "mat3[V]");
  CHECK(infer(OpKind::Neg, {image(kMat2x3)}) == "mat2x3");
  CHECK(infer(OpKind::Select, {image(kBool, V), image(kMat3), image(kMat3)}) == "mat3[V]");
  CHECK(infer(OpKind::Gather, {image(kMat3, V), image(kInt, W)}) == "mat3[W]");
  for (const OpKind kind :
       {OpKind::Mul, OpKind::Div, OpKind::Min, OpKind::Less, OpKind::Equal, OpKind::Dot, OpKind::Pow}) {
    CHECK(refuses(kind, {image(kMat3), image(kMat3)}));
  }
  CHECK(refuses(OpKind::Sqrt, {image(kMat3)}));
  CHECK(refuses(OpKind::Convert, {image(kMat3)}, attributes({1})));
  CHECK(refuses(OpKind::ReduceSum, {image(kMat3, W)}, attributes({1, 0, 0})));
  CHECK(refuses(OpKind::ScatterAdd, {image(kInt, W), image(kMat3, W)}, attributes({}, {V, 1, 1})));
  CHECK(refuses(OpKind::Select, {image(vec(3, Scalar::Bool)), image(kMat3), image(kMat3)}));
}

TEST_CASE("float functions take floats, bits take integers, logic takes bools") {
  CHECK(infer(OpKind::Exp, {image(vec(2), W, H)}) == "vec2[W, H]");
  CHECK(refuses(OpKind::Exp, {image(kInt)}));
  CHECK(refuses(OpKind::Floor, {image(kUint)}));
  CHECK(infer(OpKind::BitAnd, {image(vec(2, Scalar::Uint)), image(vec(2, Scalar::Uint))}) == "uvec2");
  CHECK(refuses(OpKind::BitAnd, {image(kFloat), image(kFloat)}));
  CHECK(refuses(OpKind::ShiftLeft, {image(kUint), image(kInt)}));
  CHECK(infer(OpKind::LogicalNot, {image(kBool, W)}) == "bool[W]");
  CHECK(infer(OpKind::Unlikely, {image(kBool, W)}) == "bool[W]");
  CHECK(refuses(OpKind::LogicalAnd, {image(kInt), image(kInt)}));
}

TEST_CASE("comparisons give bools of the same size") {
  CHECK(infer(OpKind::Less, {image(kFloat, W), image(kFloat)}) == "bool[W]");
  CHECK(infer(OpKind::Equal, {image(vec(3, Scalar::Int)), image(vec(3, Scalar::Int))}) == "bvec3");
  CHECK(infer(OpKind::NotEqual, {image(kBool), image(kBool)}) == "bool");
  CHECK(refuses(OpKind::Less, {image(kBool), image(kBool)}));
}

TEST_CASE("a choice has a scalar condition or one a component") {
  CHECK(infer(OpKind::Select, {image(kBool, W), image(vec(3)), image(vec(3), 1, H)}) == "vec3[W, H]");
  CHECK(infer(OpKind::Select, {image(vec(3, Scalar::Bool)), image(vec(3)), image(vec(3))}) == "vec3");
  CHECK(infer(OpKind::Select, {image(vec(2, Scalar::Bool)), image(vec(3)), image(vec(3))}) ==
        "'the condition of a choice of vec3 cannot be bvec2'");
  CHECK(refuses(OpKind::Select, {image(kInt), image(kFloat), image(kFloat)}));
  CHECK(refuses(OpKind::Select, {image(kBool), image(kFloat), image(kInt)}));
}

TEST_CASE("conversions keep the size") {
  CHECK(infer(OpKind::Convert, {image(vec(3), W)}, attributes({static_cast<int64_t>(Scalar::Int)})) == "ivec3[W]");
  CHECK(infer(OpKind::Convert, {image(kBool)}, attributes({static_cast<int64_t>(Scalar::Float)})) == "float");
  CHECK(refuses(OpKind::Convert, {image(kFloat)}, attributes({4})));
  CHECK(refuses(OpKind::Convert, {image(kFloat)}));
}

TEST_CASE("putting together and taking apart") {
  CHECK(infer(OpKind::Splat, {image(kInt, W)}, attributes({4})) == "ivec4[W]");
  CHECK(refuses(OpKind::Splat, {image(vec(2))}, attributes({4})));
  CHECK(refuses(OpKind::Splat, {image(kFloat)}, attributes({1})));
  CHECK(infer(OpKind::Compose, {image(kFloat, W), image(kFloat, 1, H)}, attributes({2, 1})) == "vec2[W, H]");
  CHECK(infer(OpKind::Compose, {image(vec(3)), image(vec(3))}, attributes({3, 2})) == "mat2x3");
  CHECK(infer(OpKind::Compose, {image(kFloat), image(kInt)}, attributes({2, 1})) ==
        "'a vec2 is made of float, not of int'");
  CHECK(refuses(OpKind::Compose, {image(kFloat)}, attributes({2, 1})));
  CHECK(refuses(OpKind::Compose, {image(vec(2, Scalar::Int)), image(vec(2, Scalar::Int))}, attributes({2, 2})));
  CHECK(infer(OpKind::Extract, {image(vec(3), W)}, attributes({2})) == "float[W]");
  CHECK(infer(OpKind::Extract, {image(kMat2x3)}, attributes({1})) == "vec3");
  CHECK(infer(OpKind::Extract, {image(kMat2x3)}, attributes({2})) == "'a mat2x3 has no part 2'");
  CHECK(refuses(OpKind::Extract, {image(kFloat)}, attributes({0})));
  CHECK(refuses(OpKind::Extract, {image(vec(3))}, attributes({-1})));
}

TEST_CASE("products and norms of vectors") {
  CHECK(infer(OpKind::Dot, {image(vec(3), W), image(vec(3))}) == "float[W]");
  CHECK(infer(OpKind::Length, {image(vec(2), W)}) == "float[W]");
  CHECK(infer(OpKind::Normalize, {image(vec(4))}) == "vec4");
  CHECK(refuses(OpKind::Dot, {image(vec(2, Scalar::Int)), image(vec(2, Scalar::Int))}));
}

TEST_CASE("gather") {
  const Type ivec2 = vec(2, Scalar::Int), ivec3 = vec(3, Scalar::Int);
  CHECK(infer(OpKind::Gather, {image(vec(3), V), image(kInt, W, H)}) == "vec3[W, H]");
  CHECK(infer(OpKind::Gather, {image(kFloat, V, 1, L), image(kInt, W)}) == "float[W, 1, L]");
  CHECK(infer(OpKind::Gather, {image(kFloat, W, H), image(ivec2, V, 1, L)}) == "float[V, 1, L]");
  CHECK(infer(OpKind::Gather, {image(kFloat, W, H, L), image(ivec3, V)}) == "float[V]");
  CHECK(infer(OpKind::Gather, {image(kFloat, W, H), image(kInt, V)}) ==
        "'an int does not name a place of an image of height H'");
  CHECK(infer(OpKind::Gather, {image(kFloat, W, H, 2), image(ivec2, V, 1, 3)}) ==
        "'layers do not agree: [W, H, 2] and [V, 1, 3]'");
  CHECK(refuses(OpKind::Gather, {image(kFloat, W), image(kUint, V)}));
  CHECK(refuses(OpKind::Gather, {image(kFloat, W), image(vec(4, Scalar::Int), V)}));
}

TEST_CASE("scatter") {
  const Type ivec2 = vec(2, Scalar::Int), ivec3 = vec(3, Scalar::Int);
  CHECK(infer(OpKind::ScatterAdd, {image(kInt, W, H), image(vec(3))}, attributes({}, {V, 1, 1})) == "vec3[V]");
  CHECK(infer(OpKind::ScatterAdd, {image(ivec2, W), image(kInt, W, 1, L)}, attributes({}, {V, V, L})) ==
        "int[V, V, L]");
  CHECK(infer(OpKind::ScatterAdd, {image(ivec2, W, 1, L), image(kFloat)}, attributes({}, {V, V, 1})) == "float[V, V]");
  CHECK(infer(OpKind::ScatterAdd, {image(ivec3, W), image(kFloat)}, attributes({}, {V, V, L})) == "float[V, V, L]");
  CHECK(infer(OpKind::ScatterAdd, {image(ivec2, W), image(kFloat)}, attributes({}, {V, V, L})) ==
        "'elements of 1 layers do not each have one of L'");
  CHECK(refuses(OpKind::ScatterAdd, {image(kInt, W), image(kFloat)}, attributes({}, {V, H, 1})));
  CHECK(refuses(OpKind::ScatterAdd, {image(kInt, W), image(kBool)}, attributes({}, {V, 1, 1})));
  CHECK(refuses(OpKind::ScatterAdd, {image(kInt, W), image(kFloat, V)}, attributes({}, {V, 1, 1})));
  CHECK(refuses(OpKind::ScatterAdd, {image(kInt, W), image(kFloat)}));
  CHECK(infer(OpKind::ScatterMax, {image(kInt, W), image(kInt)}, attributes({}, {V, 1, 1})) == "int[V]");
  CHECK(refuses(OpKind::ScatterMax, {image(kInt, W), image(kFloat)}, attributes({}, {V, 1, 1})));
  CHECK(refuses(OpKind::ScatterMax, {image(kInt, W), image(kUint)}, attributes({}, {V, 1, 1})));
}

TEST_CASE("shift, reductions and broadcast") {
  CHECK(infer(OpKind::Shift, {image(kBool, W, H)}, attributes({1, -1})) == "bool[W, H]");
  CHECK(infer(OpKind::ReduceSum, {image(vec(3), W, H, L)}, attributes({1, 0, 1})) == "vec3[1, H]");
  CHECK(infer(OpKind::ReduceMin, {image(kInt, W)}, attributes({1, 1, 1})) == "int");
  CHECK(refuses(OpKind::ReduceMax, {image(kBool, W)}, attributes({1, 1, 1})));
  CHECK(refuses(OpKind::ReduceMax, {image(kFloat, W)}, attributes({1, 2, 1})));
  CHECK(infer(OpKind::Broadcast, {image(kMat3, 1, H)}, attributes({}, {W, H, L})) == "mat3[W, H, L]");
  CHECK(infer(OpKind::Broadcast, {image(kFloat, V)}, attributes({}, {W, 1, 1})) ==
        "'extent [V] does not stretch to [W]'");
  CHECK(refuses(OpKind::Broadcast, {image(kFloat, 3)}, attributes({}, {1, 1, 1})));
}

TEST_CASE("sources") {
  Builder b;
  ir::Leaf memory;
  memory.name = "photo";
  memory.type = vec(3);
  memory.extent = {W, H, 1};
  b.graph().leaves.push_back(memory);
  Attrs name;
  name.text = "photo";
  CHECK(text(ops::infer(b.graph(), OpKind::Leaf, {}, name, {})) == "vec3[W, H]");
  name.text = "other";
  CHECK(text(ops::infer(b.graph(), OpKind::Leaf, {}, name, {})) == "'there is no leaf 'other''");

  Attrs components;
  components.floats = {1, 2};
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, vec(2))) == "vec2");
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, vec(2, Scalar::Uint))) == "uvec2");
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, vec(3))) ==
        "'a vec3 does not have 2 components'");
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, vec(2, Scalar::Bool))) ==
        "'a component is no bool'");
  components.floats = {0.5};
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, kInt)) == "'a component is no int'");
  components.floats = {-1};
  CHECK(text(ops::infer(b.graph(), OpKind::Const, {}, components, {}, kUint)) == "'a component is no uint'");

  CHECK(infer(OpKind::Coord, {}, attributes({2}, {W, H, L})) == "int[W, H, L]");
  CHECK(refuses(OpKind::Coord, {}, attributes({3}, {W, H, L})));
  CHECK(infer(OpKind::DimValue, {}, attributes({}, {W})) == "int");
  CHECK(infer(OpKind::StepIndex, {}) == "int");
}

TEST_CASE("gradients have the types of their targets") {
  CHECK(infer(OpKind::Grad, {image(kFloat, W), image(kFloat), image(vec(3), V), image(kInt)}) == "vec3[V], int");
  CHECK(refuses(OpKind::Grad, {image(kFloat, W), image(kFloat)}));
  CHECK(refuses(OpKind::Grad, {image(kInt), image(kInt), image(kFloat)}));
  CHECK(refuses(OpKind::Grad, {image(kFloat), image(kFloat, W), image(kFloat)}));
  CHECK(infer(OpKind::Detach, {image(kMat3, W)}) == "mat3[W]");
  CHECK(infer(OpKind::Pin, {image(kBool, W)}) == "bool[W]");
}

namespace {

// Values to build regions with: constants of extent 1, and images by Coord and Convert.
struct Regions {
  Builder b;
  ValueId number(Type type, double x = 1) { return ops::constant(b, type, x); }
  ValueId along(const Extent& extent) { return ops::coord(b, 0, extent); }
  RegionId region(const std::vector<ValueId>& yields, const std::vector<ResultType>& params = {}) {
    const RegionId id = b.begin_region(params);
    b.end_region(yields);
    return id;
  }
  std::string infer(OpKind kind, const std::vector<ValueId>& operands, const std::vector<RegionId>& regions,
                    const std::vector<Dim>& dims, const std::vector<Yield>& yields,
                    const std::vector<int64_t>& numbers = {}) {
    Attrs attrs = attributes(numbers, dims);
    attrs.yields = yields;
    return text(ops::infer(b.graph(), kind, operands, attrs, regions));
  }
};

}  // namespace

TEST_CASE("if") {
  Regions r;
  const ValueId yes = r.number(kBool), x = r.number(vec(3)), y = r.number(kFloat), i = r.number(kInt);
  const ValueId row = r.along({W, 1, 1}), column = r.along({1, H, 1});
  const auto branch = [&](const std::vector<ValueId>& yields) { return r.region(yields); };
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({x})}, {W, H, 1}, {Yield::Element}) == "vec3[W, H]");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row, x}), branch({column, x})}, {W, H, 1},
                {Yield::Element, Yield::Element}) == "int[W, H], vec3[W, H]");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({y})}, {W, H, 1}, {Yield::Element}) ==
        "'branches differ: vec3 and float'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({})}, {W, H, 1}, {Yield::Element}) ==
        "'a region yields too little'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({x, x})}, {W, H, 1}, {Yield::Element}) ==
        "'a region yields too much'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row}), branch({row})}, {1, H, 1}, {Yield::Element}) ==
        "'int[W] does not stretch to the domain, [1, H]'");
  CHECK(r.infer(OpKind::If, {i}, {branch({x}), branch({x})}, {W, H, 1}, {Yield::Element}) ==
        "'a condition is bool, not int'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x})}, {W, H, 1}, {Yield::Element}) ==
        "'expected a condition and two regions'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({x})}, {W, H, 1}, {Yield::Sum}) ==
        "'an if yields elements and scatters'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({x}), branch({x})}, {W, H}, {Yield::Element}) ==
        "'expected 3 dims, found 2'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row, x, y}), branch({i, x, y})}, {W, H, 1, V, 1, 1},
                {Yield::Scatter, Yield::Element}) == "vec3[V], float[W, H]");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row, x}), branch({i, x})}, {W, H, 1}, {Yield::Scatter}) ==
        "'expected 6 dims, found 3'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row, x}), branch({i, x})}, {W, H, 1, V, V, 1}, {Yield::Scatter}) ==
        "'an int does not name a place of an image of height V'");
  CHECK(r.infer(OpKind::If, {yes}, {branch({row, x}), branch({i, x})}, {W, H, 1, V, 1, L}, {Yield::Scatter}) ==
        "'elements of 1 layers do not each have one of L'");
}

TEST_CASE("reduce") {
  Regions r;
  const ValueId zero = r.number(kInt, 0), n = r.along({W, 1, 1}), x = r.number(vec(3)), y = r.number(kFloat),
                yes = r.number(kBool);
  const auto body = [&](const std::vector<ValueId>& yields) { return r.region(yields, {image(kInt)}); };
  const std::vector<Dim> domain{W, H, 1};
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({x, y, y, n})}, domain,
                {Yield::Sum, Yield::Min, Yield::ArgMin, Yield::Max},
                {-1}) == "vec3[W, H], float[W, H], int[W, H], int[W, H]");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({n, y})}, {W, H, 1, V, 1, 1}, {Yield::Scatter}, {8}) == "float[V]");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({y})}, domain, {Yield::Element}, {-1}) ==
        "'a reduce combines what its trips yield'");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({yes})}, domain, {Yield::Sum}, {-1}) == "'cannot sum bool'");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({x})}, domain, {Yield::ArgMin}, {-1}) ==
        "'argmin takes a scalar, not vec3'");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({y})}, domain, {Yield::Sum}) == "'expected 1 ints, found 0'");
  CHECK(r.infer(OpKind::Reduce, {zero, y}, {body({y})}, domain, {Yield::Sum}, {-1}) == "'a bound is int, not float'");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {body({y})}, {1, H, 1}, {Yield::Sum}, {-1}) ==
        "'int[W] does not stretch to the domain, [1, H]'");
  CHECK(r.infer(OpKind::Reduce, {zero, n}, {r.region({y})}, domain, {Yield::Sum}, {-1}) ==
        "'the region has one parameter, int'");
}

TEST_CASE("fold") {
  Regions r;
  const ValueId zero = r.number(kInt, 0), n = r.along({W, 1, 1}), x = r.number(vec(3)), y = r.number(kFloat),
                yes = r.number(kBool);
  const std::vector<ResultType> both{image(kInt), image(vec(3)), image(kFloat)};
  const auto body = [&](const std::vector<ValueId>& yields) { return r.region(yields, both); };
  const std::vector<Dim> domain{W, H, 1};
  const std::vector<Yield> states{Yield::Element, Yield::Element};
  const std::vector<ValueId> operands{zero, n, x, y};
  CHECK(r.infer(OpKind::Fold, operands, {body({x, y})}, domain, states, {-1, 0, 2}) == "vec3[W, H], float[W, H]");
  CHECK(r.infer(OpKind::Fold, operands, {body({yes, x, y, y})}, domain, {Yield::Element, Yield::Element, Yield::Sum},
                {8, 1, 2}) == "vec3[W, H], float[W, H], float[W, H]");
  const RegionId back = r.region({y, n, y}, {image(kInt), image(vec(3)), image(kFloat), image(kFloat)});
  CHECK(r.infer(OpKind::Fold, {zero, n, x, y, y}, {body({x, y}), back}, {W, H, 1, V, 1, 1},
                {Yield::Element, Yield::Scatter}, {-1, 0, 2, 1}) == "float[W, H], float[V]");
  CHECK(r.infer(OpKind::Fold, operands, {body({x, x})}, domain, states, {-1, 0, 2}) ==
        "'a state differs: float and vec3'");
  CHECK(r.infer(OpKind::Fold, operands, {body({y, x, y})}, domain, states, {-1, 1, 2}) ==
        "'what ends a fold is bool, not float'");
  CHECK(r.infer(OpKind::Fold, operands, {body({x})}, domain, states, {-1, 0, 2}) == "'a region yields too little'");
  CHECK(r.infer(OpKind::Fold, {zero, n, x}, {body({x, y})}, domain, states, {-1, 0, 2}) ==
        "'expected two bounds and what each state starts with'");
  CHECK(r.infer(OpKind::Fold, operands, {body({x, y})}, domain, {Yield::Element, Yield::Sum}, {-1, 0, 2}) ==
        "'the states after the last sweep are the first results, element each'");
  CHECK(r.infer(OpKind::Fold, operands, {body({x, y, y})}, domain, {Yield::Element, Yield::Element, Yield::Min},
                {-1, 0, 2}) == "'results of a fold that are no states are sums and scatters'");
  CHECK(r.infer(OpKind::Fold, operands, {r.region({x, y}, {image(kInt)})}, domain, states, {-1, 0, 2}) ==
        "'a region has as parameters the trip and the states of its sweep and of those before it'");
}

TEST_CASE("an accumulation is passed on") {
  Regions r;
  const ValueId zero = r.number(kInt, 0), y = r.number(kFloat), yes = r.number(kBool);
  const RegionId outer = r.b.begin_region(std::vector<ResultType>{image(kInt)});
  const RegionId then_region = r.region({zero, y}), else_region = r.region({zero, y});
  Attrs attrs = attributes({}, {W, H, 1, V, 1, 1});
  attrs.yields = {Yield::Scatter};
  const ValueId inner = ops::emit(r.b, OpKind::If, {yes}, attrs, {then_region, else_region});
  CHECK(r.b.value(inner).accumulation);
  r.b.end_region({inner});
  attrs.ints = {-1};
  const std::vector<ValueId> bounds{zero, zero};
  const std::vector<RegionId> regions{outer};
  CHECK(text(ops::infer(r.b.graph(), OpKind::Reduce, bounds, attrs, regions)) == "float[V]");
  const ValueId result = ops::emit(r.b, OpKind::Reduce, bounds, attrs, regions);
  CHECK_FALSE(r.b.value(result).accumulation);
}

TEST_CASE("raster") {
  Regions r;
  const Dim F = Dim::symbol("F");
  const ValueId corner = r.number(vec(2)), no = r.number(kBool, 0), field = r.along({F, 1, 1}),
                depth = r.number(kFloat), tag = r.number(kInt);
  const std::vector<ResultType> params{image(kInt), image(vec(2))};
  const auto regions = [&](const std::vector<ResultType>& p) {
    return std::vector<RegionId>{r.region({depth}, p), r.region({no}, p), r.region({tag}, p)};
  };
  const std::vector<Dim> dims{W, H, L, F};
  const std::vector<ValueId> operands{field, corner, corner, corner, no};
  CHECK(r.infer(OpKind::Raster, operands, regions(params), dims, {}, {2, 1, 3}) ==
        "int[W, H, L], int[W, H, L], int[W, H, L], int[W, H, L]");
  CHECK(r.infer(OpKind::Raster, operands, regions(params), dims, {}, {1, 1, 6}) ==
        "'expected fields, corners and cull, found 5 operands'");
  CHECK(r.infer(OpKind::Raster, operands, regions(params), dims, {}, {1, 1, 4}) ==
        "'a hull is one triangle or two, of 3 or 6 corners'");
  CHECK(r.infer(OpKind::Raster, operands, regions({image(kFloat), image(vec(2))}), dims, {}, {1, 1, 3}) ==
        "'a parameter is float and should be int'");
  CHECK(r.infer(OpKind::Raster, operands, regions(params), {W, H, L, V}, {}, {1, 1, 3}) ==
        "'int[F] does not stretch to the faces, [V, 1, L]'");
  CHECK(r.infer(OpKind::Raster, operands,
                {r.region({depth}, params), r.region({depth}, params), r.region({tag}, params)}, dims, {},
                {1, 1, 3}) == "'expected a region to yield bool, found float'");
}
