// SPDX-License-Identifier: Apache-2.0
// `@vjp(f)`: a function that gives the gradient of f in place of the compiler. It takes f's parameters and the adjoint
// of f's value, and gives the adjoints of those parameters that hold floats.
#include <algorithm>
#include <array>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

void Elaborator::collect_vjps(ModuleInfo& module) {
  for (const dsl::Item& item : module.syntax->items) {
    if (item.kind != dsl::Item::Kind::Fn || !item.fn->vjp_of) continue;
    const dsl::FnDecl& vjp = *item.fn;
    const dsl::Name& name = *vjp.vjp_of;
    const auto found = module.items.find(name.text);
    const auto* fn = found == module.items.end() ? nullptr : found->second.value.get<FunctionValue>();
    if (!fn || fn->decl == &vjp || fn->decl->vjp_of) {
      std::vector<std::string> known =
          names_of(module.items, [](const ModuleItem& other) { return other.kind == ModuleItem::Kind::Fn; });
      std::erase(known, vjp.name.text);
      report(Code::E0615, name.span, "expected a function of this file after '@vjp(', found '" + name.text + "'", {},
             suggestion(name.text, known));
      continue;
    }
    const auto [entry, first] = module.vjps.emplace(fn->decl, &vjp);
    if (!first) {
      report(Code::E0615, name.span, "expected one '@vjp' of '" + name.text + "', found a second",
             {{entry->second->vjp_of->span, "the first one is here"}});
    } else if (vjp.params.size() != fn->decl->params.size() + 1) {
      report(Code::E0616, vjp.name.span,
             "expected the parameters of '" + name.text + "' and the adjoint of its value, " +
                 std::to_string(fn->decl->params.size() + 1) + " in all, found " + std::to_string(vjp.params.size()),
             {{fn->decl->name.span, "'" + name.text + "' is declared here"}});
    }
  }
}

const dsl::FnDecl* Elaborator::vjp_of(const FunctionValue& fn) const {
  if (options_.plain_gradients || fn.is_lambda || !fn.self.empty() || open_vjps_.contains(fn.decl)) return nullptr;
  const auto& vjps = fn.scope->module->vjps;
  const auto found = vjps.find(fn.decl);
  return found == vjps.end() ? nullptr : found->second;
}

namespace {

bool is_float_image(const Value& value, const ir::Builder& b) {
  const auto* image = value.get<Image>();
  return image && b.value(image->id).type.is_float();
}

bool holds_floats(const Value& value, const ir::Builder& b) {
  bool found = false;
  for_each_leaf(value, [&](const Value& leaf) {
    const auto* constant = leaf.get<Constant>();
    found = found || is_float_image(leaf, b) || (constant && constant->type.is_float());
  });
  return found;
}

// Whether a part of it can have a gradient.
bool moves(const Value& value, const ir::Builder& b) {
  bool found = false;
  for_each_leaf(value, [&](const Value& leaf) { found = found || is_float_image(leaf, b); });
  return found;
}

// Along each direction an adjoint is as long as its target, or has an element for each of f's value, to be summed for
// the one of the target. One that does not differ along a direction may have a single element there.
bool is_adjoint_extent(const Extent& adjoint, const Extent& target, const Extent& value) {
  return std::ranges::all_of(std::array{&Extent::w, &Extent::h, &Extent::l}, [&](auto axis) {
    const Dim &a = adjoint.*axis, &t = target.*axis, &v = value.*axis;
    return a == t || (t.is_one() && a == v) || (a.is_one() && t == v);
  });
}

}  // namespace

// A number known at compile time, once for each element of the arguments that `f` is called for: its gradient is what
// `vjp` says, whatever its value.
Value Elaborator::for_each_element(const dsl::FnDecl& f, const Value& y, const std::vector<Value>& args) {
  Extent extent;
  bool agree = true;
  for (size_t i = 0; i < args.size(); ++i) {
    if (!f.params[i].type || f.params[i].type->has_extents) continue;
    for_each_leaf(args[i], [&](const Value& leaf) {
      if (!leaf.is<Image>()) return;
      const auto both = ir::broadcast(extent, extent_of(leaf));
      agree = agree && both;
      if (both) extent = *both;
    });
  }
  if (!agree)
    return fail(Code::E0616, f.name.span,
                "expected elements of one extent, as the value of '" + f.name.text +
                    "' is a number, found arguments of several; give them one extent, or take images");
  return image(materialize(broadcast(y, extent)), {&y});
}

