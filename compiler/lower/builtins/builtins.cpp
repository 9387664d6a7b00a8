// SPDX-License-Identifier: Apache-2.0
// The table of built-in functions, and those that work component by component. Vectors and matrices are in
// builtins_vector.cpp and matrix.cpp, bits in builtins_bits.cpp, images in builtins_image.cpp and builtins_sample.cpp.
#include <algorithm>
#include <numbers>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

struct BuiltinTable {
  // The functions that entries of the op table offer, and those below.
  static const std::vector<Builtin>& rows() {
    static const std::vector<Builtin> kRows = [] {
      std::vector<Builtin> all;
      for (const OpKind kind : ir::all_op_kinds()) {
        const size_t operands = ops::info(kind).domains.size();
        if (ops::info(kind).is_function)
          all.push_back({ir::op_name(kind), operands, operands, &Elaborator::float_function, kind});
      }
      all.insert(all.end(), own_rows().begin(), own_rows().end());
      return all;
    }();
    return kRows;
  }

 private:
  static const std::vector<Builtin>& own_rows() {
    using E = Elaborator;
    static const std::vector<Builtin> kRows = {
        {"roundEven", 1, 1, &E::float_function, OpKind::Round},
        {"atan", 1, 2, &E::builtin_atan},
        {"radians", 1, 1, &E::builtin_angle},
        {"degrees", 1, 1, &E::builtin_angle},
        {"saturate", 1, 1, &E::builtin_saturate},
        {"mix", 3, 3, &E::builtin_mix},
        {"step", 2, 2, &E::builtin_step},
        {"smoothstep", 3, 3, &E::builtin_smoothstep},
        {"fma", 3, 3, &E::builtin_fma},
        {"modf", 1, 1, &E::builtin_modf},
        {"frexp", 1, 1, &E::builtin_frexp},
        {"ldexp", 2, 2, &E::builtin_ldexp},
        {"isnan", 1, 1, &E::builtin_is_nan},
        {"isinf", 1, 1, &E::builtin_is_inf},
        // Bits.
        {"floatBitsToInt", 1, 1, &E::builtin_bitcast},
        {"floatBitsToUint", 1, 1, &E::builtin_bitcast},
        {"intBitsToFloat", 1, 1, &E::builtin_bitcast},
        {"uintBitsToFloat", 1, 1, &E::builtin_bitcast},
        {"bitCount", 1, 1, &E::integer_function, OpKind::BitCount},
        {"findLSB", 1, 1, &E::integer_function, OpKind::FindLsb},
        {"findMSB", 1, 1, &E::integer_function, OpKind::FindMsb},
        {"bitfieldReverse", 1, 1, &E::integer_function, OpKind::BitReverse},
        {"bitfieldExtract", 3, 3, &E::builtin_bitfield_extract},
        {"bitfieldInsert", 4, 4, &E::builtin_bitfield_insert},
        {"umulExtended", 2, 2, &E::builtin_mul_extended},
        {"imulExtended", 2, 2, &E::builtin_mul_extended},
        {"uaddCarry", 2, 2, &E::builtin_carry, OpKind::Add},
        {"usubBorrow", 2, 2, &E::builtin_carry, OpKind::Sub},
        {"packUnorm2x16", 1, 1, &E::builtin_pack},
        {"packSnorm2x16", 1, 1, &E::builtin_pack},
        {"packUnorm4x8", 1, 1, &E::builtin_pack},
        {"packSnorm4x8", 1, 1, &E::builtin_pack},
        {"unpackUnorm2x16", 1, 1, &E::builtin_unpack},
        {"unpackSnorm2x16", 1, 1, &E::builtin_unpack},
        {"unpackUnorm4x8", 1, 1, &E::builtin_unpack},
        {"unpackSnorm4x8", 1, 1, &E::builtin_unpack},
        // Numbers of any kind.
        {"abs", 1, 1, &E::number_function, OpKind::Abs},
        {"sign", 1, 1, &E::number_function, OpKind::Sign},
        {"mod", 2, 2, &E::number_function, OpKind::Mod},
        {"clamp", 3, 3, &E::number_function, OpKind::Clamp},
        {"select", 3, 3, &E::builtin_select},
        // Vectors and matrices.
        {"dot", 2, 2, &E::builtin_dot},
        {"cross", 2, 2, &E::builtin_cross},
        {"length", 1, 1, &E::builtin_length},
        {"distance", 2, 2, &E::builtin_distance},
        {"normalize", 1, 1, &E::builtin_normalize},
        {"reflect", 2, 2, &E::builtin_reflect},
        {"refract", 3, 3, &E::builtin_refract},
        {"faceforward", 3, 3, &E::builtin_faceforward},
        {"any", 1, 1, &E::builtin_any_all, OpKind::LogicalOr},
        {"all", 1, 1, &E::builtin_any_all, OpKind::LogicalAnd},
        {"not", 1, 1, &E::builtin_not},
        {"unlikely", 1, 1, &E::builtin_unlikely},
        {"lessThan", 2, 2, &E::builtin_compare, OpKind::Less},
        {"lessThanEqual", 2, 2, &E::builtin_compare, OpKind::LessEqual},
        {"greaterThan", 2, 2, &E::builtin_compare, OpKind::Less},
        {"greaterThanEqual", 2, 2, &E::builtin_compare, OpKind::LessEqual},
        {"equal", 2, 2, &E::builtin_compare, OpKind::Equal},
        {"notEqual", 2, 2, &E::builtin_compare, OpKind::NotEqual},
        {"transpose", 1, 1, &E::builtin_transpose},
        {"matrixCompMult", 2, 2, &E::builtin_matrix_comp_mult},
        {"inverse", 1, 1, &E::builtin_inverse},
        {"determinant", 1, 1, &E::builtin_determinant},
        {"outerProduct", 2, 2, &E::builtin_outer_product},
        // Images.
        {"at", 2, 2, &E::builtin_at, OpKind::Gather, {}, true},
        {"layer", 2, 2, &E::builtin_layer, OpKind::Gather, {}, true},
        {"shift", 3, 3, &E::builtin_shift},
        {"sample", 2, 2, &E::builtin_sample, OpKind::Gather, {"filter", "wrap", "layer"}},
        {"scatter_add", 3, 5, &E::builtin_scatter, OpKind::ScatterAdd},
        {"scatter_max", 3, 5, &E::builtin_scatter, OpKind::ScatterMax},
        {"sum", 1, 1, &E::builtin_reduction, OpKind::ReduceSum, {"over"}},
        {"mean", 1, 1, &E::builtin_reduction, OpKind::ReduceSum, {"over"}},
        {"min", 1, 2, &E::builtin_min_max, OpKind::Min, {"over"}},
        {"max", 1, 2, &E::builtin_min_max, OpKind::Max, {"over"}},
        {"coord", 1, 3, &E::builtin_coord},
        {"detach", 1, 1, &E::builtin_barrier, OpKind::Detach},
        {"pin", 1, 1, &E::builtin_barrier, OpKind::Pin},
        {"known", 1, 1, &E::builtin_known},
        {"known_zero", 1, 1, &E::builtin_known_zero},
        {"require", 2, 8, &E::builtin_require},
        {"grad", 2, 2, &E::builtin_grad, OpKind::Grad, {"seed"}},
        {"jvp", 3, 3, &E::builtin_jvp, OpKind::Grad},
        {"array", 2, 2, &E::builtin_array},
        {"topology", 1, 2, &E::builtin_topology},
    };
    return kRows;
  }
};

