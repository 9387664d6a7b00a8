// SPDX-License-Identifier: Apache-2.0
// Walking and comparing the values of elaboration.
#include "compiler/lower/value.h"

#include <algorithm>

namespace dr::lower {

Value make_constant(ir::Type type, std::vector<double> components) {
  if (type == ir::kInt) return ir::Dim(static_cast<int64_t>(components[0]));
  return Constant{type, std::move(components)};
}

Value make_float(double number) { return Constant{ir::kFloat, {number}}; }

Value make_bool(bool truth) { return Constant{ir::kBool, {truth ? 1.0 : 0.0}}; }

std::optional<int64_t> known_int(const Value& value) {
  const auto* dim = value.get<ir::Dim>();
  if (!dim || !dim->is_constant()) return std::nullopt;
  return dim->constant();
}

std::optional<bool> known_bool(const Value& value) {
  const auto* constant = value.get<Constant>();
  if (!constant || constant->type != ir::kBool) return std::nullopt;
  return constant->components[0] != 0;
}

bool is_known(const Value& value) { return value.is<Constant>() || known_int(value).has_value(); }

std::optional<std::vector<double>> known_components(const Value& value) {
  if (const auto number = known_int(value)) return std::vector<double>{static_cast<double>(*number)};
  if (const auto* constant = value.get<Constant>()) return constant->components;
  return std::nullopt;
}

std::vector<std::string> names_of(const ModuleItems& items, const std::function<bool(const ModuleItem&)>& which) {
  std::vector<std::string> names;
  for (const auto& [name, item] : items) {
    if (which(item)) names.push_back(name);
  }
  std::ranges::sort(names);
  return names;
}

std::string listed(const std::vector<std::string>& names) {
  std::string text;
  for (size_t k = 0; k < names.size(); ++k)
    text += (k == 0 ? "'" : k + 1 == names.size() ? " and '" : ", '") + names[k] + "'";
  return text;
}

const std::vector<Value>& parts_of(const Value& value) {
  static const std::vector<Value> kNone;
  if (const auto* s = value.get<StructValue>()) return s->fields;
  if (const auto* t = value.get<TupleValue>()) return t->items;
  if (const auto* a = value.get<ArrayValue>()) return a->items;
  return kNone;
}

Value with_parts(const Value& value, std::vector<Value> parts) {
  if (const auto* s = value.get<StructValue>()) return StructValue{s->type, s->generics, std::move(parts)};
  if (value.is<TupleValue>()) return TupleValue{std::move(parts)};
  DR_ASSERT(value.is<ArrayValue>());
  return ArrayValue{std::move(parts)};
}

std::string part_name(const Value& value, size_t i) {
  if (const auto* s = value.get<StructValue>()) return s->type->fields[i];
  return std::to_string(i);
}

Value map_leaves(const Value& value, const std::function<Value(const Value&)>& f) {
  if (!value.is_composite()) return f(value);
  std::vector<Value> parts;
  for (const Value& part : parts_of(value)) parts.push_back(map_leaves(part, f));
  return with_parts(value, std::move(parts));
}

void for_each_leaf(const Value& value, const std::function<void(const Value&)>& f) {
  if (!value.is_composite()) return f(value);
  for (const Value& part : parts_of(value)) for_each_leaf(part, f);
}

bool contains_error(const Value& value) {
  if (value.is_error()) return true;
  return std::ranges::any_of(parts_of(value), [](const Value& part) { return contains_error(part); });
}

bool same_value(const Value& a, const Value& b) {
  if (a.data.index() != b.data.index()) return false;
  if (const auto* x = a.get<Image>()) return x->id == b.as<Image>().id;
  if (const auto* x = a.get<Constant>()) return *x == b.as<Constant>();
  if (const auto* x = a.get<ir::Dim>()) return *x == b.as<ir::Dim>();
  if (const auto* x = a.get<StringValue>()) return x->text == b.as<StringValue>().text;
  if (const auto* x = a.get<ModuleValue>()) return x->module == b.as<ModuleValue>().module;
  if (const auto* x = a.get<OptimizerValue>()) {
    return x->decl == b.as<OptimizerValue>().decl && x->scope == b.as<OptimizerValue>().scope;
  }
  if (const auto* x = a.get<TypeValue>()) return same_type(*x, b.as<TypeValue>());
  const auto all_same = [](const std::vector<Value>& x, const std::vector<Value>& y) {
    return std::ranges::equal(x, y, same_value);
  };
  if (const auto* x = a.get<FunctionValue>()) {
    const auto& y = b.as<FunctionValue>();
    return x->decl == y.decl && x->scope == y.scope && all_same(x->self, y.self);
  }
  if (const auto* x = a.get<BuiltinValue>()) {
    const auto& y = b.as<BuiltinValue>();
    return x->entry == y.entry && all_same(x->self, y.self);
  }
  if (const auto* x = a.get<StructValue>(); x && x->type != b.as<StructValue>().type) return false;
  return all_same(parts_of(a), parts_of(b));
}

bool same_type(const TypeValue& a, const TypeValue& b) {
  if (a.kind != b.kind) return false;
  switch (a.kind) {
    case TypeValue::Kind::Element: return a.element == b.element;
    case TypeValue::Kind::Struct:
      return a.structure == b.structure && std::ranges::equal(a.generics, b.generics, same_value);
    case TypeValue::Kind::Tuple: return std::ranges::equal(a.elements, b.elements, same_type);
    case TypeValue::Kind::Array: return a.count == b.count && std::ranges::equal(a.elements, b.elements, same_type);
    case TypeValue::Kind::Function: return true;
    case TypeValue::Kind::Other: return false;
  }
  DR_ICE("a type of no kind");
}

Binding* Scope::find(std::string_view name) {
  // The latest first: a name of an inner loop is more likely asked for than an early one.
  for (auto it = names.rbegin(); it != names.rend(); ++it) {
    if (it->first == name) return &it->second;
  }
  return nullptr;
}

}  // namespace dr::lower
