// SPDX-License-Identifier: Apache-2.0
// Blocks and the statements that may stand anywhere: let, var, assignment, for, const if.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

Value Elaborator::evaluate_block(const dsl::Block& block) {
  const Switched<Scope*> inside(scope_, new_scope(scope_));
  return run_statements(block);
}

// The statements in the current scope; the value of the block.
Value Elaborator::run_statements(const dsl::Block& block) {
  for (const dsl::StmtPtr& stmt : block.statements) {
    if (stmt->kind == dsl::Stmt::Kind::Return) return evaluate(*stmt->a);
    if (!run_statement(*stmt) && !frames_.empty()) return Error{};
  }
  return block.value ? evaluate(*block.value) : Value(Nothing{});
}

// False where a function says nothing behind it: what it requires does not hold.
bool Elaborator::run_statement(const dsl::Stmt& stmt) {
  if (over_budget(stmt.span)) return true;
  const SpanScope span(*this, stmt.span);
  switch (stmt.kind) {
    case dsl::Stmt::Kind::Let:
    case dsl::Stmt::Kind::Var: run_let(stmt); break;
    case dsl::Stmt::Kind::Assign: run_assign(stmt); break;
    case dsl::Stmt::Kind::Update:
      if (optimizer_ && frames_.size() == optimizer_->frame) {
        run_optimizer_update(stmt);
      } else if (in_step("'<-'", stmt.span)) {
        run_update(stmt);
      }
      break;
    case dsl::Stmt::Kind::Expr: {
      const Value value = evaluate(*stmt.a);
      if (contains_error(value)) return false;
      if (!value.is<Nothing>()) {
        report(Code::E0509, stmt.a->span, "expected a statement with an effect, found a value that is not used", {},
               "bind it with 'let', or leave out the ';'");
      }
      break;
    }
    case dsl::Stmt::Kind::For: run_for(stmt); break;
    case dsl::Stmt::Kind::If: run_if(stmt); break;
    case dsl::Stmt::Kind::Break: run_break(stmt); break;
    case dsl::Stmt::Kind::ConstIf: run_const_if(stmt); break;
    case dsl::Stmt::Kind::Minimize:
      if (in_step("'minimize'", stmt.span)) run_minimize(stmt);
      break;
    case dsl::Stmt::Kind::Output:
      if (in_step("'output'", stmt.span)) run_output(stmt);
      break;
    case dsl::Stmt::Kind::Return: break;  // the block's value
  }
  return true;
}

void Elaborator::run_let(const dsl::Stmt& stmt) {
  Value value = evaluate(*stmt.a);
  if (value.is<Nothing>()) value = fail(Code::E0321, stmt.a->span, "expected a value, found a block without one");
  if (stmt.type && !contains_error(value)) {
    const std::string_view name = stmt.pattern.is_tuple ? "" : std::string_view(stmt.pattern.names[0].text);
    auto fitted = declared(value, *stmt.type, name, stmt.a->span);
    value = fitted ? *std::move(fitted) : Value(Error{});
  }
  bind_pattern(stmt.pattern, value, stmt.a->span,
               stmt.kind == dsl::Stmt::Kind::Var ? Binding::Kind::Var : Binding::Kind::Let);
}

void Elaborator::bind_pattern(const dsl::Pattern& pattern, const Value& value, const Span& span, Binding::Kind kind) {
  if (!pattern.is_tuple) {
    const dsl::Name& name = pattern.names[0];
    if (name.text != "_") set_name(value, name.text);
    define(*scope_, name, value, kind);
    return;
  }
  const std::vector<Value>& parts = parts_of(value);
  const bool fits = !value.is<StructValue>() && value.is_composite() && parts.size() == pattern.names.size();
  if (!fits && !contains_error(value)) {
    const std::string found = value.is<TupleValue>() ? "a tuple of " + std::to_string(parts.size()) : describe(value);
    report(Code::E0320, span,
           "expected a tuple of " + std::to_string(pattern.names.size()) + " for these names, found " + found);
  }
  for (size_t i = 0; i < pattern.names.size(); ++i) {
    const Value part = fits ? parts[i] : Value(Error{});
    if (pattern.names[i].text != "_") set_name(part, pattern.names[i].text);
    define(*scope_, pattern.names[i], part, kind);
  }
}

// ---- assignment ----

void Elaborator::run_assign(const dsl::Stmt& stmt) {
  std::vector<const Expr*> path;  // from the name outwards
  const Expr* at = stmt.target.get();
  for (; at->kind == Expr::Kind::Field || at->kind == Expr::Kind::Index; at = at->a.get()) path.push_back(at);
  std::reverse(path.begin(), path.end());
  Value value = evaluate(*stmt.a);
  const Binding* binding = assignable(*at);
  if (!binding || binding->value.is_error()) return;
  if (!stmt.op.empty() && !contains_error(value)) value = binary(stmt.op, evaluate(*stmt.target), value, stmt.span);
  const Value before = binding->value;
  Value after = contains_error(value) ? Value(Error{}) : assigned(before, path, value, stmt);
  if (path.empty()) set_name(after, at->name);
  set_variable(at->name, std::move(after));
}