namespace {

// By name; methods and functions have names of their own.
using Index = std::unordered_map<std::string_view, const Builtin*>;

Index indexed(const std::vector<Builtin>& rows, bool methods) {
  Index index;
  for (const Builtin& row : rows) {
    if (row.is_method == methods) index.emplace(row.name, &row);
  }
  return index;
}

const Builtin* found(const Index& index, std::string_view name) {
  const auto row = index.find(name);
  return row == index.end() ? nullptr : row->second;
}

}  // namespace

const Builtin* Elaborator::find_builtin(std::string_view name) {
  static const Index kIndex = indexed(BuiltinTable::rows(), false);
  return found(kIndex, name);
}

const Builtin* Elaborator::find_method(std::string_view name) {
  static const Index kIndex = indexed(BuiltinTable::rows(), true);
  return found(kIndex, name);
}

std::vector<std::string> Elaborator::builtin_names() {
  std::vector<std::string> names;
  for (const Builtin& row : BuiltinTable::rows()) {
    if (!row.is_method) names.emplace_back(row.name);
  }
  return names;
}

// ---- operands ----

Value Elaborator::wrong_type(const BuiltinCall& call, size_t arg, std::string_view wanted) {
  const Value& value = call.args[arg];
  const bool is_int = value.is_numeric() && element_type(value).is_integer() && wanted.starts_with("float");
  const bool is_matrix = value.is_numeric() && element_type(value).is_matrix();
  return fail(Code::E0322, call.spans[arg],
              "expected " + std::string(wanted) + " for '" + std::string(call.entry.name) + "', found " +
                  describe_element(value),
              {},
              is_int ? "convert it, such as float(i)"
              : is_matrix
                  ? "take its columns, such as m[0]; an optimizer seeks a matrix as vectors, which mat3(a, b, c) joins"
                  : "");
}

