// SPDX-License-Identifier: Apache-2.0
// Built-in functions of whole images, gradients, and arrays.
#include <algorithm>
#include <charconv>
#include <functional>
#include <map>
#include <ranges>
#include <set>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

// An op that is not element-wise. The callers speak to the user; what they miss, the op's own rule says.
Value Elaborator::image_op(OpKind kind, std::span<const Value> operands, ir::Attrs attrs,
                           std::span<const Value> elements_of) {
  std::vector<ir::ResultType> types;
  for (const Value& operand : operands) {
    if (operand.is_error()) return Error{};
    types.push_back({element_type(operand), extent_of(operand)});
  }
  const ops::InferResult inferred = ops::info(kind).infer({types, attrs});
  if (const auto* message = std::get_if<std::string>(&inferred))
    return fail(Code::E0322, span_, "'" + std::string(ir::op_name(kind)) + "': " + *message);
  std::vector<ValueId> ids;
  for (const Value& operand : operands) ids.push_back(materialize(operand));
  return Image{ops::emit(b_, kind, std::move(ids), std::move(attrs)), element_depth(elements_of)};
}

// ---- indexed reads and writes ----

// A value outside of all regions, or what is computed in one of such values alone: computed once more before it, since
// all of an image may be read of it then. Invalid for what depends on the region's own.
ValueId Elaborator::outside(ValueId value) {
  const ir::ValueInfo& info = b_.value(value);
  if (info.region == b_.graph().root()) return value;
  if (const auto found = outside_.find(value); found != outside_.end()) return found->second;
  ValueId& out = outside_[value];  // invalid so far
  if (!info.op.valid()) return out;
  const ir::Op op = b_.graph().op(info.op);
  if (!op.regions.empty() || op.results.size() != 1) return {};
  std::vector<ValueId> operands;
  for (const ValueId operand : op.operands) {
    operands.push_back(outside(operand));
    if (!operands.back().valid()) return {};
  }
  const ir::ResultType type{info.type, info.extent};
  b_.at_root([&] {
    outside_[value] = op.operands.empty() ? b_.graph().op(b_.add(op.kind, {}, {&type, 1}, op.attrs)).results[0]
                                          : ops::emit(b_, op.kind, std::move(operands), op.attrs);
  });
  return outside_[value];
}

// Takes out of a region what is computed outside of it instead and nothing in it names any more: its extent is not the
// region's.
void Elaborator::forget_outside(ir::RegionId region) {
  const ir::Graph& graph = b_.graph();
  const auto is_outside = [&](ir::OpId op) {
    return std::ranges::all_of(graph.op(op).results, [&](ValueId result) {
      const auto found = outside_.find(result);
      return found != outside_.end() && found->second.valid();
    });
  };
  // Most regions have none, and are not looked through.
  if (outside_.empty() || std::ranges::none_of(graph.region(region).ops, is_outside)) return;
  std::map<ValueId, size_t> uses;
  const std::function<void(ir::RegionId)> count = [&](ir::RegionId at) {
    for (const ValueId value : graph.region(at).yields) ++uses[value];
    for (const ir::OpId op : graph.region(at).ops) {
      for (const ValueId value : graph.op(op).operands) ++uses[value];
      for (const ir::RegionId inner : graph.op(op).regions) count(inner);
    }
  };
  count(region);
  std::set<ir::OpId> unused;
  for (const ir::OpId id : graph.region(region).ops | std::views::reverse) {
    const ir::Op& op = graph.op(id);
    if (!is_outside(id) || std::ranges::any_of(op.results, [&](ValueId result) { return uses[result] != 0; })) continue;
    unused.insert(id);
    for (const ValueId value : op.operands) --uses[value];
  }
  b_.remove(region, [&](ir::OpId id) { return unused.contains(id); });
}

namespace {

// Whether an index is known to name an image's first element.
bool is_zero(const Value& index) {
  const auto known = known_components(index);
  return known && std::ranges::all_of(*known, [](double component) { return component == 0; });
}

}  // namespace

bool Elaborator::is_index(const Value& value) const {
  if (!value.is_numeric()) return false;
  const Type type = element_type(value);
  return type.scalar == Scalar::Int && type.cols == 1 && type.rows <= 3;
}

