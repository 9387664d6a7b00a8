// SPDX-License-Identifier: Apache-2.0
// A scatter whose places can be undone becomes a gather: each element asks which elements of the domain and which trips
// name it, and sums what they have to say, in a fixed order.
//   %g = reduce 0, %n { (%k) yield scatter at (%k, %x): %v }     over [X, Y]
//     =>  %g = reduce 0, Y { (%y) yield sum of %v at k = coord.x, x = coord.y, y = %y }     over [N, X]
// So is the adjoint of a contraction (a reduce over a product of two images) one again, and that of a picture that is
// read at neighbours, clamped, mirrored or wrapped (preimage.h), reads of neighbours.
// Requires: no Grad op.  Establishes: each scatter left has an index that depends on data, or on loops that do.
#include <algorithm>
#include <memory>

#include "compiler/ir/yields.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/copy_steps.h"
#include "compiler/passes/passes.h"
#include "compiler/passes/scatter/preimage.h"

namespace dr::passes {

using namespace ir;

namespace {

// One place in a program that scatters: `value` goes to `index`, for each trip of the loops around it.
struct Site {
  Extent domain, target;
  ValueId index, value;
  std::vector<OpId> loops;  // outermost first
  struct Condition {
    ValueId value;
    bool holds;
  };
  std::vector<Condition> conditions;
};

// What a gather does, from the outside in: it runs through a variable, or finds it by a component of the index.
struct Stage {
  Variable variable;
  int component = -1;
};

// A sum of many terms for few elements goes on in blocks of this many, so that there is work for many lanes.
constexpr int64_t kBlock = 256, kManyTerms = 512, kFewElements = 1 << 14;
// A symbol's value, where one has to be thought of.
constexpr int64_t kSymbol = 512;
constexpr size_t kMostVariables = 24;

double guess(const Dim& dim) {
  SymbolValues values;
  for (const std::string& symbol : dim.symbols()) values[symbol] = kSymbol;
  return static_cast<double>(dim.evaluate(values).value_or(kSymbol));
}

class Gathered {
 public:
  Gathered(const Graph& from, Builder& to, const ValueMap& map, const Site& site)
      : from_(from), to_(to), site_(site), places_(from, to, map), preimage_(from, to, places_, trips_) {}

  // Whether its places can be undone.
  bool exists() { return find_variables() && plan(); }

  // The scattered image, of the target's extent.
  ValueId make() {
    // Where a component is the same for all elements, there is one place to sum for.
    domain_ = site_.target;
    Dim* const axes[] = {&domain_.w, &domain_.h, &domain_.l};
    ValueId mask;
    for (const int c : fixed_) {
      if (axis(site_.target, c).is_one() && constant(site_.index, c) == 0) continue;
      const ValueId own = ops::coord(to_, c, site_.target);
      mask = both(mask, ops::emit(to_, OpKind::Equal, {own, places_.at(site_.index, c)}));
      *axes[c] = Dim(1);
    }
    const std::optional<size_t> split = block_stage();
    ValueId sum;
    if (split) {
      sum = in_blocks(*split);
    } else {
      places_.run_over(domain_);
      sum = emit();
    }
    if (mask.valid()) sum = kept(mask, sum);
    return ops::broadcast(to_, sum, site_.target);
  }

 private:
  Dim axis(const Extent& extent, int k) const { return k == 0 ? extent.w : k == 1 ? extent.h : extent.l; }

  bool find_variables() {
    for (int k = 0; k < 3; ++k)
      trips_.push_back({.begin = {}, .end = {}, .first = Dim(0), .last = axis(site_.domain, k) - Dim(1)});
    if (site_.loops.size() + 3 > kMostVariables) return false;
    for (const OpId id : site_.loops) {
      const Op& op = from_.op(id);
      // Bounds that are the same for all elements.
      for (const ValueId bound : op.operands)
        if (places_.depends(bound) != 0 || !is_uniform(bound)) return false;
      places_.declare(from_.region(op.regions[0]).params[0], static_cast<Variable>(trips_.size()));
      const std::optional<Dim> begin = dim_of(op.operands[0]), end = dim_of(op.operands[1]);
      trips_.push_back({.begin = op.operands[0],
                        .end = op.operands[1],
                        .first = begin,
                        .last = end ? std::optional(*end - Dim(1)) : std::nullopt});
    }
    return true;
  }

