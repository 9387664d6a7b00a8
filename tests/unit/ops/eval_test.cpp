// SPDX-License-Identifier: Apache-2.0
// Float64 evaluation of the element-wise ops: against the C++ library at random numbers, at the points that the op
// table calls singular, and over the special values of float32.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <random>

#include "tests/catch.h"
#include "tests/unit/ops/support.h"

using namespace dr;
using namespace dr::ops_test;
using ir::kBool;
using ir::kFloat;
using ir::kInt;
using ir::kUint;
using ir::vec;

namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
const double kNan = std::nan("");
constexpr double kIntMin = -2147483648.0, kIntMax = 2147483647.0, kUintMax = 4294967295.0;

using Function1 = double (*)(double);
using Function2 = double (*)(double, double);

const std::map<OpKind, Function1> kUnary{
    {OpKind::Neg, [](double x) { return -x; }},
    {OpKind::Abs, std::fabs},
    {OpKind::Floor, std::floor},
    {OpKind::Ceil, std::ceil},
    {OpKind::Round, std::nearbyint},
    {OpKind::Trunc, std::trunc},
    {OpKind::Fract, [](double x) { return x - std::floor(x); }},
    {OpKind::Sqrt, std::sqrt},
    {OpKind::InverseSqrt, [](double x) { return 1 / std::sqrt(x); }},
    {OpKind::Exp, std::exp},
    {OpKind::Exp2, std::exp2},
    {OpKind::Expm1, std::expm1},
    {OpKind::Log, std::log},
    {OpKind::Log2, std::log2},
    {OpKind::Log1p, std::log1p},
    {OpKind::Sin, std::sin},
    {OpKind::Cos, std::cos},
    {OpKind::Tan, std::tan},
    {OpKind::Asin, std::asin},
    {OpKind::Acos, std::acos},
    {OpKind::Atan, std::atan},
    {OpKind::Sinh, std::sinh},
    {OpKind::Cosh, std::cosh},
    {OpKind::Tanh, std::tanh},
    {OpKind::Sigmoid, [](double x) { return 1 / (1 + std::exp(-x)); }},
    {OpKind::Softplus, [](double x) { return std::log(1 + std::exp(x)); }},
    {OpKind::Erf, std::erf},
    {OpKind::Asinh, std::asinh},
    {OpKind::Acosh, std::acosh},
    {OpKind::Atanh, std::atanh},
};
const std::map<OpKind, Function2> kBinary{
    {OpKind::Add, [](double x, double y) { return x + y; }},
    {OpKind::Sub, [](double x, double y) { return x - y; }},
    {OpKind::Mul, [](double x, double y) { return x * y; }},
    {OpKind::SMul, [](double x, double y) { return x * y; }},
    {OpKind::Div, [](double x, double y) { return x / y; }},
    {OpKind::Mod, [](double x, double y) { return x - y * std::floor(x / y); }},
    {OpKind::Min, std::fmin},
    {OpKind::Max, std::fmax},
    {OpKind::Pow, std::pow},
    {OpKind::Atan2, std::atan2},
};

}  // namespace

TEST_CASE("functions are those of the C++ library, whatever the size of the vector") {
  std::mt19937_64 engine(1);
  const auto draw = [&](const ops::Domain& domain) {
    return std::uniform_real_distribution(domain.low, domain.high)(engine);
  };
  for (const OpKind kind : elementwise_kinds()) {
    const bool unary = kUnary.contains(kind);
    if (!unary && !kBinary.contains(kind)) continue;
    INFO(ir::op_name(kind));
    const ops::OpInfo& info = ops::info(kind);
    for (int size = 1; size <= 4; ++size) {
      std::vector<Value> operands;
      for (const ops::Domain& domain : info.domains) {
        Value& operand = operands.emplace_back(value(vec(size), {}));
        for (int i = 0; i < size * 100; ++i) operand.planes.push_back(draw(domain));
      }
      const Value result = evaluate(kind, operands);
      CHECK(result.type == vec(size));
      REQUIRE(result.planes.size() == operands[0].planes.size());
      for (size_t i = 0; i < result.planes.size(); ++i) {
        const double x = operands[0].planes[i];
        const double expected = unary ? kUnary.at(kind)(x) : kBinary.at(kind)(x, operands[1].planes[i]);
        REQUIRE(result.planes[i] == Approx(expected).epsilon(1e-14).margin(2e-15));
      }
    }
  }
}

