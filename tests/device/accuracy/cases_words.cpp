// SPDX-License-Identifier: Apache-2.0
// The accuracy table of integers, bits, bools, choice and conversion: all but conversion to float is exact.
#include "tests/device/accuracy/table.h"

namespace dr::accuracy {

namespace {

Case of(OpKind kind, Type type, size_t count, ir::Attrs attrs = {}) {
  Case c = plain(kind, std::vector<Operand>(count, words(type)), std::move(attrs));
  c.name += " " + type.str();
  c.bound = 0;
  c.why = "integers are exact";
  return c;
}

}  // namespace

std::vector<Case> word_cases() {
  const Type uint = ir::vec(1, Scalar::Uint);
  std::vector<Case> all;
  for (const Type type : {kInt, uint}) {
    for (const OpKind kind : {OpKind::Add, OpKind::Sub, OpKind::Mul, OpKind::Div, OpKind::Mod, OpKind::Min, OpKind::Max,
                              OpKind::BitAnd, OpKind::BitOr, OpKind::BitXor, OpKind::ShiftLeft, OpKind::ShiftRight,
                              OpKind::MulHigh, OpKind::Less, OpKind::LessEqual, OpKind::Equal, OpKind::NotEqual})
      all.push_back(of(kind, type, 2));
    for (const OpKind kind : {OpKind::Neg, OpKind::Abs, OpKind::Sign, OpKind::BitNot, OpKind::BitCount, OpKind::FindLsb,
                              OpKind::FindMsb, OpKind::BitReverse})
      all.push_back(of(kind, type, 1));
    all.push_back(of(OpKind::Clamp, type, 3));
  }
  for (const OpKind kind : {OpKind::Less, OpKind::LessEqual, OpKind::Equal, OpKind::NotEqual})
    all.push_back(plain(kind, {all_floats(), all_floats()}));
  for (const OpKind kind : {OpKind::LogicalAnd, OpKind::LogicalOr, OpKind::Equal, OpKind::NotEqual})
    all.push_back(of(kind, kBool, 2));
  all.push_back(of(OpKind::LogicalNot, kBool, 1));
  all.push_back(of(OpKind::Unlikely, kBool, 1));

  Case select = plain(OpKind::Select, {words(kBool), all_floats(), all_floats()});
  select.derivatives = {{1, 0, "moves numbers"}, {2, 0, "moves numbers"}};
  all.push_back(select);
  Case chosen = plain(OpKind::Select, {words(kBool), words(kInt), words(kInt)});
  chosen.name = "select int";
  all.push_back(chosen);

  const auto word = [](Scalar s) { return ir::vec(1, s).str(); };
  const auto conversion = [&](OpKind kind, Scalar from, Scalar to) {
    const Type type = ir::vec(1, from);
    Case c = plain(kind, {type.is_float() ? all_floats() : words(type)}, ints({static_cast<int64_t>(to)}));
    c.name += " " + word(from) + " to " + word(to);
    const bool rounds = kind == OpKind::Convert && to == Scalar::Float && !type.is_bool();
    c.bound = rounds ? 0.5 : 0;
    c.why = rounds ? "one rounding" : "exact";
    return c;
  };
  const Scalar kinds[] = {Scalar::Bool, Scalar::Int, Scalar::Uint, Scalar::Float};
  for (const Scalar from : kinds)
    for (const Scalar to : kinds)
      if (from != to) all.push_back(conversion(OpKind::Convert, from, to));
  for (const Scalar whole : {Scalar::Int, Scalar::Uint}) {
    all.push_back(conversion(OpKind::Bitcast, Scalar::Float, whole));
    all.push_back(conversion(OpKind::Bitcast, whole, Scalar::Float));
  }
  return all;
}

}  // namespace dr::accuracy
