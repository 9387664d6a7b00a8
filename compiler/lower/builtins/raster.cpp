// SPDX-License-Identifier: Apache-2.0
// `raster`: setup, corners and cull are ordinary arithmetic on an axis of faces; depth, keep and tag become regions
// that get the record of the face as parameters. A missing keep is written out here.
#include "compiler/ir/raster.h"

#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

struct Elaborator::RasterCall {
  Span span;
  Dim faces;
  Extent domain;
  int64_t nearest = 1;
  bool listed = false;  // the faces of all ranks are one image
  int64_t corners = 3;
  const dsl::FnDecl *setup = nullptr, *corner = nullptr, *depth = nullptr, *keep = nullptr, *tag = nullptr,
                    *cull = nullptr;
  Value record;               // what setup gave
  std::vector<Value> fields;  // its images, then what a missing keep adds
  std::vector<Value> hull;    // the corners
};

// ---- arguments and functions ----

bool Elaborator::raster_arguments(const Expr& expr, RasterCall& call) {
  call.span = expr.span;
  bool ok = true;
  size_t next = 0;
  const dsl::Arg* keeps = nullptr;
  Dim* const extents[] = {&call.faces, &call.domain.w, &call.domain.h, &call.domain.l};
  static const std::vector<std::string> kNames = {"nearest", "listed", "corners"};
  for (const dsl::Arg& arg : expr.args) {
    if (!arg.name) {
      if (next == 4) {
        report(Code::E0304, arg.value->span, "expected faces, width, height and layers for 'raster', found more");
        return false;
      }
      const auto dim = evaluate_dim(*arg.value, "an extent");
      ok = ok && dim.has_value();
      if (dim) *extents[next] = *dim;
      if (dim && dim->is_constant() && dim->constant() < 1) {
        report(Code::E0404, arg.value->span, "expected an extent of at least 1, found " + dim->str());
        ok = false;
      }
      ++next;
      continue;
    }
    const bool listed = arg.name->text == "listed", nearest = listed || arg.name->text == "nearest";
    if (!nearest && arg.name->text != "corners") {
      report(Code::E0305, arg.name->span,
             "expected the name of a parameter of 'raster', found '" + arg.name->text + "'", {},
             suggestion(arg.name->text, kNames));
      return false;
    }
    const auto number = evaluate_known_int(*arg.value, "'" + arg.name->text + "'");
    ok = ok && number.has_value();
    if (!number) continue;
    if (nearest ? *number < 1 || *number > 64 : *number != 3 && *number != 6) {
      report(Code::E0705, arg.value->span,
             "expected " + std::string(nearest ? "1 to 64" : "3 or 6") + " for '" + arg.name->text + "', found " +
                 std::to_string(*number));
      ok = false;
    }
    if (nearest && keeps != nullptr) {
      report(Code::E0705, arg.name->span, "expected 'nearest' or 'listed' for 'raster', found both");
      ok = false;
    }
    if (nearest) keeps = &arg;
    (nearest ? call.nearest : call.corners) = *number;
    call.listed = call.listed || listed;
  }
  if (next < 3) {
    report(Code::E0304, expr.span,
           "expected faces, width, height and layers for 'raster', found " + std::to_string(next) +
               (next == 1 ? " argument" : " arguments"));
    return false;
  }
  return ok;
}

bool Elaborator::raster_functions(const Expr& expr, RasterCall& call) {
  bool ok = true;
  const auto take = [&](const dsl::FnDecl*& place, std::string_view name, size_t params, bool required) {
    for (const dsl::FnDecl& fn : expr.inner->raster_fns) {
      if (fn.name.text == name && !place) place = &fn;
    }
    if (!place) {
      if (required)
        report(Code::E0704, expr.span, "expected a function '" + std::string(name) + "' in 'raster', found none");
      ok = ok && !required;
    } else if (place->params.size() != params) {
      report(Code::E0706, place->name.span,
             "expected " + std::to_string(params) + (params == 1 ? " parameter" : " parameters") + " of '" +
                 std::string(name) + "', found " + std::to_string(place->params.size()));
      ok = false;
    }
  };
  take(call.setup, "setup", 1, true);
  take(call.corner, "corner", 2, true);
  take(call.depth, "depth", 2, !call.listed);
  take(call.keep, "keep", 2, false);
  take(call.tag, "tag", 2, false);
  take(call.cull, "cull", 1, false);
  if (call.listed && call.depth) {
    report(Code::E0705, call.depth->name.span, "expected no function 'depth' beside 'listed', found one", {},
           "faces are listed by their numbers; 'nearest' orders them by depth");
    ok = false;
  }
  return ok;
}