// The value of f, with the gradient that `vjp` gives for its arguments.
Value Elaborator::with_vjp(const FunctionValue& fn, const dsl::FnDecl& vjp, Value y, std::vector<Value> args,
                           const Span& span) {
  const std::string name = "'" + fn.decl->name.text + "'";
  if (y.is<Dim>() || std::none_of(args.begin(), args.end(), [&](const Value& arg) { return moves(arg, b_); })) return y;
  if (const auto* constant = y.get<Constant>(); constant && constant->type.is_float())
    y = for_each_element(*fn.decl, y, args);
  if (y.is<Error>()) return y;
  if (!is_float_image(y, b_)) {
    return fail(Code::E0616, vjp.vjp_of->span,
                "expected a function that gives one value of floats, found that " + name + " gives " + describe(y));
  }
  const Type type = element_type(y);
  const Extent extent = extent_of(y);
  const ValueId value = y.as<Image>().id;
  const ValueId cotangent = ops::emit(b_, OpKind::Cotangent, {},
                                      {.ints = {type.rows, type.cols, cotangents_++},
                                       .floats = {},
                                       .dims = {extent.w, extent.h, extent.l},
                                       .yields = {},
                                       .text = {}});
  std::vector<Value> vjp_args = args;
  vjp_args.push_back(Image{cotangent, y.as<Image>().element});
  open_vjps_.insert(fn.decl);
  const Value result = call_with(FunctionValue{.decl = &vjp, .scope = fn.scope, .self = {}}, std::move(vjp_args), span);
  open_vjps_.erase(fn.decl);
  if (contains_error(result)) return Error{};

  // One part of the result for each parameter that holds floats, of its form.
  std::vector<size_t> asked;
  for (size_t i = 0; i < args.size(); ++i)
    if (holds_floats(args[i], b_)) asked.push_back(i);
  const Span end = vjp.body.value ? vjp.body.value->span : vjp.body.span;
  const auto* tuple = result.get<TupleValue>();
  const std::vector<Value> parts = asked.size() == 1 ? std::vector<Value>{result}
                                   : tuple           ? tuple->items
                                                     : std::vector<Value>{};
  if (parts.size() != asked.size()) {
    return fail(Code::E0616, end,
                "expected " + std::to_string(asked.size()) + " adjoints, one for each parameter of " + name +
                    " that holds floats, found " + describe(result),
                {{fn.decl->name.span, name + " is declared here"}});
  }
  std::vector<ValueId> targets, adjoints;
  for (size_t k = 0; k < parts.size(); ++k) {
    const Value& arg = args[asked[k]];
    const std::string& param = fn.decl->params[asked[k]].name.text;
    std::vector<Value> given, wanted;
    for_each_leaf(arg, [&](const Value& leaf) { wanted.push_back(leaf); });
    for_each_leaf(parts[k], [&](const Value& leaf) { given.push_back(leaf); });
    if (given.size() != wanted.size()) {
      return fail(Code::E0616, end, "expected an adjoint of the form of '" + param + "', found " + describe(parts[k]));
    }
    for (size_t i = 0; i < wanted.size(); ++i) {
      if (!is_float_image(wanted[i], b_)) continue;
      convert_known_int(given[i], Scalar::Float);
      if (!given[i].is_numeric() || element_type(given[i]) != element_type(wanted[i])) {
        return fail(Code::E0616, end,
                    "expected an adjoint of type " + element_type(wanted[i]).str() + " for '" + param + "', found " +
                        describe_element(given[i]));
      }
      const Extent adjoint = extent_of(given[i]), target = extent_of(wanted[i]);
      if (!is_adjoint_extent(adjoint, target, extent)) {
        const auto words = [](const Extent& e, const char* before) {
          return e.is_unit() ? "one element" : before + e.str();
        };
        return fail(Code::E0616, end,
                    "expected an adjoint of " + words(target, "the extent ") + " for '" + param + "', found " +
                        words(adjoint, ""));
      }
      const auto& declared = fn.decl->params[asked[k]].type;
      if (declared && declared->has_extents && !target.is_unit() &&
          refuse_in_region("the adjoint of all of '" + param + "' that the '@vjp' of " + name + " gives", span))
        return Error{};
      targets.push_back(wanted[i].as<Image>().id);
      adjoints.push_back(materialize(given[i]));
    }
  }
  if (targets.empty()) return y;
  std::vector<ValueId> operands{value, cotangent};
  operands.insert(operands.end(), targets.begin(), targets.end());
  operands.insert(operands.end(), adjoints.begin(), adjoints.end());
  return Image{ops::emit(b_, OpKind::Vjp, std::move(operands)), y.as<Image>().element};
}

}  // namespace dr::lower