TEST_CASE("no NaN or Inf comes of finite operands where a value is defined") {
  const std::vector<double> values = finite_special_values();
  // Where a NaN is the value; where an Inf is: poles, and what is larger than float64 holds.
  const auto may_be_nan = [](OpKind kind, double x, double y) {
    switch (kind) {
      case OpKind::Sqrt:
      case OpKind::InverseSqrt:
      case OpKind::Log:
      case OpKind::Log2: return x < 0;
      case OpKind::Log1p: return x < -1;
      case OpKind::Acosh: return x < 1;
      case OpKind::Atanh: return std::abs(x) > 1;
      case OpKind::Div: return x == 0 && y == 0;
      case OpKind::Pow: return x < 0 && y != std::floor(y);
      default: return false;
    }
  };
  const auto may_be_inf = [](OpKind kind, double x, double y) {
    switch (kind) {
      case OpKind::Exp:
      case OpKind::Exp2:
      case OpKind::Expm1: return x > 700;
      case OpKind::Sinh:
      case OpKind::Cosh: return std::abs(x) > 700;
      case OpKind::InverseSqrt:
      case OpKind::Log:
      case OpKind::Log2: return x == 0;
      case OpKind::Log1p: return x == -1;
      case OpKind::Atanh: return std::abs(x) == 1;
      case OpKind::Div: return y == 0;
      case OpKind::Pow: return (x == 0 && y < 0) || std::abs(y * std::log(std::abs(x))) > 700;
      default: return false;
    }
  };
  const auto check = [&](OpKind kind, double result, double x, double y) {
    if (is_finite(result)) return;
    INFO(ir::op_name(kind) << "(" << x << ", " << y << ") = " << result);
    CHECK((std::isnan(result) ? may_be_nan(kind, x, y) : may_be_inf(kind, x, y)));
  };
  for (const auto& [kind, function] : kUnary) {
    for (const double x : values) check(kind, evaluate(kind, x), x, 0);
  }
  for (const auto& [kind, function] : kBinary) {
    for (const double x : values) {
      for (const double y : values) check(kind, evaluate(kind, x, y), x, y);
    }
  }
  for (const double x : values) {
    for (const double y : values) {
      const std::vector<Value> vectors{value(vec(3), {x, y, x})};
      check(OpKind::Length, evaluate(OpKind::Length, vectors).planes[0], x, y);
      for (const double component : evaluate(OpKind::Normalize, vectors).planes) {
        check(OpKind::Normalize, component, x, y);
        CHECK(std::abs(component) <= 1);
      }
    }
  }
}

TEST_CASE("a NaN comes through every function but the ones that it loses in") {
  for (const auto& [kind, function] : kUnary) {
    INFO(ir::op_name(kind));
    CHECK(std::isnan(evaluate(kind, kNan)));
  }
  for (const auto& [kind, function] : kBinary) {
    INFO(ir::op_name(kind));
    const bool loses = kind == OpKind::Min || kind == OpKind::Max;
    CHECK(std::isnan(evaluate(kind, kNan, 2)) == !loses);
    CHECK(std::isnan(evaluate(kind, 2, kNan)) == !loses);
    CHECK(std::isnan(evaluate(kind, kNan, kNan)));
  }
  CHECK(evaluate(OpKind::Min, kNan, 2) == 2);
  CHECK(evaluate(OpKind::Max, 2, kNan) == 2);
  CHECK(evaluate(OpKind::SMul, 0, kNan) == 0);
  CHECK(evaluate(OpKind::SMul, 0, kInf) == 0);
}

TEST_CASE("half gives the nearest float16, of two as near the even one") {
  // All that are not negative, in order.
  std::vector<double> halves;
  for (int bits = 0; bits < 0x7c00; ++bits) {
    const int exponent = bits >> 10, significand = bits & 0x3ff;
    halves.push_back(exponent == 0 ? std::ldexp(significand, -24) : std::ldexp(significand + 1024, exponent - 25));
  }
  REQUIRE(halves.back() == 65504);
  const auto half = [](double x) {
    REQUIRE(evaluate(OpKind::Half, -x) == -evaluate(OpKind::Half, x));
    return evaluate(OpKind::Half, x);
  };
  for (size_t k = 0; k + 1 < halves.size(); ++k) {
    const double low = halves[k], high = halves[k + 1], middle = 0.5 * (low + high);
    REQUIRE(half(low) == low);
    REQUIRE(half(middle) == (k % 2 == 0 ? low : high));
    REQUIRE(half(std::nextafter(middle, low)) == low);
    REQUIRE(half(std::nextafter(middle, high)) == high);
  }
  for (const double x : {65504.0, 65519.0, 65520.0, 1e30, kInf}) CHECK(half(x) == 65504);
  CHECK(std::isnan(evaluate(OpKind::Half, kNan)));
}

