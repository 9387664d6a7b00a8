// SPDX-License-Identifier: Apache-2.0
// Built-in functions that look at the bits of numbers. Those that GLSL gives out parameters return a tuple. All but the
// bit casts, counts and the high half of a product are spelled out in shifts and masks.
#include "compiler/lower/elaborator.h"

namespace dr::lower {

namespace {

Value make_uint(uint32_t number) { return Constant{ir::kUint, {static_cast<double>(number)}}; }

}  // namespace

// The operands as ints or uints of one type.
bool Elaborator::integers(BuiltinCall& call, bool splat_scalars) {
  if (!numbers(call, splat_scalars)) return false;
  for (size_t i = 0; i < call.args.size(); ++i) {
    if (element_type(call.args[i]).is_integer()) continue;
    wrong_type(call, i, "int, uint or a vector of them");
    return false;
  }
  return true;
}

Value Elaborator::integer_function(BuiltinCall& call) {
  if (!integers(call)) return Error{};
  return apply(call.entry.kind, std::move(call.args));
}

Value Elaborator::bitcast(const Value& value, Scalar to) {
  ir::Attrs attrs;
  attrs.ints = {static_cast<int64_t>(to)};
  return apply(OpKind::Bitcast, {value}, std::move(attrs));
}

Value Elaborator::builtin_bitcast(BuiltinCall& call) {
  if (call.entry.name.starts_with("float")) {
    if (!floats(call)) return Error{};
    return bitcast(call.args[0], call.entry.name.ends_with("Int") ? Scalar::Int : Scalar::Uint);
  }
  const Scalar from = call.entry.name.starts_with("int") ? Scalar::Int : Scalar::Uint;
  convert_known_int(call.args[0], from);
  if (!call.args[0].is_numeric() || element_type(call.args[0]).scalar != from)
    return wrong_type(call, 0, from == Scalar::Int ? "int or a vector of ints" : "uint or a vector of uints");
  return bitcast(call.args[0], Scalar::Float);
}

// ---- what kind of float ----

// The bits without the sign: above those of Inf stand the NaNs. Compilers may take it that there is neither, but not
// for integers.
Value Elaborator::magnitude_bits(const Value& x) { return bits_and(bitcast(x, Scalar::Uint), 0x7fffffffu); }

Value Elaborator::bits_and(const Value& x, uint32_t mask) {
  return arithmetic(OpKind::BitAnd, x, convert_scalar(make_uint(mask), element_type(x).scalar));
}

Value Elaborator::is_nan(const Value& x) {
  const Value bits = magnitude_bits(x);
  if (bits.is_error()) return bits;
  return apply(OpKind::Less, {splat(make_uint(0x7f800000u), element_type(bits)), bits});
}

Value Elaborator::builtin_is_nan(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  return is_nan(call.args[0]);
}

Value Elaborator::builtin_is_inf(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Value bits = magnitude_bits(call.args[0]);
  if (bits.is_error()) return bits;
  return apply(OpKind::Equal, {bits, splat(make_uint(0x7f800000u), element_type(bits))});
}

// ---- mantissa and exponent ----

// x 2^n by powers of two that float32 holds; three reach from the largest number to below the smallest. The steps go
// as far as they can, so that at most one of them rounds to a subnormal number that counts.
Value Elaborator::times_power_of_two(Value x, Value n) {
  if (n.is_error()) return Error{};
  const Type ints = element_type(n);
  for (int step = 0; step < 3; ++step) {
    if (x.is_error() || n.is_error()) return Error{};
    const Value part = apply(OpKind::Clamp, {n, splat(Dim(-126), ints), splat(Dim(127), ints)});
    const Value bits = arithmetic(OpKind::ShiftLeft, add(part, Dim(127)), Dim(23));
    x = mul(x, bitcast(bits, Scalar::Float));
    n = sub(n, part);
  }
  return x;
}

Value Elaborator::builtin_ldexp(BuiltinCall& call) {
  Value &x = call.args[0], &n = call.args[1];
  convert_known_int(x, Scalar::Float);
  if (!x.is_numeric() || !element_type(x).is_float() || element_type(x).is_matrix())
    return wrong_type(call, 0, "float or a vector of floats");
  if (!n.is_numeric() || element_type(n).scalar != Scalar::Int) return wrong_type(call, 1, "int or a vector of ints");
  if (!check_extents(call.args, call.span)) return Error{};
  if (!unify_rows(call.args)) {
    return fail(
        Code::E0322, call.span,
        "expected vectors of one size for 'ldexp', found " + describe_element(x) + " and " + describe_element(n));
  }
  return times_power_of_two(x, n);
}

// (significand, exponent) with x = significand 2^exponent and a significand from 0.5 to 1; (x, 0) of 0, Inf and NaN.
Value Elaborator::builtin_frexp(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Value& x = call.args[0];
  const Type floats = element_type(x);
  const auto whole = [&](int64_t number) { return splat(Dim(number), floats.with_scalar(Scalar::Int)); };
  // Subnormal numbers are scaled up first.
  const Value tiny = apply(OpKind::Less, {apply(OpKind::Abs, {x}), splat(make_float(0x1p-126), floats)});
  const Value scaled = select(tiny, mul(x, make_float(0x1p64)), x);
  const Value field = bits_and(arithmetic(OpKind::ShiftRight, bitcast(scaled, Scalar::Int), Dim(23)), 255);
  if (field.is_error()) return field;
  const Value none =
      apply(OpKind::LogicalOr, {apply(OpKind::Equal, {field, whole(0)}), apply(OpKind::Equal, {field, whole(255)})});
  const Value exponent = sub(field, select(tiny, whole(126 + 64), whole(126)));
  const Value shown = select(none, whole(0), exponent);
  const Value significand = times_power_of_two(x, apply(OpKind::Neg, {shown}));
  if (significand.is_error()) return significand;
  return TupleValue{{significand, shown}};
}

// (fraction, whole): both of x's sign.
Value Elaborator::builtin_modf(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Value whole = apply(OpKind::Trunc, {call.args[0]});
  return TupleValue{{sub(call.args[0], whole), whole}};
}

// ---- integers of 64 bits ----

// (high, low)
Value Elaborator::builtin_mul_extended(BuiltinCall& call) {
  const bool is_int = call.entry.name.starts_with("imul");
  for (size_t i = 0; i < 2; ++i) {
    convert_known_int(call.args[i], is_int ? Scalar::Int : Scalar::Uint);
    const Value& value = call.args[i];
    if (!value.is_numeric() || element_type(value).scalar != (is_int ? Scalar::Int : Scalar::Uint))
      return wrong_type(call, i, is_int ? "int or a vector of ints" : "uint or a vector of uints");
  }
  if (!integers(call)) return Error{};
  return TupleValue{{apply(OpKind::MulHigh, call.args), apply(OpKind::Mul, call.args)}};
}

// (sum, carry) and (difference, borrow), modulo 2^32.
Value Elaborator::builtin_carry(BuiltinCall& call) {
  for (size_t i = 0; i < 2; ++i) {
    convert_known_int(call.args[i], Scalar::Uint);
    if (!call.args[i].is_numeric() || element_type(call.args[i]).scalar != Scalar::Uint)
      return wrong_type(call, i, "uint or a vector of uints");
  }
  if (!integers(call)) return Error{};
  const Value result = apply(call.entry.kind, call.args);
  if (result.is_error()) return result;
  const bool adds = call.entry.kind == OpKind::Add;
  const Value over = apply(OpKind::Less, {adds ? result : call.args[0], call.args[adds ? 0 : 1]});
  return TupleValue{{result, convert_scalar(over, Scalar::Uint)}};
}

// ---- bit fields ----

// The number of the field's first bit and its size, held to the 32 bits that there are, as scalars of `value`'s kind.
std::optional<std::pair<Value, Value>> Elaborator::bit_field(BuiltinCall& call, size_t first) {
  for (size_t i = first; i < first + 2; ++i) {
    if (call.args[i].is_numeric() && element_type(call.args[i]) == ir::kInt) continue;
    wrong_type(call, i, "int");
    return std::nullopt;
  }
  const Value offset = apply(OpKind::Clamp, {call.args[first], Dim(0), Dim(32)});
  const Value size = apply(OpKind::Clamp, {call.args[first + 1], Dim(0), sub(Dim(32), offset)});
  if (size.is_error()) return std::nullopt;
  return std::pair{offset, size};
}

Value Elaborator::shifted(OpKind kind, const Value& x, const Value& by) {
  if (x.is_error() || by.is_error()) return Error{};
  return arithmetic(kind, x, convert_scalar(by, element_type(x).scalar));
}

Value Elaborator::builtin_bitfield_extract(BuiltinCall& call) {
  Value& x = call.args[0];
  if (!x.is_numeric() || !element_type(x).is_integer()) return wrong_type(call, 0, "int, uint or a vector of them");
  if (!check_extents(call.args, call.span)) return Error{};
  const auto field = bit_field(call, 1);
  if (!field) return Error{};
  const auto& [offset, size] = *field;
  // Up to the top and down again, which brings the sign along.
  const Value rest = sub(Dim(32), size);
  const Value down = shifted(OpKind::ShiftRight, shifted(OpKind::ShiftLeft, x, sub(rest, offset)), rest);
  if (down.is_error()) return down;
  const Value zero = splat(convert_scalar(Dim(0), element_type(x).scalar), element_type(x));
  return select(apply(OpKind::Equal, {size, Dim(0)}), zero, down);
}

Value Elaborator::builtin_bitfield_insert(BuiltinCall& call) {
  std::vector<Value> words{call.args[0], call.args[1]};
  for (size_t i = 0; i < 2; ++i) {
    if (words[i].is_numeric() && element_type(words[i]).is_integer()) continue;
    return wrong_type(call, i, "int, uint or a vector of them");
  }
  if (!check_extents(call.args, call.span)) return Error{};
  if (!unify_scalars(words) || !unify_rows(words)) {
    return fail(Code::E0322, call.span,
                "expected integers of one type for 'bitfieldInsert', found " + describe_element(words[0]) + " and " +
                    describe_element(words[1]));
  }
  const auto field = bit_field(call, 2);
  if (!field || words[0].is_error() || words[1].is_error()) return Error{};
  const auto& [offset, size] = *field;
  const Value ones = shifted(OpKind::ShiftRight, make_uint(0xffffffffu), sub(Dim(32), size));
  if (ones.is_error()) return ones;
  const Value low = select(apply(OpKind::Equal, {size, Dim(0)}), make_uint(0), ones);
  const Value mask = convert_scalar(shifted(OpKind::ShiftLeft, low, offset), element_type(words[0]).scalar);
  if (mask.is_error()) return mask;
  const Value inserted = arithmetic(OpKind::BitAnd, shifted(OpKind::ShiftLeft, words[1], offset), mask);
  return arithmetic(OpKind::BitOr, arithmetic(OpKind::BitAnd, words[0], apply(OpKind::BitNot, {mask})), inserted);
}

// ---- packing ----

namespace {

struct Packing {
  int count = 2;
  int bits = 16;
  bool is_signed = false;
  double scale() const { return static_cast<double>((1 << (is_signed ? bits - 1 : bits)) - 1); }
};

// "packUnorm4x8", "unpackSnorm2x16"
Packing packing_of(std::string_view name) {
  Packing packing;
  packing.is_signed = name.find("Snorm") != std::string_view::npos;
  if (name.ends_with("4x8")) packing.count = 4, packing.bits = 8;
  return packing;
}

}  // namespace

Value Elaborator::builtin_pack(BuiltinCall& call) {
  if (!floats(call)) return Error{};
  const Packing packing = packing_of(call.entry.name);
  const Type type = ir::vec(packing.count);
  if (element_type(call.args[0]) != type) return wrong_type(call, 0, type.str());
  const Value low = splat(make_float(packing.is_signed ? -1 : 0), type), high = splat(make_float(1), type);
  const Value scaled = mul(apply(OpKind::Clamp, {call.args[0], low, high}), make_float(packing.scale()));
  const Value words = convert_scalar(convert_scalar(apply(OpKind::Round, {scaled}), Scalar::Int), Scalar::Uint);
  Value packed = make_uint(0);
  for (int k = 0; k < packing.count; ++k) {
    const Value part = component(words, k);
    if (part.is_error()) return part;
    packed = arithmetic(OpKind::BitOr, packed,
                        shifted(OpKind::ShiftLeft, bits_and(part, (1u << packing.bits) - 1), Dim(k * packing.bits)));
  }
  return packed;
}

Value Elaborator::builtin_unpack(BuiltinCall& call) {
  convert_known_int(call.args[0], Scalar::Uint);
  if (!call.args[0].is_numeric() || element_type(call.args[0]) != ir::kUint) return wrong_type(call, 0, "uint");
  const Packing packing = packing_of(call.entry.name);
  const Value word = convert_scalar(call.args[0], packing.is_signed ? Scalar::Int : Scalar::Uint);
  std::vector<Value> parts;
  for (int k = 0; k < packing.count; ++k) {
    const Value up = shifted(OpKind::ShiftLeft, word, Dim(32 - (k + 1) * packing.bits));
    parts.push_back(convert_scalar(shifted(OpKind::ShiftRight, up, Dim(32 - packing.bits)), Scalar::Float));
  }
  const Type type = ir::vec(packing.count);
  const Value scaled = arithmetic(OpKind::Div, compose(std::move(parts), type), make_float(packing.scale()));
  if (!packing.is_signed || scaled.is_error()) return scaled;
  return apply(OpKind::Clamp, {scaled, splat(make_float(-1), type), splat(make_float(1), type)});
}

}  // namespace dr::lower
