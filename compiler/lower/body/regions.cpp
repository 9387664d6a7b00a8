// SPDX-License-Identifier: Apache-2.0
// `if` and `reduce` on elements. Their domain is known only when their bodies are: the regions are built first, and the
// op takes the extent to which everything in them stretches.
#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

// ---- if ----

Value Elaborator::evaluate_if(const Expr& expr) {
  if (expr.is_const) {
    const auto known = known_condition(*expr.a);
    if (!known) return Error{};
    return evaluate_block(*known ? expr.inner->then_block : *expr.inner->else_block);
  }
  const Value condition = evaluate(*expr.a);
  if (contains_error(condition)) return Error{};
  if (!condition.is_numeric() || element_type(condition) != ir::kBool) {
    const bool vector = condition.is_numeric() && element_type(condition).is_bool();
    return fail(Code::E0313, expr.a->span, "expected a bool as condition, found " + describe_element(condition), {},
                vector ? "write any(v) or all(v)" : "");
  }
  if (const auto known = known_bool(condition))
    return stretched(evaluate_block(*known ? expr.inner->then_block : *expr.inner->else_block), extent_of(condition));
  // Where neither branch computes anything, choosing costs less than branching.
  if (is_cheap(expr.inner->then_block) && is_cheap(*expr.inner->else_block)) {
    const Value a = evaluate_block(expr.inner->then_block);
    const Value b = evaluate_block(*expr.inner->else_block);
    return select_branches(condition, a, b, expr.span);
  }
  return emit_if(
      condition, expr.span, [&] { return evaluate_block(expr.inner->then_block); },
      [&] { return evaluate_block(*expr.inner->else_block); });
}

namespace {

bool is_literal(const Expr& expr) {
  if (expr.kind == Expr::Kind::Unary) return is_literal(*expr.a);
  if (expr.kind == Expr::Kind::Call) {
    return expr.a->kind == Expr::Kind::NameRef && Type::parse(expr.a->name) &&
           std::ranges::all_of(expr.args, [](const dsl::Arg& arg) { return is_literal(*arg.value); });
  }
  return expr.kind == Expr::Kind::Int || expr.kind == Expr::Kind::Float || expr.kind == Expr::Kind::Bool;
}

}  // namespace

// Whether the block only names or writes down a value.
bool Elaborator::is_cheap(const dsl::Block& block) const {
  if (!block.statements.empty() || !block.value) return false;
  return block.value->kind == Expr::Kind::NameRef || is_literal(*block.value);
}

// The type that both sides have or can be taken as.
std::optional<Type> Elaborator::branch_type(const Value& a, const Value& b, const Span& span) {
  const Type type_a = element_type(a), type_b = element_type(b);
  if (type_a == type_b) return type_a;
  if (a.is<Dim>() && type_b.is_scalar() && !type_b.is_bool()) return type_b;
  if (b.is<Dim>() && type_a.is_scalar() && !type_a.is_bool()) return type_a;
  report(Code::E0314, span,
         "expected branches of one type, found " + describe_element(a) + " and " + describe_element(b));
  return std::nullopt;
}

// Walks two values of one structure, chosen between by what has the extent `by`. What both sides have in common is
// stretched to that; an int that is known stays as it is in a structure, whose shape it may tell.
Value Elaborator::merge_branches(const Value& a, const Value& b, const Extent& by, const Span& span,
                                 const LeafPair& leaf) {
  if (contains_error(a) || contains_error(b)) return Error{};
  if (a.is<Nothing>() || b.is<Nothing>())
    return fail(Code::E0321, span, "expected a value from both branches, found none from one");
  if (same_value(a, b))
    return a.is_numeric()
               ? stretched(a, by)
               : map_leaves(a, [&](const Value& part) { return part.is<Dim>() ? part : stretched(part, by); });
  if (a.is_numeric() && b.is_numeric()) return leaf(a, b);
  const auto* s = a.get<StructValue>();
  const bool alike = a.is_composite() && a.data.index() == b.data.index() && parts_of(a).size() == parts_of(b).size() &&
                     (!s || s->type == b.as<StructValue>().type);
  if (!alike) {
    const std::string help =
        a.is<FunctionValue>() || b.is<FunctionValue>() ? "choose between functions with 'const if'" : "";
    return fail(Code::E0314, span,
                "expected branches of one type, found " + describe_element(a) + " and " + describe_element(b), {},
                help);
  }
  std::vector<Value> parts;
  for (size_t i = 0; i < parts_of(a).size(); ++i) {
    const Value &x = parts_of(a)[i], &y = parts_of(b)[i];
    parts.push_back(x.is<Dim>() && same_value(x, y) ? x : merge_branches(x, y, by, span, leaf));
    if (parts.back().is_error()) return Error{};
  }
  return with_parts(a, std::move(parts));
}

