// SPDX-License-Identifier: Apache-2.0
// From values of elaboration to ops: what is known at compile time is computed by the op's own evaluation, the rest is
// emitted. Also the words that messages use for values.
#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <limits>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

// ---- words ----

std::string Elaborator::describe(const TypeValue& type) const {
  switch (type.kind) {
    case TypeValue::Kind::Element: return type.element.str();
    case TypeValue::Kind::Struct: {
      const ModuleInfo* module = type.structure->module;
      std::string text = (module && !module->is_root ? module->name() + "." : "") + type.structure->name;
      for (size_t i = 0; i < type.generics.size(); ++i) {
        const auto* generic = type.generics[i].get<TypeValue>();
        const auto* dim = type.generics[i].get<Dim>();
        text += (i == 0 ? "<" : ", ") + (generic ? describe(*generic) : dim ? dim->str() : std::string("?"));
      }
      return text + (type.generics.empty() ? "" : ">");
    }
    case TypeValue::Kind::Tuple: {
      std::string text;
      for (const TypeValue& element : type.elements) text += (text.empty() ? "(" : ", ") + describe(element);
      return (text.empty() ? "(" : text) + ")";
    }
    case TypeValue::Kind::Array:
      return "array<" + (type.elements.empty() ? std::string("?") : describe(type.elements[0])) + ", " +
             std::to_string(type.count) + ">";
    case TypeValue::Kind::Function: return "a function";
    case TypeValue::Kind::Other: return "something else";
  }
  DR_ICE("a type of no kind");
}

TypeValue Elaborator::type_of(const Value& value) const {
  TypeValue type;
  if (value.is_numeric()) {
    type.kind = TypeValue::Kind::Element;
    type.element = element_type(value);
  } else if (const auto* s = value.get<StructValue>()) {
    type.kind = TypeValue::Kind::Struct;
    type.structure = s->type;
    type.generics = s->generics;
  } else if (const auto* t = value.get<TupleValue>()) {
    type.kind = TypeValue::Kind::Tuple;
    for (const Value& item : t->items) type.elements.push_back(type_of(item));
  } else if (const auto* a = value.get<ArrayValue>()) {
    type.kind = TypeValue::Kind::Array;
    type.count = static_cast<int64_t>(a->items.size());
    if (!a->items.empty()) type.elements.push_back(type_of(a->items[0]));
  } else if (value.is<FunctionValue>() || value.is<BuiltinValue>()) {
    type.kind = TypeValue::Kind::Function;
  }
  return type;
}

std::string Elaborator::describe_element(const Value& value) const {
  if (value.is<Nothing>()) return "no value";
  if (value.is<ModuleValue>()) return "a module";
  if (value.is<OptimizerValue>()) return "an optimizer";
  if (value.is<StringValue>()) return "a string";
  if (value.is<TypeValue>()) return "a type";
  if (value.is_error()) return "an error";
  return describe(type_of(value));
}

std::string Elaborator::describe(const Value& value) const {
  return describe_element(value) + (value.is<Image>() ? extent_of(value).str() : "");
}

Type Elaborator::element_type(const Value& value) const {
  if (const auto* image = value.get<Image>()) return b_.value(image->id).type;
  if (const auto* constant = value.get<Constant>()) return constant->type;
  DR_ASSERT(value.is<Dim>());
  return ir::kInt;
}

Extent Elaborator::extent_of(const Value& value) const {
  if (const auto* image = value.get<Image>()) return b_.value(image->id).extent;
  if (const auto* constant = value.get<Constant>()) return constant->extent;
  return {};
}

std::string Elaborator::label(const Value& value, std::string_view otherwise) const {
  if (const auto* image = value.get<Image>(); image && !b_.value(image->id).name.empty())
    return "'" + b_.value(image->id).name + "'";
  return std::string(otherwise);
}

void Elaborator::set_name(const Value& value, const std::string& name) {
  if (const auto* image = value.get<Image>()) {
    if (b_.value(image->id).name.empty()) b_.set_name(image->id, name);
    return;
  }
  const std::vector<Value>& parts = parts_of(value);
  for (size_t i = 0; i < parts.size(); ++i) set_name(parts[i], name + "." + part_name(value, i));
}

// ---- emission ----