namespace {

Span result_span(const dsl::FnDecl& fn) { return fn.body.value ? fn.body.value->span : fn.name.span; }

}  // namespace

// The function's value, which has to be of a type; a struct of anything where the type is that of no number.
Value Elaborator::call_raster_fn(const dsl::FnDecl& fn, std::vector<Value> args, const Type& type) {
  FunctionValue value{.decl = &fn, .scope = scope_, .creator = frames_.size(), .is_lambda = true, .self = {}};
  std::vector<Argument> arguments;
  for (Value& arg : args) arguments.push_back({nullptr, std::move(arg), fn.name.span});
  // Without a place of the call: the function stands where it is called.
  Value result = inline_function(value, std::move(arguments), {});
  if (contains_error(result)) return Error{};
  if (type.is_scalar()) convert_known_int(result, type.scalar);
  if (result.is_numeric() && element_type(result) == type) return result;
  return fail(Code::E0709, result_span(fn),
              "expected " + type.str() + " from '" + fn.name.text + "', found " + describe_element(result));
}

// Whether everything in it belongs to a face and a layer.
bool Elaborator::check_record(const Value& value, const RasterCall& call, const dsl::FnDecl& fn) {
  bool ok = true;
  for_each_leaf(value, [&](const Value& leaf) {
    if (!ok || !leaf.is<Image>()) return;
    const Extent extent = extent_of(leaf);
    const auto both = ir::broadcast(extent, {call.faces, 1, call.domain.l});
    if (both && *both == Extent{call.faces, 1, call.domain.l}) return;
    ok = false;
    report(Code::E0707, result_span(fn),
           "expected values of the extent " + Extent{call.faces, 1, call.domain.l}.str() + " from '" + fn.name.text +
               "', found " + describe(leaf));
  });
  return ok;
}

bool Elaborator::raster_record(RasterCall& call) {
  const Value face = Image{ops::coord(b_, 0, {call.faces, 1, 1})};
  set_name(face, call.setup->params[0].name.text);
  FunctionValue setup{.decl = call.setup, .scope = scope_, .creator = frames_.size(), .is_lambda = true, .self = {}};
  call.record = inline_function(setup, {Argument{nullptr, face, call.setup->name.span}}, {});
  if (contains_error(call.record) || !check_record(call.record, call, *call.setup)) return false;
  set_name(call.record, call.corner->params[0].name.text);
  for_each_leaf(call.record, [&](const Value& leaf) {
    if (leaf.is<Image>()) call.fields.push_back(leaf);
  });
  for (int64_t c = 0; c < call.corners; ++c) {
    call.hull.push_back(call_raster_fn(*call.corner, {call.record, Dim(c)}, ir::vec(2)));
    if (call.hull.back().is_error() || !check_record(call.hull.back(), call, *call.corner)) return false;
  }
  return true;
}

// ---- regions ----

