// SPDX-License-Identifier: Apache-2.0
// Built-in functions of vectors and of bools.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

// The first `count` arguments as float vectors of one size.
bool Elaborator::vectors(BuiltinCall& call, size_t count) {
  if (!floats(call, false)) return false;
  const Type first = element_type(call.args[0]);
  for (size_t i = 1; i < count; ++i) {
    if (element_type(call.args[i]) == first) continue;
    fail(Code::E0322, call.span,
         "expected vectors of one size for '" + std::string(call.entry.name) + "', found " + first.str() + " and " +
             describe_element(call.args[i]));
    return false;
  }
  return true;
}

Value Elaborator::builtin_dot(BuiltinCall& call) {
  if (!vectors(call, 2)) return Error{};
  return dot(call.args[0], call.args[1]);
}

Value Elaborator::builtin_cross(BuiltinCall& call) {
  if (!vectors(call, 2)) return Error{};
  if (element_type(call.args[0]) != ir::vec(3)) return wrong_type(call, 0, "vec3");
  constexpr int kYzx[] = {1, 2, 0}, kZxy[] = {2, 0, 1};
  const Value &a = call.args[0], &b = call.args[1];
  const auto product = [&](const auto& of_a, const auto& of_b) {
    const Value second = swizzle(b, of_b), first = swizzle(a, of_a);
    return mul(first, second);
  };
  const Value taken = product(kZxy, kYzx), from = product(kYzx, kZxy);
  return sub(from, taken);
}

Value Elaborator::builtin_length(BuiltinCall& call) {
  if (!vectors(call, 1)) return Error{};
  return apply(element_type(call.args[0]).is_scalar() ? OpKind::Abs : OpKind::Length, {call.args[0]});
}

Value Elaborator::builtin_distance(BuiltinCall& call) {
  if (!vectors(call, 2)) return Error{};
  const Value difference = sub(call.args[0], call.args[1]);
  if (difference.is_error()) return Error{};
  return apply(element_type(difference).is_scalar() ? OpKind::Abs : OpKind::Length, {difference});
}

Value Elaborator::builtin_normalize(BuiltinCall& call) {
  if (!vectors(call, 1)) return Error{};
  return apply(element_type(call.args[0]).is_scalar() ? OpKind::Sign : OpKind::Normalize, {call.args[0]});
}

// i - 2·dot(n, i)·n
Value Elaborator::builtin_reflect(BuiltinCall& call) {
  if (!vectors(call, 2)) return Error{};
  const Value &i = call.args[0], &n = call.args[1];
  return sub(i, mul(n, mul(make_float(2), dot(n, i))));
}

// The direction behind a surface of the normal n, eta the quotient of the indices; 0, gradient too, where all light is
// reflected.
Value Elaborator::builtin_refract(BuiltinCall& call) {
  if (!vectors(call, 2)) return Error{};
  const Value &i = call.args[0], &n = call.args[1], &eta = call.args[2];
  if (!element_type(eta).is_scalar()) return wrong_type(call, 2, "float");
  const Value cosine = dot(n, i);
  const Value squared_sine = sub(make_float(1), mul(cosine, cosine)), squared_eta = mul(eta, eta);
  const Value k = sub(make_float(1), mul(squared_eta, squared_sine));
  const Value root = apply(OpKind::Sqrt, {k}), scaled_cosine = mul(eta, cosine);
  const Value along = mul(add(scaled_cosine, root), n), kept = mul(eta, i);
  Value bent = sub(kept, along);
  if (bent.is_error()) return bent;
  return select(apply(OpKind::Less, {k, make_float(0)}), splat(make_float(0), element_type(bent)), bent);
}

// n, turned to the side that i comes from.
Value Elaborator::builtin_faceforward(BuiltinCall& call) {
  if (!vectors(call, 3)) return Error{};
  const Value& n = call.args[0];
  Value facing = dot(call.args[2], call.args[1]);
  if (facing.is_error()) return facing;
  const Value turned = apply(OpKind::Neg, {n});
  return select(apply(OpKind::Less, {facing, make_float(0)}), n, turned);
}

// ---- bools ----

Value Elaborator::builtin_any_all(BuiltinCall& call) {
  const Value& v = call.args[0];
  if (!v.is_numeric() || !element_type(v).is_bool()) return wrong_type(call, 0, "a vector of bools");
  Value result = component(v, 0);
  for (int i = 1; i < element_type(v).rows; ++i) result = apply(call.entry.kind, {result, component(v, i)});
  return result;
}

Value Elaborator::builtin_not(BuiltinCall& call) {
  if (!call.args[0].is_numeric() || !element_type(call.args[0]).is_bool())
    return wrong_type(call, 0, "a vector of bools");
  return apply(OpKind::LogicalNot, {call.args[0]});
}

Value Elaborator::builtin_unlikely(BuiltinCall& call) {
  if (!call.args[0].is_numeric() || element_type(call.args[0]) != ir::kBool) return wrong_type(call, 0, "a bool");
  return apply(OpKind::Unlikely, {call.args[0]});
}

Value Elaborator::builtin_compare(BuiltinCall& call) {
  const bool equality = call.entry.kind == OpKind::Equal || call.entry.kind == OpKind::NotEqual;
  const bool bools = equality && std::ranges::all_of(call.args, [&](const Value& v) {
                       return v.is_numeric() && element_type(v).is_bool();
                     });
  if (bools && element_type(call.args[0]) != element_type(call.args[1])) {
    return fail(Code::E0322, call.span,
                "expected vectors of one size for '" + std::string(call.entry.name) + "', found " +
                    describe_element(call.args[0]) + " and " + describe_element(call.args[1]));
  }
  if (!bools && !numbers(call)) return Error{};
  if (call.entry.name.starts_with("greater")) std::swap(call.args[0], call.args[1]);
  return apply(call.entry.kind, std::move(call.args));
}

}  // namespace dr::lower
