// SPDX-License-Identifier: Apache-2.0
// What Vulkan promises of the built-ins that the float profile `native` uses (the table of precision in its appendix on
// SPIR-V), and what follows for what we make of them. n last places are a relative error of n 2^-23 at most, and one of
// r 2^-23 is 2r last places at most: a factor may take a number to the lower end of its binade.
#include <limits>

#include "tests/device/accuracy/table.h"

namespace dr::accuracy {

namespace {

using Fn = std::function<ValueId(Builder&, const Values&, ValueId)>;

ValueId number(Builder& b, double x) { return ops::constant(b, kFloat, x); }
ValueId times(Builder& b, ValueId x, ValueId y) { return ops::mul(b, x, y); }
ValueId apply(Builder& b, OpKind kind, ValueId x) { return ops::emit(b, kind, {x}); }

Fn constant(double x) {
  return [x](Builder& b, const Values&, ValueId) { return number(b, x); };
}
// a + k |x|
Fn line(double a, double k) {
  return [a, k](Builder& b, const Values& xs, ValueId) {
    return ops::add(b, number(b, a), times(b, number(b, k), abs_of(b, xs[0])));
  };
}
std::string text_of(double x) { return std::to_string(static_cast<int>(x)); }

Promise at_most(double places, const std::string& why, Scale scale = {}, const std::string& scale_text = {}) {
  return {constant(places), text_of(places), why, std::move(scale), scale_text};
}
Promise growing(double a, double k, const std::string& why, Scale scale = {}, const std::string& scale_text = {}) {
  return {line(a, k), text_of(a) + " + " + text_of(k) + " \\|x\\|", why, std::move(scale), scale_text};
}
Promise nothing(const std::string& why) { return {constant(std::numeric_limits<double>::infinity()), "none", why}; }

const Scale kOne = [](Builder& b, const Values&, ValueId) { return one(b); };
const Scale kAdjoint = [](Builder& b, const Values&, ValueId w) { return abs_of(b, w); };

// Where [1/2, 2] is `yes`.
ValueId near_one(Builder& b, ValueId x, ValueId yes, ValueId no) {
  const ValueId above = ops::emit(b, OpKind::LessEqual, {number(b, 0.5), x});
  const ValueId below = ops::emit(b, OpKind::LessEqual, {x, number(b, 2)});
  return ops::emit(b, OpKind::Select, {ops::emit(b, OpKind::LogicalAnd, {above, below}), yes, no});
}

ValueId tan_square(Builder& b, ValueId x) {
  const ValueId y = apply(b, OpKind::Tan, x);
  return ops::add(b, one(b), times(b, y, y));
}

// No more than `most`, where the quotient is by zero.
ValueId capped(Builder& b, double most, ValueId x) { return ops::emit(b, OpKind::Min, {x, number(b, most)}); }

// exp2(y log2(x)): 3 + 2 |p| last places, and what p is off by, in relative terms log(2) times as much: 4 |y| 2^-23 for
// x in [1/2, 2], else 3 |p| 2^-23, and its own rounding. Then a factor 2 and a constant.
Fn power(double factor, double more) {
  return [=](Builder& b, const Values& xs, ValueId) {
    const ValueId x = abs_of(b, xs[0]);
    const ValueId p = abs_of(b, times(b, xs[1], apply(b, OpKind::Log2, x)));
    const ValueId off = near_one(b, x, times(b, number(b, 4), abs_of(b, xs[1])), times(b, number(b, 3), p));
    const ValueId relative = times(b, number(b, 1.4), ops::add(b, off, times(b, number(b, 0.5), p)));
    const ValueId whole = ops::add(b, ops::add(b, number(b, 3), times(b, number(b, 2), p)), relative);
    // Subnormal numbers take a product of two powers; 0 has exact ones.
    const ValueId tiny = ops::emit(b, OpKind::Less, {x, number(b, 0x1p-126)});
    const ValueId another = ops::emit(b, OpKind::Select, {tiny, number(b, more + 4), number(b, more)});
    return ops::add(b, another, times(b, number(b, factor), capped(b, 0x1p24, whole)));
  };
}

// sqrt((x - 1)(x + 1)), or with the other sign.
ValueId root(Builder& b, ValueId x, bool below) {
  const ValueId left = below ? ops::sub(b, one(b), x) : ops::sub(b, x, one(b));
  return apply(b, OpKind::Sqrt, times(b, left, ops::add(b, x, one(b))));
}

}  // namespace

void promise_native(Case& c) {
  const auto derivative = [&](Promise promise) { c.derivatives.at(0).native = std::move(promise); };
  const std::string promised = "promised", product = "twice that of the function; one rounding";
  const bool far = c.operands[0].high > 4;
  switch (c.kind) {
    case OpKind::InverseSqrt: c.native = at_most(2, promised); return;
    case OpKind::Exp: c.native = growing(3, 2, promised); return derivative(growing(7, 4, product));
    case OpKind::Exp2:
      c.native = growing(3, 2, promised);
      return derivative(growing(9, 4, product + ", log(2), another"));
    case OpKind::Expm1:
      c.native = growing(4, 2, "our own function, of exp beyond 10");
      return derivative(growing(7, 4, "of exp: " + product));
    case OpKind::Log:
    case OpKind::Log2:
      c.native =
          Promise{[](Builder& b, const Values& xs, ValueId) { return near_one(b, xs[0], number(b, 4), number(b, 3)); },
                  "3; 4 in [1/2, 2]", "promised: 3, and 2^-21 absolute in [1/2, 2]",
                  [](Builder& b, const Values& xs, ValueId) { return near_one(b, xs[0], one(b), number(b, 0)); },
                  "1 in [1/2, 2]"};
      return;
    case OpKind::Pow:
      c.native = Promise{power(1, 1), "of exp2(y log2 x)", "exp2 and log2, and how exp2 enlarges what log2 is off by"};
      derivative({power(2, 12), "2 of the power + 12", "the value twice; a quotient, two products"});
      c.derivatives.at(1).native =
          Promise{power(2, 16), "2 of the power + 16", "the value twice, a logarithm, two products",
                  [](Builder& b, const Values& xs, ValueId w) {
                    return abs_of(b, times(b, near_one(b, xs[0], w, number(b, 0)), ops::emit(b, OpKind::Pow, xs)));
                  },
                  "the adjoint times the power, for x in [1/2, 2]"};
      return;
    case OpKind::Sin:
    case OpKind::Cos:
      c.native = growing(4100, 1, "promised: 2^-11 absolute on [-pi, pi]; x less whole turns, 1 + \\|x\\|", kOne, "1");
      return derivative(growing(8201, 2, "2^-11 of the adjoint; " + product, kAdjoint, "the adjoint"));
    case OpKind::Tan:
      if (far) {
        c.native = nothing("sin / cos, where cos may be less than what it is off by");
        return;
      }
      // |cos| and |sin| off by 2^-11 and 4 last places: (|cos| + |sin|) / cos^2 of it, 1% more for the square of it
      // near the ends.
      c.native = at_most(
          11720, "promised: sin / cos, each within 2^-11",
          [](Builder& b, const Values& xs, ValueId) { return tan_square(b, xs[0]); }, "1 + tan^2");
      return derivative(at_most(
          11740, "a square of the value",
          [](Builder& b, const Values& xs, ValueId w) {
            const ValueId slope = abs_of(b, apply(b, OpKind::Tan, xs[0]));
            return times(b, times(b, abs_of(b, w), tan_square(b, xs[0])),
                         ops::add(b, one(b), times(b, number(b, 2), slope)));
          },
          "(1 + tan^2)(1 + 2 \\|tan\\|) times the adjoint"));
    case OpKind::Asin:
      c.native = at_most(4900, "promised: 4096 of atan2(x, sqrt(1 - x x)), and the rounding of 1 - x x");
      return;
    case OpKind::Acos:
      c.native = Promise{[](Builder& b, const Values& xs, ValueId) {
                           const ValueId size = times(b, root(b, xs[0], true), apply(b, OpKind::Acos, xs[0]));
                           return ops::add(b, number(b, 4120), capped(b, 0x1p22, ops::div(b, one(b), size)));
                         },
                         "4120 + 1 / (acos sin acos)",
                         "promised: 4096 of atan2(sqrt(1 - x x), x), and the rounding of 1 - x x"};
      return;
    case OpKind::Atan: c.native = at_most(4096, promised); return;
    case OpKind::Atan2: c.native = at_most(4100, promised + "; operands are scaled"); return;
    case OpKind::Sinh:
      c.native = growing(
          16, 4, "promised: half the difference of two exp",
          [](Builder& b, const Values& xs, ValueId) { return apply(b, OpKind::Cosh, xs[0]); }, "cosh");
      return derivative(growing(17, 4, "of cosh; one rounding"));
    case OpKind::Cosh:
      c.native = growing(16, 4, "promised: half the sum of two exp");
      return derivative(growing(
          17, 4, "of sinh; one rounding",
          [](Builder& b, const Values& xs, ValueId w) { return times(b, abs_of(b, w), apply(b, OpKind::Cosh, xs[0])); },
          "cosh times the adjoint"));
    case OpKind::Tanh:
      c.native = at_most(59, "promised: sinh / cosh, of 10 at most", kOne, "1");
      return derivative(growing(30, 8, "two sigmoids of 2 x, three products"));
    case OpKind::Asinh: c.native = at_most(13, "promised: log(x + sqrt(x x + 1))", kOne, "1"); return;
    case OpKind::Acosh:
      c.native =
          Promise{[](Builder& b, const Values& xs, ValueId) {
                    const ValueId lost = ops::div(b, times(b, number(b, 0.5), xs[0]), root(b, xs[0], false));
                    return ops::add(b, number(b, 13), capped(b, 4096, lost));
                  },
                  "13 + x / (2 sqrt(x^2 - 1))", "promised: log(x + sqrt(x x - 1)), and the rounding of x x", kOne, "1"};
      return;
    case OpKind::Atanh: c.native = at_most(8, "promised: half of log((1 + x) / (1 - x))", kOne, "1"); return;
    case OpKind::Sigmoid:
      c.native = growing(12, 4, "of exp, a sum, a quotient");
      return derivative(growing(24, 4, "two sigmoids, two products"));
    case OpKind::Softplus:
      c.native = growing(14, 4, "log1p of exp");
      return derivative(growing(13, 4, "of sigmoid; one rounding"));
    case OpKind::LogAddExp:
      c.native = growing(14, 4, "log1p of exp", c.scale, c.scale_text);
      for (auto& each : c.derivatives)
        each.native = growing(26, 4, "of sigmoid; one rounding", each.scale, each.scale_text);
      return;
    case OpKind::Erf:
      c.native = at_most(8, "our own function, of exp beyond 1");
      return derivative(at_most(12, "of exp, whose argument is a rounded square"));
    default: return;
  }
}

}  // namespace dr::accuracy