  bool is_uniform(ValueId v) const { return from_.value(v).extent.is_unit() || from_.value(v).region != from_.root(); }

  std::optional<Dim> dim_of(ValueId v) const {
    const OpId made = from_.value(v).op;
    if (!made.valid()) return std::nullopt;
    const Op& op = from_.op(made);
    if (op.kind == OpKind::DimValue) return op.attrs.dims[0];
    if (op.kind == OpKind::Const) return Dim(static_cast<int64_t>(op.attrs.floats[0]));
    return std::nullopt;
  }

  // --- which variable each component of the index gives ---

  // Components that an index does not have: of the row there is one, the layer is the element's own.
  bool has(int component) const { return component < from_.value(site_.index).type.rows; }
  bool is_own_layer(int component) const { return component == 2 && !has(2) && !site_.target.l.is_one(); }

  bool find(int component, Variable variable, Variables& others) {
    if (is_own_layer(component)) return variable == 2;
    return preimage_.exists(site_.index, component, variable, others);
  }

  bool plan() {
    std::vector<int> left;
    for (int c = 0; c < 3; ++c) {
      const Variables on = is_own_layer(c) ? only(2) : has(c) ? places_.depends(site_.index, c) : 0;
      if (is_own_layer(c) && site_.domain.l.is_one()) return false;
      if (on != 0)
        left.push_back(c);
      else if (has(c))
        fixed_.push_back(c);
    }
    if (!choose(left, 0, 0)) return false;
    // Runs through what is left, along rows last.
    Variables known = 0;
    for (const Stage& stage : stages_) known |= only(stage.variable);
    for (size_t k = 3; k < trips_.size(); ++k) run_through(static_cast<Variable>(k), known);
    for (const Variable k : {2, 1, 0})
      if (!axis(site_.domain, k).is_one()) run_through(k, known);
    return true;
  }

  void run_through(Variable variable, Variables& known) {
    if ((known & only(variable)) != 0) return;
    stages_.push_back({variable});
    known |= only(variable);
  }

  // Finds a variable for each component; those of `solved` come from components before, those of `run` from loops.
  bool choose(const std::vector<int>& left, Variables solved, Variables run) {
    if (left.empty()) return true;
    for (size_t k = 0; k < left.size(); ++k) {
      std::vector<int> rest = left;
      rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(k));
      for (size_t v = 0; v < trips_.size(); ++v) {
        const auto variable = static_cast<Variable>(v);
        Variables others = 0;
        if (((solved | run) & only(variable)) != 0 || !find(left[k], variable, others)) continue;
        if ((others & only(variable)) != 0) continue;
        const size_t before = stages_.size();
        Variables known = solved | run;
        for (size_t o = 0; o < trips_.size(); ++o)
          if ((others & only(static_cast<Variable>(o))) != 0) run_through(static_cast<Variable>(o), known);
        stages_.push_back({variable, left[k]});
        if (choose(rest, solved | only(variable), run | (known & ~solved))) return true;
        stages_.resize(before);
      }
    }
    return false;
  }

  // --- sums in blocks ---

  double terms(Variable variable) const {
    const Trips& trips = trips_[static_cast<size_t>(variable)];
    return trips.first && trips.last ? guess(*trips.last - *trips.first + Dim(1)) : kSymbol;
  }

  // The outermost loop, where it has to be split.
  std::optional<size_t> block_stage() const {
    double all = 1;
    std::optional<size_t> outer;
    for (size_t k = 0; k < stages_.size(); ++k) {
      if (stages_[k].component >= 0) continue;
      all *= terms(stages_[k].variable);
      const Trips& trips = trips_[static_cast<size_t>(stages_[k].variable)];
      if (!outer && trips.last && trips.first == Dim(0)) outer = k;
    }
    const double elements = guess(domain_.w) * guess(domain_.h) * guess(domain_.l);
    if (!outer || all < kManyTerms || elements > kFewElements) return std::nullopt;
    return outer;
  }

