// SPDX-License-Identifier: Apache-2.0
// Steps: what is given out, what leaves hold afterwards, gradients and optimizers.
#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

namespace {

std::string_view kind_word(ir::Leaf::Kind kind) {
  switch (kind) {
    case ir::Leaf::Kind::Param: return "param";
    case ir::Leaf::Kind::Input: return "input";
    case ir::Leaf::Kind::State: return "state";
  }
  DR_ICE("a leaf of no kind");
}

}  // namespace

void Elaborator::run_step(const dsl::StepDecl& decl) {
  const std::string name = scope_->module->prefix + decl.name.text;
  for (const ir::Step& other : b_.graph().steps) {
    if (other.name != name) continue;
    report(Code::E0202, decl.name.span, "expected each step once, found '" + decl.name.text + "' again");
    return;
  }
  if (b_.graph().steps.size() == options_.max_steps) {
    report(Code::E0503, decl.name.span,
           "expected a program of at most " + std::to_string(options_.max_steps) + " steps, found more");
    exhausted_ = true;
    return;
  }
  b_.graph().steps.push_back({name, {}, {}});
  ir::Step step{name, {}, {}};
  StepFrame frame;
  frame.step = &step;
  const Switched<StepFrame*> inside(step_, &frame);
  const Value value = evaluate_block(decl.body);
  if (!value.is<Nothing>() && !contains_error(value)) {
    report(Code::E0509, decl.body.value->span, "expected statements in a step, found a value that is not used", {},
           "write 'output name = value;'");
  }
  b_.graph().steps.back() = std::move(step);
}

bool Elaborator::in_step(std::string_view what, const Span& span) {
  if (step_ && frames_.empty() && !in_region()) return true;
  report(Code::E0512, span,
         "expected " + std::string(what) + " directly in a step, found it " +
             (step_ ? "in a function or region" : "elsewhere"),
         {}, step_ && what.find("<-") != std::string_view::npos ? "choose the value: x <- if c { a } else { x };" : "");
  return false;
}

// ---- outputs ----

void Elaborator::run_output(const dsl::Stmt& stmt) {
  for (const dsl::OutputItem& item : stmt.outputs) {
    const SpanScope span(*this, item.name.span);
    const Value value = item.value ? evaluate(*item.value) : name_value(item.name.text, item.name.span);
    if (contains_error(value)) continue;
    const Span at = item.value ? item.value->span : item.name.span;
    const auto [first, added] = step_->outputs.emplace(item.name.text, item.name.span);
    if (!added) {
      report(Code::E0610, item.name.span, "expected each output once in a step, found '" + item.name.text + "' again",
             {{first->second, "the first one is here"}});
      continue;
    }
    add_output(item.name.text, value, at);
  }
}

// One output for a number or image; one for each part of anything else, under names such as `soft.face`.
void Elaborator::add_output(const std::string& name, const Value& value, const Span& span) {
  if (value.is_numeric()) {
    step_->step->outputs.push_back({name, materialize(value)});
    return;
  }
  const std::vector<Value>& parts = parts_of(value);
  if (parts.empty())
    report(Code::E0611, span,
           "expected a number, an image or a composition of them as output, found " + describe(value));
  for (size_t i = 0; i < parts.size(); ++i) add_output(name + "." + part_name(value, i), parts[i], span);
}

// ---- updates ----

// `value` as the next content of a leaf: of its type, stretched to its extent.
std::optional<Image> Elaborator::fit_leaf(const Value& value, uint32_t leaf, const Span& span, std::string_view what) {
  if (contains_error(value)) return std::nullopt;
  const ir::Leaf target = b_.graph().leaves[leaf];
  Value fitted = value;
  if (target.type.is_scalar()) convert_known_int(fitted, target.type.scalar);
  const std::vector<dsl::Note> notes{{target.span, "'" + target.name + "' is declared here"}};
  if (!fitted.is_numeric() || element_type(fitted) != target.type) {
    report(Code::E0603, span,
           "expected " + target.type.str() + " as " + std::string(what) + ", found " + describe_element(value), notes);
    return std::nullopt;
  }
  const Extent extent = extent_of(fitted);
  const auto both = ir::broadcast(extent, target.extent);
  if (!both || *both != target.extent) {
    report(Code::E0603, span,
           "expected " + target.type.str() + target.extent.str() + " as " + std::string(what) + ", found " +
               describe(fitted),
           notes);
    return std::nullopt;
  }
  const Image image{materialize(fitted)};
  return Image{ops::broadcast(b_, image.id, target.extent)};
}

