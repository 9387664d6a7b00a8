// SPDX-License-Identifier: Apache-2.0
// The accuracy table of floats, component by component.
#include "tests/device/accuracy/cases.h"

#include <numbers>

#include "tests/device/accuracy/table.h"

namespace dr::accuracy {

namespace {

const std::string kExact = "moves or selects numbers";
const std::string kProduct = "the adjoint times a derivative: one rounding more";

Case unary(OpKind kind, const Operand& x) { return plain(kind, {x}); }
Case with(Case c, double bound, const std::string& why, Scale scale = {}, const std::string& scale_text = {}) {
  c.derivatives.push_back({c.derivatives.size(), bound, why, std::move(scale), scale_text, {}});
  return c;
}

// sin and cos: absolute where the argument is far from 0, relative within two turns.
Case turning(OpKind kind, double reach, bool absolute) {
  Case c = unary(kind, floats(-reach, reach));
  const std::string why = "pi/2 in four parts, a polynomial";
  if (!absolute) return with(c, 5, "of the other function; " + kProduct);
  c.bound = 1.7;
  c.why = "2e-7 absolute; " + why;
  c.scale = [](Builder& b, const Values&, ValueId) { return one(b); };
  c.scale_text = "1";
  return with(
      c, 2.2, "2e-7 of the adjoint; one rounding", [](Builder& b, const Values&, ValueId w) { return abs_of(b, w); },
      "the adjoint");
}

std::vector<Case> arithmetic() {
  const auto pair = [](OpKind kind) { return plain(kind, {all_floats(), all_floats()}); };
  std::vector<Case> all;
  for (const OpKind kind : {OpKind::Add, OpKind::Sub}) all.push_back(with(with(pair(kind), 0, kExact), 0, kExact));
  for (const OpKind kind : {OpKind::Mul, OpKind::SMul})
    all.push_back(with(with(pair(kind), 0.5, "one rounding"), 0.5, "one rounding"));
  all.push_back(
      with(with(pair(OpKind::Div), 4, "a reciprocal of 2.5 and a product"), 6, "two quotients and a product"));

  Case mod = plain(OpKind::Mod, {floats(-1e4, 1e4), floats(-1e3, 1e3, 0.1)});
  mod.scale = [](Builder& b, const Values& xs, ValueId) {
    return ops::emit(b, OpKind::Max, {abs_of(b, xs[0]), abs_of(b, xs[1])});
  };
  mod.scale_text = "the larger operand";
  // Where the quotient is rounded across a whole number, either side is right.
  mod.except = [](Builder& b, const Values& xs) {
    const ValueId quotient = ops::div(b, xs[0], xs[1]);
    const ValueId off = abs_of(b, ops::sub(b, quotient, ops::emit(b, OpKind::Round, {quotient})));
    const ValueId rounding = ops::mul(b, ops::constant(b, kFloat, 0x1p-20), ops::add(b, one(b), abs_of(b, quotient)));
    return ops::emit(b, OpKind::LessEqual, {off, rounding});
  };
  mod = with(with(mod, 0, kExact), 0.5, "a whole number times the adjoint");
  mod.derivatives[1].except = mod.except;
  all.push_back(mod);

  for (const OpKind kind : {OpKind::Neg, OpKind::Abs}) all.push_back(with(unary(kind, all_floats()), 0, kExact));
  all.push_back(unary(OpKind::Sign, all_floats()));
  for (const OpKind kind : {OpKind::Min, OpKind::Max}) all.push_back(with(with(pair(kind), 0, kExact), 0, kExact));
  all.push_back(with(with(with(plain(OpKind::Clamp, {all_floats(), all_floats(), all_floats()}), 0, kExact), 0, kExact),
                     0, kExact));
  return all;
}

// The sum cancels where one operand is below 0, and the difference is rounded to the larger of both.
Case log_add_exp() {
  Case c = plain(OpKind::LogAddExp, {floats(-80, 80), floats(-80, 80)});
  c.scale = [](Builder& b, const Values& xs, ValueId) {
    return ops::emit(b, OpKind::Max, {one(b), ops::emit(b, OpKind::Max, {abs_of(b, xs[0]), abs_of(b, xs[1])})});
  };
  c.scale_text = "the larger operand, at least 1";
  const auto scale = [](Builder& b, const Values& xs, ValueId w) {
    const ValueId larger = ops::emit(b, OpKind::Max, {abs_of(b, xs[0]), abs_of(b, xs[1])});
    return ops::mul(b, abs_of(b, w), ops::emit(b, OpKind::Max, {one(b), larger}));
  };
  for (int k = 0; k < 2; ++k)
    c = with(c, 12, "of sigmoid, of a rounded difference", scale, "the larger operand times the adjoint");
  return c;
}

std::vector<Case> functions() {
  const Operand any = all_floats(), positive = floats(0, kAll);
  std::vector<Case> all;
  for (const OpKind kind : {OpKind::Floor, OpKind::Ceil, OpKind::Round, OpKind::Trunc}) all.push_back(unary(kind, any));
  all.push_back(with(unary(OpKind::Fract, any), 0, kExact));
  all.push_back(with(unary(OpKind::Half, any), 0, kExact));
  all.push_back(with(unary(OpKind::Sqrt, positive), 8, "a root, a quotient, a product"));
  all.push_back(with(unary(OpKind::InverseSqrt, positive), 12, "the value, a quotient, two products"));
  all.push_back(with(unary(OpKind::Cbrt, any), 10, "the value twice, a quotient, two products"));
  all.push_back(with(unary(OpKind::Exp, floats(-110, 88.7)), 3, "the value; " + kProduct));
  all.push_back(with(unary(OpKind::Exp2, floats(-160, 127.9)), 4, "the value, ln 2; " + kProduct));
  all.push_back(with(unary(OpKind::Expm1, floats(-110, 88.7)), 3, "of exp; " + kProduct));
  for (const OpKind kind : {OpKind::Log, OpKind::Log2})
    all.push_back(with(unary(kind, positive), 4, "a quotient; " + kProduct));
  all.push_back(with(unary(OpKind::Log1p, floats(-1, kAll)), 4, "a sum, a quotient; " + kProduct));

  // Where the result neither vanishes nor overflows.
  Case pow = plain(OpKind::Pow, {floats(0, kAll), floats(-1000, 1000)});
  pow = with(with(pow, 12, "the value, a quotient, two products"), 16, "the value, a logarithm, two products");
  // There x^(y - 1) is taken, and the rounding of y - 1 counts |log x| times.
  pow.derivatives[0].except = [](Builder& b, const Values& xs) {
    const ValueId y = abs_of(b, ops::emit(b, OpKind::Pow, xs));
    const ValueId inside = ops::emit(b, OpKind::LogicalAnd,
                                     {ops::emit(b, OpKind::Less, {ops::constant(b, kFloat, 0x1.001p-126), y}),
                                      ops::emit(b, OpKind::Less, {y, ops::constant(b, kFloat, 0x1.ffp119)})});
    return ops::emit(b, OpKind::LogicalNot, {inside});
  };
  all.push_back(pow);

  const double turns = 4 * std::numbers::pi;
  for (const OpKind kind : {OpKind::Sin, OpKind::Cos}) {
    all.push_back(turning(kind, turns, false));
    all.push_back(turning(kind, 8192, true));
    all.push_back(turning(kind, std::numbers::pi, true));
  }
  all.push_back(with(unary(OpKind::Tan, floats(-1.5, 1.5)), 20, "a square of the value"));
  Case far = unary(OpKind::Tan, floats(-8192, 8192));
  far.scale = [](Builder& b, const Values& xs, ValueId) {
    const ValueId y = ops::emit(b, OpKind::Tan, {xs[0]});
    return ops::add(b, one(b), ops::mul(b, y, y));
  };
  far.scale_text = "1 + tan^2";
  all.push_back(far);
  for (const OpKind kind : {OpKind::Asin, OpKind::Acos})
    all.push_back(with(unary(kind, floats(-1, 1)), 8, "a root, a quotient, two products"));
  all.push_back(with(unary(OpKind::Atan, any), 4, "a quotient; " + kProduct));
  all.push_back(with(with(plain(OpKind::Atan2, {any, any}), 10, "five quotients"), 10, "five quotients"));

  all.push_back(with(unary(OpKind::Sinh, floats(-88.7, 88.7)), 5, "of cosh; " + kProduct));
  all.push_back(with(unary(OpKind::Cosh, floats(-88.7, 88.7)), 7, "of sinh; " + kProduct));
  all.push_back(with(unary(OpKind::Tanh, any), 12, "two sigmoids, three products"));
  all.push_back(with(unary(OpKind::Asinh, any), 8, "a root, a quotient"));
  all.push_back(with(unary(OpKind::Acosh, floats(1, kAll)), 12, "two roots, a quotient"));
  all.push_back(with(unary(OpKind::Atanh, floats(-1, 1)), 5, "a quotient, a product"));
  all.push_back(with(unary(OpKind::Sigmoid, any), 12, "two sigmoids, two products"));
  all.push_back(with(unary(OpKind::Softplus, any), 6, "of sigmoid; " + kProduct));
  all.push_back(log_add_exp());
  all.push_back(with(
      unary(OpKind::Erf, any), 3, "of exp, whose argument is a rounded square",
      [](Builder& b, const Values& xs, ValueId w) {
        const ValueId square = ops::mul(b, xs[0], xs[0]);
        const ValueId slope = ops::mul(b, abs_of(b, w), ops::emit(b, OpKind::Exp, {ops::neg(b, square)}));
        return ops::mul(b, slope, ops::add(b, one(b), square));
      },
      "(1 + x^2) times the derivative"));
  return all;
}

}  // namespace

std::vector<Case> number_cases() {
  std::vector<Case> all = arithmetic();
  for (Case& c : functions()) all.push_back(std::move(c));
  for (Case& c : all) promise_native(c);
  return all;
}

std::vector<Case> cases() {
  std::vector<Case> all = number_cases();
  for (Case& c : word_cases()) all.push_back(std::move(c));
  for (Case& c : image_cases()) all.push_back(std::move(c));
  return all;
}

std::vector<Elsewhere> elsewhere() {
  return {
      {OpKind::Grad, "written out before a device sees the graph"},
      {OpKind::Vjp, "written out before a device sees the graph"},
      {OpKind::Cotangent, "written out before a device sees the graph"},
      {OpKind::Raster, "yields faces and tags, which are compared as decisions"},
  };
}

}  // namespace dr::accuracy
