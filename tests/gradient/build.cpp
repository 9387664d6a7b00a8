// SPDX-License-Identifier: Apache-2.0
#include "tests/gradient/build.h"

#include <stdexcept>

namespace dr::gradient_test {

ValueId leaf(Builder& b, const std::string& name, Type type, const Extent& extent) {
  ir::Leaf memory;
  memory.kind = type.is_float() ? ir::Leaf::Kind::Param : ir::Leaf::Kind::Input;
  memory.name = name;
  memory.type = type;
  memory.extent = extent;
  b.graph().leaves.push_back(std::move(memory));
  const ir::ResultType result{.type = type, .extent = extent};
  ir::Attrs attrs;
  attrs.text = name;
  const ir::OpId op = b.add(OpKind::Leaf, {}, {&result, 1}, std::move(attrs));
  return b.graph().op(op).results[0];
}

namespace {

ir::Attrs region_attrs(const Extent& domain, std::vector<Yield> yields, const std::vector<Extent>& images) {
  ir::Attrs attrs = dims(domain);
  attrs.yields = std::move(yields);
  for (const Extent& e : images) attrs.dims.insert(attrs.dims.end(), {e.w, e.h, e.l});
  return attrs;
}

}  // namespace

std::vector<ValueId> make_if(Builder& b, ValueId condition, const Extent& domain, std::vector<Yield> yields,
                             const Body& then_body, const Body& else_body, const std::vector<Extent>& images) {
  const RegionId then_region = b.begin_region({});
  b.end_region(then_body());
  const RegionId else_region = b.begin_region({});
  b.end_region(else_body());
  return ops::emit_multi(b, OpKind::If, {condition}, region_attrs(domain, std::move(yields), images),
                         {then_region, else_region});
}

std::vector<ValueId> make_reduce(Builder& b, ValueId begin, ValueId end, const Extent& domain,
                                 std::vector<Yield> yields, const TripBody& body, const std::vector<Extent>& images) {
  const ir::ResultType trip{.type = ir::kInt, .extent = {}};
  const RegionId region = b.begin_region({&trip, 1});
  b.end_region(body(b.graph().region(region).params[0]));
  ir::Attrs attrs = region_attrs(domain, std::move(yields), images);
  attrs.ints = {-1};
  return ops::emit_multi(b, OpKind::Reduce, {begin, end}, std::move(attrs), {region});
}

std::vector<ValueId> make_fold(Builder& b, ValueId begin, ValueId end, const Extent& domain,
                               const std::vector<ValueId>& starts, const FoldBody& body, int64_t bound,
                               const std::vector<Extent>& images) {
  std::vector<ir::ResultType> params{{.type = ir::kInt, .extent = {}}};
  std::vector<ValueId> operands{begin, end};
  for (const ValueId start : starts) {
    params.push_back({.type = b.value(start).type, .extent = domain});
    operands.push_back(start);
  }
  const RegionId region = b.begin_region(params);
  const std::vector<ValueId> given = b.graph().region(region).params;
  const Trip trip = body(given[0], {given.begin() + 1, given.end()});
  std::vector<ValueId> yields = trip.next;
  yields.insert(yields.end(), trip.scattered.begin(), trip.scattered.end());
  if (trip.stop.valid()) yields.insert(yields.begin(), trip.stop);
  b.end_region(std::move(yields));
  ir::Attrs attrs = region_attrs(domain, std::vector(starts.size(), Yield::Element), images);
  attrs.yields.resize(starts.size() + images.size(), Yield::Scatter);
  attrs.ints = {bound, trip.stop.valid() ? 1 : 0, static_cast<int64_t>(starts.size())};
  return ops::emit_multi(b, OpKind::Fold, std::move(operands), std::move(attrs), {region});
}

namespace {

// The columns of a matrix; anything else is its own column.
std::vector<ValueId> columns(Builder& b, ValueId x) {
  const Type type = b.value(x).type;
  if (!type.is_matrix()) return {x};
  std::vector<ValueId> parts;
  for (int k = 0; k < type.cols; ++k) parts.push_back(ops::extract(b, x, k));
  return parts;
}

}  // namespace

ValueId inner(Builder& b, ValueId x, ValueId y) {
  const std::vector<ValueId> xs = columns(b, x), ys = columns(b, y);
  ValueId sum = ops::constant(b, ir::kFloat, 0.0);
  for (size_t k = 0; k < xs.size(); ++k) {
    const bool scalar = b.value(xs[k]).type.is_scalar();
    sum = ops::add(b, sum, scalar ? ops::mul(b, xs[k], ys[k]) : ops::emit(b, OpKind::Dot, {xs[k], ys[k]}));
  }
  return ops::emit(b, OpKind::ReduceSum, {sum}, ints({1, 1, 1}));
}

ValueId total(Builder& b, ValueId x) { return inner(b, x, ops::constant(b, b.value(x).type, 1.0)); }

std::vector<ValueId> grad(Builder& b, ValueId y, ValueId seed, const std::vector<ValueId>& xs) {
  std::vector<ValueId> operands{y, seed};
  operands.insert(operands.end(), xs.begin(), xs.end());
  return ops::emit_multi(b, OpKind::Grad, operands);
}

ValueId jvp(Builder& b, ValueId y, ValueId x, ValueId along) {
  const ir::ValueInfo info = b.value(y);  // a copy: emitting moves values
  const ValueId seed = ops::broadcast(b, ops::constant(b, info.type, 1.0), info.extent);
  const ValueId product = inner(b, grad(b, y, seed, {x})[0], along);
  return grad(b, product, ops::constant(b, ir::kFloat, 1.0), {seed})[0];
}

void add_step(Graph& graph, const std::string& name, const std::vector<std::pair<std::string, ValueId>>& outputs) {
  ir::Step step;
  step.name = name;
  for (const auto& [output, value] : outputs) step.outputs.push_back({output, value});
  graph.steps.push_back(std::move(step));
}

Image Random::image(Type type, const Extent& extent, double low, double high) {
  Image image = reference::zeros(type, extent.w.constant(), extent.h.constant(), extent.l.constant());
  for (double& x : image.data) x = real(low, high);
  return image;
}

Images run(reference::Session& session, const std::string& step) {
  auto result = session.run(step);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) throw std::runtime_error(error->message);
  return std::get<reference::StepResult>(std::move(result)).outputs;
}

void bind_leaves(reference::Session& session, const Images& leaves) {
  for (const auto& [name, image] : leaves) {
    if (const auto error = session.bind(name, image)) throw std::runtime_error(*error);
  }
}

}  // namespace dr::gradient_test