namespace {

bool fits_int(int64_t number) {
  return number >= std::numeric_limits<int32_t>::min() && number <= std::numeric_limits<int32_t>::max();
}

// Whether shaders can compute it: each number of the expression has 32 bits.
bool has_int_numbers(const Dim& dim) {
  const std::string text = dim.str();
  for (size_t k = 0; k < text.size(); ++k) {
    const bool begins = std::isdigit(static_cast<unsigned char>(text[k])) &&
                        (k == 0 || (!std::isalnum(static_cast<unsigned char>(text[k - 1])) && text[k - 1] != '_'));
    if (!begins) continue;
    int64_t number = 0;
    const auto [end, error] = std::from_chars(text.data() + k, text.data() + text.size(), number);
    if (error != std::errc{} || !fits_int(number)) return false;
  }
  return true;
}

}  // namespace

ValueId Elaborator::materialize(const Value& value) {
  if (const auto* image = value.get<Image>()) return image->id;
  if (const auto* constant = value.get<Constant>()) {
    const ValueId id = ops::constant(b_, constant->type, constant->components);
    return in_region() || constant->extent.is_unit() ? id : ops::broadcast(b_, id, constant->extent);
  }
  DR_ASSERT(value.is<Dim>());
  const Dim& dim = value.as<Dim>();
  if (dim.is_constant() ? !fits_int(dim.constant()) : !has_int_numbers(dim)) {
    report(Code::E0318, span_, "expected a number that fits int, found " + dim.str());
    return ops::constant(b_, ir::kInt, 0.0);
  }
  if (!dim.is_constant()) return ops::dim_value(b_, dim);
  return ops::constant(b_, ir::kInt, static_cast<double>(dim.constant()));
}

uint32_t Elaborator::element_depth(std::span<const Value> values) const {
  uint32_t depth = 0;
  const auto include = [&](const Value& leaf) {
    const auto* image = leaf.get<Image>();
    if (image && image->element != 0 && (depth == 0 || image->element < depth)) depth = image->element;
  };
  for (const Value& value : values) {
    if (value.is_numeric()) {
      include(value);
    } else {
      for_each_leaf(value, include);
    }
  }
  return depth;
}

Image Elaborator::image(ValueId id, std::initializer_list<const Value*> from) const {
  std::vector<Value> values;
  for (const Value* value : from) values.push_back(*value);
  return {id, element_depth(values)};
}

// An element-wise op on values of matching types. What the callers have not checked, the op's own rule does.
Value Elaborator::apply(OpKind kind, std::vector<Value> operands, ir::Attrs attrs) {
  if (std::ranges::any_of(operands, contains_error)) return Error{};
  const ops::OpInfo& info = ops::info(kind);
  std::vector<ir::ResultType> types;
  types.reserve(operands.size());
  for (const Value& operand : operands) {
    ir::ResultType& type = types.emplace_back();
    type.type = element_type(operand);
    type.extent = extent_of(operand);
  }
  if (!check_extents(operands, span_)) return Error{};
  // An int of the compiler has 64 bits, one of the graph 32. A float takes any, a uint the bits of either.
  const bool to_uint = kind == OpKind::Convert && attrs.ints[0] == static_cast<int64_t>(Scalar::Uint);
  for (const Value& operand : operands) {
    const auto* dim = operand.get<Dim>();
    if (!dim || !dim->is_constant() || fits_int(dim->constant()) || (kind == OpKind::Convert && !to_uint)) continue;
    if (to_uint && dim->constant() >= 0 && dim->constant() <= std::numeric_limits<uint32_t>::max()) continue;
    return fail(Code::E0318, span_,
                std::string("expected a number that fits ") + (to_uint ? "uint" : "int") + ", found " + dim->str());
  }
  const ops::InferResult inferred = info.infer({types, attrs});
  if (const auto* message = std::get_if<std::string>(&inferred)) return fail(Code::E0322, span_, *message);
  const std::vector<ir::ResultType>& results = std::get<std::vector<ir::ResultType>>(inferred);
  const Type type = results[0].type;

  const bool known = std::ranges::all_of(operands, is_known);
  if (known && info.shape == ops::Shape::Elementwise && info.eval) {
    std::vector<std::vector<double>> components;
    std::vector<const double*> planes;
    std::vector<Type> operand_types;
    for (size_t i = 0; i < operands.size(); ++i) {
      components.push_back(*known_components(operands[i]));
      operand_types.push_back(types[i].type);
    }
    for (const auto& plane : components) planes.push_back(plane.data());
    std::vector<double> result(static_cast<size_t>(type.components()));
    info.eval({.n = 1,
               .operands = planes,
               .operand_types = operand_types,
               .attrs = attrs,
               .result_type = type,
               .result = result.data()});
    // NaN and Inf are left to run time: they are then made where the program says.
    if (std::ranges::all_of(result, [](double x) { return std::isfinite(x); }))
      return stretched(make_constant(type, std::move(result)), results[0].extent);
  }
  const uint32_t element = element_depth(operands);
  std::vector<ValueId> ids;
  ids.reserve(operands.size());
  for (const Value& operand : operands) ids.push_back(materialize(operand));
  const ir::OpId op = b_.add(kind, std::move(ids), results, std::move(attrs));
  return Image{b_.graph().op(op).results[0], element};
}

