// SPDX-License-Identifier: Apache-2.0
// Packing: every schedule is sound whatever is switched off, stages only ever join, and greedy packing stays near the
// best schedule of small graphs.
#include <algorithm>
#include <cstdio>
#include <random>

#include "compiler/backend/cost/cost.h"
#include "compiler/backend/cost/lower_bound.h"
#include "compiler/ops/emit.h"
#include "tests/catch.h"
#include "tests/sanitized.h"
#include "tests/unit/backend/pack_exhaustive.h"
#include "tests/unit/passes/random_graph.h"

using namespace dr;
using namespace dr::backend;
using ir::OpKind;
using ir::ValueId;

namespace {

target::Profile profile(const std::string& name) { return std::get<target::Profile>(target::load_profile(name)); }

size_t stage_count(const Schedule& s) { return s.steps[0].passes.empty() ? 0 : s.steps[0].passes.back().stage + 1; }

// Up to ten ops over an image, a list and numbers: arithmetic, neighbours, indexed reads, sums, scatters.
ir::Graph small_graph(uint64_t seed) {
  std::mt19937_64 random(seed);
  ir::Builder b;
  const ir::Extent image{ir::Dim::symbol("W"), ir::Dim::symbol("H"), 1}, list{ir::Dim::symbol("V"), 1, 1};
  std::vector<ValueId> images, lists, numbers;
  auto leaf = [&](const char* name, ir::Type type, const ir::Extent& extent) {
    b.graph().leaves.push_back({ir::Leaf::Kind::Input, name, type, extent, {}, {}});
    return ops::emit(b, OpKind::Leaf, {}, {.text = name});
  };
  images.push_back(leaf("a", ir::kFloat, image));
  const ValueId index = leaf("i", ir::kInt, image);
  lists.push_back(leaf("v", ir::kFloat, list));
  numbers.push_back(leaf("n", ir::kFloat, {}));
  auto any = [&](const std::vector<ValueId>& from) { return from[random() % from.size()]; };
  const uint64_t count = 4 + random() % 7;
  for (uint64_t k = 0; k < count; ++k) switch (random() % 9) {
      case 0: images.push_back(ops::emit(b, OpKind::Exp, {any(images)})); break;
      case 1: images.push_back(ops::add(b, any(images), any(images))); break;
      case 2: images.push_back(ops::mul(b, any(images), any(numbers))); break;
      case 3: images.push_back(ops::emit(b, OpKind::Sin, {any(images)})); break;
      case 4: images.push_back(ops::emit(b, OpKind::Shift, {any(images)}, {.ints = {1, 0}})); break;
      case 5: images.push_back(ops::emit(b, OpKind::Gather, {any(lists), index})); break;
      case 6: numbers.push_back(ops::emit(b, OpKind::ReduceSum, {any(images)}, {.ints = {1, 1, 1}})); break;
      case 7: lists.push_back(ops::mul(b, any(lists), any(numbers))); break;
      case 8:
        lists.push_back(ops::emit(b, OpKind::ScatterAdd, {index, any(images)}, {.dims = {list.w, list.h, list.l}}));
        break;
    }
  std::vector<bool> used(b.graph().value_count(), false);
  for (uint32_t k = 0; k < b.graph().op_count(); ++k)
    for (ValueId v : b.graph().op(ir::OpId{k}).operands) used[v.index] = true;
  ir::Step step{"go", {}, {}};
  for (uint32_t k = 0; k < used.size(); ++k)
    if (!used[k] && b.graph().op(b.value(ValueId{k}).op).kind != OpKind::Leaf)
      step.outputs.push_back({"y" + std::to_string(k), ValueId{k}});
  b.graph().steps.push_back(std::move(step));
  return std::move(b).finish();
}

}  // namespace

TEST_CASE("random graphs have sound schedules on every profile, whatever is switched off") {
  for (const std::string& name : target::builtin_profiles()) {
    const target::Profile p = profile(name);
    for (int seed = 0; seed < dr::repeats(40); ++seed) {
      const ir::Graph g = passes_test::random_graph(static_cast<uint64_t>(seed));
      for (int off = 0; off < 16; ++off) {
        PackOptions options;
        options.fused = (off & 1) == 0;
        options.recompute = (off & 2) == 0;
        options.fragment = (off & 4) == 0;
        options.stages = (off & 8) == 0;
        INFO(name << ", seed " << seed << ", switched off " << off);
        const Schedule s = pack(g, p, options);
        const auto problems = check_schedule(g, s, p);
        // A single op may need more than the smallest devices have; packing must not add to that.
        for (const Violation& problem : problems) CHECK(problem.text == "");
        PackOptions apart = options;
        apart.stages = false;
        CHECK(stage_count(s) <= stage_count(pack(g, p, apart)));
      }
    }
  }
}