TEST_CASE("tails keep their relative accuracy") {
  for (double x = -700; x <= 30; x += 0.37) {
    CHECK(evaluate(OpKind::Sigmoid, x) == Approx(std::exp(x) / (1 + std::exp(x))).epsilon(1e-14));
    CHECK(evaluate(OpKind::Softplus, x) == Approx(std::log1p(std::exp(x))).epsilon(1e-14));
  }
  CHECK(evaluate(OpKind::Sigmoid, 1e4) == 1);
  CHECK(evaluate(OpKind::Softplus, 1e4) == 1e4);
  CHECK(evaluate(OpKind::Expm1, 1e-20) == 1e-20);
  CHECK(evaluate(OpKind::Log1p, 1e-20) == 1e-20);
  for (const double scale : {1e-300, 1e-30, 1.0, 1e30, 1e300}) {
    const std::vector<Value> v{value(vec(2), {3 * scale, -4 * scale})};
    CHECK(evaluate(OpKind::Length, v).planes[0] == Approx(5 * scale).epsilon(1e-15));
    CHECK(evaluate(OpKind::Normalize, v).planes[1] == Approx(-0.8).epsilon(1e-15));
  }
}

TEST_CASE("remainders stay below what they are of") {
  for (const double x : {-1e-9, -1e-30, 1e-30, 0.0, 5.0, -5.0, 7.5, 1e20, -1e20}) {
    const double part = evaluate(OpKind::Fract, x);
    CHECK(part >= 0);
    CHECK(part < 1);
    for (const double y : {1.0, 3.0, 1e-3, 1e10}) {
      CHECK(evaluate(OpKind::Mod, x, y) >= 0);
      CHECK(evaluate(OpKind::Mod, x, y) < y);
      CHECK(evaluate(OpKind::Mod, x, -y) <= 0);
      CHECK(evaluate(OpKind::Mod, x, -y) > -y);
    }
    CHECK(evaluate(OpKind::Mod, x, 0) == 0);
  }
}

TEST_CASE("values at singular points") {
  CHECK(evaluate(OpKind::Sqrt, 0) == 0);
  CHECK(evaluate(OpKind::InverseSqrt, 0) == kInf);
  CHECK(evaluate(OpKind::Log, 0) == -kInf);
  CHECK(evaluate(OpKind::Log, -0.0) == -kInf);
  CHECK(evaluate(OpKind::Log1p, -1) == -kInf);
  CHECK(evaluate(OpKind::Div, 1, 0) == kInf);
  CHECK(evaluate(OpKind::Asin, 1.5) == std::asin(1.0));
  CHECK(evaluate(OpKind::Acos, -7) == std::acos(-1.0));
  CHECK(evaluate(OpKind::Atan2, 0, 0) == 0);
  CHECK(evaluate(OpKind::Atan2, -0.0, -0.0) == 0);
  CHECK(evaluate(OpKind::Atan2, -0.0, -1) == std::acos(-1.0));
  CHECK(evaluate(OpKind::Pow, 0, 0) == 1);
  CHECK(evaluate(OpKind::Pow, 0, 2) == 0);
  CHECK(evaluate(OpKind::Pow, -0.0, -3) == kInf);
  CHECK(evaluate(OpKind::Pow, -2, 3) == -8);
  CHECK(evaluate(OpKind::Pow, -2, -2) == 0.25);
  CHECK(std::isnan(evaluate(OpKind::Pow, -2, 0.5)));
  CHECK(evaluate(OpKind::Sign, 0) == 0);
  CHECK(evaluate(OpKind::Round, 0.5) == 0);
  CHECK(evaluate(OpKind::Round, 1.5) == 2);
  CHECK(evaluate(OpKind::Round, -2.5) == -2);
  CHECK(evaluate(OpKind::Length, {value(vec(3), {0, 0, 0})}).planes == std::vector<double>{0});
  CHECK(evaluate(OpKind::Normalize, {value(vec(3), {0, 0, 0})}).planes == std::vector<double>{0, 0, 0});
  const auto clamp = [](double x, double low, double high) {
    return evaluate(OpKind::Clamp, {value(kFloat, {x}), value(kFloat, {low}), value(kFloat, {high})}).planes[0];
  };
  CHECK(clamp(2, 0, 1) == 1);
  CHECK(clamp(kNan, 0, 1) == 0);
  CHECK(clamp(0, 1, -1) == -1);
}

