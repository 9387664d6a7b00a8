// SPDX-License-Identifier: Apache-2.0
#include "tests/gradient/ops/subject.h"

#include <algorithm>

#include "tests/catch.h"
#include "tests/gradient/check.h"

namespace dr::gradient_test {

namespace {

bool is_float(Type type) { return type.is_float(); }

// The inner product at each element.
ValueId product(Builder& b, ValueId x, ValueId y) {
  const Type type = b.value(x).type;
  if (!type.is_matrix()) return type.is_scalar() ? ops::mul(b, x, y) : ops::emit(b, OpKind::Dot, {x, y});
  ValueId sum = product(b, ops::extract(b, x, 0), ops::extract(b, y, 0));
  for (int k = 1; k < type.cols; ++k) sum = ops::add(b, sum, product(b, ops::extract(b, x, k), ops::extract(b, y, k)));
  return sum;
}

}  // namespace

std::vector<Form> float_forms(OpKind kind) {
  std::vector<Form> result;
  for (Form& form : ops_test::forms(kind)) {
    if (is_float(form.result) && std::any_of(form.operands.begin(), form.operands.end(), is_float))
      result.push_back(std::move(form));
  }
  return result;
}

Subject::Subject(OpKind kind, const Form& form, size_t elements) : elements_(elements) {
  Builder b;
  const Extent extent{static_cast<int64_t>(elements), 1, 1};
  const auto memory = [&](const std::string& name, Type type, std::vector<Place>& places) {
    data_.emplace(name, reference::zeros(type, static_cast<int64_t>(elements), 1, 1));
    for (int c = 0; c < type.components(); ++c) places.push_back({.leaf = name, .component = c});
    return leaf(b, name, type, extent);
  };
  std::vector<ValueId> xs, targets;
  for (size_t k = 0; k < form.operands.size(); ++k) {
    const Type type = form.operands[k];
    xs.push_back(memory("x" + std::to_string(k), type, is_float(type) ? operands_ : conditions_));
    if (is_float(type)) targets.push_back(xs.back());
  }
  const ValueId w = memory("w", form.result, weights_);
  const ValueId y = ops::emit(b, kind, xs, form.attrs);
  add_step(b.graph(), "value", {{"0", product(b, y, w)}});

  const auto outputs = [](const std::vector<ValueId>& values) {
    std::vector<std::pair<std::string, ValueId>> named;
    for (size_t k = 0; k < values.size(); ++k) named.emplace_back(std::to_string(k), values[k]);
    return named;
  };
  const std::vector<ValueId> first = grad(b, y, w, targets);
  add_step(b.graph(), "gradient", outputs(first));

  ValueId slope;
  for (size_t k = 0; k < first.size(); ++k) {
    const ValueId term = product(b, first[k], memory("d" + std::to_string(k), b.value(first[k]).type, directions_));
    slope = slope.valid() ? ops::add(b, slope, term) : term;
  }
  add_step(b.graph(), "slope", {{"0", slope}});
  targets.push_back(w);
  add_step(b.graph(), "second", outputs(grad(b, slope, ops::constant(b, ir::kFloat, 1.0), targets)));

  graph_ = differentiated(b.graph());
  session_ = std::make_unique<reference::Session>(graph_);
}

std::vector<double> Subject::get(const Place& place) const {
  const auto& data = data_.at(place.leaf).data;
  const auto begin = data.begin() + static_cast<std::ptrdiff_t>(static_cast<size_t>(place.component) * elements_);
  return {begin, begin + static_cast<std::ptrdiff_t>(elements_)};
}

void Subject::set(const Place& place, const std::vector<double>& values) {
  auto& data = data_.at(place.leaf).data;
  std::copy(values.begin(), values.end(),
            data.begin() + static_cast<std::ptrdiff_t>(static_cast<size_t>(place.component) * elements_));
}

std::vector<reference::Image> Subject::run(const std::string& step) {
  bind_leaves(*session_, data_);
  std::map<std::string, reference::Image> results = gradient_test::run(*session_, step);
  std::vector<reference::Image> images;
  for (size_t k = 0; k < results.size(); ++k) images.push_back(std::move(results.at(std::to_string(k))));
  return images;
}

namespace {

// The planes of images, one behind the other.
std::vector<std::vector<double>> planes(const std::vector<reference::Image>& images, size_t elements) {
  std::vector<std::vector<double>> result;
  for (const reference::Image& image : images) {
    for (size_t at = 0; at < image.data.size(); at += elements) {
      result.emplace_back(image.data.begin() + static_cast<std::ptrdiff_t>(at),
                          image.data.begin() + static_cast<std::ptrdiff_t>(at + elements));
    }
  }
  return result;
}

}  // namespace

std::vector<double> Subject::value() { return run("value")[0].data; }
std::vector<std::vector<double>> Subject::gradient() { return planes(run("gradient"), elements_); }
std::vector<double> Subject::slope() { return run("slope")[0].data; }
std::vector<std::vector<double>> Subject::second() { return planes(run("second"), elements_); }

}  // namespace dr::gradient_test