std::optional<ir::RegionId> Elaborator::raster_region(const RasterCall& call, const RasterBody& body) {
  std::vector<ir::ResultType> params;
  for (const Value& field : call.fields) params.push_back({element_type(field), call.domain});
  params.push_back({ir::vec(2), call.domain});
  regions_.push_back({"'raster'", call.span, frames_.size(), {}});
  const ir::RegionId region = b_.begin_region(params);
  std::vector<Value> fields;
  for (size_t i = 0; i < params.size(); ++i) {
    const ValueId id = b_.graph().region(region).params[i];
    fields.push_back(Image{id});
    const auto* field = i < call.fields.size() ? call.fields[i].get<Image>() : nullptr;
    if (field && !b_.value(field->id).name.empty()) b_.set_name(id, b_.value(field->id).name);
    if (!field) b_.set_name(id, "p");
  }
  const Value p = fields.back();
  fields.pop_back();
  const Value result = body(fields, p);
  b_.end_region(result.is_error() ? std::vector<ValueId>{} : std::vector<ValueId>{materialize(result)});
  regions_.pop_back();
  if (result.is_error()) return std::nullopt;

  // What is captured has to belong to the pixel.
  const auto belongs = [&](const Extent& extent, const Span& span) {
    const auto both = ir::broadcast(extent, call.domain);
    if (both && *both == call.domain) return true;
    report(Code::E0708, span,
           "expected values of the extent " + call.domain.str() + " inside 'raster', found one of " + extent.str(), {},
           "what belongs to a face is returned by 'setup'");
    return false;
  };
  for (const ir::OpId op : b_.graph().region(region).ops) {
    for (const ValueId id : b_.graph().op(op).results) {
      if (!belongs(b_.value(id).extent, b_.graph().op(op).span)) return std::nullopt;
    }
  }
  for (const ValueId id : b_.graph().region(region).yields) {
    if (!belongs(b_.value(id).extent, call.span)) return std::nullopt;
  }
  return region;
}

// ---- coverage ----

// What a missing keep has to know of the edge from a to b: an end of it, and the way along it. The difference is taken
// in the order of the ends' coordinates, whichever comes first in the face, so that both faces beside the edge compute
// the same numbers but for the sign, and with them complementary sides: no pixel is lost and none is taken twice.
Value Elaborator::coverage_edge(const Value& a, const Value& b) {
  const Value ax = component(a, 0), ay = component(a, 1), bx = component(b, 0), by = component(b, 1);
  const Value same_x = apply(OpKind::Equal, {ax, bx});
  const Value swapped = apply(OpKind::LogicalOr, {apply(OpKind::Less, {bx, ax}),
                                                  apply(OpKind::LogicalAnd, {same_x, apply(OpKind::Less, {by, ay})})});
  const Value low = select(swapped, b, a), high = select(swapped, a, b);
  const Value way = sub(high, low);
  const Value forward = select(swapped, apply(OpKind::Neg, {way}), way);
  return compose({component(low, 0), component(low, 1), component(forward, 0), component(forward, 1)}, ir::vec(4));
}

// The side of an edge to which a point on it belongs, as its sign: the one for which the edge is a top or left one. An
// edge without length has none, 0, so that a triangle without area has no inside.
Value Elaborator::coverage_tie(const Value& edge) {
  const Value zero = make_float(0), dx = component(edge, 2), dy = component(edge, 3);
  const auto less = [&](const Value& a, const Value& b) { return apply(OpKind::Less, {a, b}); };
  const auto both = [&](const Value& a, const Value& b) { return apply(OpKind::LogicalAnd, {a, b}); };
  const auto either = [&](const Value& a, const Value& b) { return apply(OpKind::LogicalOr, {a, b}); };
  // Each op by itself: C++ leaves open which argument of a call comes first.
  const Value level = apply(OpKind::Equal, {dy, zero});
  const Value rightward = less(zero, dx), top = both(level, rightward);
  const Value upward = less(dy, zero), top_left = either(upward, top);
  const Value leftward = less(dx, zero), bottom = both(level, leftward);
  const Value downward = less(zero, dy), bottom_right = either(downward, bottom);
  const Value one = make_float(1), minus_one = make_float(-1), otherwise = select(bottom_right, minus_one, zero);
  return select(top_left, one, otherwise);
}

// Whether p lies on the same side of all three edges of a triangle.
Value Elaborator::coverage(std::span<const Value> edges, const Value& p) {
  const Value zero = make_float(0);
  const auto less = [&](const Value& a, const Value& b) { return apply(OpKind::Less, {a, b}); };
  const auto both = [&](const Value& a, const Value& b) { return apply(OpKind::LogicalAnd, {a, b}); };
  Value all_left, all_right;
  for (size_t i = 0; i < edges.size(); ++i) {
    const Value dx = component(edges[i], 2), dy = component(edges[i], 3);
    const auto apart = [&](int c) {
      const Value from = component(edges[i], c), to = component(p, c);
      return sub(to, from);
    };
    const Value x = apart(0), y = apart(1);
    const Value taken = mul(dy, x), exact = sub(mul(dx, y), taken), tie = coverage_tie(edges[i]);
    const Value on_edge = apply(OpKind::Equal, {exact, zero}), side = select(on_edge, tie, exact);
    const Value left = less(zero, side), right = less(side, zero);
    all_left = i == 0 ? left : both(all_left, left);
    all_right = i == 0 ? right : both(all_right, right);
  }
  return apply(OpKind::LogicalOr, {all_left, all_right});
}

