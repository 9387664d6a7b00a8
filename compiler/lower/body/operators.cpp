// SPDX-License-Identifier: Apache-2.0
// Operators. Ints known at compile time (numbers and extents) are computed here in 64 bits; matrices go to matrix.cpp.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

namespace {

std::string_view verb(std::string_view op) {
  if (op == "+") return "add";
  if (op == "-") return "subtract";
  if (op == "*") return "multiply";
  if (op == "/") return "divide";
  if (op == "%") return "take the remainder of";
  return "compare";
}

bool is_one_of(std::string_view op, std::initializer_list<std::string_view> ops) {
  return std::ranges::find(ops, op) != ops.end();
}

OpKind arithmetic_kind(std::string_view op) {
  if (op == "+") return OpKind::Add;
  if (op == "-") return OpKind::Sub;
  if (op == "*") return OpKind::Mul;
  if (op == "/") return OpKind::Div;
  DR_ASSERT(op == "%");
  return OpKind::Mod;
}

// The extent arithmetic of compiler/ir gives this for what does not fit.
bool is_undefined(const Dim& dim) { return !dim.is_constant() && dim.symbols().empty(); }

}  // namespace

Value Elaborator::checked_dim(const Dim& dim, const Span& span) {
  if (!is_undefined(dim)) return dim;
  return fail(Code::E0406, span, "expected a number of at most 64 bits, found that the result does not fit");
}

// ---- unary ----

Value Elaborator::evaluate_unary(const Expr& expr) {
  Value a = evaluate(*expr.a);
  if (a.is_error()) return a;
  const auto refuse = [&](std::string_view wanted) {
    return fail(
        Code::E0302, expr.span,
        "expected " + std::string(wanted) + " after '" + std::string(expr.op) + "', found " + describe_element(a));
  };
  if (expr.op == "!") {
    if (!a.is_numeric() || element_type(a) != ir::kBool) {
      return a.is_numeric() && element_type(a).is_bool()
                 ? Value(fail(Code::E0302, expr.span, "expected a bool after '!', found " + describe_element(a), {},
                              "write not(v) for a vector"))
                 : Value(refuse("a bool"));
    }
    return apply(OpKind::LogicalNot, {a});
  }
  if (expr.op == "-") {
    if (!a.is_numeric() || element_type(a).is_bool()) return refuse("a number");
    if (const auto* dim = a.get<Dim>()) return checked_dim(Dim(0) - *dim, expr.span);
    if (element_type(a).is_matrix())
      return map_columns(a, [&](const Value& column) { return apply(OpKind::Neg, {column}); });
    return apply(OpKind::Neg, {a});
  }
  if (!a.is_numeric() || !element_type(a).is_integer()) return refuse("an int or uint");
  if (const auto number = known_int(a)) return Dim(~*number);
  return apply(OpKind::BitNot, {a});
}

// ---- binary ----

// A chain `a + b + c` leans to the left, so its spine is walked in a loop.
Value Elaborator::evaluate_binary(const Expr& expr) {
  std::vector<const Expr*> spine;
  const Expr* at = &expr;
  for (; at->kind == Expr::Kind::Binary; at = at->a.get()) spine.push_back(at);
  Value left = evaluate(*at);
  for (auto it = spine.rbegin(); it != spine.rend(); ++it) {
    const Expr& node = **it;
    const SpanScope span(*this, node.span);
    const auto known = known_bool(left);
    // What is decided at compile time is not looked at further, so that it may guard what would be an error.
    if (known && ((node.op == "&&" && !*known) || (node.op == "||" && *known))) continue;
    const Value right = evaluate(*node.b);
    left = binary(node.op, left, right, node.span);
  }
  return left;
}