  // Sums of blocks, which stand behind one another as layers, and then their sums.
  ValueId in_blocks(size_t stage) {
    const Dim count = *trips_[static_cast<size_t>(stages_[stage].variable)].last + Dim(1);
    const double inside = all_terms() / terms(stages_[stage].variable);
    const auto size = static_cast<int64_t>(std::max(1.0, kBlock / inside));
    const Dim blocks = (count + Dim(size - 1)).divided_by(size);
    const Extent wide{domain_.w, domain_.h, domain_.l * blocks};
    const ValueId layer = ops::coord(to_, 2, wide);
    const bool one = domain_.l.is_one();
    const ValueId of = ops::dim_value(to_, blocks);
    const ValueId block = one ? layer : ops::emit(to_, OpKind::Mod, {layer, of});
    block_ = {.stage = stage, .number = block, .size = size};
    q_[2] = one ? number(0) : ops::emit(to_, OpKind::Div, {layer, of});
    const Extent narrow = domain_;
    domain_ = wide;
    places_.run_over(wide);
    const ValueId parts = ops::broadcast(to_, emit(), wide);

    domain_ = narrow;
    const ResultType trip{kInt, domain_};
    std::vector<ValueId> place;
    for (int c = 0; c < 3; ++c) place.push_back(axis(domain_, c).is_one() ? number(0) : ops::coord(to_, c, domain_));
    const ValueId first = one ? place[2] : ops::mul(to_, place[2], of);
    const ValueId begin = number(0);
    const RegionId body = to_.begin_region({&trip, 1});
    const ValueId k = to_.graph().region(body).params[0];
    place[2] = one ? k : ops::add(to_, first, k);
    const ValueId index = ops::compose(to_, place, vec(3, Scalar::Int));
    to_.end_region({ops::emit(to_, OpKind::Gather, {parts, index})});
    return reduce(begin, of, -1, body);
  }

  double all_terms() const {
    double all = 1;
    for (const Stage& stage : stages_)
      if (stage.component < 0) all *= terms(stage.variable);
    return all;
  }

  // --- what comes of it ---

  ValueId number(int64_t x) { return ops::constant(to_, kInt, static_cast<double>(x)); }

  ValueId emit() {
    for (int c = 0; c < 3; ++c)
      if (!q_[c].valid()) q_[c] = axis(domain_, c).is_one() ? number(0) : ops::coord(to_, c, domain_);
    return emit(0, 0, {});
  }

  ValueId emit(size_t at, Variables known, ValueId mask) {
    if (at == stages_.size()) return emit_value(mask);
    const Stage& stage = stages_[at];
    const Trips& trips = trips_[static_cast<size_t>(stage.variable)];
    const Variables then = known | only(stage.variable);
    const ValueId begin = trips.begin.valid() ? places_.at(trips.begin) : number(0);
    const ValueId end =
        trips.end.valid() ? places_.at(trips.end) : ops::dim_value(to_, axis(site_.domain, stage.variable));
    if (stage.component < 0) {
      if (block_.number.valid() && block_.stage == at) {
        const ValueId from = ops::mul(to_, block_.number, number(block_.size));
        const ValueId most = ops::emit(to_, OpKind::Min, {end, ops::add(to_, from, number(block_.size))});
        return loop(at, then, mask, from, most, block_.size);
      }
      return loop(at, then, mask, begin, end, trips.count());
    }
    ValueId sum;
    for (const Interval& interval : intervals(stage)) {
      places_.enter();
      const ValueId part = emit_interval(at, then, both(mask, interval.when), interval, begin, end);
      places_.leave();
      sum = sum.valid() ? ops::add(to_, sum, part) : part;
    }
    return sum;
  }

  std::vector<Interval> intervals(const Stage& stage) {
    const ValueId q = q_[stage.component];
    if (!is_own_layer(stage.component)) return preimage_.of(site_.index, stage.component, stage.variable, q);
    Interval own;
    own.first = own.last = q;
    return {own};
  }

  ValueId emit_interval(size_t at, Variables known, ValueId mask, const Interval& interval, ValueId begin,
                        ValueId end) {
    const Stage& stage = stages_[at];
    if (!interval.is_single()) {
      const ValueId first = ops::emit(to_, OpKind::Max, {interval.first, begin});
      const ValueId after = ops::emit(to_, OpKind::Min, {ops::add(to_, interval.last, number(1)), end});
      return loop(at, known, mask, first, after, preimage_.bound(interval, stage.variable));
    }
    ValueId x = interval.first;
    if (interval.modulo.valid())
      x = ops::add(to_, begin, ops::emit(to_, OpKind::Mod, {ops::sub(to_, x, begin), interval.modulo}));
    if (!is_in_range(stage, x)) {
      mask = both(mask, ops::emit(to_, OpKind::LessEqual, {begin, x}));
      mask = both(mask, ops::emit(to_, OpKind::Less, {x, end}));
    }
    places_.set(stage.variable, x);
    prepare(known);
    return emit(at + 1, known, mask);
  }