// ---- conversions ----

// An int that is known at compile time is taken as what it meets.
bool Elaborator::convert_known_int(Value& value, Scalar to) {
  const auto* dim = value.get<Dim>();
  if (!dim || (to != Scalar::Float && to != Scalar::Uint)) return false;
  if (dim->is_constant()) {
    if (to == Scalar::Uint && (dim->constant() < 0 || dim->constant() > std::numeric_limits<uint32_t>::max()))
      return false;
    value = Constant{{to, 1, 1}, {static_cast<double>(dim->constant())}};
    return true;
  }
  value = convert_scalar(value, to);
  return true;
}

Value Elaborator::convert_scalar(const Value& value, Scalar to) {
  if (value.is_error()) return value;
  const Type type = element_type(value);
  if (type.scalar == to) return value;
  ir::Attrs attrs;
  attrs.ints = {static_cast<int64_t>(to)};
  return apply(OpKind::Convert, {value}, std::move(attrs));
}

bool Elaborator::unify_scalars(std::vector<Value>& values) {
  std::optional<Scalar> to;
  for (const Value& value : values) {
    if (value.is<Dim>()) continue;
    const Scalar scalar = element_type(value).scalar;
    if (!to || scalar == Scalar::Float) to = scalar;
  }
  if (!to) return true;
  bool same = true;
  for (Value& value : values) {
    convert_known_int(value, *to);
    same = same && element_type(value).scalar == *to;
  }
  return same;
}

bool Elaborator::unify_rows(std::vector<Value>& values) {
  Type wanted;
  for (const Value& value : values) {
    const Type type = element_type(value);
    if (type.components() > wanted.components()) wanted = type;
  }
  for (Value& value : values) {
    const Type type = element_type(value);
    if (type.is_scalar() && wanted.is_vector()) value = splat(value, wanted);
    if (value.is_error()) return true;
    const Type now = element_type(value);
    if (now.rows != wanted.rows || now.cols != wanted.cols) return false;
  }
  return true;
}

Value Elaborator::to_float(const Value& value) {
  Value converted = value;
  convert_known_int(converted, Scalar::Float);
  return converted;
}

bool Elaborator::check_extents(std::span<const Value> values, const Span& span) {
  // Mostly there is nothing to compare.
  const Extent* first = nullptr;
  const bool alike = std::ranges::all_of(values, [&](const Value& value) {
    const auto* operand = value.get<Image>();
    const auto* constant = value.get<Constant>();
    if (!operand && !constant) return true;
    const Extent& extent = operand ? b_.value(operand->id).extent : constant->extent;
    if (!first) first = &extent;
    return extent == *first || extent.is_unit();
  });
  if (alike) return true;
  Extent common;
  constexpr std::string_view kAxes[] = {"width", "height", "layers"};
  for (size_t i = 0; i < values.size(); ++i) {
    const Extent extent = extent_of(values[i]);
    if (const auto both = ir::broadcast(common, extent)) {
      common = *both;
      continue;
    }
    // Name the earlier operand that disagrees, and the first axis on which it does.
    for (size_t k = 0; k < i; ++k) {
      const Extent other = extent_of(values[k]);
      const Dim* a[] = {&other.w, &other.h, &other.l};
      const Dim* b[] = {&extent.w, &extent.h, &extent.l};
      for (size_t axis = 0; axis < 3; ++axis) {
        if (a[axis]->is_one() || b[axis]->is_one() || *a[axis] == *b[axis]) continue;
        const std::string what(kAxes[axis]);
        const bool raster = in_region() && regions_.back().what == "'raster'";
        report(Code::E0401, span,
               "the " + what + " " + a[axis]->str() + " of " + label(values[k], describe(values[k])) +
                   " does not match the " + what + " " + b[axis]->str() + " of " +
                   label(values[i], describe(values[i])),
               {}, raster ? "what belongs to a face is returned by 'setup'" : "");
        return false;
      }
    }
    return false;
  }
  return true;
}

// ---- vectors ----

Value Elaborator::splat(const Value& value, const Type& type) {
  if (value.is_error() || type.is_scalar()) return value;
  ir::Attrs attrs;
  attrs.ints = {type.rows};
  return apply(OpKind::Splat, {value}, std::move(attrs));
}