void Elaborator::run_update(const dsl::Stmt& stmt) {
  const Expr& path = *stmt.target;
  const std::string& name = path.name;
  const auto leaf = find_leaf(path);
  if (!leaf || b_.graph().leaves[*leaf].kind == ir::Leaf::Kind::Input) {
    std::vector<std::string> known;
    for (const ir::Leaf& other : b_.graph().leaves) {
      if (other.kind != ir::Leaf::Kind::Input) known.push_back(other.name);
    }
    const ModuleInfo* module = path.kind == Expr::Kind::NameRef ? scope_->module : module_of(*path.a);
    const auto item = module ? module->items.find(name) : ModuleItems::const_iterator{};
    const bool failed = module && item != module->items.end() && item->second.kind == ModuleItem::Kind::Leaf && !leaf;
    if (failed) return;  // its declaration was wrong
    if (path.kind == Expr::Kind::Field && !module && evaluate(*path.a).is_error()) return;
    report(Code::E0601, stmt.target->span,
           "expected a param or state before '<-', found " + std::string(leaf ? "the input " : "") + "'" + name + "'",
           {}, leaf ? "" : suggestion(name, known));
    return;
  }
  const auto writer = step_->writers.find(*leaf);
  const std::string what = "the next value of '" + name + "'";
  if (writer == step_->writers.end()) {
    const auto value = fit_leaf(evaluate(*stmt.a), *leaf, stmt.a->span, what);
    step_->writers[*leaf] = {stmt.span, step_->step->updates.size(), false};
    if (value) step_->step->updates.push_back({*leaf, value->id});
    return;
  }
  if (!writer->second.minimized) {
    report(Code::E0602, stmt.span, "expected one writer of '" + name + "' in a step, found a second",
           {{writer->second.span, "the first one is here"}});
    return;
  }
  // After `minimize`, one update of the same param projects what the optimizer gave: there the name means the new
  // value.
  writer->second.minimized = false;
  writer->second.span = stmt.span;
  const size_t place = writer->second.update;
  if (place >= step_->step->updates.size()) return;  // the optimizer's value was wrong
  const Value next = Image{step_->step->updates[place].value};
  const ModuleInfo* module = path.kind == Expr::Kind::NameRef ? nullptr : module_of(*path.a);
  Scope* scope = new_scope(scope_);
  if (!module) define_inner(*scope, name, next, scope_->module->items.find(name)->second.span, Binding::Kind::Let);
  const ModuleItem* item = module ? &module->items.find(name)->second : nullptr;
  const Switched<std::pair<const ModuleItem*, Value>> projected(projected_, {item, next});
  const Switched<Scope*> inside(scope_, scope);
  const auto value = fit_leaf(evaluate(*stmt.a), *leaf, stmt.a->span, what);
  if (value) step_->step->updates[place].value = value->id;
}

// `m <- e` in an optimizer's update.
void Elaborator::run_optimizer_update(const dsl::Stmt& stmt) {
  const std::string& name = stmt.target->name;
  const auto state = optimizer_->states.find(name);
  if (state == optimizer_->states.end()) {
    std::vector<std::string> known;
    for (const auto& [other, leaf] : optimizer_->states) known.push_back(other);
    report(Code::E0614, stmt.target->span,
           "expected a state of the optimizer '" + optimizer_->name + "' before '<-', found '" + name + "'", {},
           suggestion(name, known));
    return;
  }
  const uint32_t leaf = state->second.first;
  if (const auto writer = step_->writers.find(leaf); writer != step_->writers.end()) {
    report(Code::E0602, stmt.span, "expected one writer of '" + name + "' in an optimizer, found a second",
           {{writer->second.span, "the first one is here"}});
    return;
  }
  const auto value = fit_leaf(evaluate(*stmt.a), leaf, stmt.a->span, "the next value of '" + name + "'");
  step_->writers[leaf] = {stmt.span, step_->step->updates.size(), false};
  if (value) step_->step->updates.push_back({leaf, value->id});
}

// ---- gradients ----