// Floats, or ints known at compile time that are taken as floats. Scalars stretch to the size of vectors beside them.
bool Elaborator::floats(BuiltinCall& call, bool splat_scalars) {
  for (size_t i = 0; i < call.args.size(); ++i) {
    Value& value = call.args[i];
    convert_known_int(value, Scalar::Float);
    if (value.is_error()) return false;
    if (value.is_numeric() && element_type(value).is_float() && !element_type(value).is_matrix()) continue;
    wrong_type(call, i, "float or a vector of floats");
    return false;
  }
  if (!check_extents(call.args, call.span)) return false;
  if (!splat_scalars || unify_rows(call.args)) return true;
  fail(Code::E0322, call.span,
       "expected vectors of one size for '" + std::string(call.entry.name) + "', found " +
           describe_element(call.args.front()) + " and " + describe_element(call.args.back()));
  return false;
}

// Numbers of one kind.
bool Elaborator::numbers(BuiltinCall& call, bool splat_scalars) {
  for (size_t i = 0; i < call.args.size(); ++i) {
    if (call.args[i].is_numeric() && !element_type(call.args[i]).is_bool() && !element_type(call.args[i]).is_matrix())
      continue;
    wrong_type(call, i, "numbers");
    return false;
  }
  const std::vector<Value> given = call.args;
  if (!check_extents(call.args, call.span)) return false;
  if (unify_scalars(call.args) && (!splat_scalars || unify_rows(call.args))) {
    return std::ranges::none_of(call.args, [](const Value& value) { return value.is_error(); });
  }
  fail(Code::E0322, call.span,
       "expected numbers of one type for '" + std::string(call.entry.name) + "', found " +
           describe_element(given.front()) + " and " + describe_element(given.back()));
  return false;
}

// ---- component by component ----

Value Elaborator::float_function(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  return apply(call.entry.kind, std::move(call.args));
}

Value Elaborator::number_function(BuiltinCall& call) {
  if (!numbers(call)) return Error{};
  return apply(call.entry.kind, std::move(call.args));
}

Value Elaborator::builtin_atan(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const OpKind kind = call.args.size() == 2 ? OpKind::Atan2 : OpKind::Atan;
  return apply(kind, std::move(call.args));
}

Value Elaborator::builtin_angle(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  return mul(call.args[0], make_float(call.entry.name == "radians" ? std::numbers::pi / 180 : 180 / std::numbers::pi));
}

// The product is rounded before the sum: devices differ in what they fuse.
Value Elaborator::builtin_fma(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  return add(mul(call.args[0], call.args[1]), call.args[2]);
}

Value Elaborator::builtin_saturate(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Type type = element_type(call.args[0]);
  return apply(OpKind::Clamp, {call.args[0], splat(make_float(0), type), splat(make_float(1), type)});
}