Value Elaborator::select_branches(const Value& condition, const Value& a, const Value& b, const Span& span) {
  return merge_branches(a, b, extent_of(condition), span, [&](const Value& x, const Value& y) -> Value {
    const auto type = branch_type(x, y, span);
    if (!type) return Error{};
    Value then_value = x, else_value = y;
    convert_known_int(then_value, type->scalar);
    convert_known_int(else_value, type->scalar);
    if (!type->is_matrix()) return select(condition, then_value, else_value);
    std::vector<Value> columns;
    for (int c = 0; c < type->cols; ++c) {
      const Value otherwise = component(else_value, c), then = component(then_value, c);
      columns.push_back(select(condition, then, otherwise));
    }
    return compose(std::move(columns), *type);
  });
}

Value Elaborator::emit_if(const Value& condition, const Span& span, const Branch& then, const Branch& otherwise) {
  const ValueId condition_id = materialize(condition);
  regions_.push_back({"'if'", span, frames_.size(), {}});
  // The else region is built while the then region is still open: a literal of either may take its type from the other.
  const ir::RegionId then_region = b_.begin_region({});
  const Value a = then();
  const ir::RegionId else_region = b_.begin_region({});
  const Value b = otherwise();

  struct Pair {
    Value a, b;
    Type type;
  };
  std::vector<Pair> pairs;
  const Value merged = merge_branches(a, b, {}, span, [&](const Value& x, const Value& y) -> Value {
    const auto type = branch_type(x, y, span);
    if (!type) return Error{};
    pairs.push_back({x, y, *type});
    return Nothing{};
  });
  const auto close = [&](Value Pair::*side) {
    std::vector<ValueId> yields;
    for (Pair& pair : pairs) {
      convert_known_int(pair.*side, pair.type.scalar);
      if (!(pair.*side).is_error()) yields.push_back(materialize(pair.*side));
    }
    // A region op has a result, even where all that the branches give is known at compile time.
    if (pairs.empty()) yields.push_back(ops::constant(b_, ir::kBool, 0.0));
    b_.end_region(std::move(yields));
  };
  close(&Pair::b);
  close(&Pair::a);
  regions_.pop_back();
  if (merged.is_error() || diagnostics_.has_errors()) return Error{};

  const ir::RegionId regions[] = {then_region, else_region};
  const auto domain = region_domain(b_.value(condition_id).extent, regions, span);
  if (!domain) return Error{};
  ir::Attrs attrs;
  attrs.dims = {domain->w, domain->h, domain->l};
  attrs.yields.assign(std::max<size_t>(pairs.size(), 1), ir::Yield::Element);
  const std::vector<ValueId> results =
      ops::emit_multi(b_, OpKind::If, {condition_id}, std::move(attrs), {then_region, else_region});
  size_t next = 0;
  return merge_branches(a, b, extent_of(condition), span, [&](const Value&, const Value&) -> Value {
    const Pair& pair = pairs[next];
    return image(results[next++], {&condition, &pair.a, &pair.b});
  });
}

// ---- reduce ----

// An end of the range.
bool Elaborator::loop_range(const Value& value, const Expr& expr, std::string_view loop) {
  if (value.is_error()) return false;
  if (value.is_numeric() && element_type(value) == ir::kInt) return true;
  report(Code::E0710, expr.span, "expected an int as the range of " + std::string(loop) + ", found " + describe(value));
  return false;
}

namespace {

// The number that an int is held to by `min(n, 64)`.
std::optional<Dim> held_below(const ir::Graph& graph, const Value& value) {
  const auto* image = value.get<Image>();
  if (!image || !graph.value(image->id).op.valid()) return std::nullopt;
  const ir::Op& op = graph.op(graph.value(image->id).op);
  if (op.kind != OpKind::Min) return std::nullopt;
  for (const ValueId operand : op.operands) {
    const ir::OpId from = graph.value(operand).op;
    if (!from.valid() || graph.op(from).kind != OpKind::Const) continue;
    return Dim(static_cast<int64_t>(graph.op(from).attrs.floats[0]));
  }
  return std::nullopt;
}

}  // namespace

// The most trips that there are: what the program promises, or what is known; -1: any number. Nothing after an error.
std::optional<int64_t> Elaborator::loop_bound(const Expr* promise, const Value& begin, const Value& end) {
  if (promise) {
    const auto known = evaluate_known_int(*promise, "'max'");
    if (!known) return std::nullopt;
    if (*known >= 0 && *known <= INT32_MAX) return known;
    report(Code::E0710, promise->span, "expected a bound of at least 0 on the trips, found " + std::to_string(*known));
    return std::nullopt;
  }
  if (!begin.is<Dim>()) return -1;
  const auto last = end.is<Dim>() ? std::optional(end.as<Dim>()) : held_below(b_.graph(), end);
  if (!last) return -1;
  const Dim trips = *last - begin.as<Dim>();
  return trips.is_constant() ? std::max<int64_t>(trips.constant(), 0) : -1;
}

