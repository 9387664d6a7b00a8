// SPDX-License-Identifier: Apache-2.0
#include "tests/gradient/check.h"

#include <algorithm>
#include <cmath>

#include "compiler/passes/passes.h"
#include "tests/catch.h"

namespace dr::gradient_test {

namespace {

// The derivative of a function of one number: central differences at three distances, the error terms of second and
// fourth order removed.
template <class F>
double slope(const F& f) {
  constexpr double kStep = 0.02;
  const auto central = [&](double h) { return (f(h) - f(-h)) / (2 * h); };
  const double far = central(kStep), middle = central(kStep / 2), near = central(kStep / 4);
  const double coarse = (4 * middle - far) / 3, fine = (4 * near - middle) / 3;
  return (16 * fine - coarse) / 15;
}

// `step` gives "value", a float, and "adjoint" with a leaf's name behind it for each of these leaves.
void check_step(const Graph& graph, const Images& data, const std::string& step, const std::vector<std::string>& leaves,
                double tolerance) {
  reference::Session session(graph);
  bind_leaves(session, data);
  const Images exact = run(session, step);
  for (const std::string& name : leaves) {
    Image x = data.at(name);
    const Image& adjoint = exact.at("adjoint " + name);
    REQUIRE(adjoint.data.size() == x.data.size());
    double scale = 1;
    for (const double a : adjoint.data) scale = std::max(scale, std::abs(a));
    for (size_t k = 0; k < x.data.size(); ++k) {
      const double at = x.data[k];
      const double expected = slope([&](double h) {
        x.data[k] = at + h;
        bind_leaves(session, {{name, x}});
        return run(session, step + " value").at("value").data[0];
      });
      x.data[k] = at;
      INFO(step << ": component " << k << " of " << name);
      CHECK(std::abs(adjoint.data[k] - expected) <= tolerance * scale);
    }
    bind_leaves(session, {{name, x}});
  }
}

const std::string& text_of_leaf(const Graph& graph, ValueId leaf) { return graph.op(graph.value(leaf).op).attrs.text; }

}  // namespace

ValueId Problem::param(const std::string& name, Type type, const Extent& extent, double low, double high) {
  params.push_back(leaf(b, name, type, extent));
  data.emplace(name, random.image(type, extent, low, high));
  return params.back();
}

ValueId Problem::input(const std::string& name, Type type, const Extent& extent, std::vector<double> components) {
  Image image = reference::zeros(type, extent.w.constant(), extent.h.constant(), extent.l.constant());
  REQUIRE(image.data.size() == components.size());
  image.data = std::move(components);
  data.emplace(name, std::move(image));
  return leaf(b, name, type, extent);
}

Graph differentiated(const Graph& graph) {
  CHECK(passes::verify(graph).empty());
  Graph result = passes::differentiate(graph);
  const std::vector<std::string> violations = passes::verify(result);
  for (const std::string& violation : violations) UNSCOPED_INFO(violation);
  CHECK(violations.empty());
  return result;
}

void check_gradients(Problem problem, ValueId y, const CheckOptions& options) {
  Builder& b = problem.b;
  const ir::ValueInfo info = b.value(y);
  const ValueId w = leaf(b, "w", info.type, info.extent);
  problem.data.emplace("w", problem.random.image(info.type, info.extent, 0.5, 1.5));

  const std::vector<ValueId> adjoints = grad(b, y, w, problem.params);
  std::vector<std::pair<std::string, ValueId>> outputs;
  std::vector<std::string> names;
  for (size_t k = 0; k < adjoints.size(); ++k) {
    names.push_back(text_of_leaf(b.graph(), problem.params[k]));
    outputs.emplace_back("adjoint " + names.back(), adjoints[k]);
    CHECK(b.value(adjoints[k]).type == b.value(problem.params[k]).type);
    CHECK(b.value(adjoints[k]).extent == b.value(problem.params[k]).extent);
  }
  add_step(b.graph(), "first value", {{"value", inner(b, w, y)}});
  add_step(b.graph(), "first", outputs);
  if (options.second) {
    ValueId along = ops::constant(b, ir::kFloat, 0.0);
    for (size_t k = 0; k < adjoints.size(); ++k) {
      const ir::ValueInfo x = b.value(adjoints[k]);
      const std::string name = "direction " + names[k];
      problem.data.emplace(name, problem.random.image(x.type, x.extent, -1, 1));
      along = ops::add(b, along, inner(b, leaf(b, name, x.type, x.extent), adjoints[k]));
    }
    std::vector<ValueId> xs = problem.params;
    xs.push_back(w);
    const std::vector<ValueId> seconds = grad(b, along, ops::constant(b, ir::kFloat, 1.0), xs);
    outputs.clear();
    for (size_t k = 0; k < xs.size(); ++k)
      outputs.emplace_back("adjoint " + text_of_leaf(b.graph(), xs[k]), seconds[k]);
    add_step(b.graph(), "second value", {{"value", along}});
    add_step(b.graph(), "second", outputs);
  }

  const Graph graph = differentiated(b.graph());
  check_step(graph, problem.data, "first", names, options.tolerance);
  if (!options.second) return;
  names.push_back("w");
  check_step(graph, problem.data, "second", names, options.tolerance);
}

}  // namespace dr::gradient_test
