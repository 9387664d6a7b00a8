// SPDX-License-Identifier: Apache-2.0
// Expressions other than operators and calls: literals, names, fields, swizzles, indices, arrays.
#include <algorithm>
#include <charconv>

#include "compiler/lower/elaborator.h"
#include "dsl/diagnostic/foreign_words.h"

namespace dr::lower {

Value Elaborator::evaluate(const Expr& expr) {
  if (over_budget(expr.span)) return Error{};
  if (depth_ >= kMaxDepth) {
    return fail(
        Code::E0505, expr.span,
        "expected at most " + std::to_string(kMaxDepth) + " expressions inside each other, through calls, found more");
  }
  ++depth_;
  const SpanScope span(*this, expr.span);
  Value value = evaluate_any(expr);
  --depth_;
  return value;
}

Value Elaborator::evaluate_any(const Expr& expr) {
  switch (expr.kind) {
    case Expr::Kind::Int:
    case Expr::Kind::Float: return evaluate_number(expr);
    case Expr::Kind::Bool: return make_bool(expr.bool_value);
    case Expr::Kind::String: return StringValue{expr.name};
    case Expr::Kind::NameRef: return name_value(expr.name, expr.span);
    case Expr::Kind::StepCount: return step_count(expr);
    case Expr::Kind::Unary: return evaluate_unary(expr);
    case Expr::Kind::Binary: return evaluate_binary(expr);
    case Expr::Kind::Field: return evaluate_field(expr);
    case Expr::Kind::Index: return evaluate_index(expr);
    case Expr::Kind::Call: return evaluate_call(expr);
    case Expr::Kind::Lambda: return evaluate_lambda(expr);
    case Expr::Kind::If: return evaluate_if(expr);
    case Expr::Kind::Reduce: return evaluate_reduce(expr);
    case Expr::Kind::Fold: return evaluate_fold(expr);
    case Expr::Kind::Tuple: {
      TupleValue tuple;
      size_t parts = 0;
      for (const dsl::ExprPtr& item : expr.items) {
        tuple.items.push_back(evaluate(*item));
        if (!has_room(tuple.items.back(), parts, expr.span)) return Error{};
      }
      return tuple;
    }
    case Expr::Kind::Array: return evaluate_array(expr);
    case Expr::Kind::Raster: return evaluate_raster(expr);
    case Expr::Kind::BlockExpr: return evaluate_block(expr.inner->then_block);
    case Expr::Kind::Error: return Error{};
  }
  DR_ICE("an expression of no kind");
}

Value Elaborator::evaluate_number(const Expr& expr) {
  if (expr.kind == Expr::Kind::Float) return make_float(expr.float_value);
  if (!expr.unsigned_suffix) return Dim(expr.int_value);
  if (expr.int_value > UINT32_MAX)
    return fail(Code::E0318, expr.span, "expected a number that fits uint, found " + expr.name);
  return Constant{ir::kUint, {static_cast<double>(expr.int_value)}};
}

Value Elaborator::evaluate_lambda(const Expr& expr) {
  FunctionValue lambda;
  lambda.decl = &expr.inner->fn;
  lambda.scope = scope_;
  lambda.creator = frames_.size();
  lambda.is_lambda = true;
  return lambda;
}

// ---- fields ----

Value Elaborator::evaluate_field(const Expr& expr) {
  const Value base = [&] {
    const Switched<Span> before_dot(before_dot_, expr.a->span);
    return evaluate(*expr.a);
  }();
  return field_of(base, expr.name, expr.span, expr.a.get());
}

Value Elaborator::field_of(const Value& base, const std::string& name, const Span& span, const Expr* base_expr) {
  Value value = found_field(base, name, span, base_expr);
  observe_field(base, name, span, value);
  return value;
}

Value Elaborator::found_field(const Value& base, const std::string& name, const Span& span, const Expr* base_expr) {
  if (base.is_error()) return Error{};
  if (const auto* module = base.get<ModuleValue>()) return module_field(*module->module, name, span);
  if (base.is_numeric()) return numeric_field(base, name, span, base_expr);
  if (const auto* s = base.get<StructValue>()) {
    const auto field = std::ranges::find(s->type->fields, name);
    if (field != s->type->fields.end()) return s->fields[static_cast<size_t>(field - s->type->fields.begin())];
    std::vector<std::string> known = s->type->fields;
    if (s->type->decl) {
      for (const dsl::FnDecl& method : s->type->decl->methods) {
        known.push_back(method.name.text);
        if (method.name.text != name) continue;
        FunctionValue fn{.decl = &method, .scope = &s->type->module->scope, .self = {base}};
        if (!s->generics.empty()) {
          fn.scope = new_scope(fn.scope);
          for (size_t i = 0; i < s->generics.size(); ++i) define(*fn.scope, s->type->decl->generics[i], s->generics[i]);
        }
        return fn;
      }
    }
    std::vector<dsl::Note> notes;
    if (s->type->decl) notes.push_back({s->type->decl->name.span, "'" + s->type->name + "' is declared here"});
    return fail(Code::E0307, span, no_field(*s->type, name), std::move(notes), suggestion(name, known));
  }
  if (const auto* tuple = base.get<TupleValue>()) {
    size_t index = 0;
    const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), index);
    if (error == std::errc() && end == name.data() + name.size()) {
      const auto checked =
          checked_index(static_cast<int64_t>(index), static_cast<int64_t>(tuple->items.size()), "a tuple", span);
      return checked ? tuple->items[static_cast<size_t>(*checked)] : Value(Error{});
    }
  }
  if (const auto* array = base.get<ArrayValue>(); array && name == "length")
    return Dim(static_cast<int64_t>(array->items.size()));
  return fail(Code::E0307, span, "expected a value with a field '" + name + "', found " + describe(base));
}

