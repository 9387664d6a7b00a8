// SPDX-License-Identifier: Apache-2.0
// Random graphs: <J v, w> by forward mode (dual.h) must equal <v, J^T w> by the pass `differentiate`. The graphs have
// gradients inside, so higher derivatives are covered, and regions in regions. The reverse mode runs twice: by that
// pass alone, and between two rounds of `simplify` as programs have it. A failure prints the seed; DR_SEED=n runs that
// one graph.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "compiler/passes/passes.h"
#include "tests/catch.h"
#include "tests/gradient/check.h"
#include "tests/gradient/dual.h"
#include "tests/gradient/random_graph.h"

using namespace dr::gradient_test;

namespace {

constexpr int kGraphs = 1000;
constexpr double kTolerance = 1e-12;

// Components of an image of numbers, in the order of Image::data.
template <class Get>
std::vector<double> components(const DualImage& image, const Get& get) {
  std::vector<double> out;
  for (size_t c = 0; c < image.elements[0].size(); ++c) {
    for (const Element& e : image.elements) out.push_back(get(e[c]));
  }
  return out;
}

// What `check` gives after the pass `differentiate`, alone or as part of the pipeline.
Images run_backward(const Graph& differentiated, const Images& data) {
  dr::reference::Session session(differentiated);
  bind_leaves(session, data);
  return run(session, "check");
}

Graph pipeline(const Graph& graph) { return dr::passes::run_passes(graph, dr::passes::default_passes()); }

size_t check_graph(uint64_t seed) {
  RandomGraph generator = random_graph(seed);
  Builder& b = generator.builder;
  const size_t ops = b.graph().op_count();
  const dr::ir::ValueInfo info = b.value(generator.y);
  const Extent seed_extent = generator.random.chance(0.5) ? Extent{} : info.extent;
  const ValueId w = leaf(b, "w", info.type, seed_extent);
  const std::vector<ValueId> adjoints = grad(b, generator.y, w, generator.params);
  std::vector<std::pair<std::string, ValueId>> outputs{{"y", generator.y}};
  for (size_t k = 0; k < adjoints.size(); ++k) outputs.emplace_back(leaf_name(k), adjoints[k]);
  Graph before = b.graph();
  add_step(before, "check", outputs);
  const Graph graph = differentiated(before);

  Images data = generator.data;
  data.emplace("w", generator.random.image(info.type, seed_extent, 0.5, 1.5));
  std::map<std::string, LeafData> leaves;
  for (const auto& [name, image] : data) {
    const Extent extent{image.width, image.height, image.layers};
    leaves[name] = {image, name == "w" ? Image{} : generator.random.image(image.type, extent, -1, 1)};
  }
  const std::vector<DualImage> forward = evaluate_dual(graph, leaves);
  const DualImage& y = forward[graph.steps[0].outputs[0].value.index];
  const std::vector<double> values = components(y, [](Number n) { return n.value; });
  const std::vector<double> tangents = components(y, [](Number n) { return n.tangent; });
  const std::vector<double>& weights = data.at("w").data;

  for (const bool simplified : {false, true}) {
    INFO((simplified ? "simplified" : "differentiated only"));
    const Images backward = run_backward(simplified ? pipeline(before) : graph, data);

    // The two evaluators agree on the values.
    double difference = 0, largest = 1;
    for (size_t k = 0; k < values.size(); ++k) {
      difference = std::max(difference, std::abs(values[k] - backward.at("y").data[k]));
      largest = std::max(largest, std::abs(values[k]));
    }
    CHECK(difference <= kTolerance * largest);

    double left = 0, right = 0, terms = 0;
    const auto accumulate = [&](double& sum, double term) {
      sum += term;
      terms += std::abs(term);
    };
    for (size_t k = 0; k < tangents.size(); ++k) accumulate(left, tangents[k] * weights[weights.size() == 1 ? 0 : k]);
    for (size_t k = 0; k < adjoints.size(); ++k) {
      const std::string name = leaf_name(k);
      const std::vector<double>& adjoint = backward.at(name).data;
      for (size_t i = 0; i < adjoint.size(); ++i) accumulate(right, adjoint[i] * leaves.at(name).tangent.data[i]);
    }
    INFO("<J v, w> = " << left << ", <v, J^T w> = " << right << ", sum of the terms' sizes " << terms);
    CHECK(std::abs(left - right) <= kTolerance * std::max(terms, 1e-3));
  }
  return ops;
}

}  // namespace

TEST_CASE("forward and reverse mode agree on random graphs") {
  const char* only = std::getenv("DR_SEED");
  const uint64_t first = only != nullptr ? std::strtoull(only, nullptr, 10) : 1;
  const uint64_t count = only != nullptr ? 1 : kGraphs;
  size_t ops = 0;
  for (uint64_t seed = first; seed < first + count; ++seed) {
    INFO("DR_SEED=" << seed);
    ops += check_graph(seed);
  }
  std::printf("%zu graphs of %zu ops in the mean\n", static_cast<size_t>(count), ops / count);
}
