// SPDX-License-Identifier: Apache-2.0
#include "tests/stress/problem.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "compiler/backend/compile.h"
#include "compiler/passes/passes.h"
#include "tests/gradient/random_graph.h"
#include "tests/unit/passes/random_graph.h"

namespace dr::test {

using io::Array;
using reference::Image;

namespace {

using Outputs = std::vector<std::pair<std::string, ir::ValueId>>;

// How `y` changes as its params move by their cosines, and the gradient's product with the same direction: the same
// number.
void add_jvp(gradient_test::RandomGraph& made, const std::vector<ir::ValueId>& gradients, Outputs& outputs) {
  ir::Builder& b = made.builder;
  ir::ValueId product, changes;
  for (size_t k = 0; k < gradients.size(); ++k) {
    const ir::ValueId way = ops::emit(b, ir::OpKind::Cos, {made.params[k]});
    const ir::ValueId one = gradient_test::inner(b, gradients[k], way);
    const ir::ValueId other = gradient_test::total(b, gradient_test::jvp(b, made.y, made.params[k], way));
    product = product.valid() ? ops::add(b, product, one) : one;
    changes = changes.valid() ? ops::add(b, changes, other) : other;
  }
  outputs.insert(outputs.end(), {{"product", product}, {"changes", changes}});
}

// A matrix product of two leaves of random sizes, and its gradients.
void add_contraction(gradient_test::RandomGraph& made, Outputs& outputs) {
  ir::Builder& b = made.builder;
  const int w = 1 + made.random.integer(5), h = 1 + made.random.integer(5), depth = 1 + made.random.integer(20);
  const ir::ValueId left = gradient_test::leaf(b, "left", ir::kFloat, {depth, h, 1}),
                    right = gradient_test::leaf(b, "right", ir::kFloat, {w, depth, 1});
  const ir::Extent domain{w, h, 1};
  const ir::ValueId column = ops::coord(b, 0, domain), row = ops::coord(b, 1, domain);
  const ir::ValueId zero = ops::constant(b, ir::kInt, 0.0), end = ops::constant(b, ir::kInt, depth);
  const ir::ResultType trip{ir::kInt, domain};
  const ir::RegionId region = b.begin_region({&trip, 1});
  const ir::ValueId k = b.graph().region(region).params[0];
  const auto at = [&](ir::ValueId image, ir::ValueId x, ir::ValueId y) {
    const ir::ValueId place = ops::compose(b, {x, y, zero}, ir::vec(3, ir::Scalar::Int));
    return ops::emit(b, ir::OpKind::Gather, {image, place});
  };
  b.end_region({ops::mul(b, at(left, k, row), at(right, column, k))});
  ir::Attrs attrs{.dims = {domain.w, domain.h, domain.l}, .yields = {ir::Yield::Sum}};
  attrs.ints = {-1};
  const ir::ValueId matrix = ops::emit_multi(b, ir::OpKind::Reduce, {zero, end}, std::move(attrs), {region})[0];
  const ir::ValueId bent = gradient_test::total(b, ops::emit(b, ir::OpKind::Sin, {matrix}));
  const auto adjoints = gradient_test::grad(b, bent, ops::constant(b, ir::kFloat, 1.0), {left, right});
  outputs.insert(outputs.end(), {{"matrix", matrix}, {"to_left", adjoints[0]}, {"to_right", adjoints[1]}});
}

ir::Graph smooth(uint64_t seed, const Sizes& sizes) {
  auto made =
      gradient_test::random_graph(seed, {.ops = 6, .steps = 4, .sizes = sizes.images, .long_trips = sizes.trips});
  const ir::Type type = made.builder.value(made.y).type;
  const ir::ValueId w = ops::constant(made.builder, type, 1.0);
  const auto adjoints = gradient_test::grad(made.builder, made.y, w, made.params);
  Outputs outputs{{"y", made.y}};
  for (size_t k = 0; k < adjoints.size(); ++k) outputs.emplace_back("d" + std::to_string(k), adjoints[k]);
  if (sizes.trips == 0) add_jvp(made, adjoints, outputs);
  add_contraction(made, outputs);
  gradient_test::add_step(made.builder.graph(), "run", outputs);
  return std::move(made.builder).finish();
}

int64_t constant(const ir::Dim& dim) { return *dim.evaluate({}); }

// Of any platform, and of nothing but its arguments.
uint64_t mixed(uint64_t x) {
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

Array array_of(const Image& image) {
  const auto n = static_cast<size_t>(image.count()), components = static_cast<size_t>(image.type.components());
  std::vector<double> values(image.data.size());
  for (size_t c = 0; c < components; ++c)
    for (size_t i = 0; i < n; ++i) values[i * components + c] = image.data[c * n + i];
  return Array::from_doubles(values, image.type.components(), image.width, image.height, image.layers);
}

template <class T>
T value_of(io::Result<T> result) {
  if (!result) throw std::runtime_error(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

}  // namespace

Problem random_problem(uint64_t seed, const Sizes& sizes) {
  if (seed % 2 == 0) return {passes_test::random_graph(seed, sizes.images), seed, true};
  return {smooth(seed, sizes), seed, false};
}

ir::Graph lowered(const ir::Graph& graph) { return passes::run_passes(graph, passes::default_passes()); }

Images data_of(const Problem& problem) {
  Images data;
  for (const ir::Leaf& leaf : problem.graph.leaves) {
    Image image =
        reference::zeros(leaf.type, constant(leaf.extent.w), constant(leaf.extent.h), constant(leaf.extent.l));
    uint64_t name = mixed(problem.seed);
    for (const char c : leaf.name) name = mixed(name + static_cast<unsigned char>(c));
    for (size_t i = 0; i < image.data.size(); ++i) {
      const uint64_t bits = mixed(name + i + 1);
      double& x = image.data[i];
      if (leaf.type.is_bool())
        x = static_cast<double>(bits % 2);
      else if (problem.exact || !leaf.type.is_float())
        x = static_cast<double>(bits % 7) - 2;
      else
        x = static_cast<double>(static_cast<float>(3 * (static_cast<double>(bits >> 11) * 0x1p-53) - 1.5));
    }
    data.emplace(leaf.name, std::move(image));
  }
  return data;
}

Images evaluate(const Problem& problem, const ir::Graph& graph, bool float32, double moved) {
  Images data = data_of(problem);
  for (auto& [name, image] : data) {
    if (!image.type.is_float() || moved == 0) continue;
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] *= mixed(i + problem.seed) % 2 == 0 ? 1 + moved : 1 - moved;
  }
  reference::Session session(graph);
  gradient_test::bind_leaves(session, data);
  reference::Options options;
  options.float32 = float32;
  options.threads = 1;
  auto result = session.run("run", options);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) throw std::runtime_error(error->message);
  return std::move(std::get<reference::StepResult>(result).outputs);
}

std::string Way::str() const {
  std::string text = std::string(lower) + " " + pack + " scatter " + scatter;
  for (const std::string& part : ablate) text += " without " + part;
  return text;
}

Images run_on(const runtime::Device& device, const Problem& problem, const ir::Graph& graph,
              const target::Profile& profile, const Images& like, const Way& way) {
  const bool fragment = std::string_view(way.lower) == "fragment";
  auto options =
      backend::compile_options(way.lower, fragment ? "hardware" : "compute", way.pack, way.ablate, way.scatter);
  if (const auto* wrong = std::get_if<std::string>(&options)) throw std::runtime_error(*wrong);
  auto compiled = backend::compile(graph, profile, std::get<backend::CompileOptions>(options));
  if (const auto* limit = std::get_if<backend::Limit>(&compiled)) throw BeyondProfile(limit->text);
  auto loaded = runtime::Program::load(device, bundle::write(std::get<backend::Compiled>(compiled).bundle));
  // What depends on extents is told when data is there.
  const auto done = [](const auto& result) {
    if (result) return;
    if (result.error().find("the device allows") != std::string::npos) throw BeyondProfile(result.error());
    throw std::runtime_error(result.error());
  };
  done(loaded);
  runtime::Program program = std::move(loaded).value();
  const Images data = data_of(problem);
  for (const auto& leaf : program.leaves()) done(program.bind(leaf.name, array_of(data.at(leaf.name))));
  done(program.run("run"));
  Images out;
  for (const auto& [name, expected] : like) {
    const std::vector<double> found = value_of(program.output("run", name)).to_doubles();
    Image image = expected;
    const auto n = static_cast<size_t>(image.count()), components = static_cast<size_t>(image.type.components());
    if (found.size() != image.data.size()) throw std::runtime_error("an output has another size: " + name);
    for (size_t c = 0; c < components; ++c)
      for (size_t i = 0; i < n; ++i) image.data[c * n + i] = found[i * components + c];
    out.emplace(name, std::move(image));
  }
  return out;
}

double distance(const Images& found, const Images& expected) {
  double worst = 0;
  for (const auto& [name, image] : expected) {
    const Image& other = found.at(name);
    double size = 1, difference = 0;
    for (size_t i = 0; i < image.data.size(); ++i) {
      const double x = image.data[i], y = other.data[i];
      if (x == y || (std::isnan(x) && std::isnan(y))) continue;
      if (!image.type.is_float() || !std::isfinite(x) || !std::isfinite(y)) return HUGE_VAL;
      size = std::max(size, std::abs(x));
      difference = std::max(difference, std::abs(x - y));
    }
    worst = std::max(worst, difference / size);
  }
  return worst;
}

}  // namespace dr::test
