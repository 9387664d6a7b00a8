// SPDX-License-Identifier: Apache-2.0
// The cost model.
#include "compiler/backend/cost/cost.h"

#include <algorithm>

#include "compiler/backend/analysis/axes.h"
#include "compiler/backend/analysis/uses.h"
#include "compiler/ir/yields.h"
#include "compiler/ops/op.h"

namespace dr::backend {

using ir::Op;
using ir::OpKind;
using ir::ValueId;

int op_cost(OpKind kind) { return ops::info(kind).cost; }

size_t op_size(const ir::Graph& graph, const Op& op) {
  if (is_inline(op) || is_memory(op)) return 0;
  size_t components = 0;
  for (ValueId v : op.results) components += static_cast<size_t>(graph.value(v).type.components());
  size_t size = static_cast<size_t>(1 + op_cost(op.kind)) * components;
  for (ir::RegionId region : op.regions)
    for (ir::OpId id : graph.region(region).ops) size += op_size(graph, graph.op(id));
  return size;
}

int recompute_limit(const target::Profile& profile, bool fragment) {
  const target::Costs& c = profile.costs;
  const double bytes_per_ns = fragment ? c.fragment_image_bytes_per_ns : c.compute_buffer_bytes_per_ns;
  const double operations_per_ns = fragment ? c.fragment_operations_per_ns : c.compute_operations_per_ns;
  constexpr double kBytes = 8;  // a component stored and loaded
  // Bounded: long shaders cost compile time and registers, which bandwidth does not know.
  return static_cast<int>(std::clamp(kBytes * operations_per_ns / bytes_per_ns, 4.0, 64.0));
}

namespace {

constexpr double kUnknownTrips = 8, kReduceGroup = 4096;
// The share of a scatter's elements that add something, where only those run.
constexpr double kActive = 0.125;

struct Model {
  const ir::Graph& graph;
  const Schedule& schedule;
  const StepSchedule& step;
  const target::Costs& costs;
  const ir::SymbolValues& symbols;
  const CostAssumptions& assumptions;
  bool known = true;
  std::optional<ChangingAxes> changing = std::nullopt;

  double evaluate(const ir::Dim& dim) {
    const auto value = dim.evaluate(symbols);
    known = known && value.has_value();
    return value ? static_cast<double>(*value) : 0;
  }
  double elements(const ir::Extent& e) { return evaluate(e.w) * evaluate(e.h) * evaluate(e.l); }

  // Of a loop, as far as its bounds are numbers or extents.
  double trips(const Op& op) const {
    if (!ir::is_loop(op.kind)) return 1;
    double bounds[2] = {};
    for (const size_t k : {size_t{0}, size_t{1}}) {
      const ir::OpId id = graph.value(op.operands[k]).op;
      if (!id.valid()) return kUnknownTrips;
      const Op& bound = graph.op(id);
      if (bound.kind == OpKind::Const) {
        bounds[k] = bound.attrs.floats[0];
      } else if (const auto extent =
                     bound.kind == OpKind::DimValue ? bound.attrs.dims[0].evaluate(symbols) : std::nullopt) {
        bounds[k] = static_cast<double>(*extent);
      } else {
        return kUnknownTrips;
      }
    }
    return std::max(bounds[1] - bounds[0], 0.0);
  }

  // For one element; of a block, which computes once what its elements share.
  double arithmetic(const Op& op, const Block* block = nullptr) {
    double own = op_cost(op.kind) * std::max(1, graph.value(op.results[0]).type.components());
    if (block) {
      const Axes changes = changing_axes().of(op);
      for (size_t axis = 0; axis < 3; ++axis)
        if (((changes >> axis) & 1) == 0) own /= block->each[axis];
    }
    for (ir::RegionId region : op.regions) {
      double inside = 0;
      for (ir::OpId id : graph.region(region).ops) inside += arithmetic(graph.op(id), block);
      own += trips(op) * inside;
    }
    return own;
  }

  ChangingAxes& changing_axes() {
    if (!changing) changing.emplace(graph);
    return *changing;
  }