Value Elaborator::gather(const Value& base, const Value& index, const Span& base_span, const Span& index_span,
                         std::string_view where) {
  if (refuse_element(base, where.substr(where.find(' ') + 1), base_span)) return Error{};
  const auto* source = base.get<Image>();
  if (in_region() && !source && base.is_numeric()) {  // known at compile time, and so outside of all regions
    ValueId there;
    b_.at_root([&] { there = materialize(base); });
    return gather(Image{there, 0}, index, base_span, index_span, where);
  }
  if (in_region() && source) {
    const ValueId there = outside(source->id);
    if (there.valid() && there != source->id) return gather(Image{there, 0}, index, base_span, index_span, where);
  }
  if (in_region() && (!source || b_.value(source->id).region != b_.graph().root())) {
    return fail(
        Code::E0703, base_span,
        "expected an image from outside " + std::string(regions_.back().what) + " " + std::string(where) +
            ", found one that is computed inside",
        {{regions_.back().span, "the region is here"}},
        "what depends on the region's own values is one element; read each image before it is computed with, or call "
        "what makes it before, with 'let'");
  }
  const Extent extent = extent_of(base);
  const std::string name = label(base, describe(base));
  if (!is_index(index)) {
    return fail(Code::E0405, index_span,
                "expected an int, ivec2 or ivec3 as the place to read, found " + describe(index));
  }
  const Type type = element_type(index);
  if (type.is_scalar() && !extent.h.is_one()) {
    return fail(Code::E0405, index_span,
                "expected an ivec2 to read " + name + ", which has the height " + extent.h.str() + ", found int", {},
                "write .at(ivec2(x, y)) for the element in column x and row y");
  }
  const Extent places = extent_of(index);
  if (type.rows < 3 && !extent.l.is_one() && !places.l.is_one() && extent.l != places.l) {
    return fail(
        Code::E0407, index_span,
        "the layers " + places.l.str() + " of the index do not match the layers " + extent.l.str() + " of " + name, {},
        "name the layer with an ivec3");
  }
  if (const auto* constant = base.get<Constant>(); constant && extent.is_unit() && is_zero(index))
    return stretched(base, places);
  const Value operands[] = {base, index};
  return image_op(OpKind::Gather, operands, {}, {&index, 1});
}

Value Elaborator::builtin_at(BuiltinCall& call) {
  return gather(call.args[0], call.args[1], call.spans[0], call.spans[1]);
}

// One layer, read in place.
Value Elaborator::builtin_layer(BuiltinCall& call) {
  const Value &base = call.args[0], &layer = call.args[1];
  if (!layer.is_numeric() || element_type(layer) != ir::kInt) {
    return fail(Code::E0405, call.spans[1], "expected an int as the layer to read, found " + describe(layer));
  }
  if (refuse_element(base, "'.layer'", call.spans[0])) return Error{};
  const Extent extent{extent_of(base).w, extent_of(base).h, 1};
  const auto axis = [&](int i) -> Value {
    if ((i == 0 ? extent.w : extent.h).is_one()) return Dim(0);
    return Image{ops::coord(b_, i, extent)};
  };
  const Value index = compose({axis(0), axis(1), layer}, ir::vec(3, Scalar::Int));
  if (index.is_error()) return Error{};
  return gather(base, index, call.spans[0], call.spans[1]);
}

// scatter_add and scatter_max.
Value Elaborator::builtin_scatter(BuiltinCall& call) {
  const bool largest = call.entry.kind == OpKind::ScatterMax;
  const std::string name = "'" + std::string(call.entry.name) + "'";
  if (refuse_in_region(name, call.span)) return Error{};
  for (size_t i = 0; i < 2; ++i) {
    if (refuse_element(call.args[i], name, call.spans[i])) return Error{};
  }
  if (!is_index(call.args[0])) {
    return fail(Code::E0405, call.spans[0],
                std::string("expected ints, ivec2s or ivec3s as the places to ") + (largest ? "write" : "add") +
                    " to, found " + describe(call.args[0]));
  }
  const Value& value = call.args[1];
  if (!value.is_numeric() || element_type(value).is_bool()) return wrong_type(call, 1, largest ? "ints" : "numbers");
  if (largest && element_type(value).scalar != Scalar::Int) return wrong_type(call, 1, "ints");
  ir::Attrs attrs;
  attrs.dims = {1, 1, 1};
  for (size_t i = 2; i < call.args.size(); ++i) {
    const auto* dim = call.args[i].get<Dim>();
    if (!dim)
      return fail(Code::E0403, call.spans[i],
                  "expected an extent of numbers and symbols, found " + describe(call.args[i]));
    attrs.dims[i - 2] = *dim;
  }
  if (!check_extents(call.args, call.span)) return Error{};
  const Value operands[] = {call.args[0], call.args[1]};
  return image_op(call.entry.kind, operands, std::move(attrs), operands);
}

Value Elaborator::builtin_shift(BuiltinCall& call) {
  if (refuse_in_region("'shift'", call.span) || refuse_element(call.args[0], "'shift'", call.spans[0])) return Error{};
  if (!is_image_value(call.args[0], call.spans[0], "'shift'")) return Error{};
  ir::Attrs attrs;
  for (size_t i = 1; i < 3; ++i) {
    const auto offset = known_int(call.args[i]);
    if (!offset) {
      return fail(Code::E0501, call.spans[i],
                  "expected an int known at compile time as the offset of 'shift', found " + describe(call.args[i]), {},
                  "read with x.at(coord(W, H).xy + d) for an offset known at run time");
    }
    if (*offset < -(int64_t{1} << 24) || *offset > int64_t{1} << 24) {
      return fail(Code::E0318, call.spans[i],
                  "expected an offset of at most 16777216, found " + std::to_string(*offset));
    }
    attrs.ints.push_back(*offset);
  }
  return image_op(OpKind::Shift, {&call.args[0], 1}, std::move(attrs), {});
}