TEST_CASE("no schedule does with less than the lower bound") {
  const ir::SymbolValues symbols{{"W", 256}, {"H", 256}, {"V", 5000}};
  size_t tight = 0;
  for (uint64_t seed = 0; seed < 200; ++seed) {
    const ir::Graph g = small_graph(seed);
    const target::Profile p = profile("nvidia-h200");
    const Schedule s = pack(g, p, {});
    const StepSchedule& step = s.steps[0];
    int64_t moved = 0;
    for (const Pass& pass : step.passes)
      for (const auto* values : {&pass.reads, &pass.writes})
        for (ValueId v : *values) {
          const ir::ValueInfo& info = g.value(v);
          moved += 4 * info.type.components() * *(info.extent.w * info.extent.h * info.extent.l).evaluate(symbols);
        }
    INFO("seed " << seed);
    const auto least = lower_bound(g, g.steps[0], symbols, false);
    REQUIRE(least);
    CHECK(stage_count(s) >= least->stages);
    CHECK(moved >= least->bytes);
    if (stage_count(s) == least->stages && moved == least->bytes) ++tight;
    // Nothing changes, so nothing is left for later runs.
    CHECK(lower_bound(g, g.steps[0], symbols, true)->bytes == 0);
  }
  CHECK(tight > 20);
  CHECK_FALSE(lower_bound(small_graph(1), small_graph(1).steps[0], {}, false));
}

TEST_CASE("greedy packing stays near the best schedule of small graphs") {
  if (kSanitized) return;  // how good schedules are
  const ir::SymbolValues symbols{{"W", 256}, {"H", 256}, {"V", 5000}};
  std::vector<double> ratios;
  size_t tried = 0;
  uint64_t worst_seed = 0;
  for (uint64_t seed = 0; ratios.size() < 500 && seed < 2000; ++seed) {
    const ir::Graph g = small_graph(seed);
    if (g.steps[0].outputs.empty()) continue;
    const target::Profile p =
        profile(std::vector{"lavapipe", "arm-mali-g76", "nvidia-rtx2080", "nvidia-h200"}[seed % 4]);
    PackOptions options;
    options.fragment = p.lower == "fragment";
    const auto best = backend_test::pack_exhaustive(g, p, options, symbols, 2000);
    if (!best) continue;
    const Schedule greedy = pack(g, p, options);
    const double cost = *step_cost(g, greedy, greedy.steps[0], p, symbols);
    // The search loads what is stored; greedy packing may compute it again, and be better for once.
    ratios.push_back(std::max(1.0, cost / best->cost));
    if (ratios.back() >= *std::max_element(ratios.begin(), ratios.end())) worst_seed = seed;
    tried += best->tried;
  }
  REQUIRE(ratios.size() == 500);
  std::sort(ratios.begin(), ratios.end());
  double mean = 0;
  for (double r : ratios) mean += r / static_cast<double>(ratios.size());
  std::printf(
      "greedy against the best of %zu schedules of 500 graphs: mean %.4f, median %.4f, 90%% %.4f, 99%% %.4f, "
      "worst %.4f (seed %llu)\n",
      tried, mean, ratios[250], ratios[450], ratios[495], ratios.back(), static_cast<unsigned long long>(worst_seed));
  CHECK(mean <= 1.01);
  CHECK(ratios.back() <= 1.10);
}

namespace {

// x = 0.5 sin(x), so many times, and back again by the chain rule.
ir::Graph chain(size_t length) {
  ir::Builder b;
  const ir::Extent list{ir::Dim::symbol("V"), 1, 1};
  b.graph().leaves.push_back({ir::Leaf::Kind::Input, "a", ir::kFloat, list, {}, {}});
  std::vector<ValueId> x{ops::emit(b, OpKind::Leaf, {}, {.text = "a"})};
  const ValueId half = ops::constant(b, ir::kFloat, 0.5);
  for (size_t k = 0; k < length; ++k) x.push_back(ops::mul(b, ops::emit(b, OpKind::Sin, {x.back()}), half));
  ValueId adjoint = half;
  for (size_t k = length; k-- > 0;)
    adjoint = ops::mul(b, adjoint, ops::mul(b, ops::emit(b, OpKind::Cos, {x[k]}), half));
  ir::Graph graph = std::move(b).finish();
  graph.steps.push_back({"go", {{"value", x.back()}, {"gradient", adjoint}, {"middle", x[length / 2]}}, {}});
  return graph;
}

}  // namespace

TEST_CASE("no shader grows without bound, and neither does what is computed again for that") {
  for (const char* name : {"lavapipe", "nvidia-h200", "arm-mali-g76"}) {
    std::vector<size_t> totals;
    for (const size_t length : {500u, 1000u, 2000u}) {
      const ir::Graph g = chain(length);
      size_t graph_size = 0, total = 0;
      for (uint32_t k = 0; k < g.op_count(); ++k) graph_size += op_size(g, g.op(ir::OpId{k}));
      const Schedule s = pack(g, profile(name), {});
      CHECK(check_schedule(g, s, profile(name)).empty());
      for (const Pass& pass : s.steps[0].passes) {
        size_t size = 0;
        for (const ir::OpId id : pass.ops) size += op_size(g, g.op(id));
        CHECK(size <= 8192);
        total += size;
      }
      INFO(name << " " << length);
      CHECK(total <= 3 * graph_size);
      CHECK(s.steps[0].passes.size() * 1000 <= total);
      totals.push_back(total);
    }
    CHECK(totals[2] <= 5 * totals[0]);
  }
}