  double bytes(ValueId v) {
    const Resource& r = schedule.resources[step.stored.at(v).index];
    // A face and its tag are read at once.
    if (r.is(Resource::Storage::Bits)) return 4.0 * elements(r.extent);
    if (r.is_entries())
      return raster_part(graph, v).what != ir::RasterResult::Face ? 0 : 8.0 * elements(graph.value(v).extent);
    const int words = !r.is_buffer() && r.type.rows == 3 ? 4 : r.words();
    return 4.0 * words * elements(r.extent);
  }
  double bandwidth(ValueId v, bool fragment) const {
    const Resource::Storage storage = schedule.resources[step.stored.at(v).index].storage;
    if (storage == Resource::Storage::Tile) return costs.fragment_input_bytes_per_ns;
    const bool image = storage == Resource::Storage::Image;
    if (fragment) return image ? costs.fragment_image_bytes_per_ns : costs.fragment_buffer_bytes_per_ns;
    return image ? costs.compute_image_bytes_per_ns : costs.compute_buffer_bytes_per_ns;
  }

  double pass_cost(size_t index) {
    const Pass& pass = step.passes[index];
    const bool fragment = pass.is<FragmentPass>();
    const bool joins = index > 0 && step.passes[index - 1].stage == pass.stage;
    double count = elements(pass.domain);
    double cost = fragment ? (joins ? costs.subpass_ns : costs.pass_ns) : costs.dispatch_ns;
    const std::vector<ValueId> inputs = stage_inputs(step, index);
    double loads = 0;
    for (ValueId v : pass.reads) {
      const bool input = std::find(inputs.begin(), inputs.end(), v) != inputs.end();
      loads += bytes(v) / (input && fragment ? costs.fragment_input_bytes_per_ns : bandwidth(v, fragment));
    }
    cost += loads;
    for (ValueId v : pass.writes) cost += bytes(v) / bandwidth(v, fragment);
    const auto* map = pass.as<MapPass>();
    const Block* block = map && map->block ? &*map->block : nullptr;
    double work = 0;
    for (ir::OpId id : pass.ops)
      if (graph.op(id).kind != OpKind::Raster) work += arithmetic(graph.op(id), block);
    work *= count / (fragment ? costs.fragment_operations_per_ns : costs.compute_operations_per_ns);
    switch (pass.kind()) {
      case PassKind::Map: return cost + work;
      case PassKind::Reduce:
        while (count > kReduceGroup) {
          cost += costs.dispatch_ns;
          count /= kReduceGroup;
        }
        return cost + work;
      case PassKind::Scatter: {
        const auto& scatter = pass.get<ScatterPass>();
        // A row's sources are read where the table says.
        if (scatter.lowering() == ScatterLowering::Rows)
          return cost + work + costs.dispatch_ns + 4 * count / costs.compute_buffer_bytes_per_ns;
        // Clearing, the list of those that add something, the largest contribution, the sums, their conversion; two
        // words a contribution. The shader runs twice.
        const bool all = scatter.clauses().empty();
        const double active = all ? 1 : kActive;
        return cost + 3 * costs.dispatch_ns + (all ? 0 : costs.dispatch_ns) + active * loads + 2 * active * work +
               3 * active * count * costs.atomic_add_ns;
      }
      case PassKind::Raster: break;
    }
    const Op& op = graph.op(graph.value(pass.writes.front()).op);
    const double faces = evaluate(op.attrs.dims[3]);
    const double layers = evaluate(pass.domain.l),
                 ranks = op.results.size() == 1 ? 1 : static_cast<double>(op.results.size()) / 2;
    const bool drawn = pass.is_drawn();
    const double triangle = drawn ? costs.hardware_triangle_ns : costs.compute_triangle_ns;
    double pixel = drawn ? costs.hardware_pixel_ns : costs.compute_pixel_ns;
    pixel += arithmetic(op) / (drawn ? costs.fragment_operations_per_ns : costs.compute_operations_per_ns);
    cost += ranks * (drawn ? costs.pass_ns : costs.dispatch_ns);
    // Draws find one rank after the other.
    cost += (drawn ? ranks : 1) * faces * layers * (triangle + assumptions.faces_cover * pixel);
    return cost;
  }
};

}  // namespace

std::optional<double> step_cost(const ir::Graph& graph, const Schedule& schedule, const StepSchedule& step,
                                const target::Profile& profile, const ir::SymbolValues& symbols,
                                const CostAssumptions& assumptions) {
  Model model{graph, schedule, step, profile.costs, symbols, assumptions};
  double total = 0;
  for (size_t k = 0; k < step.passes.size(); ++k) total += model.pass_cost(k);
  return model.known ? std::optional(total) : std::nullopt;
}

}  // namespace dr::backend