TEST_CASE("integers wrap to 32 bits") {
  const auto of_int = [](OpKind kind, double x, double y) {
    return evaluate(kind, {value(kInt, {x}), value(kInt, {y})}).planes[0];
  };
  const auto of_uint = [](OpKind kind, double x, double y) {
    return evaluate(kind, {value(kUint, {x}), value(kUint, {y})}).planes[0];
  };
  CHECK(of_int(OpKind::Add, kIntMax, 1) == kIntMin);
  CHECK(of_int(OpKind::Sub, kIntMin, 1) == kIntMax);
  CHECK(of_int(OpKind::Mul, 65536, 65536) == 0);
  CHECK(of_int(OpKind::Mul, kIntMin, -1) == kIntMin);
  CHECK(of_uint(OpKind::Sub, 0, 1) == kUintMax);
  CHECK(of_uint(OpKind::Mul, kUintMax, kUintMax) == 1);
  CHECK(of_int(OpKind::Div, -7, 2) == -3);
  CHECK(of_int(OpKind::Div, 7, 0) == 0);
  CHECK(of_int(OpKind::Div, kIntMin, -1) == kIntMin);
  CHECK(of_uint(OpKind::Div, kUintMax, 2) == 2147483647);
  CHECK(of_int(OpKind::Mod, -7, 2) == 1);
  CHECK(of_int(OpKind::Mod, 7, -2) == -1);
  CHECK(of_int(OpKind::Mod, -8, 2) == 0);
  CHECK(of_int(OpKind::Mod, 5, 0) == 0);
  CHECK(of_int(OpKind::Mod, kIntMin, -1) == 0);
  CHECK(of_int(OpKind::BitAnd, -1, 255) == 255);
  CHECK(of_int(OpKind::BitOr, kIntMin, 1) == kIntMin + 1);
  CHECK(of_uint(OpKind::BitXor, kUintMax, 1) == kUintMax - 1);
  CHECK(of_int(OpKind::ShiftLeft, 1, 31) == kIntMin);
  CHECK(of_int(OpKind::ShiftLeft, 3, 33) == 6);
  CHECK(of_int(OpKind::ShiftRight, -8, 1) == -4);
  CHECK(of_int(OpKind::ShiftRight, -8, -31) == -4);
  CHECK(of_uint(OpKind::ShiftRight, kUintMax, 28) == 15);
  CHECK(evaluate(OpKind::BitNot, {value(kInt, {0})}).planes[0] == -1);
  CHECK(evaluate(OpKind::BitNot, {value(kUint, {0})}).planes[0] == kUintMax);
  CHECK(evaluate(OpKind::Neg, {value(kInt, {kIntMin})}).planes[0] == kIntMin);
  CHECK(evaluate(OpKind::Neg, {value(kUint, {1})}).planes[0] == kUintMax);
  CHECK(evaluate(OpKind::Abs, {value(kInt, {kIntMin})}).planes[0] == kIntMin);
  CHECK(evaluate(OpKind::Sign, {value(kInt, {-5})}).planes[0] == -1);
  CHECK(evaluate(OpKind::Sign, {value(kUint, {kUintMax})}).planes[0] == 1);
  CHECK(of_int(OpKind::Min, -3, 2) == -3);
  CHECK(of_uint(OpKind::Max, 3, kUintMax) == kUintMax);
}

TEST_CASE("bits are counted, found and turned round") {
  const auto of_int = [](OpKind kind, double x) { return evaluate(kind, {value(kInt, {x})}).planes[0]; };
  const auto of_uint = [](OpKind kind, double x) { return evaluate(kind, {value(kUint, {x})}).planes[0]; };
  CHECK(evaluate(OpKind::BitCount, {value(kUint, {1})}).type == kInt);
  CHECK(of_uint(OpKind::BitCount, kUintMax) == 32);
  CHECK(of_int(OpKind::BitCount, -2) == 31);
  CHECK(of_int(OpKind::BitCount, 0) == 0);
  CHECK(of_uint(OpKind::FindLsb, 40) == 3);
  CHECK(of_int(OpKind::FindLsb, 0) == -1);
  CHECK(of_int(OpKind::FindLsb, kIntMin) == 31);
  CHECK(of_uint(OpKind::FindMsb, kUintMax) == 31);
  CHECK(of_int(OpKind::FindMsb, -1) == -1);
  CHECK(of_int(OpKind::FindMsb, -9) == 3);
  CHECK(of_int(OpKind::FindMsb, 0) == -1);
  CHECK(of_uint(OpKind::BitReverse, 1) == 2147483648.0);
  CHECK(of_int(OpKind::BitReverse, 1) == kIntMin);
  CHECK(of_uint(OpKind::BitReverse, 0x12345678) == 0x1e6a2c48);
}

