// SPDX-License-Identifier: Apache-2.0
// Random programs, differentially: the evaluator in float64 against itself with every result rounded to float32, and
// against devices, where ways to compile (fused, naive, ablations, lowerings) must give the same bits. Half of them
// compute with small whole numbers, exactly, and must agree in all bits; half are smooth with gradients inside.
// DR_STRESS_EVALUATOR and DR_STRESS_DEVICE set how many programs run, DR_SEED the first seed.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "compiler/backend/compile.h"
#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/passes/passes.h"
#include "tests/catch.h"
#include "tests/device/devices.h"
#include "tests/gradient/random_graph.h"
#include "tests/unit/passes/random_graph.h"

using namespace dr;
using gradient_test::Images;
using io::Array;
using reference::Image;
using test::must;

namespace {

// An error is of rounding as long as it is below so much of the largest number of its result.
constexpr double kTolerance = 1e-5;
// Where two numbers that a program compares differ by rounding alone, float32 may decide otherwise than float64. So
// many smooth programs of a thousand may differ by more.
constexpr double kDecided = 4;

struct Problem {
  ir::Graph graph;  // one step, "run"
  Images data;
  bool exact = false;
};

uint64_t number(const char* name, uint64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::strtoull(text, nullptr, 10) : otherwise;
}

int64_t constant(const ir::Dim& dim) { return *dim.evaluate({}); }

Problem whole_numbers(uint64_t seed) {
  Problem p{passes_test::random_graph(seed), {}, true};
  std::mt19937_64 random(seed);
  for (const ir::Leaf& leaf : p.graph.leaves) {
    Image image =
        reference::zeros(leaf.type, constant(leaf.extent.w), constant(leaf.extent.h), constant(leaf.extent.l));
    for (double& x : image.data)
      x = leaf.type.is_bool() ? static_cast<double>(random() % 2) : static_cast<double>(random() % 7) - 2;
    p.data.emplace(leaf.name, std::move(image));
  }
  return p;
}

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
  const auto leaf = [&](const char* name, int width, int height) {
    const ir::Extent extent{width, height, 1};
    b.graph().leaves.push_back({ir::Leaf::Kind::Param, name, ir::kFloat, extent, {}, {}});
    made.data.emplace(name, made.random.image(ir::kFloat, extent, -1.5, 1.5));
    ir::Attrs attrs;
    attrs.text = name;
    return ops::emit(b, ir::OpKind::Leaf, {}, std::move(attrs));
  };
  const ir::ValueId left = leaf("left", depth, h), right = leaf("right", w, depth);
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

Problem smooth(uint64_t seed) {
  auto made = gradient_test::random_graph(seed, {.ops = 6, .steps = 4});
  const ir::Type type = made.builder.value(made.y).type;
  const ir::ValueId w = ops::constant(made.builder, type, 1.0);
  const auto adjoints = gradient_test::grad(made.builder, made.y, w, made.params);
  Outputs outputs{{"y", made.y}};
  for (size_t k = 0; k < adjoints.size(); ++k) outputs.emplace_back("d" + std::to_string(k), adjoints[k]);
  add_jvp(made, adjoints, outputs);
  add_contraction(made, outputs);
  gradient_test::add_step(made.builder.graph(), "run", outputs);
  Problem p{std::move(made.builder).finish(), std::move(made.data), false};
  for (auto& [name, image] : p.data)
    for (double& x : image.data) x = static_cast<double>(static_cast<float>(x));
  return p;
}

Problem problem(uint64_t seed) {
  Problem p = seed % 2 == 0 ? whole_numbers(seed) : smooth(seed);
  p.graph = passes::run_passes(p.graph, passes::default_passes(), {.verify_each = false, .after = {}});
  return p;
}

Images evaluate(const Problem& p, bool float32) {
  reference::Session session(p.graph);
  gradient_test::bind_leaves(session, p.data);
  reference::Options options;
  options.float32 = float32;
  options.threads = 1;
  auto result = session.run("run", options);
  if (const auto* error = std::get_if<reference::EvalError>(&result)) FAIL(error->message);
  return std::move(std::get<reference::StepResult>(result).outputs);
}

// The largest difference of the outputs, each in units of its largest number or of 1; infinite where one is NaN or Inf
// and the other not, or where integers or bools differ.
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

// What came of many programs.
struct Tally {
  std::vector<double> smooth;
  uint64_t exact = 0;
  std::vector<uint64_t> beyond;  // seeds
  void add(uint64_t seed, const Problem& p, double found) {
    if (p.exact) {
      ++exact;
      CHECK(found == 0);
    } else {
      CHECK(std::isfinite(found));
      smooth.push_back(found);
      if (found > kTolerance) beyond.push_back(seed);
    }
  }
  void report(const char* what) {
    std::sort(smooth.begin(), smooth.end());
    const auto share = [&](double p) {
      return smooth[static_cast<size_t>(p * static_cast<double>(smooth.size() - 1))];
    };
    std::printf("%-24s %llu programs agree exactly; %zu smooth ones: median %.1e, 99%% %.1e, worst %.1e, %zu beyond %g",
                what, static_cast<unsigned long long>(exact), smooth.size(), share(0.5), share(0.99), share(1),
                beyond.size(), kTolerance);
    for (const uint64_t seed : beyond) std::printf(" %llu", static_cast<unsigned long long>(seed));
    std::printf("\n");
    CHECK(static_cast<double>(beyond.size()) <= std::ceil(kDecided * 1e-3 * static_cast<double>(smooth.size())));
    CHECK(share(0.5) > 0);  // float32 is not float64
  }
};

Array array_of(const Image& image) {
  const auto n = static_cast<size_t>(image.count()), components = static_cast<size_t>(image.type.components());
  std::vector<double> values(image.data.size());
  for (size_t c = 0; c < components; ++c)
    for (size_t i = 0; i < n; ++i) values[i * components + c] = image.data[c * n + i];
  return Array::from_doubles(values, image.type.components(), image.width, image.height, image.layers);
}

Images run_on(const runtime::Device& device, const Problem& p, const target::Profile& profile, const Images& like,
              const std::string& lower, const std::string& pack, const std::vector<std::string>& ablate) {
  auto options = backend::compile_options(lower, lower == "fragment" ? "hardware" : "compute", pack, ablate);
  auto& chosen = std::get<backend::CompileOptions>(options);
  auto compiled = backend::compile(p.graph, profile, chosen);
  if (const auto* problem = std::get_if<backend::Limit>(&compiled)) FAIL(problem->text);
  auto program = must(runtime::Program::load(device, bundle::write(std::get<backend::Compiled>(compiled).bundle)));
  for (const auto& leaf : program.leaves()) must(program.bind(leaf.name, array_of(p.data.at(leaf.name))));
  must(program.run("run"));
  Images out;
  for (const auto& [name, expected] : like) {
    const std::vector<double> found = must(program.output("run", name)).to_doubles();
    Image image = expected;
    const auto n = static_cast<size_t>(image.count()), components = static_cast<size_t>(image.type.components());
    REQUIRE(found.size() == image.data.size());
    for (size_t c = 0; c < components; ++c)
      for (size_t i = 0; i < n; ++i) image.data[c * n + i] = found[i * components + c];
    out.emplace(name, std::move(image));
  }
  return out;
}

struct Way {
  const char *lower, *pack;
  std::vector<std::string> ablate;
};

}  // namespace