// a·(1 - t) + b·t is a at 0 and b at 1, without rounding; with a bool it chooses.
Value Elaborator::builtin_mix(BuiltinCall& call) {
  if (call.args[2].is_numeric() && element_type(call.args[2]).is_bool()) {
    call.args = {call.args[2], call.args[1], call.args[0]};
    return builtin_select(call);
  }
  if (!floats(call)) return Error{};
  const Value& t = call.args[2];
  const Value second = mul(call.args[1], t), first = mul(call.args[0], sub(make_float(1), t));
  return add(first, second);
}

Value Elaborator::builtin_step(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Type type = element_type(call.args[0]);
  const Value below = apply(OpKind::Less, {call.args[1], call.args[0]});
  return select(below, splat(make_float(0), type), splat(make_float(1), type));
}

// Where both edges are one, it is the step there; the quotient is then taken with another divisor, so that neither the
// value nor the gradient sees 0 / 0.
Value Elaborator::builtin_smoothstep(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Type type = element_type(call.args[0]);
  const Value zero = splat(make_float(0), type), one = splat(make_float(1), type);
  const Value& x = call.args[2];
  const Value width = sub(call.args[1], call.args[0]);
  Value t;
  const auto known = known_components(width);
  if (known && std::ranges::find(*known, 0.0) == known->end()) {
    t = apply(OpKind::Clamp, {arithmetic(OpKind::Div, sub(x, call.args[0]), width), zero, one});
  } else {
    const Value degenerate = apply(OpKind::Equal, {width, zero});
    const Value divisor = select(degenerate, one, width), way = sub(x, call.args[0]);
    const Value ramp = apply(OpKind::Clamp, {arithmetic(OpKind::Div, way, divisor), zero, one});
    const Value step = select(apply(OpKind::Less, {x, call.args[0]}), zero, one);
    t = select(degenerate, step, ramp);
  }
  const Value rest = sub(make_float(3), mul(make_float(2), t)), square = mul(t, t);
  return mul(square, rest);
}

// select(c, a, b), of numbers, vectors, structs and arrays.
Value Elaborator::builtin_select(BuiltinCall& call) {
  const Value& c = call.args[0];
  if (!c.is_numeric() || !element_type(c).is_bool()) return wrong_type(call, 0, "a bool as the first argument");
  if (element_type(c).is_vector()) {
    std::vector<Value> sides{call.args[1], call.args[2]};
    const bool alike = sides[0].is_numeric() && sides[1].is_numeric() && unify_scalars(sides) && unify_rows(sides);
    if (alike && (sides[0].is_error() || sides[1].is_error())) return Error{};
    if (!alike || element_type(sides[0]).rows != element_type(c).rows) {
      return fail(Code::E0322, call.span,
                  "expected vectors of the size of " + describe_element(c) + " for '" + std::string(call.entry.name) +
                      "', found " + describe_element(call.args[1]) + " and " + describe_element(call.args[2]));
    }
    return select(c, sides[0], sides[1]);
  }
  if (const auto known = known_bool(c)) {
    // The types still have to agree.
    if (call.args[1].is_numeric() && call.args[2].is_numeric()) {
      std::vector<Value> sides{call.args[1], call.args[2]};
      unify_scalars(sides);
      if (element_type(sides[0]) == element_type(sides[1]) && check_extents(sides, call.span))
        return stretched(stretched(sides[*known ? 0 : 1], extent_of(sides[*known ? 1 : 0])), extent_of(c));
    }
  }
  return select_branches(c, call.args[1], call.args[2], call.span);
}

// One argument: over the image; two: of both.
Value Elaborator::builtin_min_max(BuiltinCall& call) {
  if (call.args.size() == 1) return builtin_reduction(call);
  if (!call.named.empty())
    return fail(Code::E0305, call.named[0].name->span,
                "expected 'over' with one image only, found it with two arguments");
  // Extents of the program stay extents where both are numbers.
  const auto a = known_int(call.args[0]), b = known_int(call.args[1]);
  if (a && b) return Dim(call.entry.kind == OpKind::Min ? std::min(*a, *b) : std::max(*a, *b));
  return number_function(call);
}

}  // namespace dr::lower
