// SPDX-License-Identifier: Apache-2.0
// The entry of lowering: limits, and the root file's leaves, `let`s and steps in the order written.
#include "compiler/lower/lower.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "compiler/ir/initial_step.h"
#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"
#include "dsl/syntax/parser.h"

namespace dr::lower {

std::optional<ir::Graph> lower(dsl::SourceManager& sources, dsl::FileId root, const Options& options,
                               dsl::DiagnosticList& diagnostics) {
  // Where a gradient is asked for of what is zero by an input, that input's value has to stay open.
  Options chosen = options;
  for (;;) {
    const dsl::DiagnosticList before = diagnostics;
    if (chosen.zero_count) *chosen.zero_count = {};
    Elaborator elaborator(sources, chosen, diagnostics);
    auto graph = elaborator.run(root);
    const std::vector<std::string> open = elaborator.inputs_to_open();
    if (!graph || open.empty()) return graph;
    chosen.open.insert(open.begin(), open.end());
    diagnostics = before;
  }
}

std::vector<std::string> builtin_names() { return Elaborator::builtin_names(); }

std::vector<std::string> type_names() {
  return {"bool",  "int",   "uint",  "float", "vec2",  "vec3",  "vec4", "ivec2", "ivec3", "ivec4",
          "uvec2", "uvec3", "uvec4", "bvec2", "bvec3", "bvec4", "mat2", "mat3",  "mat4"};
}

void Elaborator::set_span(const Span& span) {
  span_ = span;
  b_.set_span(span);
}

// Whether elaboration has to end. Unrolling can multiply without bound: each limit below is a message, not a hang.
bool Elaborator::over_budget(const Span& span, size_t cost) {
  if (exhausted_ || diagnostics_.full()) return true;
  constexpr size_t kStopEvery = 64;
  const size_t before = steps_;
  steps_ += cost;
  if (observation_ && observation_->stop && before / kStopEvery != steps_ / kStopEvery && observation_->stop())
    return observation_->stopped = exhausted_ = true;
  if (b_.graph().op_count() > options_.max_ops) {
    report(Code::E0503, span,
           "expected a program of at most " + std::to_string(options_.max_ops) +
               " operations after unrolling, found more");
    exhausted_ = true;
  } else if (steps_ > options_.max_expressions) {
    report(Code::E0503, span,
           "expected at most " + std::to_string(options_.max_expressions) + " expressions after unrolling, found more");
    exhausted_ = true;
  }
  return exhausted_;
}

// Whether one more part, and what is in it, can be added to a tuple, array or struct that has so many; counts it.
bool Elaborator::has_room(const Value& part, size_t& parts, const Span& span) {
  size_t more = 0;
  for_each_leaf(part, [&](const Value&) { ++more; });
  parts += more;
  steps_ += more;
  if (exhausted_ || parts <= options_.max_parts) return !exhausted_;
  report(Code::E0503, span,
         "expected a tuple, array or struct of at most " + std::to_string(options_.max_parts) +
             " values, those of its parts counted, found more");
  exhausted_ = true;
  return false;
}

// ---- the program ----

namespace {

struct DeepGradient {
  Span span;
  size_t order;
};

template <class F>
void for_each_source(const ir::Graph& graph, const ir::Op& op, F&& use) {
  for (const ValueId operand : op.operands) use(operand);
  for (const ir::RegionId region : op.regions)
    for (const ValueId yield : graph.region(region).yields) use(yield);
}

// How many gradients deep a gradient is, from those before it: one more than those on the ways from its targets to its
// value. What only leads to its seed is on none: it is multiplied with, and not differentiated.
size_t order_of_gradient(const ir::Graph& graph, const ir::Op& gradient, const std::vector<size_t>& orders) {
  std::vector<bool> depends(graph.value_count()), needed(graph.value_count());
  const ir::OpId last = graph.value(gradient.operands[0]).op;
  for (const ValueId target : std::span(gradient.operands).subspan(2)) depends[target.index] = true;
  needed[gradient.operands[0].index] = true;
  if (!last.valid()) return 1;
  for (uint32_t k = 0; k <= last.index; ++k) {
    const ir::Op& op = graph.op({k});
    bool any = false;
    for_each_source(graph, op, [&](ValueId v) { any = any || depends[v.index]; });
    for (const ValueId result : op.results) depends[result.index] = depends[result.index] || any;
  }
  size_t order = 0;
  for (uint32_t k = last.index + 1; k-- > 0;) {
    const ir::Op& op = graph.op({k});
    if (std::ranges::none_of(op.results, [&](ValueId v) { return needed[v.index] && depends[v.index]; })) continue;
    for_each_source(graph, op, [&](ValueId v) { needed[v.index] = true; });
    if (op.kind == OpKind::Grad) order = std::max(order, orders[k]);
  }
  return order + 1;
}

// A gradient comes to about four times the ops of what it is of, so gradients of gradients grow with a power of four.
std::optional<DeepGradient> too_deep_gradient(const ir::Graph& graph, size_t max_ops) {
  constexpr size_t kGrowth = 4;
  const auto is_too_deep = [&](size_t order) {
    size_t ops = graph.op_count();
    for (size_t i = 1; i < order && ops <= kGrowth * max_ops; ++i) ops *= kGrowth;
    return ops > kGrowth * max_ops;
  };
  size_t gradients = 0;
  for (uint32_t k = 0; k < graph.op_count(); ++k) gradients += graph.op({k}).kind == OpKind::Grad ? 1 : 0;
  if (!is_too_deep(gradients)) return std::nullopt;
  std::vector<size_t> orders(graph.op_count());
  for (uint32_t k = 0; k < graph.op_count(); ++k) {
    const ir::Op& op = graph.op({k});
    if (op.kind != OpKind::Grad) continue;
    orders[k] = order_of_gradient(graph, op, orders);
    if (is_too_deep(orders[k])) return DeepGradient{op.span, orders[k]};
  }
  return std::nullopt;
}

struct TooLarge {
  Span span;
  ir::Extent extent;
};

// Whether an image has more elements than an int counts, however small its symbols are.
bool is_too_large(const ir::Extent& extent) {
  constexpr int64_t kMost = std::numeric_limits<int32_t>::max();
  const Dim elements = extent.w * extent.h * extent.l;
  ir::SymbolValues ones;
  for (const Dim* axis : {&extent.w, &extent.h, &extent.l}) {
    for (const std::string& symbol : axis->symbols()) ones[symbol] = 1;
  }
  // Where the product of constants does not fit, nor does the image.
  const std::optional<int64_t> count = elements.evaluate(ones);
  return !count || *count > kMost;
}

std::optional<TooLarge> too_large(const ir::Graph& graph) {
  std::set<ir::Extent> fitting{ir::Extent{}};
  const auto too_large = [&](const ir::Extent& extent) {
    if (fitting.contains(extent)) return false;
    if (is_too_large(extent)) return true;
    fitting.insert(extent);
    return false;
  };
  for (const ir::Leaf& leaf : graph.leaves) {
    if (too_large(leaf.extent)) return TooLarge{leaf.span, leaf.extent};
  }
  for (uint32_t k = 0; k < graph.value_count(); ++k) {
    const ir::ValueInfo& value = graph.value(ValueId{k});
    if (value.op.valid() && too_large(value.extent)) return TooLarge{graph.op(value.op).span, value.extent};
  }
  return std::nullopt;
}

}  // namespace

std::optional<ir::Graph> Elaborator::run(dsl::FileId root) {
  const std::string name(sources_.name(root));
  const size_t slash = name.rfind('/');
  root_ = load_module(root, name, slash == std::string::npos ? "." : name.substr(0, slash + 1));
  // A tree with holes would only repeat what the parser has said.
  if (!parsed_ && !observation_) return std::nullopt;
  if (!parsed_) observation_->messages_of_text = diagnostics_.all().size();
  scope_ = &root_->scope;
  b_.reserve(sources_.text(root).size() / 4);  // long programs give about an op for six characters
  apply_defines(*root_);
  for (const dsl::Param& param : root_->syntax->params) {
    if (param.default_value) continue;
    report(Code::E0304, param.name.span,
           "expected a program, found a module whose parameter '" + param.name.text + "' nothing gives", {},
           "make an instance of it in a program, or give the parameter a default value");
    return std::nullopt;
  }
  bind_module_params(*root_, {}, root_->syntax->params_span, "");
  declare_leaves(*root_);
  run_program(*root_);
  count_steps();
  add_initial_steps();
  if (const auto deep = too_deep_gradient(b_.graph(), options_.max_ops)) {
    report(Code::E0503, deep->span,
           "expected a program that stays below " + std::to_string(options_.max_ops) +
               " operations, found gradients of gradients, " + std::to_string(deep->order) + " deep");
  }
  if (const auto large = too_large(b_.graph())) {
    report(Code::E0406, large->span,
           "expected an image of fewer than 2^31 elements, found one of " + large->extent.str());
  }
  if (diagnostics_.has_errors()) return std::nullopt;
  warn_of_shared_counts();
  for (const uint32_t leaf : zeros_.used()) b_.graph().leaves[leaf].is_fixed = true;
  for (const uint32_t leaf : zeros_.sought()) inputs_to_open_.push_back(b_.graph().leaves[leaf].name);
  return std::move(b_).finish();
}

// `step_index` counts the runs of the step that runs. Where a step uses a schedule that a step which changes something
// uses too, it starts again there, and a step that only looks sees another model: a program rarely means that.
void Elaborator::warn_of_shared_counts() {
  if (counts_.empty()) return;
  // By the instance and the start of the let.
  struct Users {
    Span let;
    std::vector<std::string> steps;  // those that change something first
    bool changes = false;
  };
  std::map<std::pair<std::string, uint32_t>, Users> users;
  std::vector<const ir::Step*> steps;
  for (const ir::Step& step : b_.graph().steps)
    if (ir::leaf_of_initial_step(step.name).empty()) steps.push_back(&step);  // they count nothing
  std::ranges::stable_partition(steps, [](const ir::Step* step) { return !step->updates.empty(); });
  for (const ir::Step* const of : steps) {
    const ir::Step& step = *of;
    std::vector<ValueId> roots;
    for (const ir::Output& output : step.outputs) roots.push_back(output.value);
    for (const ir::Update& update : step.updates) roots.push_back(update.value);
    const std::vector<bool> live = ir::live_ops(b_.graph(), roots);
    for (const auto& [op, let, prefix] : counts_) {
      if (!live[op.index]) continue;
      Users& found = users[{prefix, let.begin}];
      found.let = let;
      found.changes = found.changes || !step.updates.empty();
      if (std::ranges::find(found.steps, step.name) == found.steps.end()) found.steps.push_back(step.name);
    }
  }
  // One warning for all the schedules that the same steps share.
  std::map<std::vector<std::string>, std::vector<Span>> shared;
  for (const auto& [where, user] : users)
    if (user.steps.size() > 1 && user.changes) shared[user.steps].push_back(user.let);
  for (const auto& [names, lets] : shared) {
    dsl::Diagnostic& warning =
        diagnostics_.warning(Code::E0618, lets[0],
                             "expected a schedule for each step, found one that the steps '" + names[0] + "' and '" +
                                 names[1] + "' share: 'step_index' starts at 0 in each of them");
    for (size_t k = 1; k < lets.size(); ++k) warning.notes.push_back({lets[k], "this one, too"});
    warning.help = "say which count is meant, as 'step_index of " + names[0] +
                   "' (the schedules of std.optim take it as 'at'), or write the schedule in the steps; random numbers "
                   "that are to stay "
                   "the same are a state's initial value";
  }
}

namespace {

bool is_const_of_library(const std::string& path, std::string_view name) {
  const auto text = library_module(path);
  if (!text) return false;
  dsl::SourceManager sources;
  dsl::DiagnosticList ignored;
  const dsl::Module module = dsl::parse(sources, sources.add(path, std::string(*text)), ignored);
  return std::ranges::any_of(module.items, [&](const dsl::Item& item) {
    return item.kind == dsl::Item::Kind::Const && item.constant->name.text == name;
  });
}

}  // namespace

// A number of a const that declares no type is of the type that it has as written: -D RATE=4 is 4.0 for `const RATE =
// 0.5;`.
void Elaborator::apply_defines(ModuleInfo& root) {
  struct Define {
    ModuleItem* item;
    std::string name;
    dsl::FileId file;
    Span all;
    Value written;
  };
  std::vector<Define> defines;
  for (const auto& [name, text] : options_.defines) {
    const dsl::FileId file = sources_.add("-D " + name, text);
    const Span all{file, 0, static_cast<uint32_t>(text.size())};
    // Those of the library by their module's name, std.loss.weight; what one that is not imported has is of no effect.
    ModuleInfo* module = &root;
    std::string item_name = name;
    if (const size_t dot = name.rfind('.'); dot != std::string::npos) {
      std::string path = name.substr(0, dot);
      std::ranges::replace(path, '.', '/');
      path += ".dr";
      const auto imported = std::ranges::find(modules_, "library:" + path, &ModuleInfo::path);
      if (imported == modules_.end() && is_const_of_library(path, name.substr(dot + 1))) continue;
      if (imported != modules_.end()) {
        module = &*imported;
        item_name = name.substr(dot + 1);
      }
    }
    const auto found = module->items.find(item_name);
    if (found == module->items.end() || found->second.kind != ModuleItem::Kind::Const) {
      const std::vector<std::string> known =
          names_of(module->items, [](const ModuleItem& item) { return item.kind == ModuleItem::Kind::Const; });
      report(Code::E0209, all, "expected the name of a const of the program after -D, found '" + name + "'", {},
             suggestion(item_name, known));
      continue;
    }
    Define& define = defines.emplace_back(Define{&found->second, name, file, all, {}});
    if (!define.item->constant->type) define.written = item_value(*module, item_name, *define.item, all);
    if (diagnostics_.has_errors()) return;
  }
  // What they are made of, and what is made of them, is computed anew.
  for (ModuleInfo& module : modules_)
    for (auto& [name, item] : module.items)
      if (item.constant != nullptr) item.state = ModuleItem::State::Waiting;
  if (observation_) observation_->names.clear();  // and so is what they are shown as
  for (const Define& define : defines) {
    const dsl::ExprPtr expr = dsl::parse_expression(sources_, define.file, diagnostics_);
    if (diagnostics_.has_errors()) return;
    Value value = evaluate(*expr);
    if (!value.is_error() && define.item->constant->type) {
      const auto fitted = declared(value, *define.item->constant->type, define.name, define.all);
      value = fitted ? *fitted : Value(Error{});
    } else if (const auto* written = define.written.get<Constant>(); written && value.is<Dim>()) {
      const Scalar scalar = written->type.scalar;
      if (!convert_known_int(value, scalar) && scalar == Scalar::Uint)
        value = fail(Code::E0309, define.all,
                     "expected a uint for '" + define.name + "', as it is one, found " + describe(value));
    }
    define.item->value = value;
    define.item->state = ModuleItem::State::Done;
    observe(define.item->span, value, define.item->span);
  }
}

void Elaborator::declare_leaves(ModuleInfo& module) {
  for (const dsl::Item& item : module.syntax->items) {
    if (item.kind == dsl::Item::Kind::Leaf) declare_leaf(module, *item.leaf);
  }
  // An initial value may read inputs, wherever they are declared.
  for (const dsl::Item& item : module.syntax->items) {
    if (item.kind == dsl::Item::Kind::Leaf && item.leaf->initial) begin_leaf(module, *item.leaf);
  }
}

namespace {

ir::Leaf::Kind leaf_kind(dsl::LeafDecl::Kind kind) {
  switch (kind) {
    case dsl::LeafDecl::Kind::Param: return ir::Leaf::Kind::Param;
    case dsl::LeafDecl::Kind::Input: return ir::Leaf::Kind::Input;
    case dsl::LeafDecl::Kind::State: return ir::Leaf::Kind::State;
  }
  DR_ICE("a leaf of no kind");
}

// The names in an extent.
void collect_names(const Expr& expr, std::vector<const Expr*>& names) {
  if (expr.kind == Expr::Kind::NameRef) names.push_back(&expr);
  if (expr.kind != Expr::Kind::Binary && expr.kind != Expr::Kind::Unary) return;
  if (expr.a) collect_names(*expr.a, names);
  if (expr.b) collect_names(*expr.b, names);
}

}  // namespace

// A name in an extent that means nothing else is a symbol from here on: one of the program, also in an instance.
void Elaborator::declare_symbols(ModuleInfo& module, const Expr& extent, bool& ok) {
  std::vector<const Expr*> names;
  collect_names(extent, names);
  for (const Expr* name : names) {
    const auto found = module.items.find(name->name);
    const bool known = found != module.items.end();
    const auto outer = root_->items.find(name->name);
    if (is_any_extent(*name)) {
      report(Code::E0403, name->span, "expected a number, a const, a parameter or a new symbol in an extent, found '_'",
             {}, "give the extent a name: '_' stands for any extent of a function's argument");
      ok = false;
    } else if (!known && &module != root_ && outer != root_->items.end() &&
               outer->second.kind != ModuleItem::Kind::Symbol) {
      report(Code::E0403, name->span,
             "expected a number, a const, a parameter or a new symbol in an extent, found '" + name->name +
                 "', which means something else in the program",
             {{outer->second.span, "'" + name->name + "' is declared here"}}, "make it a parameter of the module");
      ok = false;
    } else if (!known) {
      // Tables of a topology have symbols named after their faces.
      const std::string_view faces = std::string_view(name->name).substr(0, name->name.rfind("_edges"));
      const bool own = faces != name->name && module.items.find(faces) != module.items.end();
      std::string prefix = own ? module.prefix : "";
      std::ranges::replace(prefix, '.', '_');
      ModuleItem symbol;
      symbol.kind = ModuleItem::Kind::Symbol;
      symbol.span = name->span;
      symbol.value = Dim::symbol(prefix + name->name);
      if (!own) root_->items.emplace(name->name, symbol);
      module.items.emplace(name->name, std::move(symbol));
    } else if (found->second.kind == ModuleItem::Kind::Leaf || found->second.kind == ModuleItem::Kind::Let) {
      report(Code::E0403, name->span,
             "expected a number, a const or a new symbol in an extent, found the value '" + name->name + "'",
             {{found->second.span, "'" + name->name + "' is declared here"}});
      ok = false;
    }
    if (!ok) return;
  }
}

ValueId Elaborator::add_leaf(ir::Leaf leaf) {
  ir::Attrs attrs;
  attrs.text = leaf.name;
  b_.graph().leaves.push_back(std::move(leaf));
  const ValueId id = ops::emit(b_, OpKind::Leaf, {}, attrs);
  b_.set_name(id, attrs.text);
  return id;
}

void Elaborator::declare_leaf(ModuleInfo& module, const dsl::LeafDecl& decl) {
  ModuleItem& item = module.items.find(decl.name.text)->second;
  if (item.kind != ModuleItem::Kind::Leaf || item.span != decl.name.span) return;  // declared twice
  item.value = Error{};
  if (!decl.type) return;  // the parser has said why
  const auto resolved = type_name(*decl.type);
  if (!resolved) return;
  const auto* type = resolved->get<TypeValue>();
  if (!type || type->kind != TypeValue::Kind::Element) {
    const bool is_array = type && type->kind == TypeValue::Kind::Array;
    report(
        Code::E0613, decl.type->span,
        "expected a scalar, vector or matrix type for the leaf '" + decl.name.text + "', found " +
            (is_array ? "an array"
             : type   ? describe(*type)
                      : std::string("another kind of type")),
        {},
        is_array ? "write how many elements there are behind their type, as in " + decl.name.text + " : float[3]" : "");
    return;
  }
  ir::Leaf leaf{leaf_kind(decl.kind), module.prefix + decl.name.text, type->element, {}, {}, decl.span};
  Dim* axes[] = {&leaf.extent.w, &leaf.extent.h, &leaf.extent.l};
  bool ok = true;
  for (size_t i = 0; i < decl.type->extents.size(); ++i) {
    const Expr& expr = *decl.type->extents[i];
    declare_symbols(module, expr, ok);
    if (!ok) return;
    const auto dim = evaluate_dim(expr, "an extent");
    if (!dim) return;
    if (dim->is_constant() && dim->constant() < 1) {
      report(Code::E0404, expr.span, "expected an extent of at least 1, found " + dim->str());
      return;
    }
    *axes[i] = *dim;
  }
  const SpanScope span(*this, decl.span);
  item.leaf = static_cast<uint32_t>(b_.graph().leaves.size());
  item.value = Image{add_leaf(std::move(leaf))};
  leaf_values_[*item.leaf] = item.value;
  fix_input(*item.leaf);
  observe(decl.name.span, item.value, decl.name.span);
}

// What is known of an input before the program runs.
void Elaborator::fix_input(uint32_t index) {
  ir::Leaf& leaf = b_.graph().leaves[index];
  if (leaf.kind != ir::Leaf::Kind::Input || !leaf.extent.is_unit() || !leaf.type.is_float()) return;
  const auto components = static_cast<size_t>(leaf.type.components());
  if (const auto given = options_.known.find(leaf.name); given != options_.known.end()) {
    if (given->second.size() != 1 && given->second.size() != components) return;
    leaf.initial = given->second;
    if (leaf.initial.size() < components) leaf.initial.assign(components, given->second[0]);
  } else {
    if (!options_.bound) return;
    const auto bound = options_.bound->find(leaf.name);
    const bool is_bound = bound != options_.bound->end();
    const bool zero = is_bound
                          ? bound->second
                          : !leaf.initial.empty() && std::ranges::all_of(leaf.initial, [](double x) { return x == 0; });
    if (!zero) return;
    if (is_bound) leaf.initial.assign(components, 0.0);
  }
  if (!options_.open.contains(leaf.name)) zeros_.fix(index);
}

void Elaborator::begin_leaf(ModuleInfo& module, const dsl::LeafDecl& decl) {
  const ModuleItem& item = module.items.find(decl.name.text)->second;
  if (!item.leaf || item.span != decl.name.span) return;                    // it was wrong
  if (options_.known.contains(b_.graph().leaves[*item.leaf].name)) return;  // that value stands instead
  bool ok = true;
  Value computed;
  const Type type = b_.graph().leaves[*item.leaf].type;
  std::vector<double> known = initial_value(decl, type, ok, &computed);
  ir::Leaf& leaf = b_.graph().leaves[*item.leaf];
  if (ok) leaf.initial = std::move(known);
  if (ok && options_.bound && !options_.bound->contains(leaf.name)) fix_input(*item.leaf);
  if (!ok || !computed.is_numeric()) return;
  const SpanScope here(*this, decl.initial->span);
  if (const auto filling = computed_initial(decl, computed, leaf)) initials_.emplace_back(*item.leaf, *filling);
}

// The components that fill a leaf. A scalar fills all components of a vector.
std::vector<double> Elaborator::initial_value(const dsl::LeafDecl& decl, const Type& type, bool& ok, Value* computed) {
  ok = false;
  const Switched<bool> in_initial(in_initial_, true);
  Value value = evaluate(*decl.initial);
  if (value.is_error()) return {};
  const std::string wanted =
      "expected a value of type " + type.str() + " that is known at compile time for '" + decl.name.text + "', found ";
  convert_known_int(value, type.scalar);
  const auto components = known_components(value);
  if (!components && value.is_numeric() && computed) {
    *computed = value;
    ok = true;
    return {};
  }
  if (!components) {
    report(Code::E0612, decl.initial->span,
           wanted + describe(value) + (value.is_numeric() ? " computed at run time" : ""));
    return {};
  }
  const Type found = element_type(value);
  if (found != type && found != type.element()) {
    report(Code::E0612, decl.initial->span, wanted + describe(value));
    return {};
  }
  ok = true;
  if (found == type) return *components;
  std::vector<double> filled(static_cast<size_t>(type.components()), components->front());
  // A scalar makes a diagonal matrix, as its constructor does.
  if (type.is_matrix()) {
    for (int i = 0; i < type.components(); ++i) {
      if (i / type.rows != i % type.rows) filled[static_cast<size_t>(i)] = 0;
    }
  }
  return filled;
}

void Elaborator::run_program(ModuleInfo& module) {
  const Switched<const ModuleInfo*> running(running_, &module);
  for (const dsl::Item& item : module.syntax->items) {
    if (over_budget({})) return;
    switch (item.kind) {
      case dsl::Item::Kind::Const: {
        // Also those that nothing uses: a mistake in one should not wait for its first use.
        const auto found = module.items.find(item.constant->name.text);
        if (found->second.constant == item.constant.get()) {
          item_value(module, item.constant->name.text, found->second, item.constant->name.span);
        }
        break;
      }
      case dsl::Item::Kind::Statement: {
        const Switched<Span> let(let_, item.statement->span);
        const Switched<std::pair<const Expr*, const dsl::Name*>> instance(
            instance_let_, {item.statement->a.get(), &item.statement->pattern.names.front()});
        run_statement(*item.statement);
        break;
      }
      case dsl::Item::Kind::Step: run_step(*item.step); break;
      case dsl::Item::Kind::Fn:
      case dsl::Item::Kind::Struct:
      case dsl::Item::Kind::Optimizer:
      case dsl::Item::Kind::Leaf: break;
    }
  }
}

}  // namespace dr::lower
