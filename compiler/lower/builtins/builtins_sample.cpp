// SPDX-License-Identifier: Apache-2.0
// `sample`: an image read at normalized coordinates, spelled out in indexed reads and arithmetic. So its gradients, to
// the texels and through the weights to the coordinates, and its second derivatives are those of the ops it is made of.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

bool is_word_argument(std::string_view name) { return name == "over" || name == "filter" || name == "wrap"; }

const Expr* word_argument(const BuiltinCall& call, std::string_view name) {
  if (!call.syntax) return nullptr;
  for (const dsl::Arg& arg : call.syntax->args) {
    if (arg.name && arg.name->text == name) return arg.value.get();
  }
  return nullptr;
}

// Which of `words` stands after `name =`; the first where there is none.
std::optional<size_t> Elaborator::chosen_word(const BuiltinCall& call, std::string_view name,
                                              const std::vector<std::string>& words) {
  const Expr* expr = word_argument(call, name);
  if (!expr) return 0;
  const bool named = expr->kind == Expr::Kind::NameRef;
  const auto found = named ? std::ranges::find(words, expr->name) : words.end();
  if (found != words.end()) return static_cast<size_t>(found - words.begin());
  report(Code::E0323, expr->span,
         "expected " + one_of(words) + " after '" + std::string(name) + "', found " +
             (named ? "'" + expr->name + "'" : "something else"),
         {}, named ? suggestion(expr->name, words) : "");
  return std::nullopt;
}

Value Elaborator::builtin_sample(BuiltinCall& call) {
  enum : size_t { kBilinear, kNearest };
  enum : size_t { kClamp, kRepeat, kMirror, kZero };
  const Value &base = call.args[0], &uv = call.args[1];
  const auto filter = chosen_word(call, "filter", {"bilinear", "nearest"});
  const auto wrap = chosen_word(call, "wrap", {"clamp", "repeat", "mirror", "zero"});
  if (!filter || !wrap) return Error{};
  if (!base.is_numeric()) return wrong_type(call, 0, "an image");
  if (*filter == kBilinear && (!element_type(base).is_float() || element_type(base).is_matrix()))
    return wrong_type(call, 0, "floats or vectors of floats, with this filter,");
  if (!uv.is_numeric() || element_type(uv) != ir::vec(2)) return wrong_type(call, 1, "vec2 as the place to read");
  std::optional<Value> layer;
  for (const Argument& arg : call.named) {
    if (arg.name->text != "layer") continue;
    layer = arg.value;
    if (!layer->is_numeric() || element_type(*layer) != ir::kInt)
      return fail(Code::E0405, arg.span, "expected an int as the layer to read, found " + describe(*layer));
  }

  const Extent extent = extent_of(base);
  const Type places = ir::vec(2, Scalar::Int);
  const Value size = compose({to_float(extent.w), to_float(extent.h)}, ir::vec(2));
  const Value last = compose({Value(extent.w - 1), Value(extent.h - 1)}, places);
  const auto whole = [&](int64_t number) { return splat(Dim(number), places); };

  // Into one turn of the texture. Halves of it are exact, so are folds.
  Value turn = uv;
  if (*wrap == kRepeat) turn = apply(OpKind::Fract, {uv});
  if (*wrap == kMirror) {
    Value twice = mul(make_float(2), apply(OpKind::Fract, {mul(make_float(0.5), uv)}));
    if (twice.is_error()) return twice;
    const Value back = sub(make_float(2), twice);
    turn = select(apply(OpKind::Less, {splat(make_float(1), ir::vec(2)), twice}), back, twice);
  }
  // In texels; with a centre at every whole number where there is something to mix.
  Value p = mul(turn, size);
  if (*filter == kBilinear) p = sub(p, make_float(0.5));
  if (p.is_error()) return p;
  // A NaN reads nothing, so that nothing comes back from it either. Beyond the texture the place does not matter.
  const Value nan = is_nan(p);
  const Value lost = apply(OpKind::LogicalOr, {component(nan, 0), component(nan, 1)});
  p = apply(OpKind::Clamp, {p, splat(make_float(-1), ir::vec(2)), size});
  const Value corner = apply(OpKind::Floor, {p});
  const Value low = convert_scalar(corner, Scalar::Int);
  if (low.is_error() || last.is_error()) return Error{};

  const auto settled = [&](const Value& i) -> Value {
    Value at = i;
    if (*wrap == kClamp || *wrap == kMirror) at = apply(OpKind::Clamp, {i, whole(0), last});
    if (*wrap == kRepeat) {
      const Value above = select(apply(OpKind::Less, {last, i}), whole(0), i);
      at = select(apply(OpKind::Less, {i, whole(0)}), last, above);
    }
    return select(lost, whole(-1), at);
  };
  const auto read = [&](const Value& x, const Value& y) -> Value {
    if (x.is_error() || y.is_error()) return Error{};
    std::vector<Value> parts{component(x, 0), component(y, 1)};
    if (layer) parts.push_back(*layer);
    const Type type = ir::vec(static_cast<int>(parts.size()), Scalar::Int);
    Value index = compose(std::move(parts), type);
    if (index.is_error()) return index;
    return gather(base, index, call.spans[0], call.spans[1], "for 'sample'");
  };
  const Value near = settled(low);
  if (*filter == kNearest) return read(near, near);
  const Value far = settled(add(low, Dim(1)));
  const Value t = sub(p, corner);
  const auto mix = [&](const Value& a, const Value& b, const Value& weight) {
    const Value second = mul(b, weight), first = mul(a, sub(make_float(1), weight));
    return add(first, second);
  };
  const auto row = [&](const Value& y) {
    const Value weight = component(t, 0), second = read(far, y), first = read(near, y);
    return mix(first, second, weight);
  };
  const Value above = row(near), below = row(far);
  return mix(above, below, component(t, 1));
}

}  // namespace dr::lower