// ---- reductions ----

// The axes named by `over`, or all.
std::optional<std::array<bool, 3>> Elaborator::reduction_axes(const BuiltinCall& call) {
  std::array<bool, 3> axes{true, true, true};
  const Expr* over = word_argument(call, "over");
  if (!over) return axes;
  axes = {};
  std::vector<const Expr*> words;
  if (over->kind == Expr::Kind::Tuple) {
    for (const dsl::ExprPtr& item : over->items) words.push_back(item.get());
  } else {
    words.push_back(over);
  }
  static const std::vector<std::string> kNames = {"x", "y", "layers"};
  for (const Expr* word : words) {
    const auto name = word->kind == Expr::Kind::NameRef ? std::ranges::find(kNames, word->name) : kNames.end();
    if (name == kNames.end()) {
      const bool named = word->kind == Expr::Kind::NameRef;
      report(Code::E0323, word->span,
             std::string("expected x, y, layers or a tuple of them after 'over', found ") +
                 (named ? "'" + word->name + "'" : "something else"),
             {}, named ? suggestion(word->name, kNames) : "");
      return std::nullopt;
    }
    axes[static_cast<size_t>(name - kNames.begin())] = true;
  }
  return axes;
}

Value Elaborator::builtin_reduction(BuiltinCall& call) {
  const Value& x = call.args[0];
  const std::string what = "'" + std::string(call.entry.name) + "'";
  const bool mean = call.entry.name == "mean";
  if (refuse_in_region(what, call.span) || refuse_element(x, what, call.spans[0])) return Error{};
  if (!x.is_numeric() || element_type(x).is_bool()) return wrong_type(call, 0, mean ? "floats" : "numbers");
  Value operand = x;
  if (mean) convert_known_int(operand, Scalar::Float);
  if (mean && !element_type(operand).is_float()) return wrong_type(call, 0, "floats");
  const auto axes = reduction_axes(call);
  if (!axes) return Error{};

  const Extent extent = extent_of(operand);
  const Dim* lengths[] = {&extent.w, &extent.h, &extent.l};
  ir::Attrs attrs;
  Dim count = 1;
  for (size_t i = 0; i < 3; ++i) {
    const bool taken = (*axes)[i] && !lengths[i]->is_one();
    attrs.ints.push_back(taken ? 1 : 0);
    if (taken) count = count * *lengths[i];
  }
  if (std::ranges::count(attrs.ints, 1) == 0) return operand;
  OpKind kind = OpKind::ReduceSum;
  if (call.entry.name == "min") kind = OpKind::ReduceMin;
  if (call.entry.name == "max") kind = OpKind::ReduceMax;
  const auto reduce = [&](const Value& part) { return image_op(kind, {&part, 1}, attrs, {}); };
  Value reduced = element_type(operand).is_matrix() ? map_columns(operand, reduce) : reduce(operand);
  if (!mean || reduced.is_error()) return reduced;
  Value divisor = count;
  convert_known_int(divisor, Scalar::Float);
  if (element_type(reduced).is_matrix()) return matrix_scalar(OpKind::Div, reduced, divisor);
  return arithmetic(OpKind::Div, reduced, divisor);
}

Value Elaborator::builtin_coord(BuiltinCall& call) {
  Extent extent;
  Dim* axes[] = {&extent.w, &extent.h, &extent.l};
  for (size_t i = 0; i < call.args.size(); ++i) {
    const auto* dim = call.args[i].get<Dim>();
    if (!dim)
      return fail(Code::E0403, call.spans[i],
                  "expected an extent of numbers and symbols, found " + describe(call.args[i]));
    if (dim->is_constant() && dim->constant() < 1)
      return fail(Code::E0404, call.spans[i], "expected an extent of at least 1, found " + dim->str());
    *axes[i] = *dim;
  }
  // Along an axis of one element, too, it is no int known at compile time: what it decides has the extents that it has
  // for any other size.
  const auto given = static_cast<int>(call.args.size());
  std::vector<Value> parts;
  for (int i = 0; i < 3; ++i) parts.push_back(i < given ? Value(Image{ops::coord(b_, i, extent)}) : Value(Dim(0)));
  return compose(std::move(parts), ir::vec(3, Scalar::Int));
}

// ---- barriers and gradients ----

