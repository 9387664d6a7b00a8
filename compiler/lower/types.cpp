// SPDX-License-Identifier: Apache-2.0
// Declared types against values: generic names and names of extents are bound by what they meet first and must agree
// afterwards. `scope_` is the scope in which the declaration's names live.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

std::string TypeMatch::subject() const {
  const std::string_view nameless = role.empty() ? "the value" : "this function";
  return part + std::string(role) + (name.empty() ? std::string(nameless) : "'" + std::string(name) + "'");
}

std::vector<dsl::Note> TypeMatch::notes() const {
  if (!declared.valid()) return {};
  return {
      {declared, role.empty() ? "'" + std::string(name) + "' is declared here" : "the result type is declared here"}};
}

// What a type's name stands for, without its arguments and extents.
std::optional<Value> Elaborator::type_name(const dsl::TypeExpr& type) {
  TypeValue value;
  if (type.kind == dsl::TypeExpr::Kind::Tuple) {
    value.kind = TypeValue::Kind::Tuple;
    return value;
  }
  if (type.kind == dsl::TypeExpr::Kind::Function) {
    value.kind = TypeValue::Kind::Function;
    return value;
  }
  if (type.path.empty()) return std::nullopt;  // the parser has said why
  const dsl::Name& first = type.path[0];
  const auto& items = scope_->module->items;
  const bool declared = find_binding(first.text) || items.contains(first.text);
  if (!declared && type.path.size() == 1) {
    if (const auto element = Type::parse(first.text)) {
      value.kind = TypeValue::Kind::Element;
      value.element = *element;
      return value;
    }
    if (first.text == "array") {
      value.kind = TypeValue::Kind::Array;
      return value;
    }
    if (first.text == "topology" || first.text == "fragment") {
      value.kind = TypeValue::Kind::Struct;
      value.structure = first.text == "topology" ? &topology_type(false) : &fragment_type();
      return value;
    }
  }
  if (!declared) {
    std::vector<std::string> known = type_names();
    known.insert(known.end(), {"array", "fragment", "topology"});
    const std::vector<std::string> structs =
        names_of(items, [](const ModuleItem& item) { return item.kind == ModuleItem::Kind::Struct; });
    known.insert(known.end(), structs.begin(), structs.end());
    report(Code::E0310, first.span, "expected the name of a type, found '" + first.text + "'", {},
           suggestion(first.text, known));
    return std::nullopt;
  }
  Value found = name_value(first.text, first.span);
  for (size_t i = 1; i < type.path.size(); ++i) found = field_of(found, type.path[i].text, type.path[i].span, nullptr);
  if (found.is<TypeValue>()) return found;
  if (found.is_error() && diagnostics_.has_errors()) return std::nullopt;
  // A leaf that is declared further down has no value yet, which is no error of its own.
  report(Code::E0310, type.span,
         "expected a type, found " + (found.is_error() ? "'" + first.text + "'" : describe(found)));
  return std::nullopt;
}

bool Elaborator::mismatch(const Value& value, const std::string& wanted, TypeMatch& how) {
  std::string help;
  if (value.is<Image>() && element_type(value) == ir::kInt && wanted == "float") help = "convert it with float(...)";
  report(how.code, how.span, "expected " + how.subject() + " to be " + wanted + ", found " + describe_element(value),
         how.notes(), std::move(help));
  return false;
}

// `_` among a parameter's extents: several images of one type may each have their own.
bool Elaborator::is_any_extent(const Expr& extent) { return extent.kind == Expr::Kind::NameRef && extent.name == "_"; }

// A name in an extent that nothing outside the declaration gives a meaning to.
bool Elaborator::may_bind(std::string_view name, const TypeMatch& how) const {
  if (!how.bind_extents) return false;
  if (scope_->find(name)) return true;
  for (const Scope* scope = scope_->parent; scope; scope = scope->parent) {
    for (const auto& [other, binding] : scope->names) {
      if (other == name) return false;
    }
  }
  const auto item = scope_->module->items.find(name);
  return item == scope_->module->items.end() || item->second.kind == ModuleItem::Kind::Symbol;
}