std::vector<ValueId> Elaborator::emit_grad(const Value& y, const Value& seed, std::span<const ValueId> targets) {
  std::vector<ValueId> operands{materialize(y), materialize(seed)};
  operands[1] = ops::broadcast(b_, operands[1], b_.value(operands[0]).extent);
  operands.insert(operands.end(), targets.begin(), targets.end());
  return ops::emit_multi(b_, OpKind::Grad, std::move(operands));
}

std::optional<std::vector<ValueId>> Elaborator::grad_targets(const Value& y, const Value& x, const Span& y_span,
                                                             const Span& x_span) {
  if (!y.is_numeric() || !element_type(y).is_float()) {
    report(Code::E0608, y_span, "expected a float, vector or matrix of floats to differentiate, found " + describe(y));
    return std::nullopt;
  }
  std::vector<ValueId> targets;
  bool ok = true;
  // What the expression in the place of x has just made: y was there before.
  const auto is_new = [&](ValueId target) {
    const auto* value = y.get<Image>();
    const ir::ValueInfo& info = b_.value(target);
    return value && info.name.empty() && info.op.valid() && b_.value(value->id).op.valid() &&
           info.op.index > b_.value(value->id).op.index;
  };
  const auto take = [&](const Value& leaf, const std::string& part) {
    const std::string of_part = part.empty() ? "" : " in '" + part + "'";
    const auto* target = leaf.get<Image>();
    if (target && is_new(target->id)) {
      ok = false;
      report(Code::E0607, x_span,
             "expected a leaf or a name to differentiate by, found an expression, which nothing depends on", {},
             "bind it with 'let', and compute what is differentiated of that name");
    } else if (!target) {
      ok = false;
      const bool known = leaf.is_numeric();
      report(Code::E0607, x_span,
             "expected a leaf or a value computed from leaves to differentiate by, found " +
                 (known ? "a number known at compile time" : describe(leaf)) + of_part);
    } else if (!element_type(leaf).is_float()) {
      ok = false;
      report(Code::E0608, x_span, "expected floats to differentiate by, found " + describe(leaf) + of_part);
    } else if (target->element != 0 && extent_of(leaf) != extent_of(y)) {
      ok = false;
      report(Code::E0607, x_span,
             "expected an element of the extent of what is differentiated, found " + describe(leaf) + " and " +
                 describe(y));
    } else {
      targets.push_back(target->id);
    }
  };
  const std::function<void(const Value&, const std::string&)> walk = [&](const Value& value, const std::string& path) {
    const std::vector<Value>& parts = parts_of(value);
    for (size_t i = 0; i < parts.size(); ++i) walk(parts[i], path + (path.empty() ? "" : ".") + part_name(value, i));
    if (parts.empty()) take(value, path);
  };
  walk(x, "");
  if (ok && targets.empty()) {
    ok = false;
    report(Code::E0607, x_span,
           "expected a leaf or a value computed from leaves to differentiate by, found " + describe(x));
  }
  return ok ? std::optional(std::move(targets)) : std::nullopt;
}

Value Elaborator::grad(const Value& y, const Value& x, const std::optional<Argument>& seed, const Span& y_span,
                       const Span& x_span) {
  const auto targets = grad_targets(y, x, y_span, x_span);
  if (!targets) return Error{};
  const Type type = element_type(y);
  Value start = Constant{type, std::vector<double>(static_cast<size_t>(type.components()), 1.0)};
  if (seed) {
    start = seed->value;
    if (type.is_scalar()) convert_known_int(start, Scalar::Float);
    const auto both = start.is_numeric() ? ir::broadcast(extent_of(start), extent_of(y)) : std::nullopt;
    if (!start.is_numeric() || element_type(start) != type || !both || *both != extent_of(y)) {
      return fail(Code::E0609, seed->span,
                  "expected a seed of " + describe(y) + ", as what is differentiated, found " + describe(seed->value));
    }
  }
  const std::vector<ValueId> results = emit_grad(y, start, *targets);
  size_t next = 0;
  return map_leaves(x, [&](const Value& leaf) -> Value { return image(results[next++], {&y, &leaf}); });
}