// detach and pin, of everything in a struct, tuple or array.
Value Elaborator::builtin_barrier(BuiltinCall& call) {
  const bool detach = call.entry.kind == OpKind::Detach;
  bool numeric = false;
  for_each_leaf(call.args[0], [&](const Value& leaf) { numeric = numeric || leaf.is_numeric(); });
  if (!numeric) return wrong_type(call, 0, "numbers or images");
  return map_leaves(call.args[0], [&](const Value& leaf) -> Value {
    if (!leaf.is<Image>() || (detach && !element_type(leaf).is_float())) return leaf;
    return image_op(call.entry.kind, {&leaf, 1}, {}, {&leaf, 1});
  });
}

// Whether all of a value is numbers, none of which is in the graph.
Value Elaborator::builtin_known(BuiltinCall& call) {
  bool numeric = false, known = true;
  for_each_leaf(call.args[0], [&](const Value& leaf) {
    numeric = numeric || leaf.is_numeric();
    const auto* dim = leaf.get<Dim>();
    known = known && (leaf.is<Constant>() || (dim != nullptr && dim->is_constant()));
  });
  if (!numeric) return wrong_type(call, 0, "numbers or images");
  return Constant{ir::kBool, {known ? 1.0 : 0.0}};
}

Value Elaborator::builtin_known_zero(BuiltinCall& call) {
  bool numeric = false, zero = true;
  for_each_leaf(call.args[0], [&](const Value& leaf) {
    numeric = numeric || leaf.is_numeric();
    const auto components = known_components(leaf);
    const auto* image = leaf.get<Image>();
    zero = zero && (components ? std::ranges::all_of(*components, [](double x) { return x == 0; })
                               : image != nullptr && zeros_.is_zero(image->id));
  });
  if (!numeric) return wrong_type(call, 0, "numbers or images");
  zero = zero && options_.find_zeros;
  if (options_.zero_count) ++(zero ? options_.zero_count->zero : options_.zero_count->other);
  return Constant{ir::kBool, {zero ? 1.0 : 0.0}};
}

namespace {

std::string short_text(double number) {
  char text[32];
  return {text, std::to_chars(text, text + sizeof text, number).ptr};
}

}  // namespace

// A mistake where the condition does not hold, told in these words: "expected <words>, found 0 and 3".
Value Elaborator::builtin_require(BuiltinCall& call) {
  const auto* words = call.args[1].get<StringValue>();
  if (words == nullptr) return wrong_type(call, 1, "a string that says what is expected");
  const auto holds = known_components(call.args[0]);
  if (!holds || !element_type(call.args[0]).is_bool() || holds->size() != 1) {
    return fail(Code::E0501, call.spans[0],
                "expected a condition that is known at compile time, found " + describe(call.args[0]), {},
                "where x may be known only when the program runs, write '!known(x) || …'");
  }
  if ((*holds)[0] != 0) return Nothing{};
  std::string found;
  for (size_t i = 2; i < call.args.size(); ++i) {
    const auto numbers = known_components(call.args[i]);
    const bool is_number = numbers && numbers->size() == 1;
    found += (i == 2                      ? ", found "
              : i + 1 == call.args.size() ? " and "
                                          : ", ") +
             (is_number ? short_text((*numbers)[0]) : describe(call.args[i]));
  }
  return fail(Code::E0516, call.span, "expected " + words->text + found);
}

Value Elaborator::builtin_grad(BuiltinCall& call) {
  if (refuse_in_region("'grad'", call.span)) return Error{};
  std::optional<Argument> seed;
  if (!call.named.empty()) seed = call.named[0];
  return grad(call.args[0], call.args[1], seed, call.spans[0], call.spans[1]);
}

Value Elaborator::builtin_jvp(BuiltinCall& call) {
  if (refuse_in_region("'jvp'", call.span)) return Error{};
  return jvp(call.args[0], call.args[1], call.args[2], call);
}

// ---- arrays ----

Value Elaborator::builtin_array(BuiltinCall& call) {
  const auto count = known_int(call.args[0]);
  if (!count)
    return fail(Code::E0501, call.spans[0],
                "expected an int known at compile time as the length of an array, found " + describe(call.args[0]));
  if (*count < 0 || *count > kMaxTrips) {
    return fail(
        Code::E0502, call.spans[0],
        "expected an array of at most " + std::to_string(kMaxTrips) + " items, found " + std::to_string(*count));
  }
  std::vector<Value> items;
  std::vector<Span> spans;
  size_t parts = 0;
  for (int64_t i = 0; i < *count; ++i) {
    items.push_back(call_with(call.args[1], {Dim(i)}, call.spans[1]));
    spans.push_back(call.spans[1]);
    if (contains_error(items.back()) || !has_room(items.back(), parts, call.spans[1])) return Error{};
  }
  return unify_items(std::move(items), spans);
}

}  // namespace dr::lower