Value Elaborator::evaluate_reduce(const Expr& expr) {
  const Value begin = evaluate(*expr.a);
  const Value end = evaluate(*expr.b);
  if (!loop_range(begin, *expr.a, "'reduce'") || !loop_range(end, *expr.b, "'reduce'")) return Error{};
  const auto known_bound = loop_bound(expr.c.get(), begin, end);
  if (!known_bound) return Error{};
  const int64_t bound = *known_bound;
  ir::Yield yield = ir::Yield::Sum;
  if (expr.name == "min") yield = ir::Yield::Min;
  if (expr.name == "max") yield = ir::Yield::Max;
  if (expr.name == "argmin") yield = ir::Yield::ArgMin;

  const std::vector<Value> range{begin, end};
  if (!check_extents(range, expr.span)) return Error{};
  const ValueId begin_id = materialize(begin);
  ValueId end_id = materialize(end);
  // What is promised holds: devices that end loops count on it.
  if (const auto known = loop_bound(nullptr, begin, end); expr.c && (*known < 0 || *known > bound)) {
    const ValueId most = ops::constant(b_, ir::kInt, static_cast<double>(bound));
    ValueId trips = ops::sub(b_, end_id, begin_id);
    if (const auto* from = begin.get<Dim>(); !from || !from->is_constant() || from->constant() != 0) {
      // The difference of two ints may leave their range.
      const ValueId none = ops::constant(b_, ir::kInt, 0);
      const ValueId far = ops::emit(b_, OpKind::Less, {trips, none});
      trips = ops::select(b_, ops::emit(b_, OpKind::Less, {begin_id, end_id}), ops::select(b_, far, most, trips), none);
    }
    end_id = ops::add(b_, begin_id, ops::emit(b_, OpKind::Min, {trips, most}));
  }
  const Extent trips_extent = *ir::broadcast(b_.value(begin_id).extent, b_.value(end_id).extent);
  regions_.push_back({"'reduce'", expr.span, frames_.size(), {}});
  const ir::ResultType param{ir::kInt, trips_extent};
  const ir::RegionId region = b_.begin_region({&param, 1});
  const ValueId i = b_.graph().region(region).params[0];
  b_.set_name(i, expr.inner->loop_var.text);
  Value body;
  {
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    define(*scope_, expr.inner->loop_var, Image{i, element_depth(range)}, Binding::Kind::Index);
    body = evaluate_block(expr.inner->then_block);
  }
  bool ok = !contains_error(body);
  const Span at = expr.inner->then_block.value ? expr.inner->then_block.value->span : expr.inner->then_block.span;
  std::vector<Value> leaves;
  for_each_leaf(body, [&](const Value& leaf) { leaves.push_back(leaf); });
  const auto refuse = [&](std::string_view wanted) {
    report(Code::E0711, at,
           "expected " + std::string(wanted) + " from the body of 'reduce', found " + describe_element(body));
    ok = false;
  };
  if (ok && leaves.empty()) refuse("numbers");
  if (ok && yield == ir::Yield::ArgMin && leaves.size() != 1) refuse("one number");
  for (const Value& leaf : leaves) {
    if (ok && (!leaf.is_numeric() || element_type(leaf).is_bool() ||
               (element_type(leaf).is_matrix() && yield != ir::Yield::Sum)))
      refuse("numbers");
    if (ok && yield == ir::Yield::ArgMin && !element_type(leaf).is_scalar()) refuse("one number");
  }
  std::vector<ValueId> yields;
  for (const Value& leaf : leaves) {
    if (ok) yields.push_back(materialize(leaf));
  }
  b_.end_region(std::move(yields));
  regions_.pop_back();
  if (!ok || diagnostics_.has_errors()) return Error{};

  const auto domain = region_domain(trips_extent, {&region, 1}, expr.span);
  if (!domain) return Error{};
  ir::Attrs attrs;
  attrs.ints = {bound};
  attrs.dims = {domain->w, domain->h, domain->l};
  attrs.yields.assign(leaves.size(), yield);
  const std::vector<ValueId> results =
      ops::emit_multi(b_, OpKind::Reduce, {begin_id, end_id}, std::move(attrs), {region});
  size_t next = 0;
  return map_leaves(body, [&](const Value& leaf) -> Value { return image(results[next++], {&begin, &end, &leaf}); });
}

}  // namespace dr::lower