  // Whether the element's own place is one of the variable's, whatever it is.
  bool is_in_range(const Stage& stage, ValueId x) const {
    const Trips& trips = trips_[static_cast<size_t>(stage.variable)];
    const Dim size = axis(site_.target, stage.component);
    return x == q_[stage.component] && trips.first == Dim(0) && trips.last && *trips.last + Dim(1) == size;
  }

  ValueId loop(size_t at, Variables known, ValueId mask, ValueId begin, ValueId end, int64_t bound) {
    if (mask.valid()) end = ops::select(to_, mask, end, begin);
    const ResultType trip{kInt, domain_};
    const RegionId body = to_.begin_region({&trip, 1});
    places_.enter();
    places_.set(stages_[at].variable, to_.graph().region(body).params[0]);
    prepare(known);
    const ValueId value = emit(at + 1, known, {});
    places_.leave();
    to_.end_region({value});
    return reduce(begin, end, bound, body);
  }

  ValueId reduce(ValueId begin, ValueId end, int64_t bound, RegionId body) {
    return ops::emit(to_, OpKind::Reduce, {begin, end},
                     {.ints = {bound}, .dims = {domain_.w, domain_.h, domain_.l}, .yields = {Yield::Sum}}, {body});
  }

  void prepare(Variables known) {
    places_.prepare(site_.index, known);
    places_.prepare(site_.value, known);
    for (const Site::Condition& condition : site_.conditions) places_.prepare(condition.value, known);
  }

  ValueId emit_value(ValueId mask) {
    for (const auto& [value, holds] : site_.conditions) {
      const ValueId now = places_.at(value);
      mask = both(mask, holds ? now : ops::emit(to_, OpKind::LogicalNot, {now}));
    }
    if (!mask.valid()) return places_.at(site_.value);
    const Type type = from_.value(site_.value).type;
    if (site_.conditions.empty()) return kept(mask, places_.at(site_.value));
    const RegionId then = to_.begin_region({});
    places_.enter();
    const ValueId value = places_.at(site_.value);
    places_.leave();
    to_.end_region({value});
    const RegionId otherwise = to_.begin_region({});
    to_.end_region({ops::constant(to_, type, 0.0)});
    return ops::emit(to_, OpKind::If, {mask}, {.dims = {domain_.w, domain_.h, domain_.l}, .yields = {Yield::Element}},
                     {then, otherwise});
  }

  // The value where the mask holds, else 0.
  ValueId kept(ValueId mask, ValueId value) {
    const Type type = to_.value(value).type;
    if (!type.is_matrix()) return ops::select(to_, mask, value, ops::zero_like(to_, value));
    std::vector<ValueId> columns;
    for (int k = 0; k < type.cols; ++k) {
      const ValueId column = ops::extract(to_, value, k);
      columns.push_back(ops::select(to_, mask, column, ops::zero_like(to_, column)));
    }
    return ops::compose(to_, columns, type);
  }

  std::optional<int64_t> constant(ValueId v, int c) const {
    const OpId made = from_.value(v).op;
    if (!made.valid()) return std::nullopt;
    const Op& op = from_.op(made);
    if (op.kind == OpKind::Compose) return constant(op.operands[static_cast<size_t>(c)], 0);
    if (op.kind != OpKind::Const) return std::nullopt;
    return static_cast<int64_t>(op.attrs.floats[static_cast<size_t>(c)]);
  }

  ValueId both(ValueId a, ValueId b) {
    if (!a.valid() || !b.valid()) return a.valid() ? a : b;
    return ops::emit(to_, OpKind::LogicalAnd, {a, b});
  }