namespace {

// What a binding is that `=` cannot change, and what to write instead.
std::pair<std::string, std::string> unchanging(const Binding& binding, const std::string& name) {
  const std::string copy = "assign to a copy: 'var copy = " + name + ";'";
  if (binding.leaf) return {"a leaf", "write '<-' to give it its next value"};
  switch (binding.kind) {
    case Binding::Kind::Parameter: return {"a parameter", copy};
    case Binding::Kind::Index: return {"which the loop counts", copy};
    case Binding::Kind::Carried:
      return {"which the loop carries",
              "what stands at the end of the block is its next value: write it there, without '='"};
    case Binding::Kind::Let:
    case Binding::Kind::Var: break;
  }
  return {"which does not change", "declare it with 'var'"};
}

}  // namespace

// The binding of a name that may be assigned here; null where that has been refused.
const Binding* Elaborator::assignable(const Expr& place) {
  const Expr* at = &place;
  const Binding* binding = find_binding(at->name);
  if (!binding) {
    const auto item = scope_->module->items.find(at->name);
    if (item == scope_->module->items.end()) {
      report(Code::E0201, at->span, "expected the name of a variable, found '" + at->name + "'", {},
             suggestion(at->name, visible_names()));
      return nullptr;
    }
    const bool leaf = item->second.kind == ModuleItem::Kind::Leaf;
    report(Code::E0507, at->span,
           "expected a 'var' before '=', found " + std::string(leaf ? "the leaf '" : "'") + at->name + "'",
           {{item->second.span, "'" + at->name + "' is declared here"}},
           leaf ? "write '<-' to give a leaf its next value" : "");
    return nullptr;
  }
  if (binding->kind != Binding::Kind::Var) {
    const auto [is, help] = unchanging(*binding, at->name);
    report(Code::E0507, at->span, "expected a 'var' before '=', found '" + at->name + "', " + is,
           {{binding->span, "'" + at->name + "' is declared here"}}, help);
    return nullptr;
  }
  if (binding->frame != frames_.size() || binding->region != regions_.size()) {
    const bool region = binding->region != regions_.size();
    report(Code::E0508, at->span,
           "expected an assignment to a variable of this " + std::string(region ? "region" : "function") + ", found '" +
               at->name + "' from outside",
           {{binding->span, "'" + at->name + "' is declared here"}}, region ? "make it the value of the region" : "");
    return nullptr;
  }
  return binding;
}

// Evaluation may have added names to the scope since the variable was found.
void Elaborator::set_variable(std::string_view name, Value value) {
  for (Scope* scope = scope_; scope; scope = scope->parent) {
    if (Binding* place = scope->find(name)) {
      place->value = std::move(value);
      return;
    }
  }
}

// `current` with `value` at the end of the path.
Value Elaborator::assigned(const Value& current, std::span<const Expr* const> path, const Value& value,
                           const dsl::Stmt& stmt) {
  if (path.empty()) return fit_assignment(current, value, stmt);
  const Expr& step = *path[0];
  const auto rest = path.subspan(1);
  if (current.is_numeric() && step.kind == Expr::Kind::Field) {
    const auto indices = swizzle_indices(element_type(current), step.name, step.span);
    if (!indices) return Error{};
    for (size_t i = 0; i < indices->size(); ++i) {
      for (size_t k = 0; k < i; ++k) {
        if ((*indices)[i] == (*indices)[k])
          return fail(Code::E0308, step.span, "expected each component once before '=', found '" + step.name + "'");
      }
    }
    const Value part = swizzle(current, *indices);
    const Value next = assigned(part, rest, value, stmt);
    return next.is_error() ? Value(Error{}) : assigned_components(current, *indices, next, stmt);
  }
  if (current.is_numeric()) {
    const auto index = evaluate_known_int(*step.b, "the place of an assignment");
    if (!index) return Error{};
    const Type type = element_type(current);
    if (type.is_scalar())
      return fail(Code::E0317, step.span,
                  "expected an array, a vector or a matrix before '[', found " + describe(current));
    const auto checked = checked_index(*index, type.is_matrix() ? type.cols : type.rows, type.str(), step.b->span);
    if (!checked) return Error{};
    const int place = static_cast<int>(*checked);
    const Value next = assigned(component(current, place), rest, value, stmt);
    if (next.is_error()) return Error{};
    std::vector<Value> parts;
    for (int i = 0; i < (type.is_matrix() ? type.cols : type.rows); ++i)
      parts.push_back(i == place ? next : component(current, i));
    return compose(std::move(parts), type);
  }
  // A field of a struct or an item of an array.
  std::vector<Value> parts = parts_of(current);
  size_t place = 0;
  if (const auto* s = current.get<StructValue>(); s && step.kind == Expr::Kind::Field) {
    place = static_cast<size_t>(std::ranges::find(s->type->fields, step.name) - s->type->fields.begin());
    if (place == parts.size()) {
      return fail(Code::E0307, step.span, no_field(*s->type, step.name), {}, suggestion(step.name, s->type->fields));
    }
  } else if (current.is<ArrayValue>() && step.kind == Expr::Kind::Index) {
    const auto index = evaluate_known_int(*step.b, "the place of an assignment");
    if (!index) return Error{};
    const auto checked = checked_index(*index, static_cast<int64_t>(parts.size()),
                                       "an array of " + std::to_string(parts.size()), step.b->span);
    if (!checked) return Error{};
    place = static_cast<size_t>(*checked);
  } else {
    return fail(Code::E0507, step.span,
                "expected a component, a field of a struct or an item of an array before '=', found a part of " +
                    describe(current));
  }
  Value next = assigned(parts[place], rest, value, stmt);
  if (next.is_error()) return Error{};
  parts[place] = std::move(next);
  return with_parts(current, std::move(parts));
}

