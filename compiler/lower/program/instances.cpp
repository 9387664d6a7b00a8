// SPDX-License-Identifier: Apache-2.0
// Instances of modules: `let rig = studio(size = 64);` gives the leaves, `let`s and steps of a file to the program,
// under names such as `rig.light`. And what steps leave to others: how often they have run, and the values leaves begin
// with.
#include <algorithm>

#include "compiler/ir/initial_step.h"
#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

// ---- instances ----

// The parameters become names at the instance's top level, and so do the names in extents that they bind.
bool Elaborator::bind_module_params(ModuleInfo& instance, std::vector<Argument> args, const Span& span,
                                    const std::string& name) {
  static const std::vector<dsl::Name> kNoGenerics;
  Scope* scope = new_scope(&instance.scope);
  const bool ok = bind_params(instance.syntax->params, kNoGenerics, std::move(args), *scope, span, name,
                              instance.syntax->params_span, false);
  for (const dsl::Param& param : instance.syntax->params) {
    ModuleItem& item = instance.items.find(param.name.text)->second;
    const Binding* binding = scope->find(param.name.text);
    item.value = binding ? binding->value : Value(Error{});
    item.state = ModuleItem::State::Done;
  }
  for (const auto& [bound, binding] : scope->names) {
    if (instance.items.contains(bound)) continue;
    instance.items.emplace(bound,
                           ModuleItem{.kind = ModuleItem::Kind::Symbol, .span = binding.span, .value = binding.value});
  }
  return ok;
}

Value Elaborator::instantiate_module(ModuleInfo& base, const Expr& call) {
  const std::string words = base.path.substr(base.path.find_last_of("/:") + 1);
  const std::string file = words.substr(0, words.rfind(".dr"));
  if (&call != instance_let_.first || base.is_instance) {
    return fail(Code::E0515, call.span,
                base.is_instance ? "expected a module before '(', found an instance of one"
                                 : "expected the instance of a module as a 'let' at the top level, found it elsewhere",
                {}, "write 'let name = " + file + "(...);' outside of functions and steps");
  }
  const dsl::Name& name = *instance_let_.second;
  std::vector<Argument> args = evaluate_args(call.args);
  ModuleInfo& outer = *scope_->module;
  for (const dsl::Item& item : outer.syntax->items) {
    if (item.kind != dsl::Item::Kind::Step || item.step->name.text != name.text) continue;
    return fail(Code::E0202, name.span, "expected a name of its own for an instance, found that of a step",
                {{item.step->name.span, "the step '" + name.text + "' is here"}});
  }

  ModuleInfo& instance = modules_.emplace_back();
  instance.path = base.path;
  instance.folder = base.folder;
  instance.syntax = base.syntax;
  instance.is_instance = true;
  instance.prefix = outer.prefix + name.text + ".";
  instance.scope.module = &instance;
  for (const auto& [import, item] : base.items)
    if (item.kind == ModuleItem::Kind::Import) instance.items.emplace(import, item);
  collect_items(instance);
  collect_vjps(instance);
  instance.loading = false;
  if (!bind_module_params(instance, std::move(args), call.span, file)) return Error{};

  instances_.emplace_back(file, call.span);
  {
    const Switched<Scope*> inside(scope_, &instance.scope);
    declare_leaves(instance);
    run_program(instance);
  }
  instances_.pop_back();
  return ModuleValue{&instance};
}

// ---- how often a step has run ----

// A state that the step counts up, so that others see it too.
Value Elaborator::step_count(const Expr& expr) {
  const Expr& path = *expr.a;
  const ModuleInfo* module = path.kind == Expr::Kind::NameRef ? scope_->module : module_of(*path.a);
  if (!module && evaluate(*path.a).is_error()) return Error{};
  if (module) observe_step(path, *module);
  std::vector<std::string> known;
  bool found = false;
  if (module && module->runs()) {
    for (const dsl::Item& item : module->syntax->items) {
      if (item.kind != dsl::Item::Kind::Step) continue;
      known.push_back(item.step->name.text);
      found = found || item.step->name.text == path.name;
    }
  }
  if (!found) {
    return fail(Code::E0514, path.span, "expected the name of a step after 'step_index of', found '" + path.name + "'",
                {}, suggestion(path.name, known));
  }
  const std::string step = module->prefix + path.name;
  if (const auto made = step_counts_.find(step); made != step_counts_.end()) return Image{made->second.value};
  StepCount count{static_cast<uint32_t>(b_.graph().leaves.size()), {}};
  b_.at_root([&] {
    count.value = add_leaf({ir::Leaf::Kind::State, step + ".step_index", ir::kInt, {}, {0.0}, expr.span});
  });
  step_counts_.emplace(step, count);
  return Image{count.value};
}

void Elaborator::count_steps() {
  for (const auto& [name, count] : step_counts_) {
    const auto index = b_.graph().step_index(name);
    if (!index) continue;  // it was wrong
    const ValueId next = ops::add(b_, count.value, ops::constant(b_, ir::kInt, 1.0));
    b_.graph().steps[*index].updates.push_back({count.leaf, next});
  }
}

// ---- initial values that are computed ----

// The image that fills the leaf, of its type and extent.
std::optional<ValueId> Elaborator::computed_initial(const dsl::LeafDecl& decl, const Value& value,
                                                    const ir::Leaf& leaf) {
  const auto wrong = [&](const std::string& found, std::vector<dsl::Note> notes = {}) {
    report(Code::E0612, decl.initial->span,
           "expected a value of type " + leaf.type.str() + leaf.extent.str() + " for '" + decl.name.text + "', found " +
               found,
           std::move(notes));
    return std::nullopt;
  };
  const Type found = element_type(value);
  if (found != leaf.type && (found != leaf.type.element() || leaf.type.is_matrix())) return wrong(describe(value));
  const auto both = ir::broadcast(extent_of(value), leaf.extent);
  if (!both || *both != leaf.extent) return wrong(describe(value));
  const ValueId id = ops::broadcast(b_, materialize(found == leaf.type ? value : splat(value, leaf.type)), leaf.extent);
  const std::vector<bool> live = ir::live_ops(b_.graph(), {&id, 1});
  for (const ir::OpId op : b_.graph().region(b_.graph().root()).ops) {
    const ir::Op& read = b_.graph().op(op);
    if (!live[op.index] || read.kind != OpKind::Leaf) continue;
    const ir::Leaf& other = b_.graph().leaves[*b_.graph().leaf_index(read.attrs.text)];
    if (other.kind == ir::Leaf::Kind::Input) continue;
    return wrong("one that reads '" + other.name + "', which steps change",
                 {{other.span, "'" + other.name + "' is declared here"}});
  }
  return id;
}

// Each is a step with one update, which the host runs before a step first needs the leaf.
void Elaborator::add_initial_steps() {
  for (const auto& [leaf, value] : initials_) {
    const std::string name = ir::initial_step_of(b_.graph().leaves[leaf].name);
    b_.graph().steps.push_back({name, {}, {{leaf, value}}});
  }
}

}  // namespace dr::lower