bool Elaborator::match_extent(const Dim& actual, const Expr& wanted, int axis, TypeMatch& how, Dim* stretched) {
  Dim dim;
  if (how.bind_extents && is_any_extent(wanted)) {
    *stretched = actual;
    return true;
  }
  if (wanted.kind == Expr::Kind::NameRef && may_bind(wanted.name, how)) {
    const Binding* bound = scope_->find(wanted.name);
    if (!bound) {
      define(*scope_, {wanted.name, wanted.span}, actual);
      *stretched = actual;
      return true;
    }
    const auto* known = bound->value.get<Dim>();
    if (!known) {
      report(Code::E0403, wanted.span, "expected an extent of numbers and symbols, found " + describe(bound->value));
      return false;
    }
    dim = *known;
  } else {
    const auto known = evaluate_dim(wanted, "an extent");
    if (!known) return false;
    dim = *known;
  }
  *stretched = dim;
  if (actual == dim || (how.stretch && actual.is_one())) return true;
  constexpr std::string_view kAxes[] = {"width", "height", "layers"};
  report(Code::E0402, how.span,
         "expected the " + std::string(kAxes[axis]) + " of " + how.subject() + " to be " + dim.str() + ", found " +
             actual.str(),
         how.notes());
  return false;
}

std::optional<Value> Elaborator::match(const Value& value, const dsl::TypeExpr& type, TypeMatch& how) {
  if (contains_error(value)) return std::nullopt;
  switch (type.kind) {
    case dsl::TypeExpr::Kind::Tuple: return match_tuple(value, type, how);
    case dsl::TypeExpr::Kind::Function:
      // A type is a function too: its constructor.
      if (value.is<FunctionValue>() || value.is<BuiltinValue>() || value.is<TypeValue>()) return value;
      mismatch(value, "a function", how);
      return std::nullopt;
    case dsl::TypeExpr::Kind::Named: return match_named(value, type, how);
  }
  DR_ICE("a type expression of no kind");
}

std::optional<Value> Elaborator::match_tuple(const Value& value, const dsl::TypeExpr& type, TypeMatch& how) {
  const auto* tuple = value.get<TupleValue>();
  if (!tuple || tuple->items.size() != type.elements.size()) {
    mismatch(value, "a tuple of " + std::to_string(type.elements.size()), how);
    return std::nullopt;
  }
  TupleValue result;
  const std::string part = how.part;
  for (size_t i = 0; i < tuple->items.size(); ++i) {
    how.part = "element " + std::to_string(i) + " of " + part;
    auto item = match(tuple->items[i], *type.elements[i], how);
    if (!item) return std::nullopt;
    result.items.push_back(*std::move(item));
  }
  how.part = part;
  return result;
}

std::optional<Value> Elaborator::match_named(const Value& value, const dsl::TypeExpr& type, TypeMatch& how) {
  // A generic name that stands for nothing yet takes the type that it meets.
  if (type.path.size() == 1 && how.generics && !scope_->find(type.path[0].text)) {
    const auto is_it = [&](const dsl::Name& generic) { return generic.text == type.path[0].text; };
    if (std::ranges::any_of(*how.generics, is_it)) {
      const TypeValue found = type_of(value);
      if (found.kind == TypeValue::Kind::Other) {
        mismatch(value, "a value", how);
        return std::nullopt;
      }
      define(*scope_, type.path[0], found);
    }
  }
  const auto resolved = type_name(type);
  if (!resolved) return std::nullopt;
  const auto& wanted = resolved->as<TypeValue>();
  const bool is_array = wanted.kind == TypeValue::Kind::Array && type.path.size() == 1 && type.path[0].text == "array";
  return is_array ? match_array(value, type, how) : match_type_value(value, wanted, type, how);
}

std::optional<Value> Elaborator::match_array(const Value& value, const dsl::TypeExpr& type, TypeMatch& how) {
  if (type.type_args.empty() || type.type_args.size() > 2 || !type.type_args[0]) {
    report(Code::E0311, type.span, "expected array<type, length>, found another list of arguments");
    return std::nullopt;
  }
  const auto* array = value.get<ArrayValue>();
  if (!array) {
    mismatch(value, "an array", how);
    return std::nullopt;
  }
  ArrayValue result;
  const std::string part = how.part;
  how.part = "an item of " + part;
  for (const Value& item : array->items) {
    auto matched = match(item, *type.type_args[0], how);
    if (!matched) return std::nullopt;
    result.items.push_back(*std::move(matched));
  }
  how.part = "the length of " + part;
  if (type.type_args.size() == 2 && !match_generic_arg(Dim(static_cast<int64_t>(array->items.size())),
                                                       type.type_args[1].get(), type.value_args[1].get(), how)) {
    return std::nullopt;
  }
  how.part = part;
  return result;
}