Value Elaborator::assigned_components(const Value& current, std::span<const int> indices, const Value& value,
                                      const dsl::Stmt& stmt) {
  const Type type = element_type(current);
  if (type.is_scalar()) return value;
  std::vector<Value> parts;
  for (int i = 0; i < type.rows; ++i) parts.push_back(component(current, i));
  const SpanScope span(*this, stmt.span);
  for (size_t i = 0; i < indices.size(); ++i)
    parts[static_cast<size_t>(indices[i])] = component(value, static_cast<int>(i));
  return compose(std::move(parts), type);
}

// The new value of a place, of the type that the place has. Extents may change.
Value Elaborator::fit_assignment(const Value& current, const Value& value, const dsl::Stmt& stmt) {
  Value fitted = value;
  if (current.is_numeric() && element_type(current).is_scalar())
    convert_known_int(fitted, element_type(current).scalar);
  const TypeValue wanted = type_of(current), found = type_of(fitted);
  if (same_type(wanted, found) || (wanted.kind == TypeValue::Kind::Other && found.kind == wanted.kind)) return fitted;
  const bool int_before = current.is<Dim>() && fitted.is_numeric() && element_type(fitted) == ir::kFloat;
  return fail(
      Code::E0511, stmt.a->span,
      "expected a value of type " + describe_element(current) + " for the variable, found " + describe_element(value),
      {}, int_before ? "start with a float, such as 0.0" : "");
}

// ---- compile-time control flow ----

void Elaborator::run_for(const dsl::Stmt& stmt) {
  const Value first = evaluate(*stmt.a), last = evaluate(*stmt.b);
  if (!is_unrolled(stmt, first, last)) return run_loop(stmt);
  const auto begin = evaluate_known_int(*stmt.a, "the range of 'for'");
  const auto end = evaluate_known_int(*stmt.b, "the range of 'for'");
  if (!begin || !end) return;
  int64_t trips = 0;
  if (*end > *begin && (__builtin_sub_overflow(*end, *begin, &trips) || trips > kMaxTrips)) {
    report(Code::E0502, stmt.b->span,
           "expected at most " + std::to_string(kMaxTrips) + " trips of 'for', found a range from " +
               std::to_string(*begin) + " to " + std::to_string(*end),
           {}, "add ', max = " + std::to_string(trips) + "' for a loop at run time");
    return;
  }
  // A trip's names stay in memory, also where its body is empty: it counts as so many expressions.
  constexpr size_t kTripCost = 25;
  const size_t mistakes = mistakes_;
  for (int64_t i = *begin; i < *end; ++i) {
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    define(*scope_, stmt.loop_var, Dim(i), Binding::Kind::Index);
    // Further trips would only make the same mistake again.
    if (over_budget(stmt.span, kTripCost) || mistakes_ > mistakes) return;
    if (const Value value = run_statements(stmt.body); !value.is<Nothing>() && !contains_error(value)) {
      report(Code::E0509, stmt.body.value->span,
             "expected statements in the body of 'for', found a value that is not used", {}, "");
      return;
    }
  }
}

std::optional<bool> Elaborator::known_condition(const Expr& expr) {
  const Value condition = evaluate(expr);
  if (condition.is_error()) return std::nullopt;
  if (const auto known = known_bool(condition)) return known;
  if (!condition.is_numeric() || element_type(condition) != ir::kBool) {
    report(Code::E0313, expr.span, "expected a bool as condition, found " + describe(condition));
  } else {
    report(Code::E0501, expr.span,
           "expected a condition known at compile time for 'const if', found one known at run time", {},
           "leave out 'const' to choose for each element");
  }
  return std::nullopt;
}

void Elaborator::run_const_if(const dsl::Stmt& stmt) {
  const auto condition = known_condition(*stmt.a);
  if (!condition) return;
  const dsl::Block* block = *condition ? &stmt.body : stmt.else_body ? &*stmt.else_body : nullptr;
  if (!block) return;
  const Switched<Scope*> inside(scope_, new_scope(scope_));
  run_breakable(block->statements, [&] {
    if (block->value) evaluate(*block->value);
  });
}

}  // namespace dr::lower