Value Elaborator::binary(std::string_view op, Value a, Value b, const Span& span) {
  if (a.is_error() || b.is_error()) return Error{};
  if (is_one_of(op, {"&&", "||"})) return logic(op, a, b, span);
  if (!a.is_numeric() || !b.is_numeric()) {
    return fail(Code::E0302, span,
                "expected numbers beside '" + std::string(op) + "', found " + describe_element(a) + " and " +
                    describe_element(b));
  }
  if (a.is<Dim>() && b.is<Dim>()) {
    bool done = false;
    Value result = dim_arithmetic(op, a.as<Dim>(), b.as<Dim>(), span, done);
    if (done) return result;
  }
  if (is_one_of(op, {"==", "!=", "<", "<=", ">", ">="})) return compare(op, a, b, span);
  if (is_one_of(op, {"&", "|", "^", "<<", ">>"})) return bits(op, a, b, span);

  const auto words = [&] {
    return "cannot " + std::string(verb(op)) + " " + describe_element(a) + " and " + describe_element(b);
  };
  std::vector<Value> operands{a, b};
  if (!unify_scalars(operands) || element_type(operands[0]).is_bool()) {
    const bool mixed = !element_type(a).is_bool() && !element_type(b).is_bool();
    const bool floats = element_type(a).is_float() || element_type(b).is_float();
    return fail(Code::E0301, span, words(), {},
                !mixed   ? ""
                : floats ? "convert one of them, such as float(i)"
                         : "convert one of them: int(u) or uint(i)");
  }
  if (operands[0].is_error() || operands[1].is_error()) return Error{};
  // Before scalars are splat, while the operands have their names.
  if (!check_extents(operands, span)) return Error{};
  const OpKind kind = arithmetic_kind(op);
  const Type type_a = element_type(operands[0]), type_b = element_type(operands[1]);
  if (kind == OpKind::Mod && type_a.is_float())
    return fail(Code::E0301, span, words(), {}, "write mod(x, y) for floats");
  if (type_a.is_matrix() || type_b.is_matrix()) {
    bool done = false;
    if (kind == OpKind::Mul) {
      Value product = matrix_product(operands[0], operands[1], span, done);
      if (done) return product;
    }
    if (type_a.is_scalar() || type_b.is_scalar() || type_a == type_b)
      return matrix_scalar(kind, operands[0], operands[1]);
    return fail(Code::E0301, span, words());
  }
  if (!unify_rows(operands)) return fail(Code::E0301, span, words());
  return apply(kind, std::move(operands));
}

// Ints known at compile time. What extents cannot express (`done` stays false) is computed at run time.
Value Elaborator::dim_arithmetic(std::string_view op, const Dim& a, const Dim& b, const Span& span, bool& done) {
  done = true;
  if (op == "+") return checked_dim(a + b, span);
  if (op == "-") return checked_dim(a - b, span);
  if (op == "*") return checked_dim(a * b, span);
  const bool known = a.is_constant() && b.is_constant();
  if ((op == "/" || op == "%") && b.is_constant() && b.constant() == 0) {
    return fail(Code::E0510, span, "expected a divisor other than 0, found 0");
  }
  if (op == "/") {
    if (known) return Dim(a.constant() / b.constant());
    if (b.is_constant() && b.constant() > 0) return checked_dim(a.divided_by(b.constant()), span);
  }
  if (op == "%" && b.is_constant() && b.constant() > 0) {
    // The remainder of the division that rounds down, as at run time.
    return checked_dim(a - a.divided_by(b.constant()) * b, span);
  }
  if (is_one_of(op, {"==", "!=", "<", "<=", ">", ">="})) {
    const Dim difference = a - b;
    if (difference.is_constant()) {
      const int64_t d = difference.constant();
      return make_bool(op == "=="   ? d == 0
                       : op == "!=" ? d != 0
                       : op == "<"  ? d < 0
                       : op == "<=" ? d <= 0
                       : op == ">"  ? d > 0
                                    : d >= 0);
    }
  }
  if (known && is_one_of(op, {"<<", ">>"})) {
    const int64_t bits = b.constant();
    if (bits < 0 || bits > 62)
      return fail(Code::E0406, span, "expected a shift by 0 to 62 bits at compile time, found " + b.str());
    return op == "<<" ? checked_dim(a * Dim(int64_t{1} << bits), span) : Value(Dim(a.constant() >> bits));
  }
  done = known && is_one_of(op, {"&", "|", "^"});
  if (op == "&" && done) return Dim(a.constant() & b.constant());
  if (op == "|" && done) return Dim(a.constant() | b.constant());
  if (op == "^" && done) return Dim(a.constant() ^ b.constant());
  return Error{};
}

