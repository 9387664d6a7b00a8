// SPDX-License-Identifier: Apache-2.0
// Calls: arguments find their parameters, generic names and extents are bound, and the body is elaborated in place.
#include <algorithm>

#include "compiler/lower/elaborator.h"

namespace dr::lower {

namespace {

std::string counted(size_t count, std::string_view what) {
  return std::to_string(count) + " " + std::string(what) + (count == 1 ? "" : "s");
}

// The parameter that was meant, or all of them.
std::string parameter_help(const std::string& name, const std::vector<std::string>& known) {
  if (const auto nearest = dsl::nearest_name(name, known)) return "did you mean '" + *nearest + "'?";
  if (known.empty()) return "it has no parameters";
  return known.size() == 1 ? "its parameter is " + listed(known) : "its parameters are " + listed(known);
}

std::string shown(const std::string& name) { return name.empty() ? "this function" : "'" + name + "'"; }

}  // namespace

Value Elaborator::evaluate_call(const Expr& expr) {
  const Value callee = evaluate(*expr.a);
  if (const auto* builtin = callee.get<BuiltinValue>()) {
    std::vector<Argument> args;
    args.reserve(expr.args.size());
    for (const dsl::Arg& arg : expr.args) {
      const bool is_word = arg.name && is_word_argument(arg.name->text);
      args.push_back(
          {arg.name ? &*arg.name : nullptr, is_word ? Value(Nothing{}) : evaluate(*arg.value), arg.value->span});
    }
    return call_builtin(*builtin, std::move(args), &expr, expr.span);
  }
  if (const auto* module = callee.get<ModuleValue>()) return instantiate_module(*module->module, expr);
  return call(callee, evaluate_args(expr.args), expr.span);
}

std::vector<Argument> Elaborator::evaluate_args(const std::vector<dsl::Arg>& args) {
  std::vector<Argument> values;
  values.reserve(args.size());
  for (const dsl::Arg& arg : args)
    values.push_back({arg.name ? &*arg.name : nullptr, evaluate(*arg.value), arg.value->span});
  return values;
}

Value Elaborator::call(const Value& callee, std::vector<Argument> args, const Span& span) {
  if (callee.is_error()) return Error{};
  const SpanScope here(*this, span);
  if (const auto* fn = callee.get<FunctionValue>()) return inline_function(*fn, std::move(args), span);
  if (const auto* builtin = callee.get<BuiltinValue>()) return call_builtin(*builtin, std::move(args), nullptr, span);
  if (const auto* type = callee.get<TypeValue>()) return construct(*type, std::move(args), span);
  if (const auto* optimizer = callee.get<OptimizerValue>(); optimizer && !optimizer->called)
    return call_optimizer(*optimizer, std::move(args), span);
  return fail(Code::E0306, span, "expected a function before '(', found " + describe(callee), {},
              callee.is_numeric() ? "write x.at(i) to read an image at a place" : "");
}

// A call with positional arguments that have no text of their own.
Value Elaborator::call_with(const Value& callee, std::vector<Value> values, const Span& span) {
  std::vector<Argument> args;
  for (Value& value : values) args.push_back({nullptr, std::move(value), span});
  return call(callee, std::move(args), span);
}

// ---- arguments ----

// One argument a parameter, or none where the default is to be taken.
std::optional<std::vector<std::optional<Argument>>> Elaborator::order_arguments(const std::vector<dsl::Param>& params,
                                                                                std::vector<Argument> args,
                                                                                const Span& call,
                                                                                const std::string& name,
                                                                                const Span& declared) {
  std::vector<std::optional<Argument>> ordered(params.size());
  const auto notes = [&]() -> std::vector<dsl::Note> {
    if (!declared.valid()) return {};
    return {{declared, (name.empty() ? "the function" : "'" + name + "'") + std::string(" is declared here")}};
  };
  size_t next = 0;
  for (Argument& arg : args) {
    size_t at = next;
    if (arg.name) {
      std::vector<std::string> known;
      for (const dsl::Param& param : params) known.push_back(param.name.text);
      at = static_cast<size_t>(std::ranges::find(known, arg.name->text) - known.begin());
      if (at == params.size()) {
        report(Code::E0305, arg.name->span,
               "expected the name of a parameter of " + shown(name) + ", found '" + arg.name->text + "'", notes(),
               parameter_help(arg.name->text, known));
        return std::nullopt;
      }
    } else {
      if (at >= params.size()) {
        report(Code::E0304, arg.span,
               "expected " + counted(params.size(), "argument") + " for " + shown(name) + ", found " +
                   std::to_string(args.size()),
               notes());
        return std::nullopt;
      }
      ++next;
    }
    if (ordered[at]) {
      report(Code::E0305, arg.name ? arg.name->span : arg.span,
             "expected one argument for '" + params[at].name.text + "', found a second", notes());
      return std::nullopt;
    }
    if (arg.name) observe(arg.name->span, arg.value, params[at].name.span);
    ordered[at] = std::move(arg);
  }
  for (size_t i = 0; i < params.size(); ++i) {
    if (ordered[i] || params[i].default_value) continue;
    report(Code::E0304, call,
           "expected an argument for '" + params[i].name.text + "' of " + shown(name) + ", found none", notes());
    return std::nullopt;
  }
  return ordered;
}

// Defines the parameters in `scope`, with the generic names and extents that the arguments bind.
bool Elaborator::bind_params(const std::vector<dsl::Param>& params, const std::vector<dsl::Name>& generics,
                             std::vector<Argument> args, Scope& scope, const Span& call, const std::string& name,
                             const Span& declared, bool element_params) {
  auto ordered = order_arguments(params, std::move(args), call, name, declared);
  if (!ordered) return false;
  const Switched<Scope*> inside(scope_, &scope);
  TypeMatch how;
  how.code = Code::E0303;
  how.generics = &generics;
  how.bind_extents = true;
  how.parameter = element_params;

  // Plain names first, so that `a : float[W / 2], b : float[W]` works in either order.
  for (size_t i = 0; i < params.size(); ++i) {
    if (!(*ordered)[i] || !params[i].type || params[i].type->kind != dsl::TypeExpr::Kind::Named) continue;
    const Value& value = (*ordered)[i]->value;
    if (!value.is_numeric()) continue;
    const Extent extent = extent_of(value);
    const Dim* axes[] = {&extent.w, &extent.h, &extent.l};
    for (size_t axis = 0; axis < params[i].type->extents.size() && axis < 3; ++axis) {
      const Expr& wanted = *params[i].type->extents[axis];
      if (wanted.kind != Expr::Kind::NameRef || is_any_extent(wanted) || !may_bind(wanted.name, how) ||
          scope.find(wanted.name))
        continue;
      define(scope, {wanted.name, wanted.span}, *axes[axis]);
    }
  }

  bool ok = true;
  for (size_t i = 0; i < params.size(); ++i) {
    const dsl::Param& param = params[i];
    Value value;
    how.span = call;
    if ((*ordered)[i]) {
      value = (*ordered)[i]->value;
      how.span = (*ordered)[i]->span;
    } else {
      value = evaluate(*param.default_value);
    }
    how.declared = param.name.span;
    how.name = param.name.text;
    if (contains_error(value)) {
      ok = false;
    } else if (param.type) {
      auto matched = match(value, *param.type, how);
      ok = ok && matched.has_value();
      value = matched ? *std::move(matched) : Value(Error{});
    }
    if (ok && param.is_const) {
      bool known = true;
      for_each_leaf(value, [&](const Value& leaf) {
        const auto* dim = leaf.get<Dim>();
        known = known && !leaf.is<Image>() && (!dim || dim->is_constant());
      });
      if (!known) {
        report(Code::E0501, how.span,
               "expected a value known at compile time for '" + param.name.text + "', found " + describe(value) +
                   " known at run time",
               how.notes());
        ok = false;
      }
    }
    define(scope, param.name, std::move(value), Binding::Kind::Parameter);
  }
  for (const dsl::Name& generic : generics) {
    if (!ok || scope.find(generic.text)) continue;
    report(Code::E0312, call,
           "expected arguments that say what '" + generic.text + "' of " + shown(name) + " is, found none",
           {{generic.span, "'" + generic.text + "' is declared here"}});
    ok = false;
  }
  return ok;
}

// ---- functions ----

bool Elaborator::check_recursion(const FunctionValue& fn, const Span& span) {
  // A function value called by a function that was passed it belongs to the place where it was made: that a library
  // function is open on the way to it is no recursion.
  for (size_t i = frames_.size(); i > 0;) {
    const Frame& frame = frames_[i - 1];
    if (frame.fn == fn.decl && frame.scope == fn.scope) {
      report(Code::E0504, span,
             "expected functions without recursion, found that " + shown(fn.decl->name.text) + " calls itself",
             {{fn.decl->name.span, "it is declared here"}});
      return false;
    }
    i = frame.is_lambda ? std::min(frame.creator, i - 1) : i - 1;
  }
  if (frames_.size() < kMaxCalls) return true;
  report(Code::E0505, span, "expected at most " + std::to_string(kMaxCalls) + " calls inside each other, found more");
  return false;
}

Value Elaborator::inline_function(const FunctionValue& fn, std::vector<Argument> args, const Span& span) {
  if (!check_recursion(fn, span)) return Error{};
  const dsl::FnDecl& decl = *fn.decl;
  if (!fn.self.empty()) args.insert(args.begin(), Argument{nullptr, fn.self[0], span});
  Scope* scope = new_scope(fn.scope);
  if (!bind_params(decl.params, decl.generics, std::move(args), *scope, span, decl.name.text, decl.name.span, true))
    return Error{};

  const dsl::FnDecl* vjp = vjp_of(fn);
  std::vector<Value> bound;
  if (vjp)
    for (const dsl::Param& param : decl.params) bound.push_back(scope->find(param.name.text)->value);

  frames_.push_back({&decl, decl.name.text, span, fn.scope, fn.creator, fn.is_lambda});
  const size_t depth = frames_.size();
  const Switched<Scope*> inside(scope_, scope);
  Value value = evaluate_block(decl.body);
  const Span end = decl.body.value                ? decl.body.value->span
                   : decl.body.statements.empty() ? decl.body.span
                                                  : decl.body.statements.back()->span;
  if (value.is<Nothing>()) {
    value = fail(Code::E0321, end, "expected a value at the end of " + shown(decl.name.text) + ", found none");
  } else if (decl.result && !contains_error(value)) {
    TypeMatch how;
    how.code = Code::E0324;
    how.role = "the result of ";
    how.name = decl.name.text;
    how.span = end;
    how.declared = decl.result->span;
    how.stretch = true;
    auto matched = match(value, *decl.result, how);
    value = matched ? *std::move(matched) : Value(Error{});
  }
  frames_.pop_back();
  value = leave_call(value, depth);
  if (!vjp || contains_error(value)) return value;
  for (Value& argument : bound) argument = leave_call(argument, depth);
  return with_vjp(fn, *vjp, value, std::move(bound), span);
}

// What was one element inside the call is a whole image outside.
Value Elaborator::leave_call(const Value& value, size_t depth) const {
  return map_leaves(value, [&](const Value& leaf) {
    const auto* image = leaf.get<Image>();
    return image && image->element >= depth ? Value(Image{image->id}) : leaf;
  });
}

// ---- built-in functions ----

Value Elaborator::call_builtin(const BuiltinValue& builtin, std::vector<Argument> args, const Expr* syntax,
                               const Span& span) {
  const Builtin& entry = *builtin.entry;
  const std::string name(entry.name);
  BuiltinCall call{.entry = entry, .args = {}, .spans = {}, .named = {}, .syntax = syntax, .span = span};
  for (const Value& self : builtin.self) {
    call.args.push_back(self);
    call.spans.push_back(syntax && syntax->a && syntax->a->a ? syntax->a->a->span : span);
  }
  bool failed = false;
  for (Argument& arg : args) {
    failed = failed || contains_error(arg.value);
    if (!arg.name) {
      call.args.push_back(std::move(arg.value));
      call.spans.push_back(arg.span);
      continue;
    }
    if (std::ranges::find(entry.named, arg.name->text) == entry.named.end()) {
      const std::vector<std::string> known(entry.named.begin(), entry.named.end());
      return fail(Code::E0305, arg.name->span,
                  known.empty() ? "expected arguments without names for '" + name + "', found '" + arg.name->text + "'"
                                : "expected the name of a parameter of '" + name + "', found '" + arg.name->text + "'",
                  {}, known.empty() ? std::string() : parameter_help(arg.name->text, known));
    }
    call.named.push_back(std::move(arg));
  }
  const size_t hidden = entry.is_method ? 1 : 0;
  if (call.args.size() < entry.min_args || call.args.size() > entry.max_args) {
    std::string wanted = std::to_string(entry.min_args - hidden);
    if (entry.max_args != entry.min_args) wanted += " to " + std::to_string(entry.max_args - hidden);
    return fail(Code::E0304, span,
                "expected " + wanted + (wanted == "1" ? " argument" : " arguments") + " for '" + name + "', found " +
                    std::to_string(call.args.size() - hidden),
                {}, name == "at" ? "write .at(ivec2(x, y)), or .at(ivec3(x, y, layer))" : "");
  }
  if (failed) return Error{};
  const SpanScope here(*this, span);
  return (this->*entry.handler)(call);
}

// ---- optimizers ----

Value Elaborator::call_optimizer(const OptimizerValue& optimizer, std::vector<Argument> args, const Span& span) {
  static const std::vector<dsl::Name> kNoGenerics;
  // Other libraries pass the gradient; here 'minimize' takes it.
  if (!args.empty() && !args[0].name && !extent_of(args[0].value).is_unit()) {
    const std::string& name = optimizer.decl->name.text;
    return fail(Code::E0305, args[0].span, "expected a number among the settings of '" + name + "', found an image",
                {{optimizer.decl->name.span, "'" + name + "' is declared here"}},
                "an optimizer takes the gradient itself: 'minimize error over x with ...' in a step");
  }
  Scope* scope = new_scope(optimizer.scope);
  if (!bind_params(optimizer.decl->params, kNoGenerics, std::move(args), *scope, span, optimizer.decl->name.text,
                   optimizer.decl->name.span, false)) {
    return Error{};
  }
  return OptimizerValue{optimizer.decl, scope, true};
}

}  // namespace dr::lower