// How `y` changes along a direction is how the gradient's product with the direction changes with the seed: what leads
// from a seed to the gradient is linear, and its adjoint leads from directions to changes. Nothing of the result
// depends on the seed's value.
Value Elaborator::jvp(const Value& y, const Value& x, const Value& direction, const BuiltinCall& call) {
  const auto targets = grad_targets(y, x, call.spans[0], call.spans[1]);
  if (!targets || contains_error(direction)) return Error{};
  std::vector<Value> along;
  for_each_leaf(direction, [&](const Value& leaf) { along.push_back(leaf); });
  bool fits = along.size() == targets->size();
  for (size_t k = 0; fits && k < along.size(); ++k) {
    const ir::ValueInfo& target = b_.value((*targets)[k]);
    if (!along[k].is_numeric()) {
      fits = false;
      continue;
    }
    if (target.type.is_scalar()) convert_known_int(along[k], Scalar::Float);
    const auto both = ir::broadcast(extent_of(along[k]), target.extent);
    fits = element_type(along[k]) == target.type && both && *both == target.extent;
  }
  if (!fits) {
    return fail(
        Code::E0609, call.spans[2],
        "expected a direction of " + describe(x) + ", as what is differentiated by, found " + describe(direction));
  }
  const Type type = element_type(y);
  const Value seed = image(ops::broadcast(b_, ops::constant(b_, type, 1.0), extent_of(y)), {&y});
  const std::vector<ValueId> gradients = emit_grad(y, seed, *targets);
  ValueId sum;
  for (size_t k = 0; k < gradients.size(); ++k) {
    const Type part = element_type(along[k]);
    const ValueId d = materialize(along[k]);
    for (int c = 0; c < (part.is_matrix() ? part.cols : 1); ++c) {
      const ValueId a = part.is_matrix() ? ops::extract(b_, gradients[k], c) : gradients[k];
      const ValueId b = part.is_matrix() ? ops::extract(b_, d, c) : d;
      ir::Attrs all;
      all.ints = {1, 1, 1};
      const ValueId product = part.is_scalar() ? ops::mul(b_, a, b) : ops::emit(b_, OpKind::Dot, {a, b});
      const ValueId term = ops::emit(b_, OpKind::ReduceSum, {product}, std::move(all));
      sum = sum.valid() ? ops::add(b_, sum, term) : term;
    }
  }
  return image(emit_grad(Image{sum}, make_float(1), std::vector<ValueId>{seed.as<Image>().id})[0], {&y});
}

// ---- optimizers ----

void Elaborator::run_minimize(const dsl::Stmt& stmt) {
  Value objective = evaluate(*stmt.a);
  bool ok = !contains_error(objective);
  if (ok) convert_known_int(objective, Scalar::Float);
  if (ok && (!objective.is_numeric() || element_type(objective) != ir::kFloat || !extent_of(objective).is_unit())) {
    const bool image = objective.is_numeric() && element_type(objective).is_float();
    report(Code::E0605, stmt.a->span, "expected one float to minimize, found " + describe(objective), {},
           image ? "take its mean or sum" : "");
    ok = false;
  }
  std::vector<uint32_t> leaves;
  for (const dsl::ExprPtr& target : stmt.targets) {
    const auto leaf = find_leaf(*target);
    const bool named = leaf || target->kind == Expr::Kind::NameRef;
    const std::string name = named ? "'" + target->name + "'" : "an expression";
    if (!leaf || b_.graph().leaves[*leaf].kind != ir::Leaf::Kind::Param) {
      if (!leaf && contains_error(evaluate(*target))) {
        ok = false;
        continue;
      }
      report(Code::E0604, target->span,
             "expected a param after 'over', found " +
                 (leaf ? "the " + std::string(kind_word(b_.graph().leaves[*leaf].kind)) + " " : "") + name);
      ok = false;
      continue;
    }
    if (!b_.graph().leaves[*leaf].type.is_float()) {
      report(
          Code::E0604, target->span,
          "expected a param of floats after 'over', found " + name + " of type " + b_.graph().leaves[*leaf].type.str());
      ok = false;
    }
    if (const auto writer = step_->writers.find(*leaf); writer != step_->writers.end()) {
      report(Code::E0602, target->span, "expected one writer of " + name + " in a step, found a second",
             {{writer->second.span, "the first one is here"}});
      ok = false;
    }
    // Also named twice in one `over`: the slot is filled below.
    step_->writers[*leaf] = {target->span, SIZE_MAX, true};
    leaves.push_back(*leaf);
  }
  const Expr& named = stmt.b->kind == Expr::Kind::Call ? *stmt.b->a : *stmt.b;
  const Switched<Span> optimizer_at(optimizer_at_, named.span);
  const Value optimizer = evaluate(*stmt.b);
  if (contains_error(optimizer)) ok = false;
  const auto* chosen = optimizer.get<OptimizerValue>();
  if (ok && !chosen) {
    report(Code::E0606, stmt.b->span, "expected an optimizer after 'with', found " + describe(optimizer), {},
           optimizers_here());
    ok = false;
  }
  if (!ok) return;
  OptimizerValue called = *chosen;
  if (!called.called) {
    const Value with_defaults = call_optimizer(called, {}, stmt.b->span);
    if (with_defaults.is_error()) return;
    called = with_defaults.as<OptimizerValue>();
  }

  std::vector<Value> targets;
  std::vector<ValueId> ids;
  for (const uint32_t leaf : leaves) {
    targets.push_back(leaf_values_.at(leaf));
    ids.push_back(targets.back().as<Image>().id);
  }
  const std::vector<ValueId> gradients = emit_grad(objective, make_float(1), ids);
  for (size_t i = 0; i < leaves.size(); ++i) {
    const Value next = instantiate(called, leaves[i], targets[i], Image{gradients[i]}, stmt);
    const auto value = fit_leaf(next, leaves[i], stmt.b->span,
                                "the optimizer's value for '" + b_.graph().leaves[leaves[i]].name + "'");
    if (!value) continue;
    step_->writers[leaves[i]].update = step_->step->updates.size();
    step_->step->updates.push_back({leaves[i], value->id});
  }
}