Value Elaborator::numeric_field(const Value& base, const std::string& name, const Span& span, const Expr* base_expr) {
  const Type type = element_type(base);
  if (name == "width" || name == "height" || name == "layers") {
    if (refuse_element(base, "'." + name + "'", base_expr ? base_expr->span : span)) return Error{};
    const Extent extent = extent_of(base);
    return name == "width" ? extent.w : name == "height" ? extent.h : extent.l;
  }
  if (name == "px" && type.is_scalar() && (type.is_float() || base.is<Dim>())) return to_float(base);
  if (const Builtin* method = find_method(name)) return BuiltinValue{method, {base}};
  const auto indices = swizzle_indices(type, name, span);
  if (!indices) return Error{};
  return swizzle(base, *indices);
}

// The components that `name` names, or an error.
std::optional<std::vector<int>> Elaborator::swizzle_indices(const Type& type, const std::string& name,
                                                            const Span& span) {
  constexpr std::string_view kSets[] = {"xyzw", "rgba", "stpq"};
  if (!type.is_matrix() && !name.empty()) {
    for (const std::string_view set : kSets) {
      std::vector<int> indices;
      for (const char letter : name) {
        const size_t at = set.find(letter);
        if (at != std::string_view::npos) indices.push_back(static_cast<int>(at));
      }
      if (indices.size() != name.size()) continue;
      if (name.size() > 4) {
        report(Code::E0308, span, "expected at most 4 components, found '" + name + "'");
        return std::nullopt;
      }
      for (const int index : indices) {
        if (index < type.rows) continue;
        report(Code::E0308, span,
               "expected a component of " + type.str() + ", found '" + std::string(1, set[static_cast<size_t>(index)]) +
                   "'");
        return std::nullopt;
      }
      return indices;
    }
  }
  std::vector<std::string> known = {"width", "height", "layers", "at", "layer"};
  const std::string what = type.is_matrix()
                               ? "expected a field of an image, found '"
                               : "expected components such as 'x' or 'xyz', or a field of an image, found '";
  const char* const foreign = dsl::instead_of_field(name);
  std::string help = type.is_matrix()     ? "write m[0] for the first column"
                     : foreign            ? foreign
                     : find_builtin(name) ? "write " + name + "(x)"
                                          : suggestion(name, known);
  report(Code::E0307, span, what + name + "' of " + type.str(), {}, std::move(help));
  return std::nullopt;
}

// ---- indices ----

std::optional<int64_t> Elaborator::checked_index(int64_t index, int64_t count, std::string_view what,
                                                 const Span& span) {
  if (index >= 0 && index < count) return index;
  report(Code::E0316, span,
         "expected an index from 0 to " + std::to_string(count - 1) + " into " + std::string(what) + ", found " +
             std::to_string(index));
  return std::nullopt;
}

Value Elaborator::evaluate_index(const Expr& expr) {
  const Value base = evaluate(*expr.a);
  const Value index = evaluate(*expr.b);
  if (base.is_error() || index.is_error()) return Error{};
  return index_value(base, index, expr);
}