// A generic argument, given as a type or a value, against what it has to be.
bool Elaborator::match_generic_arg(const Value& actual, const dsl::TypeExpr* type, const Expr* expr, TypeMatch& how) {
  const auto words = [&](const Value& value) {
    const auto* dim = value.get<Dim>();
    const auto* named = value.get<TypeValue>();
    return dim ? dim->str() : named ? describe(*named) : describe(value);
  };
  Value wanted;
  if (type && type->path.size() == 1 && how.generics && !scope_->find(type->path[0].text) &&
      std::ranges::any_of(*how.generics,
                          [&](const dsl::Name& generic) { return generic.text == type->path[0].text; })) {
    define(*scope_, type->path[0], actual);
    return true;
  }
  if (type) {
    // A bare name was read as a type; it may be a number all the same.
    if (type->kind == dsl::TypeExpr::Kind::Named && type->type_args.empty() && !type->has_extents &&
        !type->path.empty()) {
      wanted = name_value(type->path[0].text, type->path[0].span);
      for (size_t i = 1; i < type->path.size(); ++i)
        wanted = field_of(wanted, type->path[i].text, type->path[i].span, nullptr);
    } else {
      const auto resolved = type_name(*type);
      if (!resolved) return false;
      wanted = *resolved;
    }
  } else if (expr) {
    wanted = evaluate(*expr);
  }
  if (wanted.is_error()) return false;
  if (same_value(actual, wanted)) return true;
  report(how.code, how.span, "expected " + how.subject() + " to be " + words(wanted) + ", found " + words(actual),
         how.notes());
  return false;
}

bool Elaborator::match_generics(const StructValue& value, const dsl::TypeExpr& type, TypeMatch& how) {
  if (type.type_args.empty()) return true;
  if (type.type_args.size() != value.generics.size()) {
    report(Code::E0311, type.span,
           "expected " + std::to_string(value.generics.size()) + " arguments for the type " + value.type->name +
               ", found " + std::to_string(type.type_args.size()));
    return false;
  }
  const std::string part = how.part;
  for (size_t i = 0; i < value.generics.size(); ++i) {
    how.part = "'" + value.type->decl->generics[i].text + "' of " + part;
    if (!match_generic_arg(value.generics[i], type.type_args[i].get(), type.value_args[i].get(), how)) return false;
  }
  how.part = part;
  return true;
}

std::optional<Value> Elaborator::match_type_value(const Value& value, const TypeValue& wanted,
                                                  const dsl::TypeExpr& type, TypeMatch& how) {
  if (wanted.kind == TypeValue::Kind::Element) return match_element(value, wanted.element, type, how);
  if (wanted.kind == TypeValue::Kind::Struct) {
    const auto* s = value.get<StructValue>();
    const bool topologies = s && wanted.structure == &topology_type(false) && s->type == &topology_type(true);
    if (s && (s->type == wanted.structure || topologies) &&
        (wanted.generics.empty() || same_type(type_of(value), wanted))) {
      if (!match_generics(*s, type, how)) return std::nullopt;
      return value;
    }
  } else if (same_type(type_of(value), wanted)) {
    return value;
  }
  mismatch(value, describe(wanted), how);
  return std::nullopt;
}

std::optional<Value> Elaborator::match_element(const Value& value, const Type& wanted, const dsl::TypeExpr& type,
                                               TypeMatch& how) {
  Value fitted = value;
  if (wanted.is_scalar()) convert_known_int(fitted, wanted.scalar);
  if (fitted.is_error()) return std::nullopt;
  if (!fitted.is_numeric() || element_type(fitted) != wanted) {
    mismatch(value, wanted.str(), how);
    return std::nullopt;
  }
  if (!type.has_extents) {
    if (auto* image = fitted.get<Image>(); image && how.parameter && image->element == 0)
      image->element = static_cast<uint32_t>(frames_.size() + 1);
    return fitted;
  }
  if (const auto* image = fitted.get<Image>();
      image && image->element > 0 && how.parameter && refuse_element(fitted, how.subject(), how.span))
    return std::nullopt;
  if (how.ignore_extents) return fitted;
  const Extent extent = extent_of(fitted);
  Extent target = extent;
  const Dim* actual[] = {&extent.w, &extent.h, &extent.l};
  Dim* stretched[] = {&target.w, &target.h, &target.l};
  for (size_t axis = 0; axis < type.extents.size() && axis < 3; ++axis) {
    if (!match_extent(*actual[axis], *type.extents[axis], static_cast<int>(axis), how, stretched[axis]))
      return std::nullopt;
  }
  return how.stretch ? broadcast(fitted, target) : fitted;
}

// A value for a name that was declared with a type.
std::optional<Value> Elaborator::declared(const Value& value, const dsl::TypeExpr& type, std::string_view name,
                                          const Span& span) {
  TypeMatch how;
  how.code = Code::E0309;
  how.name = name;
  how.span = span;
  how.stretch = true;
  return match(value, type, how);
}

}  // namespace dr::lower