// One optimizer for one param: states of its own, and its update inlined.
Value Elaborator::instantiate(const OptimizerValue& optimizer, uint32_t leaf, const Value& x, const Value& g,
                              const dsl::Stmt& stmt) {
  const dsl::OptimizerDecl& decl = *optimizer.decl;
  const ir::Leaf param = b_.graph().leaves[leaf];
  Scope* scope = new_scope(optimizer.scope);
  OptimizerFrame frame;
  frame.name = decl.name.text;
  frame.frame = frames_.size() + 1;
  for (const dsl::LeafDecl& state : decl.states) {
    const Switched<Scope*> inside(scope_, scope);
    const SpanScope span(*this, state.span);
    ir::Leaf memory{ir::Leaf::Kind::State,
                    step_->step->name + "." + param.name + "." + state.name.text,
                    param.type,
                    param.extent,
                    {},
                    state.span};
    if (state.type) {
      const auto resolved = type_name(*state.type);
      if (!resolved) return Error{};
      const auto& type = resolved->as<TypeValue>();
      if (type.kind != TypeValue::Kind::Element) {
        return fail(Code::E0613, state.type->span,
                    "expected a scalar, vector or matrix type for the state '" + state.name.text + "', found " +
                        describe(type));
      }
      memory.type = type.element;
      memory.extent = {};
      Dim* axes[] = {&memory.extent.w, &memory.extent.h, &memory.extent.l};
      for (size_t i = 0; i < state.type->extents.size() && i < 3; ++i) {
        const auto dim = evaluate_dim(*state.type->extents[i], "an extent");
        if (!dim) return Error{};
        *axes[i] = *dim;
      }
    }
    if (state.initial) {
      bool ok = true;
      memory.initial = initial_value(state, memory.type, ok);
      if (!ok) return Error{};
    }
    const auto index = static_cast<uint32_t>(b_.graph().leaves.size());
    b_.graph().leaves.push_back(memory);
    ir::Attrs attrs;
    attrs.text = memory.name;
    const ValueId id = ops::emit(b_, OpKind::Leaf, {}, std::move(attrs));
    b_.set_name(id, memory.name);
    define(*scope, state.name, Image{id});
    if (Binding* binding = scope->find(state.name.text)) binding->leaf = index;
    frame.states[state.name.text] = {index, state.span};
  }
  const Switched<OptimizerFrame*> inside(optimizer_, &frame);
  FunctionValue update{.decl = &decl.update, .scope = scope, .creator = frames_.size(), .is_lambda = true, .self = {}};
  return call_with(update, {x, g}, stmt.b->span);
}

}  // namespace dr::lower