TEST_CASE("the high half of a product is that of 64 bits") {
  std::mt19937_64 engine(4);
  for (int i = 0; i < 10000; ++i) {
    const auto x = static_cast<uint32_t>(engine() >> (32 + engine() % 31)), y = static_cast<uint32_t>(engine());
    const double of_uint =
        evaluate(OpKind::MulHigh, {value(kUint, {static_cast<double>(x)}), value(kUint, {static_cast<double>(y)})})
            .planes[0];
    REQUIRE(of_uint == static_cast<double>((uint64_t{x} * uint64_t{y}) >> 32));
    const auto p = static_cast<int32_t>(x), q = static_cast<int32_t>(y);
    const double of_int =
        evaluate(OpKind::MulHigh, {value(kInt, {static_cast<double>(p)}), value(kInt, {static_cast<double>(q)})})
            .planes[0];
    REQUIRE(of_int == static_cast<double>((int64_t{p} * int64_t{q}) >> 32));
  }
}

TEST_CASE("bits of floats are those of float32") {
  const auto cast = [](Scalar to, Type from, double x) {
    return evaluate(OpKind::Bitcast, {value(from, {x})}, ints({static_cast<int64_t>(to)})).planes[0];
  };
  CHECK(cast(Scalar::Uint, kFloat, 1) == 0x3f800000);
  CHECK(cast(Scalar::Uint, kFloat, -2) == 0xc0000000);
  CHECK(cast(Scalar::Int, kFloat, -2) == -1073741824);
  CHECK(cast(Scalar::Uint, kFloat, 0.1) == 0x3dcccccd);
  CHECK(cast(Scalar::Uint, kFloat, 1e300) == 0x7f800000);
  CHECK(cast(Scalar::Uint, kFloat, kNan) > 0x7f800000);
  CHECK(cast(Scalar::Float, kUint, 0x40490fdb) == static_cast<double>(3.14159274f));
  CHECK(cast(Scalar::Float, kInt, -1073741824) == -2);
  CHECK(cast(Scalar::Float, kUint, 0x7f800000) == kInf);
  CHECK(std::isnan(cast(Scalar::Float, kInt, 0x7fc00000)));
}

TEST_CASE("integer arithmetic agrees with 64 bits at random") {
  std::mt19937_64 engine(2);
  const std::vector<double> edges{0, 1, -1, 2, kIntMax, kIntMin, kIntMin + 1};
  const auto draw = [&] {
    if (engine() % 3 == 0) return edges[engine() % edges.size()];
    return static_cast<double>(static_cast<int32_t>(engine() >> (32 + engine() % 31)));
  };
  for (int i = 0; i < 10000; ++i) {
    const double x = draw(), y = draw();
    const auto a = static_cast<int64_t>(x), b = static_cast<int64_t>(y);
    const auto of_int = [&](OpKind kind) { return evaluate(kind, {value(kInt, {x}), value(kInt, {y})}).planes[0]; };
    const auto low = [](int64_t wide) { return static_cast<double>(static_cast<int32_t>(wide)); };
    REQUIRE(of_int(OpKind::Add) == low(a + b));
    REQUIRE(of_int(OpKind::Mul) == low(a * b));
    REQUIRE(of_int(OpKind::Div) == (b == 0 ? 0 : low(a / b)));
    const auto floor_mod = [](int64_t p, int64_t q) { return q == 0 ? 0 : ((p % q) + q) % q; };
    REQUIRE(of_int(OpKind::Mod) == low(floor_mod(a, b)));
  }
}