Value Elaborator::component(const Value& value, int index) {
  if (value.is_error()) return value;
  if (element_type(value).is_scalar()) return value;
  ir::Attrs attrs;
  attrs.ints = {index};
  return apply(OpKind::Extract, {value}, std::move(attrs));
}

Value Elaborator::compose(std::vector<Value> parts, const Type& type) {
  if (parts.size() == 1) return parts[0];
  ir::Attrs attrs;
  attrs.ints = {type.rows, type.cols};
  return apply(OpKind::Compose, std::move(parts), std::move(attrs));
}

Value Elaborator::swizzle(const Value& value, std::span<const int> indices) {
  const Type type = element_type(value);
  bool whole = indices.size() == static_cast<size_t>(type.rows);
  for (size_t i = 0; i < indices.size(); ++i) whole = whole && indices[i] == static_cast<int>(i);
  if (whole) return value;
  if (type.is_scalar()) return splat(value, ir::vec(static_cast<int>(indices.size()), type.scalar));
  std::vector<Value> parts;
  for (const int index : indices) parts.push_back(component(value, index));
  return compose(std::move(parts), ir::vec(static_cast<int>(indices.size()), type.scalar));
}

Value Elaborator::broadcast(const Value& value, const Extent& extent) {
  // Inside a region everything is one element's and stretches by itself.
  if (value.is_error() || extent_of(value) == extent || in_region()) return value;
  return image(ops::broadcast(b_, materialize(value), extent), {&value});
}

Value Elaborator::stretched(const Value& value, const Extent& extent) {
  if (in_region() || !value.is_numeric()) return value;
  const auto both = ir::broadcast(extent_of(value), extent);
  if (!both) return value;  // told of where they meet
  const auto* constant = value.get<Constant>();
  return constant ? Value(Constant{constant->type, constant->components, *both}) : broadcast(value, *both);
}

Value Elaborator::select(const Value& condition, const Value& a, const Value& b) {
  return apply(OpKind::Select, {condition, a, b});
}

Value Elaborator::arithmetic(OpKind kind, const Value& a, const Value& b) {
  std::vector<Value> operands{a, b};
  if (contains_error(a) || contains_error(b)) return Error{};
  unify_scalars(operands);
  unify_rows(operands);
  return apply(kind, std::move(operands));
}

Value Elaborator::dot(const Value& a, const Value& b) {
  if (a.is_error() || b.is_error()) return Error{};
  return element_type(a).is_scalar() ? mul(a, b) : apply(OpKind::Dot, {a, b});
}

// ---- places ----

bool Elaborator::refuse_in_region(std::string_view what, const Span& span) {
  if (!in_region()) return false;
  const RegionFrame& region = regions_.back();
  report(Code::E0701, span,
         "expected arithmetic on elements inside " + std::string(region.what) + ", found " + std::string(what) +
             ", which needs whole images",
         {{region.span, "the " + std::string(region.what.substr(1, region.what.size() - 2)) + " is here"}},
         "compute it before with 'let'");
  return true;
}

bool Elaborator::refuse_element(const Value& value, std::string_view what, const Span& span) {
  const auto* operand = value.get<Image>();
  if (!operand || operand->element == 0) return false;
  const Type type = element_type(value);
  report(Code::E0702, span,
         "expected a whole image for " + std::string(what) + ", found " + label(value, "a value") +
             ", which is one element inside this function",
         {},
         "give the parameters that it is made of an extent, such as " + type.str() +
             "[W, H], or float[1] for a number that "
             "all elements share");
  return true;
}

std::optional<Extent> Elaborator::region_domain(Extent domain, std::span<const ir::RegionId> regions,
                                                const Span& span) {
  const auto include = [&](ValueId id) {
    const ir::ValueInfo& info = b_.value(id);
    if (info.accumulation) return true;
    const auto both = ir::broadcast(domain, info.extent);
    if (!both) {
      report(Code::E0408, span,
             "expected parts of one extent in the region, found " + domain.str() + " and " + info.extent.str());
      return false;
    }
    domain = *both;
    return true;
  };
  for (const ir::RegionId region : regions) {
    forget_outside(region);
    for (const ir::OpId op : b_.graph().region(region).ops) {
      for (const ValueId result : b_.graph().op(op).results) {
        if (!include(result)) return std::nullopt;
      }
    }
    for (const ValueId yield : b_.graph().region(region).yields) {
      if (!include(yield)) return std::nullopt;
    }
  }
  return domain;
}

}  // namespace dr::lower
