// SPDX-License-Identifier: Apache-2.0
// Fold as loops of a shader: one for each sweep. What a later sweep sees of the states before a trip is stored in an
// array of the invocation where all trips have room there. Where they have not, and two sweeps are all, the states
// before some trips are stored, and those between are computed again from the nearest. All that loops may stop and go
// on with is kept by loop_variable() and kept_array(): states change where a trip is complete.
#include <algorithm>

#include "compiler/backend/analysis/fold_memory.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/backend/glsl/shader.h"
#include "compiler/ir/yields.h"

namespace dr::backend::glsl {

using ir::Op;
using ir::RegionId;
using ir::Type;
using ir::ValueId;
using ir::Yield;

namespace {

bool reads(const ir::Graph& graph, RegionId region, ValueId value) {
  const auto has = [&](const std::vector<ValueId>& values) { return std::ranges::find(values, value) != values.end(); };
  if (has(graph.region(region).yields)) return true;
  return std::ranges::any_of(graph.region(region).ops, [&](ir::OpId id) {
    const Op& op = graph.op(id);
    return has(op.operands) ||
           std::ranges::any_of(op.regions, [&](RegionId inner) { return reads(graph, inner, value); });
  });
}

}  // namespace

struct Shader::FoldLoops {
  const Op& op;
  std::string begin, end;
  std::string trips;                           // how many were run
  std::vector<std::vector<std::string>> now;   // variables: by sweep, by state
  std::vector<std::vector<std::string>> kept;  // arrays, by sweep, by state; empty: nobody asks
  std::vector<std::string> enter = {};         // statements before the first sweep
  std::string stopped = {};                    // whether it ended by its own condition; empty: nobody asks
  size_t sweeps() const { return op.regions.size(); }
};

void Shader::fold_op(const Op& op) {
  FoldLoops loops{op, use(op.operands[0]), use(op.operands[1]), unique("trips"), {}, {}};
  // What sweeps read at their own element is loaded once.
  for (const ValueId v : uses_of(graph_, op).at_element)
    if (!is_defined(v) && step_.stored.count(v) != 0) use(v);
  for (size_t s = 0; s < loops.sweeps(); ++s) {
    std::vector<std::string>& names = loops.now.emplace_back();
    for (const ValueId start : ir::fold_starts(op, s)) {
      const std::string from = use(start);
      names.push_back(unique("state"));
      loop_variable(loops.enter, graph_.value(start).type, names.back(), from);
    }
  }
  std::vector<std::string> results = loops.now.back();
  for (size_t k = results.size(); k < op.results.size(); ++k) {
    const ir::ValueInfo& info = graph_.value(op.results[k]);
    const bool scatter = op.attrs.yields[k] == Yield::Scatter;
    results.push_back(scatter ? std::string() : unique(info.name.empty() ? "fold" : info.name));
    if (!scatter) loop_variable(loops.enter, info.type, results.back(), zero(info.type));
  }
  forward_accumulators(op, op.regions.back());
  if (cut_ && ir::fold_stops(op)) {
    loops.stopped = unique("stopped");
    loop_variable(loops.enter, ir::kBool, loops.stopped, "false");
  }

  const FoldMemory memory = fold_memory(graph_, op);
  if (memory.how == FoldMemory::How::Checkpoints) {
    fold_from_checkpoints(loops, memory.slots, results);
  } else {
    fold_storing(loops, results);
  }
  for (size_t k = 0; k < results.size(); ++k)
    if (!results[k].empty()) define(op.results[k], results[k]);
}

// Whether one more trip comes after `count`.
std::string Shader::fold_goes_on(const FoldLoops& loops, const std::string& count) const {
  const int64_t bound = ir::fold_bound(loops.op);
  return (loops.stopped.empty() ? "" : "!" + loops.stopped + " && ") + loops.begin + " + " + count + " < " + loops.end +
         (bound < 0 ? "" : " && " + count + " < " + std::to_string(bound));
}

// An array that loops keep, and its items.
std::string Shader::kept_array(const Type& type, int64_t count) {
  std::string name = unique("kept");
  if (cut_) return cut_->keep_array(type, name, count);
  body_.line(type.str() + " " + name + "[" + std::to_string(count) + "];");
  return name;
}
// A statement before a loop.
void Shader::loop_statement(std::vector<std::string>& enter, std::string statement) {
  cut_ ? enter.push_back(std::move(statement)) : body_.line(statement);
}
std::string Shader::kept_item(const std::string& array, const std::string& index) const {
  return cut_ ? CutLoops::item(array, index) : array + "[" + index + "]";
}
std::string Shader::keep_item(const std::string& array, const std::string& index, const std::string& value) const {
  return cut_ ? CutLoops::set_item(array, index, value) : array + "[" + index + "] = " + value + ";";
}

void Shader::fold_storing(FoldLoops& loops, const std::vector<std::string>& results) {
  const Op& op = loops.op;
  const size_t last = loops.sweeps() - 1;
  for (size_t s = 0; s < last; ++s) {
    std::vector<std::string>& arrays = loops.kept.emplace_back(loops.now[s].size());
    for (size_t k = 0; k < arrays.size(); ++k) {
      bool wanted = false;
      for (size_t later = s + 1; later <= last; ++later)
        wanted = wanted || reads(graph_, op.regions[later], ir::fold_params(graph_, op, later, s)[k]);
      if (!wanted) continue;
      arrays[k] = kept_array(graph_.value(ir::fold_starts(op, s)[k]).type, std::max<int64_t>(1, ir::fold_bound(op)));
    }
  }
  loop_variable(loops.enter, ir::kInt, loops.trips, "0");
  for (size_t s = 0; s <= last; ++s) {
    const std::string trip = s == 0 ? loops.trips : unique("trip");
    std::vector<std::string> enter;
    const bool shared = s == last && begin_shared(op);
    if (shared) {
      loop_variable(enter, ir::kInt, trip, sharing_->share);
      open_loop(enter, trip + " < " + loops.trips, trip + " += " + sharing_->shares);
    } else if (s == 0) {
      open_loop(loops.enter, fold_goes_on(loops, trip), "");
    } else if (s % 2 == 1) {
      loop_variable(enter, ir::kInt, trip, loops.trips + " - 1");
      open_loop(enter, trip + " >= 0", "--" + trip);
    } else {
      loop_variable(enter, ir::kInt, trip, "0");
      open_loop(enter, trip + " < " + loops.trips, "++" + trip);
    }
    push_scope();
    fold_trip(loops, s, trip, results);
    pop_scope();
    close_loop();
    if (shared) end_shared(op, {});
  }
}

// The parameters of a sweep's region at a trip: its number, what is kept of earlier sweeps, and the states now.
void Shader::fold_parameters(const FoldLoops& loops, size_t sweep, const std::string& trip) {
  const Op& op = loops.op;
  const ValueId number = graph_.region(op.regions[sweep]).params[0];
  define(number, unique("i"));
  body_.line("int " + use(number) + " = " + loops.begin + " + " + trip + ";");
  for (size_t of = 0; of <= sweep; ++of) {
    const std::span<const ValueId> params = ir::fold_params(graph_, op, sweep, of);
    for (size_t k = 0; k < params.size(); ++k) {
      const std::string array = of < loops.kept.size() ? loops.kept[of][k] : "";
      if (of < sweep && array.empty()) continue;
      const ir::ValueInfo& info = graph_.value(params[k]);
      const std::string name = unique(info.name.empty() ? "state" : info.name);
      body_.line(info.type.str() + " " + name + " = " + (of < sweep ? kept_item(array, trip) : loops.now[of][k]) + ";");
      if (of == sweep && !array.empty()) body_.line(keep_item(array, trip, name));
      define(params[k], name);
    }
  }
}

// One trip of a sweep, in a scope of its own; the first counts it.
void Shader::fold_trip(const FoldLoops& loops, size_t sweep, const std::string& trip,
                       const std::vector<std::string>& results) {
  fold_parameters(loops, sweep, trip);
  if (sweep + 1 == loops.sweeps()) {
    yields(loops.op, loops.op.regions[sweep], results, {});
  } else {
    fold_advance(loops, sweep);
  }
  if (sweep != 0) return;
  const ValueId stop = ir::fold_stop(graph_, loops.op);
  const std::string stops = stop.valid() ? use(stop) : "";
  body_.line("++" + trip + ";");
  if (stop.valid() && loops.stopped.empty())
    body_.line("if (" + stops + ") break;");
  else if (stop.valid())
    body_.line("if (" + stops + ") { " + loops.stopped + " = true; break; }");
}

// Computes a sweep's next states from its parameters.
void Shader::fold_advance(const FoldLoops& loops, size_t sweep) {
  element_ops(graph_.region(loops.op.regions[sweep]).ops);
  const std::span<const ValueId> next = ir::fold_next(graph_, loops.op, sweep);
  std::vector<std::string> values;
  for (const ValueId v : next) values.push_back(use(v));
  if (cut_) cut_->finish_trip(body_);
  for (size_t k = 0; k < values.size(); ++k) body_.line(loops.now[sweep][k] + " = " + values[k] + ";");
}

// The second sweep goes from each trip to the checkpoint before it and forwards again, leaving checkpoints closer and
// closer to the trip: half of those that are free at equal distances, and so on.
void Shader::fold_from_checkpoints(FoldLoops& loops, int64_t slots, const std::vector<std::string>& results) {
  const Op& op = loops.op;
  const std::string count = std::to_string(slots), top = unique("top"), trip = unique("trip"), at = unique("at"),
                    next = unique("next"), free = unique("free");
  const std::vector<std::string>& now = loops.now[0];
  std::vector<std::string> arrays;
  for (size_t k = 0; k < now.size(); ++k) {
    arrays.push_back(kept_array(graph_.value(ir::fold_starts(op, 0)[k]).type, slots));
    loop_statement(loops.enter, keep_item(arrays[k], "0", now[k]));
  }
  const std::string places = kept_array(ir::kInt, slots);
  loop_statement(loops.enter, keep_item(places, "0", "0"));
  loop_variable(loops.enter, ir::kInt, top, "0");
  fold_count_trips(loops, results);

  loop_variable(loops.enter, ir::kInt, trip, loops.trips + " - 1");
  open_loop(loops.enter, trip + " >= 0", "--" + trip);
  std::vector<std::string> enter;
  for (size_t k = 0; k < arrays.size(); ++k) loop_statement(enter, now[k] + " = " + kept_item(arrays[k], top) + ";");
  body_.line("int " + free + ";");
  const std::string set_free = free + " = " + count + " - 1 - " + top + ";",
                    after = at + " + (" + free + " >= " + trip + " - " + at + " ? 1 : (" + trip + " - " + at + " + (" +
                            free + " + 1) / 2) / ((" + free + " + 1) / 2 + 1))";
  loop_variable(enter, ir::kInt, at, kept_item(places, top));
  loop_statement(enter, set_free);
  loop_variable(enter, ir::kInt, next, after);
  open_loop(enter, at + " < " + trip, "");
  push_scope();
  fold_parameters(loops, 0, at);
  fold_advance(loops, 0);
  pop_scope();
  body_.line("++" + at + ";");
  body_.line("if (" + top + " < " + count + " - 1 && " + at + " >= " + next + " && " + at + " < " + trip + ") {");
  body_.line("++" + top + ";");
  body_.line(keep_item(places, top, at));
  for (size_t k = 0; k < arrays.size(); ++k) body_.line(keep_item(arrays[k], top, now[k]));
  body_.line(set_free);
  body_.line(next + " = " + after + ";");
  body_.line("}");
  close_loop();
  push_scope();
  const std::span<const ValueId> before = ir::fold_params(graph_, op, 1, 0);
  for (size_t k = 0; k < before.size(); ++k) define(before[k], now[k]);
  fold_trip(loops, 1, trip, results);
  pop_scope();
  body_.line("if (" + top + " > 0 && " + kept_item(places, top) + " == " + trip + ") --" + top + ";");
  close_loop();
}

// How many trips the first sweep takes: those that its own condition leaves, or what the range says.
void Shader::fold_count_trips(FoldLoops& loops, const std::vector<std::string>& results) {
  if (ir::fold_stops(loops.op)) {
    loop_variable(loops.enter, ir::kInt, loops.trips, "0");
    open_loop(loops.enter, fold_goes_on(loops, loops.trips), "");
    push_scope();
    fold_trip(loops, 0, loops.trips, results);
    pop_scope();
    close_loop();
    loops.enter.clear();
    return;
  }
  const std::string all = "max(" + loops.end + " - " + loops.begin + ", 0)";
  const int64_t bound = ir::fold_bound(loops.op);
  body_.line("int " + loops.trips + " = " + (bound < 0 ? all : "min(" + all + ", " + std::to_string(bound) + ")") +
             ";");
}

}  // namespace dr::backend::glsl
