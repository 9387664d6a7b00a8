// SPDX-License-Identifier: Apache-2.0
// Frames: values over work lists, element-wise ops, indexed reads and If inside regions. Reduce is in reduce.cpp, Fold
// in fold.cpp.
#include "compiler/reference/region.h"

#include <algorithm>
#include <cmath>

#include "compiler/reference/fold.h"
#include "compiler/reference/reduce.h"

namespace dr::reference {

using ir::Op;
using ir::OpKind;
using ir::Yield;

// --- frames ---

Frame RegionRunner::outermost(const Plan& plan, const Places& places) {
  Frame frame;
  frame.plan = &plan;
  frame.n = places.size();
  frame.places = &places;
  frame.lanes.resize(plan.slots.size());
  return frame;
}

Frame RegionRunner::inner(const Plan& plan, Frame& parent, const std::vector<uint32_t>* list) {
  Frame frame;
  frame.plan = &plan;
  frame.parent = &parent;
  frame.n = list != nullptr ? list->size() : parent.n;
  frame.from_parent = list;
  frame.lanes.resize(plan.slots.size());
  return frame;
}

void RegionRunner::clear(Frame& frame, bool keep_captured) {
  for (size_t slot = 0; slot < frame.lanes.size(); ++slot) {
    if (keep_captured && frame.plan->slots[slot].source != Slot::Source::Made) continue;
    pool_.give(std::move(frame.lanes[slot].own));
    frame.lanes[slot] = {};
  }
  if (!keep_captured && frame.parent != nullptr) frame.places = nullptr;
}

const Places& RegionRunner::places(Frame& frame) {
  if (frame.places != nullptr) return *frame.places;
  const Places& outer = places(*frame.parent);
  if (frame.from_parent == nullptr) {
    frame.places = &outer;
    return outer;
  }
  const auto pick = [&](const std::vector<int32_t>& from, std::vector<int32_t>& to) {
    to.resize(frame.n);
    for (size_t i = 0; i < frame.n; ++i) to[i] = from[(*frame.from_parent)[i]];
  };
  pick(outer.x, frame.own_places.x);
  pick(outer.y, frame.own_places.y);
  pick(outer.l, frame.own_places.l);
  frame.places = &frame.own_places;
  return frame.own_places;
}

double* RegionRunner::make(Frame& frame, uint32_t slot, size_t n) {
  Lanes& lanes = frame.lanes[slot];
  pool_.give(std::move(lanes.own));
  lanes.own = pool_.take(components(frame.plan->slots[slot].type) * n);
  lanes.data = lanes.own.data();
  lanes.n = n;
  lanes.origin = {};
  return lanes.own.data();
}

void RegionRunner::fetch_root(Frame& frame, uint32_t slot, const Image& image) {
  Lanes& lanes = frame.lanes[slot];
  const size_t planes = components(image.type), count = size_of(image).count();
  if (count == 1) {
    lanes.data = image.data.data();
    lanes.n = 1;
  } else {
    const Places& p = places(frame);
    const Strides strides(image);
    const size_t n = frame.n;
    double* out = make(frame, slot, n);
    for (size_t i = 0; i < n; ++i) {
      const size_t at = static_cast<size_t>(p.x[i]) * strides.x + static_cast<size_t>(p.y[i]) * strides.y +
                        static_cast<size_t>(p.l[i]) * strides.l;
      for (size_t c = 0; c < planes; ++c) out[c * n + i] = image.data[c * count + at];
    }
  }
  if (context_.tracing() && first_not_finite(lanes.data, planes, lanes.n) < lanes.n) {
    lanes.origin = context_.origins[frame.plan->slots[slot].value.index];
  }
}

void RegionRunner::fetch_parent(Frame& frame, uint32_t slot) {
  const Slot& info = frame.plan->slots[slot];
  const Lanes& outer = get(*frame.parent, info.parent_slot);
  const size_t planes = components(info.type);
  Lanes& lanes = frame.lanes[slot];
  if (outer.n == 1 || frame.from_parent == nullptr) {
    lanes.data = outer.data;
    lanes.n = outer.n;
  } else {
    const std::vector<uint32_t>& list = *frame.from_parent;
    double* out = make(frame, slot, frame.n);
    for (size_t c = 0; c < planes; ++c) {
      const double* plane = outer.data + c * outer.n;
      for (size_t i = 0; i < frame.n; ++i) out[c * frame.n + i] = plane[list[i]];
    }
  }
  // The elements that are not finite may all be outside the list.
  if (outer.origin.valid() && first_not_finite(lanes.data, planes, lanes.n) < lanes.n) lanes.origin = outer.origin;
}

const Lanes& RegionRunner::get(Frame& frame, uint32_t slot) {
  Lanes& lanes = frame.lanes[slot];
  if (lanes.n != 0) return lanes;
  const Slot& info = frame.plan->slots[slot];
  switch (info.source) {
    case Slot::Source::Made: DR_ICE("a region's value is used before it is made");
    case Slot::Source::Parent: fetch_parent(frame, slot); break;
    case Slot::Source::Root: {
      const Image* image = context_.images[info.value.index];
      DR_ASSERT(image != nullptr);
      fetch_root(frame, slot, *image);
      break;
    }
  }
  return lanes;
}

// --- ops ---

void RegionRunner::run(Frame& frame) {
  for (const OpPlan& op : frame.plan->ops) {
    run_op(frame, op);
    for (uint32_t slot : op.dead) {
      pool_.give(std::move(frame.lanes[slot].own));
      frame.lanes[slot] = {};
    }
  }
}

void RegionRunner::run_op(Frame& frame, const OpPlan& op) {
  switch (op.op->kind) {
    case OpKind::If: run_if(frame, op); return;
    case OpKind::Reduce: run_reduce(frame, op); return;
    case OpKind::Fold: run_fold(frame, op); return;
    case OpKind::Gather: run_gather(frame, op); break;
    case OpKind::Const:
    case OpKind::Coord:
    case OpKind::DimValue:
    case OpKind::StepIndex: run_source(frame, op); break;
    case OpKind::Broadcast:
    case OpKind::Detach:
    case OpKind::Pin:
#define DR_OP(kind, name)
#define DR_ELEMENTWISE(kind, name) case OpKind::kind:
#include "compiler/ir/op_kinds.def"
#undef DR_OP
      run_elementwise(frame, op);
      break;
    case OpKind::Leaf:
    case OpKind::ScatterAdd:
    case OpKind::ScatterMax:
    case OpKind::Shift:
    case OpKind::ReduceSum:
    case OpKind::ReduceMin:
    case OpKind::ReduceMax:
    case OpKind::Raster:
    case OpKind::Grad:
    case OpKind::Vjp:
    case OpKind::Cotangent: DR_ICE("op '" + std::string(ir::op_name(op.op->kind)) + "' stands in a region");
  }
  if (context_.tracing()) trace(frame, op);
}

void RegionRunner::run_elementwise(Frame& frame, const OpPlan& plan) {
  const Op& op = *plan.op;
  DR_ASSERT(plan.operands.size() <= kMaxOperands);
  const double* operands[kMaxOperands];
  size_t count = 0, n = 1;
  for (uint32_t slot : plan.operands) n = std::max(n, get(frame, slot).n);
  for (uint32_t slot : plan.operands) {
    const Lanes& lanes = frame.lanes[slot];
    if (lanes.n == n) {
      operands[count++] = lanes.data;
      continue;
    }
    const size_t planes = components(frame.plan->slots[slot].type);
    const Buffer& buffer = expanded_.emplace_back(pool_.take(planes * n));
    for (size_t c = 0; c < planes; ++c) std::fill_n(buffer.data() + c * n, n, lanes.data[c]);
    operands[count++] = buffer.data();
  }
  evaluate_batch(context_.graph, op, n, {operands, count}, make(frame, plan.results[0], n), context_.float32);
  for (Buffer& buffer : expanded_) pool_.give(std::move(buffer));
  expanded_.clear();
}

void RegionRunner::run_gather(Frame& frame, const OpPlan& plan) {
  // The image is read as a whole: it has a slot, but no value at the current element is asked for.
  const Slot& source = frame.plan->slots[plan.operands[0]];
  DR_ASSERT(context_.graph.value(source.value).region == context_.graph.root());
  const Image& image = *context_.images[source.value.index];
  const Lanes& index = get(frame, plan.operands[1]);
  const size_t planes = components(image.type), count = size_of(image).count();
  const size_t index_planes = components(frame.plan->slots[plan.operands[1]].type);
  const bool own_layer = index_planes < 3 && image.layers > 1;
  const size_t n = own_layer ? frame.n : index.n;
  const int32_t* layers = own_layer ? places(frame).l.data() : nullptr;
  double* out = make(frame, plan.results[0], n);
  for (size_t i = 0; i < n; ++i) {
    const int64_t at = place_of_index(size_of(image), index_planes, index.data + (index.n == 1 ? 0 : i), index.n,
                                      own_layer ? layers[i] : 0);
    for (size_t c = 0; c < planes; ++c) out[c * n + i] = at < 0 ? 0.0 : image.data[c * count + static_cast<size_t>(at)];
  }
}

void RegionRunner::run_source(Frame& frame, const OpPlan& plan) {
  const Op& op = *plan.op;
  const uint32_t slot = plan.results[0];
  if (op.kind == OpKind::Const) {
    double* out = make(frame, slot, 1);
    std::copy(op.attrs.floats.begin(), op.attrs.floats.end(), out);
    if (context_.float32 && frame.plan->slots[slot].type.is_float()) round_to_float(out, op.attrs.floats.size());
    return;
  }
  if (op.kind == OpKind::Coord) {
    const auto axis = static_cast<size_t>(op.attrs.ints[0]);
    if (op.attrs.dims[axis].evaluate(context_.symbols) == 1) {
      *make(frame, slot, 1) = 0;
      return;
    }
    const Places& p = places(frame);
    const std::vector<int32_t>& from = axis == 0 ? p.x : axis == 1 ? p.y : p.l;
    std::copy(from.begin(), from.end(), make(frame, slot, frame.n));
    return;
  }
  const bool is_dim = op.kind == OpKind::DimValue;
  *make(frame, slot, 1) =
      wrap(static_cast<double>(is_dim ? op.attrs.dims[0].evaluate(context_.symbols).value() : context_.step_index),
           ir::Scalar::Int);
}

void RegionRunner::scatter(Frame& frame, const YieldPlan& yield) {
  for (uint32_t sink : yield.sinks) {
    const Lanes& index = get(frame, yield.index);
    const Lanes& value = get(frame, yield.value);
    log_->add(sink, index, frame.plan->slots[yield.index].type, value, places(frame));
  }
}

void RegionRunner::run_branch(Frame& frame, const OpPlan& op, const Plan& branch, const std::vector<uint32_t>* list) {
  Frame child = inner(branch, frame, list);
  run(child);
  for (size_t k = 0; k < branch.yields.size(); ++k) {
    const YieldPlan& yield = branch.yields[k];
    if (yield.how == Yield::Scatter) {
      if (!yield.forwarded) scatter(child, yield);
      continue;
    }
    const Lanes& value = get(child, yield.value);
    const uint32_t slot = op.results[k];
    const size_t planes = components(frame.plan->slots[slot].type);
    if (list == nullptr) {
      std::copy_n(value.data, planes * value.n, make(frame, slot, value.n));
    } else {
      if (frame.lanes[slot].n == 0) make(frame, slot, frame.n);
      double* out = frame.lanes[slot].own.data();
      for (size_t c = 0; c < planes; ++c) {
        for (size_t i = 0; i < child.n; ++i) out[c * frame.n + (*list)[i]] = value.at(c, i);
      }
    }
    if (!frame.lanes[slot].origin.valid()) frame.lanes[slot].origin = value.origin;
  }
  clear(child);
}

void RegionRunner::run_if(Frame& frame, const OpPlan& op) {
  const Lanes& condition = get(frame, op.operands[0]);
  std::vector<uint32_t> lists[2];
  for (size_t i = 0; i < condition.n; ++i) lists[condition.data[i] != 0 ? 0 : 1].push_back(static_cast<uint32_t>(i));
  for (size_t branch = 0; branch < 2; ++branch) {
    if (lists[branch].empty()) continue;
    const bool all = lists[branch].size() == condition.n;
    run_branch(frame, op, op.regions[branch], all ? nullptr : &lists[branch]);
  }
}

void RegionRunner::run_reduce(Frame& frame, const OpPlan& op) { ReduceRun(*this, frame, op).run(); }
void RegionRunner::run_fold(Frame& frame, const OpPlan& op) { FoldRun(*this, frame, op).run(); }

// --- finding what is not finite ---

Origin RegionRunner::origin_here(Frame& frame, const OpPlan& plan, size_t i) {
  const Places& p = places(frame);
  Origin origin{.op = op_id(*plan.op), .x = p.x[i], .y = p.y[i], .l = p.l[i]};
  std::vector<std::vector<double>> operands;
  for (uint32_t slot : plan.operands) {
    const Lanes& lanes = frame.lanes[slot];
    std::vector<double>& values = operands.emplace_back();
    // An image that an indexed read takes has no lanes.
    for (size_t c = 0; lanes.n != 0 && c < components(frame.plan->slots[slot].type); ++c)
      values.push_back(lanes.at(c, lanes.n == 1 ? 0 : i));
  }
  origin.operands = std::make_shared<const std::vector<std::vector<double>>>(std::move(operands));
  if (!first_.valid()) first_ = origin;
  return origin;
}

void RegionRunner::trace(Frame& frame, const OpPlan& plan) {
  Lanes& result = frame.lanes[plan.results[0]];
  const size_t bad = first_not_finite(result.data, components(frame.plan->slots[plan.results[0]].type), result.n);
  if (bad == result.n) return;
  for (uint32_t slot : plan.operands) {
    const Slot& info = frame.plan->slots[slot];
    const Lanes& operand = frame.lanes[slot];
    const size_t i = operand.n == 1 ? 0 : bad;
    bool finite = true;
    for (size_t c = 0; operand.n != 0 && c < components(info.type); ++c) finite &= std::isfinite(operand.at(c, i));
    if (!finite) {
      result.origin = operand.origin;
      return;
    }
    // An image that an indexed read takes is not among the frame's lanes.
    if (plan.op->kind == OpKind::Gather && info.source == Slot::Source::Root &&
        context_.origins[info.value.index].valid()) {
      result.origin = context_.origins[info.value.index];
      return;
    }
  }
  result.origin = origin_here(frame, plan, bad);
}

// --- ops of the root ---

Origin run_region_op(const Context& context, const Op& op, std::span<Image* const> results, std::span<Origin> origins,
                     Workers& workers) {
  const Plan plan = plan_op(context.graph, op);
  std::vector<Image*> images;
  std::vector<size_t> sink_results;
  for (size_t k = 0; k < results.size(); ++k) {
    if (op.attrs.yields[k] != Yield::Scatter) continue;
    images.push_back(results[k]);
    sink_results.push_back(k);
  }
  Scatter scatter{.images = images, .origins = std::vector<Origin>(images.size()), .turnstile = {}};

  Size domain;
  domain.w = op.attrs.dims[0].evaluate(context.symbols).value();
  domain.h = op.attrs.dims[1].evaluate(context.symbols).value();
  domain.l = op.attrs.dims[2].evaluate(context.symbols).value();
  const size_t count = domain.count();
  const size_t tasks = (count + kBatch - 1) / kBatch;

  std::vector<RegionRunner> runners;
  for (size_t k = 0; k < workers.count(); ++k) runners.emplace_back(context);
  std::vector<std::vector<Origin>> found(context.tracing() ? tasks : 0, std::vector<Origin>(results.size()));
  std::vector<Origin> first(found.size());
  const auto evaluate = [&](size_t task, size_t worker) {
    RegionRunner& runner = runners[worker];
    const size_t begin = task * kBatch, n = std::min(kBatch, count - begin);
    const Places places = places_of_range(domain, begin, n);
    ScatterLog log(scatter, task);
    runner.set_log(&log);
    Frame frame = runner.outermost(plan, places);
    runner.run(frame);
    for (size_t k = 0; k < results.size(); ++k) {
      if (op.attrs.yields[k] == Yield::Scatter) continue;
      DR_ASSERT(size_of(*results[k]) == domain);
      const Lanes& value = runner.get(frame, plan.ops[0].results[k]);
      for (size_t c = 0; c < components(results[k]->type); ++c) {
        double* out = results[k]->data.data() + c * count + begin;
        if (value.n == n) {
          std::copy_n(value.data + c * n, n, out);
        } else {
          std::fill_n(out, n, value.data[c]);
        }
      }
      if (context.tracing()) found[task][k] = value.origin;
    }
    if (context.tracing()) first[task] = runner.take_first();
    runner.clear(frame);
    log.finish();
  };
  workers.run(tasks, [&](size_t task, size_t worker) {
    try {
      evaluate(task, worker);
    } catch (...) {
      scatter.turnstile.give_up();
      throw;
    }
  });

  for (const std::vector<Origin>& task : found) {
    for (size_t k = 0; k < results.size(); ++k) {
      if (!origins[k].valid()) origins[k] = task[k];
    }
  }
  const auto earliest = std::find_if(first.begin(), first.end(), [](const Origin& origin) { return origin.valid(); });
  Origin made = earliest != first.end() ? *earliest : Origin{};
  for (size_t s = 0; s < sink_results.size(); ++s) {
    if (context.float32 && images[s]->type.is_float()) round_to_float(images[s]->data.data(), images[s]->data.size());
    Origin& origin = origins[sink_results[s]];
    origin = scatter.origins[s];
    // Finite values may add up to Inf.
    if (!context.tracing() || origin.valid()) continue;
    const Size size = size_of(*images[s]);
    const size_t bad = first_not_finite(images[s]->data.data(), components(images[s]->type), size.count());
    if (bad == size.count()) continue;
    const Places place = places_of_range(size, bad, 1);
    origin = {.op = context.graph.value(op.results[0]).op, .x = place.x[0], .y = place.y[0], .l = place.l[0]};
    if (!made.valid()) made = origin;
  }
  return made;
}

}  // namespace dr::reference