TEST_CASE("the evaluator in float32 is near itself in float64") {
  const uint64_t first = number("DR_SEED", 1), count = number("DR_STRESS_EVALUATOR", 1000);
  Tally tally;
  for (uint64_t seed = first; seed < first + count; ++seed) {
    INFO("DR_SEED=" << seed);
    const Problem p = problem(seed);
    const Images exact = evaluate(p, false);
    tally.add(seed, p, distance(evaluate(p, true), exact));
    if (p.exact) continue;
    const double product = exact.at("product").data[0], changes = exact.at("changes").data[0];
    CHECK(std::abs(product - changes) <= 1e-12 * std::max(1.0, std::abs(product)));
  }
  if (count > 1) tally.report("float32 evaluator");
}

TEST_CASE("devices are near the evaluator, and every way to compile gives the same bits") {
  const uint64_t first = number("DR_SEED", 1), count = number("DR_STRESS_DEVICE", 12);
  const std::vector<Way> ways = {
      {"fragment", "fused", {}},        {"compute", "naive", {}},  {"fragment", "fused", {"substages", "remat"}},
      {"compute", "fused", {"stages"}}, {"fragment", "naive", {}}, {"compute", "fused", {"cache", "remat"}}};
  for (const test::NamedDevice& device : test::devices()) {
    const auto loaded = target::load_profile(device.name);
    const auto& profile = std::get<target::Profile>(loaded);
    Tally tally;
    for (uint64_t seed = first; seed < first + count; ++seed) {
      INFO("DR_SEED=" << seed << " on " << device.name);
      const Problem p = problem(seed);
      const Images expected = evaluate(p, false);
      const Images found = run_on(device.device, p, profile, expected, "compute", "fused", {});
      tally.add(seed, p, distance(found, expected));
      const Way& way = p.exact ? ways[(seed / 2) % ways.size()] : ways[seed % 4 == 1 ? 0 : 3];
      INFO(way.lower << " " << way.pack << " " << (way.ablate.empty() ? "" : way.ablate[0]));
      const Images other = run_on(device.device, p, profile, expected, way.lower, way.pack, way.ablate);
      CHECK(distance(other, found) == 0);
    }
    for (const std::string& message : device.device.validation_messages()) FAIL("validation: " << message);
    if (count > 1) tally.report(device.name.c_str());
  }
}