TEST_CASE("conversions saturate") {
  const auto convert = [](Scalar to, Type from, double x) {
    return evaluate(OpKind::Convert, {value(from, {x})}, ints({static_cast<int64_t>(to)})).planes[0];
  };
  CHECK(convert(Scalar::Int, kFloat, -2.9) == -2);
  CHECK(convert(Scalar::Int, kFloat, 1e20) == kIntMax);
  CHECK(convert(Scalar::Int, kFloat, -kInf) == kIntMin);
  CHECK(convert(Scalar::Int, kFloat, kNan) == 0);
  CHECK(convert(Scalar::Uint, kFloat, -5) == 0);
  CHECK(convert(Scalar::Uint, kFloat, -0.5) == 0);
  CHECK(convert(Scalar::Uint, kFloat, 1e20) == kUintMax);
  CHECK(convert(Scalar::Uint, kFloat, kNan) == 0);
  CHECK(convert(Scalar::Bool, kFloat, 0.25) == 1);
  CHECK(convert(Scalar::Bool, kFloat, -0.0) == 0);
  CHECK(convert(Scalar::Bool, kFloat, kNan) == 0);
  CHECK(convert(Scalar::Uint, kInt, -1) == kUintMax);
  CHECK(convert(Scalar::Int, kUint, kUintMax) == -1);
  CHECK(convert(Scalar::Bool, kInt, -7) == 1);
  CHECK(convert(Scalar::Float, kUint, kUintMax) == kUintMax);
  CHECK(convert(Scalar::Float, kBool, 1) == 1);
}

TEST_CASE("comparisons are false with a NaN, but not equal is true") {
  for (const double x : {kNan, 1.0}) {
    CHECK(evaluate(OpKind::Less, x, kNan) == 0);
    CHECK(evaluate(OpKind::LessEqual, x, kNan) == 0);
    CHECK(evaluate(OpKind::Equal, x, kNan) == 0);
    CHECK(evaluate(OpKind::NotEqual, x, kNan) == 1);
  }
  CHECK(evaluate(OpKind::LessEqual, 1, 1) == 1);
  CHECK(evaluate(OpKind::Less, 1, 1) == 0);
}

TEST_CASE("planes of vectors and matrices") {
  const Type mat2x3{Scalar::Float, 3, 2};
  // Two elements: component c of element i is at [2 c + i].
  const Value a = value(vec(3), {1, 2, 3, 4, 5, 6});
  const Value b = value(vec(3), {7, 8, 9, 10, 11, 12});
  const Value matrix = evaluate(OpKind::Compose, {a, b}, ints({3, 2}));
  CHECK(matrix.type == mat2x3);
  CHECK(matrix.planes == std::vector<double>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12});
  CHECK(evaluate(OpKind::Extract, {matrix}, ints({1})).planes == b.planes);
  CHECK(evaluate(OpKind::Extract, {a}, ints({2})).planes == std::vector<double>{5, 6});
  CHECK(evaluate(OpKind::Compose, {value(kInt, {1, 2}), value(kInt, {3, 4})}, ints({2, 1})).planes ==
        std::vector<double>{1, 2, 3, 4});
  CHECK(evaluate(OpKind::Splat, {value(kFloat, {1, 2})}, ints({3})).planes == std::vector<double>{1, 2, 1, 2, 1, 2});
  CHECK(evaluate(OpKind::Dot, {a, b}).planes == std::vector<double>{1 * 7 + 3 * 9 + 5 * 11, 2 * 8 + 4 * 10 + 6 * 12});
  const Value one_condition = evaluate(OpKind::Select, {value(kBool, {1, 0}), a, b});
  CHECK(one_condition.planes == std::vector<double>{1, 8, 3, 10, 5, 12});
  const Value each = evaluate(OpKind::Select, {value(vec(3, Scalar::Bool), {1, 0, 0, 1, 0, 0}), a, b});
  CHECK(each.planes == std::vector<double>{1, 8, 9, 4, 11, 12});
  CHECK(evaluate(OpKind::Add, {matrix, matrix}).planes[11] == 24);
  CHECK(evaluate(OpKind::SMul, {matrix, matrix}).planes[11] == 144);
  CHECK(evaluate(OpKind::Pin, {matrix}).planes == matrix.planes);
}

TEST_CASE("logic") {
  for (const double x : {0.0, 1.0}) {
    for (const double y : {0.0, 1.0}) {
      const std::vector<Value> both{value(kBool, {x}), value(kBool, {y})};
      CHECK(evaluate(OpKind::LogicalAnd, both).planes[0] == (x == 1 && y == 1));
      CHECK(evaluate(OpKind::LogicalOr, both).planes[0] == (x == 1 || y == 1));
    }
    CHECK(evaluate(OpKind::LogicalNot, {value(kBool, {x})}).planes[0] == 1 - x);
  }
}