Value Elaborator::index_value(const Value& base, const Value& index, const Expr& expr) {
  const bool is_array = base.is<ArrayValue>();
  if (!is_array && (!base.is_numeric() || element_type(base).is_scalar())) {
    std::string help;
    if (base.is_numeric()) help = "write x.at(i) to read an image at a place";
    if (base.is<TupleValue>()) help = "write t.0 for the first element of a tuple";
    return fail(Code::E0317, expr.span, "expected an array, a vector or a matrix before '[', found " + describe(base),
                {}, std::move(help));
  }
  // A reader of other languages means the element of the image, and a component has a name.
  const auto* of_image = base.get<Image>();
  const bool is_element = of_image && of_image->element > 0;
  if (base.is_numeric() && !is_element && !element_type(base).is_matrix() && !extent_of(base).is_unit()) {
    return fail(Code::E0317, expr.span, "expected an array, a vector or a matrix before '[', found " + describe(base),
                {},
                "write x.at(i) for the element at a place, x.x, x.y, … for a component of all elements, and "
                "[x.x, x.y, …][i] for one that an image of indices chooses");
  }
  if (!index.is_numeric() || element_type(index) != ir::kInt) {
    if (!index.is_numeric() || element_type(index) != ir::kUint) {
      return fail(Code::E0317, expr.b->span, "expected an int as index, found " + describe(index));
    }
  }
  const auto known = known_components(index);
  const Type type = is_array ? Type{} : element_type(base);
  const int64_t count = is_array           ? static_cast<int64_t>(base.as<ArrayValue>().items.size())
                        : type.is_matrix() ? type.cols
                                           : type.rows;
  const std::string what = is_array ? "an array of " + std::to_string(count) : type.str();
  const auto item = [&](int64_t i) {
    return is_array ? base.as<ArrayValue>().items[static_cast<size_t>(i)] : component(base, static_cast<int>(i));
  };
  if (known) {
    const auto checked = checked_index(static_cast<int64_t>(known->front()), count, what, expr.b->span);
    return checked ? item(*checked) : Value(Error{});
  }
  // Known at run time only: choices as a tree, so that few wait for each other. The first and the last item stand for
  // what lies outside.
  if (count == 0)
    return fail(Code::E0316, expr.b->span, "expected an index into an array that has items, found an empty one");
  const Value place = convert_scalar(index, Scalar::Int);
  const auto chosen = [&](const auto& self, int64_t begin, int64_t end) -> Value {
    if (end - begin == 1) return item(begin);
    const int64_t middle = begin + (end - begin + 1) / 2;
    const Value first = self(self, begin, middle), last = self(self, middle, end);
    const Value here = apply(OpKind::LessEqual, {place, Dim(middle - 1)});
    if (here.is_error() || first.is_error() || last.is_error()) return Error{};
    return select_branches(here, first, last, expr.span);
  };
  return chosen(chosen, 0, count);
}

// ---- arrays ----

Value Elaborator::evaluate_array(const Expr& expr) {
  std::vector<Value> items;
  std::vector<Span> spans;
  size_t parts = 0;
  for (const dsl::ExprPtr& item : expr.items) {
    items.push_back(evaluate(*item));
    spans.push_back(item->span);
    if (!has_room(items.back(), parts, expr.span)) return Error{};
  }
  return unify_items(std::move(items), spans);
}

// An array of items of one type; ints known at compile time become what the others are.
Value Elaborator::unify_items(std::vector<Value> items, std::span<const Span> spans) {
  const Value* model = nullptr;
  for (const Value& item : items) {
    if (contains_error(item)) return Error{};
    if (!model || (model->is<Dim>() && item.is_numeric())) model = &item;
  }
  if (!model) return ArrayValue{};
  const TypeValue wanted = type_of(*model);
  for (size_t i = 0; i < items.size(); ++i) {
    if (wanted.kind == TypeValue::Kind::Element) convert_known_int(items[i], wanted.element.scalar);
    const TypeValue found = type_of(items[i]);
    if (found.kind != TypeValue::Kind::Other && same_type(found, wanted)) continue;
    return fail(
        Code::E0319, spans[i],
        "expected items of one type in an array, found " + describe_element(items[i]) + " beside " + describe(wanted));
  }
  return ArrayValue{std::move(items)};
}

// ---- what a place wants ----

bool Elaborator::is_image_value(const Value& value, const Span& span, std::string_view what) {
  if (value.is_numeric()) return true;
  if (!value.is_error())
    report(Code::E0208, span, "expected a number or an image for " + std::string(what) + ", found " + describe(value));
  return false;
}

std::optional<int64_t> Elaborator::evaluate_known_int(const Expr& expr, std::string_view what) {
  const Value value = evaluate(expr);
  if (value.is_error()) return std::nullopt;
  if (const auto number = known_int(value)) return number;
  report(Code::E0501, expr.span,
         "expected an int known at compile time for " + std::string(what) + ", found " + describe(value) +
             (value.is_numeric() && element_type(value) == ir::kInt ? " known at run time" : ""));
  return std::nullopt;
}

// An int that may hold symbols.
std::optional<Dim> Elaborator::evaluate_dim(const Expr& expr, std::string_view what) {
  const Value value = evaluate(expr);
  if (value.is_error()) return std::nullopt;
  if (const auto* dim = value.get<Dim>()) return *dim;
  report(Code::E0403, expr.span,
         "expected " + std::string(what) + " of numbers and symbols, found " + describe(value) +
             (value.is_numeric() && element_type(value) == ir::kInt ? " known at run time" : ""));
  return std::nullopt;
}

}  // namespace dr::lower
