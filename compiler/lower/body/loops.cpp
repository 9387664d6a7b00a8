// SPDX-License-Identifier: Apache-2.0
// Loops at run time and what carries values through them: `fold`, `for`, `break`, and `if` as a statement. Variables
// that a region's statements assign are the region's own while it is elaborated; its op gives what they are afterwards.
#include <algorithm>

#include "compiler/lower/elaborator.h"
#include "compiler/ops/emit.h"

namespace dr::lower {

namespace {

// No program can name these.
constexpr std::string_view kBreak = " break", kFold = " fold";

void add_assigned(std::span<const dsl::StmtPtr> statements, std::set<std::string>& names) {
  for (const dsl::StmtPtr& stmt : statements) {
    switch (stmt->kind) {
      case dsl::Stmt::Kind::Assign: {
        const Expr* at = stmt->target.get();
        while (at->kind == Expr::Kind::Field || at->kind == Expr::Kind::Index) at = at->a.get();
        names.insert(at->name);
        break;
      }
      case dsl::Stmt::Kind::Break: names.emplace(kBreak); break;
      case dsl::Stmt::Kind::For: {
        const bool outer = names.contains(std::string(kBreak));
        add_assigned(stmt->body.statements, names);
        if (!outer) names.erase(std::string(kBreak));  // of that loop
        break;
      }
      case dsl::Stmt::Kind::If:
      case dsl::Stmt::Kind::ConstIf:
        add_assigned(stmt->body.statements, names);
        if (stmt->else_body) add_assigned(stmt->else_body->statements, names);
        break;
      case dsl::Stmt::Kind::Let:
      case dsl::Stmt::Kind::Var:
      case dsl::Stmt::Kind::Update:
      case dsl::Stmt::Kind::Expr:
      case dsl::Stmt::Kind::Minimize:
      case dsl::Stmt::Kind::Output:
      case dsl::Stmt::Kind::Return: break;
    }
  }
}

std::set<std::string> assigned_names(std::span<const dsl::StmtPtr> statements) {
  std::set<std::string> names;
  add_assigned(statements, names);
  return names;
}

bool may_break(std::span<const dsl::StmtPtr> statements) {
  return assigned_names(statements).contains(std::string(kBreak));
}

std::vector<Value> leaves_of(const Value& value) {
  std::vector<Value> leaves;
  for_each_leaf(value, [&](const Value& leaf) { leaves.push_back(leaf); });
  return leaves;
}

}  // namespace

// The variables of this function and region among the names, in order.
std::vector<std::string> Elaborator::variables_of(const std::set<std::string>& names) const {
  std::vector<std::string> out;
  for (const std::string& name : names) {
    const Binding* binding = find_binding(name);
    if (binding && binding->kind == Binding::Kind::Var && binding->frame == frames_.size() &&
        binding->region == regions_.size())
      out.push_back(name);
  }
  return out;
}

// ---- if and break ----

void Elaborator::run_if(const dsl::Stmt& stmt) {
  const Value condition = evaluate(*stmt.a);
  if (contains_error(condition)) return;
  if (!condition.is_numeric() || element_type(condition) != ir::kBool) {
    const bool vector = condition.is_numeric() && element_type(condition).is_bool();
    report(Code::E0313, stmt.a->span, "expected a bool as condition, found " + describe_element(condition), {},
           vector ? "write any(v) or all(v)" : "");
    return;
  }
  std::set<std::string> assigned = assigned_names(stmt.body.statements);
  if (stmt.else_body) assigned.merge(assigned_names(stmt.else_body->statements));
  const auto run = [&](const dsl::Block& block) {
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    run_breakable(block.statements, [] {});
  };
  run_branches(
      condition, stmt.span, assigned, [&] { run(stmt.body); },
      [&] {
        if (stmt.else_body) run(*stmt.else_body);
      });
}

void Elaborator::run_branches(const Value& condition, const Span& span, const std::set<std::string>& assigned,
                              const std::function<void()>& then, const std::function<void()>& otherwise) {
  if (const auto known = known_bool(condition)) return *known ? then() : otherwise();
  const std::vector<std::string> names = variables_of(assigned);
  const auto branch = [&](const std::function<void()>& run) -> Value {
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    for (const std::string& name : names) {
      const Binding outer = *find_binding(name);
      define_inner(*scope_, name, outer.value, outer.span);
    }
    run();
    TupleValue values;
    for (const std::string& name : names) values.items.push_back(scope_->find(name)->value);
    return values;
  };
  if (names.empty()) {
    // What is wrong inside is told all the same.
    const size_t mistakes = mistakes_;
    emit_if(
        condition, span, [&] { return branch(then); }, [&] { return branch(otherwise); });
    if (mistakes_ > mistakes) return;
    report(Code::E0112, span, "expected an 'if' that changes a variable or gives a value, found one that does neither");
    return;
  }
  const Value merged = emit_if(
      condition, span, [&] { return branch(then); }, [&] { return branch(otherwise); });
  for (size_t k = 0; k < names.size(); ++k)
    set_variable(names[k], merged.is_error() ? Value(Error{}) : parts_of(merged)[k]);
}

void Elaborator::run_break(const dsl::Stmt& stmt) {
  const Value condition = stmt.a ? evaluate(*stmt.a) : make_bool(true);
  if (contains_error(condition)) return;
  if (!condition.is_numeric() || element_type(condition) != ir::kBool) {
    report(Code::E0313, stmt.a->span, "expected a bool as condition, found " + describe_element(condition));
    return;
  }
  const Binding* binding = find_binding(kBreak);
  if (!binding || binding->frame != frames_.size() || binding->region != regions_.size()) {
    report(Code::E0513, stmt.span,
           "expected 'break' in the body of a loop, found it " +
               std::string(binding ? "in a function or region inside of one" : "elsewhere"));
    return;
  }
  set_variable(kBreak, condition);
}

// The rest stands behind all statements.
void Elaborator::run_breakable(std::span<const dsl::StmtPtr> statements, const std::function<void()>& rest) {
  for (size_t k = 0; k < statements.size(); ++k) {
    run_statement(*statements[k]);
    const Binding* stop = find_binding(kBreak);
    if (!stop || !may_break(statements.subspan(k, 1))) continue;
    if (const auto known = known_bool(stop->value)) {
      if (*known) return;
      continue;
    }
    if (stop->value.is_error()) return;
    const std::span<const dsl::StmtPtr> behind = statements.subspan(k + 1);
    if (behind.empty() && variables_of({std::string(kFold)}).empty()) break;  // nothing that it would leave out
    std::set<std::string> assigned = assigned_names(behind);
    assigned.emplace(kBreak);
    assigned.emplace(kFold);
    const Value condition = stop->value;
    run_branches(
        condition, statements[k]->span, assigned, [] {}, [&] { run_breakable(behind, rest); });
    return;
  }
  rest();
}

// ---- loops ----

std::optional<Elaborator::Range> Elaborator::evaluate_range(const Expr& begin, const Expr& end, const Expr* max,
                                                            std::string_view loop, const Span& span) {
  Range range{.begin = evaluate(begin), .end = evaluate(end), .bound = -1, .loop = loop, .span = span};
  if (!loop_range(range.begin, begin, loop) || !loop_range(range.end, end, loop)) return std::nullopt;
  const auto bound = loop_bound(max, range.begin, range.end);
  if (!bound) return std::nullopt;
  range.bound = *bound;
  return range;
}

// What a trip gives for a state, of the state's type; an Error where it has another.
Value Elaborator::fit_state(const Value& state, const Value& next, const Span& span) {
  if (contains_error(next) || contains_error(state)) return Error{};
  const bool alike = state.data.index() == next.data.index() && parts_of(state).size() == parts_of(next).size() &&
                     (!state.is<StructValue>() || state.as<StructValue>().type == next.as<StructValue>().type);
  if (state.is_composite() && alike) {
    std::vector<Value> parts;
    for (size_t k = 0; k < parts_of(state).size(); ++k) {
      parts.push_back(fit_state(parts_of(state)[k], parts_of(next)[k], span));
      if (parts.back().is_error()) return Error{};
    }
    return with_parts(next, std::move(parts));
  }
  Value fitted = next;
  if (state.is_numeric() && next.is_numeric()) {
    if (element_type(state).is_scalar()) convert_known_int(fitted, element_type(state).scalar);
    if (element_type(state) == element_type(fitted)) return fitted;
  } else if (same_value(state, next)) {
    return next;
  }
  const bool was_int = state.is_numeric() && element_type(state) == ir::kInt;
  return fail(Code::E0712, span,
              "expected what the loop carries to stay " + describe_element(state) + ", found " + describe_element(next),
              {}, was_int && next.is_numeric() ? "start with a float, such as 0.0" : "");
}

std::vector<Value> Elaborator::emit_fold(const Range& range, const std::vector<Value>& starts, const Span& span,
                                         const Trip& trip) {
  std::vector<Value> failed(starts.size(), Error{});
  std::vector<Value> all{range.begin, range.end}, start_leaves;
  for (const Value& start : starts) {
    for (const Value& leaf : leaves_of(start)) {
      if (!leaf.is_numeric()) continue;
      all.push_back(leaf);
      start_leaves.push_back(leaf);
    }
  }
  if (!check_extents(all, span)) return failed;
  std::vector<ValueId> operands;
  Extent extent;
  for (const Value& value : all) {
    operands.push_back(materialize(value));
    extent = *ir::broadcast(extent, b_.value(operands.back()).extent);
  }
  std::vector<ir::ResultType> params{{ir::kInt, extent}};
  for (const Value& leaf : start_leaves) params.push_back({element_type(leaf), extent});
  const uint32_t depth = element_depth(all);

  regions_.push_back({range.loop, span, frames_.size(), {}});
  const ir::RegionId region = b_.begin_region(params);
  size_t at = 1;
  std::vector<Value> states;
  for (const Value& start : starts) {
    states.push_back(map_leaves(start, [&](const Value& leaf) -> Value {
      return leaf.is_numeric() ? Value(Image{b_.graph().region(region).params[at++], depth}) : leaf;
    }));
  }
  const size_t mistakes = mistakes_;
  const auto [stop, next] = trip(Image{b_.graph().region(region).params[0], depth}, states);
  bool ok = mistakes_ == mistakes && !contains_error(stop);
  const bool stops = ok && known_bool(stop) != false;
  std::vector<ValueId> yields;
  if (stops) yields.push_back(materialize(stop));
  std::vector<Value> next_leaves;
  for (const Value& value : next) {
    ok = ok && !contains_error(value);
    for (const Value& leaf : leaves_of(value))
      if (leaf.is_numeric()) next_leaves.push_back(leaf);
  }
  std::vector<ValueId> ids;
  for (const Value& leaf : next_leaves)
    if (ok) ids.push_back(materialize(leaf));
  yields.insert(yields.end(), ids.begin(), ids.end());
  ir::Attrs attrs;
  attrs.yields.assign(start_leaves.size(), ir::Yield::Element);
  if (ok && range.scans) {
    const auto element = [&](const Value& value) { return refuse_element(value, "'scan'", span); };
    ok = std::ranges::none_of(all, element) && std::ranges::none_of(next_leaves, element) &&
         keep_trips(range, extent, ids, attrs, yields);
  }
  b_.end_region(std::move(yields));
  regions_.pop_back();
  if (!ok || diagnostics_.has_errors()) return failed;
  DR_ASSERT(next_leaves.size() == start_leaves.size());
  if (next_leaves.empty()) return failed;  // a loop that changes nothing, which run_loop reports

  const auto domain = region_domain(extent, {&region, 1}, span);
  if (!domain) return failed;
  attrs.ints = {range.bound, stops ? 1 : 0, static_cast<int64_t>(start_leaves.size())};
  attrs.dims.insert(attrs.dims.begin(), {domain->w, domain->h, domain->l});
  std::vector<ValueId> results = ops::emit_multi(b_, OpKind::Fold, std::move(operands), std::move(attrs), {region});
  if (range.scans) results.erase(results.begin(), results.begin() + static_cast<ptrdiff_t>(ids.size()));
  std::vector<Value> out;
  size_t k = 0;
  for (const Value& start : starts) {
    out.push_back(map_leaves(start, [&](const Value& leaf) -> Value {
      if (!leaf.is_numeric()) return leaf;
      const Value& last = next_leaves[k];
      // What no trip changes stays what it was, and known where it was.
      const bool same =
          !range.scans && last.is<Image>() && last.as<Image>().id == b_.graph().region(region).params[1 + k];
      const ValueId result = results[k++];
      return same ? stretched(leaf, extent) : Value(image(result, {&range.begin, &range.end, &leaf, &last}));
    }));
  }
  return out;
}

// The states after each trip of a scan, which stand along the first axis that the elements leave free: a scatter to
// places of their own. The region is still open.
bool Elaborator::keep_trips(const Range& range, Extent domain, const std::vector<ValueId>& next, ir::Attrs& attrs,
                            std::vector<ValueId>& yields) {
  const auto refuse = [&](const std::string& message, const std::string& help = "") {
    report(Code::E0713, range.span, message, {}, help);
    return false;
  };
  const bool known = range.begin.is<Dim>() && range.end.is<Dim>();
  const Dim trips = known ? range.end.as<Dim>() - range.begin.as<Dim>() : Dim(range.bound);
  if (!known && range.bound < 0)
    return refuse("expected a range between extents, or 'max = M', which says how many trips have room",
                  "write 'scan(k in 0..n, max = 64, ...)'");
  if (trips.is_constant() && trips.constant() < 1)
    return refuse("expected at least one trip to keep, found " + std::to_string(trips.constant()));
  if (regions_.size() > 1)
    return refuse("expected 'scan' outside of regions, found it in " + std::string(regions_[regions_.size() - 2].what),
                  "carry what is needed with 'fold'");
  const auto own = region_domain(domain, {{b_.current_region()}}, range.span);
  if (!own) return false;
  domain = *own;
  for (const ValueId v : next) {
    const auto both = ir::broadcast(domain, b_.value(v).extent);
    if (!both)
      return refuse("expected values of one extent, found " + domain.str() + " and " + b_.value(v).extent.str());
    domain = *both;
    if (b_.value(v).type.is_bool())
      return refuse("expected numbers to keep of each trip, found " + b_.value(v).type.str(),
                    "carry an int: 'if c { 1 } else { 0 }'");
  }
  Extent image = domain;
  Dim* const axes[] = {&image.w, &image.h, &image.l};
  Dim* const* const free = std::ranges::find_if(axes, [](const Dim* axis) { return axis->is_one(); });
  if (free == std::end(axes))
    return refuse("expected an axis of extent 1 for the trips, found values of the extent " + domain.str());
  **free = trips;
  std::vector<Value> place;
  for (int axis = 0; axis < 3; ++axis) {
    if (axes[axis] == *free) {
      place.push_back(apply(OpKind::Sub, {Image{b_.graph().region(b_.current_region()).params[0]}, range.begin}));
    } else if (axes[axis]->is_one()) {
      place.emplace_back(Dim(0));
    } else {
      ValueId at;
      b_.at_root([&] { at = ops::coord(b_, axis, domain); });
      place.emplace_back(Image{at});
    }
  }
  const ValueId index = materialize(compose(std::move(place), ir::vec(3, Scalar::Int)));
  for (const ValueId v : next) {
    attrs.yields.push_back(ir::Yield::Scatter);
    attrs.dims.insert(attrs.dims.end(), {image.w, image.h, image.l});
    yields.push_back(index);
    yields.push_back(v);
  }
  return true;
}

Value Elaborator::evaluate_fold(const Expr& expr) {
  const bool scans = expr.name == "scan";
  auto range = evaluate_range(*expr.a, *expr.b, expr.c.get(), scans ? "'scan'" : "'fold'", expr.span);
  if (range) range->scans = scans;
  std::vector<Value> starts;
  bool ok = range.has_value();
  for (const dsl::Arg& arg : expr.args) {
    starts.push_back(evaluate(*arg.value));
    ok = ok && !contains_error(starts.back());
    size_t numbers = 0;
    for (const Value& leaf : leaves_of(starts.back())) numbers += leaf.is_numeric() ? 1 : 0;
    if (!ok || numbers > 0) continue;
    report(Code::E0712, arg.value->span, "expected a number, or several, to carry, found " + describe(starts.back()));
    ok = false;
  }
  if (expr.args.empty()) {
    report(Code::E0712, expr.span, "expected a value that the loop carries, found none", {},
           "write 'fold(k in a..b, total = 0.0) { total + x.at(k) }'");
    ok = false;
  }
  if (!ok) return Error{};
  const auto packed = [](const std::vector<Value>& values) {
    return values.size() == 1 ? values[0] : Value(TupleValue{values});
  };
  const dsl::Block& block = expr.inner->then_block;
  const auto trip = [&](const Value& i, const std::vector<Value>& states) -> std::pair<Value, std::vector<Value>> {
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    define(*scope_, expr.inner->loop_var, i, Binding::Kind::Index);
    set_name(i, expr.inner->loop_var.text);
    for (size_t k = 0; k < states.size(); ++k) {
      define(*scope_, *expr.args[k].name, states[k], Binding::Kind::Carried);
      set_name(states[k], expr.args[k].name->text);
    }
    define_inner(*scope_, kBreak, make_bool(false), expr.span);
    define_inner(*scope_, kFold, packed(states), expr.span);
    Scope* const own = scope_;
    run_breakable(block.statements, [&] {
      const Span at = block.value ? block.value->span : block.span;
      Value next = block.value ? evaluate(*block.value) : Value(Nothing{});
      if (next.is<Nothing>())
        next = fail(Code::E0321, at, "expected the next values that the loop carries, found a block without a value");
      set_variable(kFold, fit_state(packed(states), next, at));
    });
    const Value next = own->find(kFold)->value;
    std::vector<Value> values =
        states.size() == 1 || next.is_error() ? std::vector<Value>(states.size(), next) : parts_of(next);
    return {own->find(kBreak)->value, std::move(values)};
  };
  return packed(emit_fold(*range, starts, expr.span, trip));
}

// A `for` whose range is known and that says nothing of a loop is written out trip by trip.
bool Elaborator::is_unrolled(const dsl::Stmt& stmt, const Value& begin, const Value& end) const {
  if (stmt.c || may_break(stmt.body.statements)) return false;
  const bool known = known_int(begin).has_value() && known_int(end).has_value();
  return known || begin.is_error() || end.is_error();
}

void Elaborator::run_loop(const dsl::Stmt& stmt) {
  const auto range = evaluate_range(*stmt.a, *stmt.b, stmt.c.get(), "'for'", stmt.span);
  if (!range) return;
  std::set<std::string> assigned = assigned_names(stmt.body.statements);
  assigned.erase(std::string(kBreak));
  const std::vector<std::string> names = variables_of(assigned);
  std::vector<Value> starts;
  for (const std::string& name : names) {
    starts.push_back(find_binding(name)->value);
    if (contains_error(starts.back())) return;
  }
  const auto trip = [&](const Value& i, const std::vector<Value>& states) -> std::pair<Value, std::vector<Value>> {
    const Switched<Scope*> outside(scope_, new_scope(scope_));
    Scope* const own = scope_;
    for (size_t k = 0; k < names.size(); ++k) {
      define_inner(*scope_, names[k], states[k], find_binding(names[k])->span);
      set_name(states[k], names[k]);
    }
    define_inner(*scope_, kBreak, make_bool(false), stmt.span);
    const Switched<Scope*> inside(scope_, new_scope(scope_));
    define(*scope_, stmt.loop_var, i, Binding::Kind::Index);
    set_name(i, stmt.loop_var.text);
    run_breakable(stmt.body.statements, [&] {
      if (!stmt.body.value) return;
      evaluate(*stmt.body.value);
      report(Code::E0509, stmt.body.value->span,
             "expected statements in the body of 'for', found a value that is not used", {}, "");
    });
    std::vector<Value> next;
    for (size_t k = 0; k < names.size(); ++k)
      next.push_back(fit_state(states[k], own->find(names[k])->value, stmt.span));
    return {own->find(kBreak)->value, std::move(next)};
  };
  const size_t mistakes = mistakes_;
  const std::vector<Value> results = emit_fold(*range, starts, stmt.span, trip);
  if (names.empty() && mistakes_ == mistakes) {
    report(Code::E0509, stmt.span, "expected a loop at run time that changes a variable, found one that changes none");
  }
  for (size_t k = 0; k < names.size(); ++k) {
    set_name(results[k], names[k]);
    set_variable(names[k], results[k]);
  }
}

}  // namespace dr::lower