// ---- the op ----

const StructType& Elaborator::fragment_type() {
  static const StructType kFragment{"fragment", {"face", "tag", "order"}, nullptr, nullptr};
  return kFragment;
}

Value Elaborator::evaluate_raster(const Expr& expr) {
  if (refuse_in_region("'raster'", expr.span)) return Error{};
  RasterCall call;
  if (!raster_arguments(expr, call) || !raster_functions(expr, call) || !raster_record(call)) return Error{};
  const Value cull = call.cull ? call_raster_fn(*call.cull, {call.record}, ir::kBool) : make_bool(false);
  if (cull.is_error() || (call.cull && !check_record(cull, call, *call.cull))) return Error{};

  const size_t record_fields = call.fields.size();
  if (!call.keep) {
    for (size_t c = 0; c < call.hull.size(); ++c) {
      const size_t triangle = c - c % 3;
      const Value edge = coverage_edge(call.hull[c], call.hull[triangle + (c + 1) % 3]);
      // Corners that are all known at compile time leave no image; the region takes one all the same.
      call.fields.push_back(edge.is_error() ? edge : Value(Image{materialize(edge)}));
      if (edge.is_error()) return Error{};
    }
  }
  // The record as the region sees it.
  const auto record_at = [&](std::span<const Value> fields) {
    size_t next = 0;
    return map_leaves(call.record, [&](const Value& leaf) { return leaf.is<Image>() ? fields[next++] : leaf; });
  };
  const auto depth = raster_region(call, [&](std::span<const Value> fields, const Value& p) {
    return call.depth ? call_raster_fn(*call.depth, {record_at(fields), p}, ir::kFloat) : make_float(0);
  });
  const auto keep = raster_region(call, [&](std::span<const Value> fields, const Value& p) {
    if (call.keep) return call_raster_fn(*call.keep, {record_at(fields), p}, ir::kBool);
    const auto edges = fields.subspan(record_fields);
    const Value first = coverage(edges.first(3), p);
    return edges.size() == 3 ? first : apply(OpKind::LogicalOr, {first, coverage(edges.subspan(3), p)});
  });
  const auto tag = raster_region(call, [&](std::span<const Value> fields, const Value& p) {
    return call.tag ? call_raster_fn(*call.tag, {record_at(fields), p}, ir::kInt) : Value(Dim(0));
  });
  if (!depth || !keep || !tag || diagnostics_.has_errors()) return Error{};

  std::vector<ValueId> operands;
  for (const Value& field : call.fields) operands.push_back(materialize(field));
  for (const Value& corner : call.hull) operands.push_back(materialize(corner));
  operands.push_back(materialize(cull));
  ir::Attrs attrs;
  attrs.ints = {call.nearest, static_cast<int64_t>(call.fields.size()), call.corners};
  // Orders that nobody reads are dropped later.
  attrs.ints.push_back(call.listed ? ir::kListed : ir::kOrdered);
  attrs.dims = {call.domain.w, call.domain.h, call.domain.l, call.faces};
  const std::vector<ValueId> results =
      ops::emit_multi(b_, OpKind::Raster, std::move(operands), std::move(attrs), {*depth, *keep, *tag});
  if (call.listed) return Image{results[0]};
  ArrayValue nearest;
  for (size_t k = 0; k < static_cast<size_t>(call.nearest); ++k) {
    nearest.items.push_back(StructValue{
        &fragment_type(), {}, {Image{results[3 * k]}, Image{results[3 * k + 1]}, Image{results[3 * k + 2]}}});
  }
  return nearest;
}

}  // namespace dr::lower