Value Elaborator::compare(std::string_view op, const Value& a, const Value& b, const Span& span) {
  std::vector<Value> operands{a, b};
  const bool agree = unify_scalars(operands);
  if (operands[0].is_error() || operands[1].is_error()) return Error{};
  const Type type_a = element_type(operands[0]), type_b = element_type(operands[1]);
  const bool equality = op == "==" || op == "!=";
  if (!agree || !type_a.is_scalar() || !type_b.is_scalar() || (type_a.is_bool() && !equality)) {
    std::string help;
    if (type_a.is_vector() || type_b.is_vector()) {
      const std::string_view name = op == "=="   ? "all(equal(a, b))"
                                    : op == "!=" ? "any(notEqual(a, b))"
                                    : op == "<"  ? "lessThan(a, b)"
                                    : op == "<=" ? "lessThanEqual(a, b)"
                                    : op == ">"  ? "greaterThan(a, b)"
                                                 : "greaterThanEqual(a, b)";
      help = "write " + std::string(name) + (type_a == type_b ? "" : ", of two vectors");
    }
    return fail(Code::E0301, span, "cannot compare " + describe_element(a) + " and " + describe_element(b), {},
                std::move(help));
  }
  if (op == "==") return apply(OpKind::Equal, std::move(operands));
  if (op == "!=") return apply(OpKind::NotEqual, std::move(operands));
  if (op == ">" || op == ">=") std::swap(operands[0], operands[1]);
  return apply(op == "<" || op == ">" ? OpKind::Less : OpKind::LessEqual, std::move(operands));
}

Value Elaborator::logic(std::string_view op, const Value& a, const Value& b, const Span& span) {
  for (const Value* side : {&a, &b}) {
    if (side->is_numeric() && element_type(*side) == ir::kBool) continue;
    return fail(Code::E0302, span,
                "expected bools beside '" + std::string(op) + "', found " + describe_element(a) + " and " +
                    describe_element(b));
  }
  // `true && x` is x, so that a condition of the program's configuration leaves no trace.
  if (known_bool(a)) return stretched(b, extent_of(a));
  if (const auto known = known_bool(b))
    return *known == (op == "&&") ? stretched(a, extent_of(b)) : stretched(b, extent_of(a));
  return apply(op == "&&" ? OpKind::LogicalAnd : OpKind::LogicalOr, {a, b});
}

Value Elaborator::bits(std::string_view op, const Value& a, const Value& b, const Span& span) {
  const auto refuse = [&] {
    return fail(Code::E0302, span,
                "expected ints or uints beside '" + std::string(op) + "', found " + describe_element(a) + " and " +
                    describe_element(b),
                {}, op == "^" ? "'^' is exclusive or; a power is pow(a, b), a square a * a" : "");
  };
  const bool is_shift = op == "<<" || op == ">>";
  std::vector<Value> operands{a, b};
  bool agree = unify_scalars(operands);
  if (operands[0].is_error() || operands[1].is_error()) return Error{};
  if (!element_type(operands[0]).is_integer() || !element_type(operands[1]).is_integer()) return refuse();
  // The amount of a shift is a number of bits, whatever its type.
  if (is_shift && !agree) {
    operands[1] = convert_scalar(operands[1], element_type(operands[0]).scalar);
    agree = true;
  }
  if (!agree || !unify_rows(operands)) return refuse();
  const OpKind kind = op == "&"    ? OpKind::BitAnd
                      : op == "|"  ? OpKind::BitOr
                      : op == "^"  ? OpKind::BitXor
                      : op == "<<" ? OpKind::ShiftLeft
                                   : OpKind::ShiftRight;
  return apply(kind, std::move(operands));
}

}  // namespace dr::lower
