// SPDX-License-Identifier: Apache-2.0
// What the adjoints of the structured constructs share: taking yields apart, replaying a region's ops inside the
// region that computes their adjoints, and carrying adjoints of captured values and read images out of it.
#include <algorithm>
#include <set>

#include "compiler/ir/yields.h"
#include "compiler/ops/emit.h"
#include "compiler/passes/gradient/differentiate.h"

namespace dr::passes {

using ir::Extent;
using ir::Graph;
using ir::Op;
using ir::OpId;
using ir::RegionId;
using ir::ValueId;
using ir::Yield;
using ir::Yielded;
using ir::yielded;

std::vector<ResultAdjoint> result_adjoints(Sweep& sweep, const Frame& frame, const Op& op) {
  std::vector<ResultAdjoint> adjoints(op.results.size());
  for (size_t k = 0; k < op.results.size(); ++k) {
    const ValueId result = op.results[k];
    const bool goes_on = std::ranges::any_of(ir::yielding_regions(op), [&](RegionId region) {
      return static_cast<bool>(sweep.active[yielded(sweep.source, op, region)[k].value.index]);
    });
    // A state may be what it starts with.
    const size_t last = op.regions.size() - 1;
    const bool carried = op.kind == ir::OpKind::Fold && k < ir::fold_states(op, last) &&
                         sweep.active[ir::fold_params(sweep.source, op, last, last)[k].index];
    if (!goes_on && !carried) continue;  // the result is a target itself
    if (const auto images = frame.accumulated.find(result); images != frame.accumulated.end()) {
      adjoints[k].images = images->second;
    }
    const auto found = frame.adjoints.find(result);
    if (found == frame.adjoints.end()) continue;
    if (op.attrs.yields[k] == Yield::Scatter) {
      // It is going to be read at an index, so it must have its elements.
      const Extent& extent = sweep.source.value(result).extent;
      adjoints[k].images = {ops::broadcast(sweep.builder, found->second, extent)};
    } else {
      adjoints[k].element = found->second;
    }
  }
  return adjoints;
}

bool any(std::span<const ResultAdjoint> adjoints) {
  return std::ranges::any_of(adjoints, [](const ResultAdjoint& adjoint) { return adjoint.any(); });
}

Extent adjoint_domain(const Frame& frame, const Op& op) {
  if (!frame.root) return frame.domain;
  return {op.attrs.dims[0], op.attrs.dims[1], op.attrs.dims[2]};
}

void replay(Sweep& sweep, RegionId region, std::span<const ValueId> values) {
  std::set<ValueId> needed(values.begin(), values.end());
  std::vector<OpId> list;
  const std::vector<OpId>& all = sweep.source.region(region).ops;
  for (auto it = all.rbegin(); it != all.rend(); ++it) {
    const Op& op = sweep.source.op(*it);
    if (std::ranges::none_of(op.results, [&](ValueId id) { return needed.contains(id); })) continue;
    list.push_back(*it);
    needed.insert(op.operands.begin(), op.operands.end());
    for (const RegionId inner : op.regions) {
      const std::vector<ValueId> captured = ir::captures(sweep.source, inner);
      needed.insert(captured.begin(), captured.end());
    }
  }
  std::ranges::reverse(list);
  for (const OpId id : list) ir::copy_op(sweep.source, id, sweep.builder, sweep.now);
}

void reverse(Sweep& sweep, Frame& frame, const Op& op, RegionId region, std::span<const ResultAdjoint> adjoints) {
  const std::vector<Yielded> yields = yielded(sweep.source, op, region);
  const auto flows = [&](size_t k) { return adjoints[k].any() && sweep.active[yields[k].value.index]; };
  std::vector<ValueId> values;
  for (size_t k = 0; k < yields.size(); ++k) {
    if (!flows(k)) continue;
    values.push_back(yields[k].value);
    if (yields[k].index.valid()) values.push_back(yields[k].index);
  }
  replay(sweep, region, values);

  for (size_t k = 0; k < yields.size(); ++k) {
    if (!flows(k)) continue;
    const ValueId value = yields[k].value;
    if (adjoints[k].element.valid()) sweep.add(frame, value, adjoints[k].element);
    for (const ValueId image : adjoints[k].images) {
      if (yields[k].index.valid()) {
        sweep.add(frame, value, ops::emit(sweep.builder, ir::OpKind::Gather, {image, sweep.now[yields[k].index]}));
      } else {
        frame.accumulated[value].push_back(image);
      }
    }
  }
  sweep.run(frame, sweep.source.region(region).ops);
  // What is left are adjoints of captured values.
  std::erase_if(frame.adjoints, [&](const auto& entry) { return sweep.source.value(entry.first).region == region; });
}

void yield_captured(const Sweep& sweep, const Frame& frame, std::span<const RegionId> own, ir::Attrs& attrs,
                    std::vector<ValueId>& yields, std::vector<ValueId>& captured, std::vector<ValueId>& images) {
  for (const auto& [value, adjoint] : frame.adjoints) {
    if (std::ranges::find(own, sweep.source.value(value).region) != own.end()) continue;
    captured.push_back(value);
    yields.push_back(adjoint);
    attrs.yields.push_back(Yield::Sum);
  }
  for (const ScatterTerm& term : frame.scatters) {
    images.push_back(term.image);
    if (term.index.valid()) yields.push_back(term.index);
    yields.push_back(term.value);
    attrs.yields.push_back(Yield::Scatter);
    append_extent(attrs, sweep.source.value(term.image).extent);
  }
}

void append_extent(ir::Attrs& attrs, const Extent& extent) {
  attrs.dims.insert(attrs.dims.end(), {extent.w, extent.h, extent.l});
}

void collect(Sweep& sweep, Frame& outer, std::span<const ValueId> captured, std::span<const ValueId> images,
             std::span<const ValueId> results) {
  for (size_t k = 0; k < captured.size(); ++k) {
    const Extent& extent = sweep.source.value(captured[k]).extent;
    sweep.add(outer, captured[k], outer.root ? ops::reduce_to(sweep.builder, results[k], extent) : results[k]);
  }
  for (size_t k = 0; k < images.size(); ++k) {
    const ValueId result = results[captured.size() + k];
    if (outer.root) {
      sweep.add(outer, images[k], result);
    } else {
      outer.scatters.push_back({.image = images[k], .index = {}, .value = result});
    }
  }
}

}  // namespace dr::passes