  const Graph& from_;
  Builder& to_;
  const Site& site_;
  std::vector<Trips> trips_;  // by Variable
  AtPlaces places_;
  Preimage preimage_;
  std::vector<Stage> stages_;
  std::vector<int> fixed_;
  Extent domain_;  // of what is emitted
  ValueId q_[3];   // the element
  struct Block {
    size_t stage = 0;
    ValueId number;
    int64_t size = 0;
  } block_;
};

class Inverter {
 public:
  explicit Inverter(const Graph& from) : from_(from), map_(from.value_count()), wanted_(from.value_count()) {
    const std::vector<bool> live = live_ops(from, {});
    for (const Step& step : from.steps) {
      for (const Output& output : step.outputs) wanted_[output.value.index] = true;
      for (const Update& update : step.updates) wanted_[update.value.index] = true;
    }
    for (const OpId id : from.region(from.root()).ops) {
      if (!live[id.index]) continue;
      for (const ValueId v : from.op(id).operands) wanted_[v.index] = true;
      for (const RegionId region : from.op(id).regions)
        for (const ValueId v : captures(from, region)) wanted_[v.index] = true;
    }
  }

  Graph run() {
    to_.reserve(from_.op_count());
    to_.graph().leaves = from_.leaves;
    for (const OpId id : from_.region(from_.root()).ops) {
      copy_op(from_, id, to_, map_);
      const Op& op = from_.op(id);
      to_.set_span(op.span);
      for (size_t k = 0; k < op.results.size(); ++k)
        if (wanted_[op.results[k].index]) invert(op, k);
    }
    to_.graph().steps = copy_steps(from_, map_);
    return std::move(to_).finish();
  }

 private:
  void invert(const Op& op, size_t result) {
    std::vector<Site> sites;
    if (!find_sites(op, result, sites)) return;
    std::vector<std::unique_ptr<Gathered>> gathers;
    for (const Site& site : sites) {
      gathers.push_back(std::make_unique<Gathered>(from_, to_, map_, site));
      if (!gathers.back()->exists()) return;
    }
    const ValueInfo& info = from_.value(op.results[result]);
    ValueId sum;
    for (const auto& gather : gathers) {
      const ValueId part = gather->make();
      sum = sum.valid() ? ops::add(to_, sum, part) : part;
    }
    if (!sum.valid()) sum = ops::broadcast(to_, ops::constant(to_, info.type, 0.0), info.extent);
    map_.set(op.results[result], sum);
    if (!info.name.empty()) to_.set_name(sum, info.name);
  }

  bool find_sites(const Op& op, size_t result, std::vector<Site>& sites) const {
    if (op.kind == OpKind::ScatterAdd) {
      const Extent domain = *broadcast(from_.value(op.operands[0]).extent, from_.value(op.operands[1]).extent);
      sites.push_back({domain, from_.value(op.results[0]).extent, op.operands[0], op.operands[1], {}, {}});
      return true;
    }
    if (!combines_yields(op.kind) || op.attrs.yields[result] != Yield::Scatter) return false;
    return collect(op, result, {domain_of(op), from_.value(op.results[result]).extent, {}, {}, {}, {}}, sites);
  }

  bool collect(const Op& op, size_t result, const Site& outer, std::vector<Site>& sites) const {
    if (op.kind == OpKind::Fold || domain_of(op) != outer.domain) return false;
    for (size_t k = 0; k < op.regions.size(); ++k) {
      Site site = outer;
      if (op.kind == OpKind::If) site.conditions.push_back({op.operands[0], k == 0});
      if (op.kind == OpKind::Reduce) site.loops.push_back(from_.value(op.results[0]).op);
      const Yielded part = yielded(from_, op, op.regions[k])[result];
      if (!part.index.valid()) {
        const ValueInfo& inner = from_.value(part.value);
        if (!collect(from_.op(inner.op), inner.result_index, site, sites)) return false;
        continue;
      }
      if (is_zero(part.value)) continue;
      site.index = part.index;
      site.value = part.value;
      sites.push_back(std::move(site));
    }
    return true;
  }

  bool is_zero(ValueId v) const {
    const OpId op = from_.value(v).op;
    return op.valid() && from_.op(op).kind == OpKind::Const &&
           std::ranges::all_of(from_.op(op).attrs.floats, [](double x) { return x == 0; });
  }

  const Graph& from_;
  Builder to_;
  ValueMap map_;
  std::vector<bool> wanted_;
};

}  // namespace

Graph invert_scatters(const Graph& graph, const Skips& /*skips*/) { return Inverter(graph).run(); }

}  // namespace dr::passes
