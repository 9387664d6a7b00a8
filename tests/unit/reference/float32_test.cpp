// SPDX-License-Identifier: Apache-2.0
// Rounding to float32: where it happens, and that programs stay as near to float64 as their ops promise.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "compiler/lower/lower.h"
#include "compiler/ops/op.h"
#include "compiler/passes/passes.h"
#include "tests/catch.h"
#include "tests/unit/reference/support.h"

namespace dr::reference_test {
namespace {

reference::Options rounded() {
  reference::Options options;
  options.float32 = true;
  return options;
}

double f32(double x) { return static_cast<double>(static_cast<float>(x)); }

TEST_CASE("leaves, constants, ops, sums and folds are rounded") {
  const std::string_view text = R"(
    leaf x : float[W] input
    %0 : float[W] = leaf text "x"
    %1 : float = const floats [0.1]
    %2 : float[W] = mul %0, %1
    %3 : float = reduce_sum %0 ints [1, 0, 0]
    %4 : int = const floats [0]
    %5 : int = dim dims [W]
    %6 : float = reduce %4, %5 ints [-1] dims [1, 1, 1] yields [sum] (%7 : int) {
      %8 : float = gather %0, %7
      yield %8
    }
    %9 : float[2] = scatter_add %4, %0 dims [2, 1, 1]
    step s {
      output leaf %0
      output constant %1
      output product %2
      output sum %3
      output folded %6
      output scattered %9
    })";
  const Numbers x{0.3, 1e8, -1e8};
  const Images out = run(parse(text), {{"x", row("float", x)}}, rounded());
  CHECK(out.at("leaf").data == Numbers{f32(0.3), 1e8, -1e8});
  CHECK(out.at("constant").data == Numbers{f32(0.1)});
  CHECK(out.at("product").data == Numbers{f32(f32(0.3) * f32(0.1)), f32(1e8 * f32(0.1)), f32(-1e8 * f32(0.1))});
  // What the small number adds to the large one is lost on the way, but for scatters, which are rounded at the end.
  CHECK(out.at("sum").data == Numbers{0});
  CHECK(out.at("folded").data == Numbers{0});
  CHECK(out.at("scattered").data == Numbers{f32(0.3), 0});
  CHECK(run(parse(text), {{"x", row("float", x)}}).at("product").data[0] == 0.3 * 0.1);
}

// Units in the last place that an output may be away, when each op adds its bound: along the longest chain of ops.
double bound_of(const ir::Graph& graph, ir::ValueId value) {
  std::vector<double> bounds(graph.value_count());
  for (uint32_t k = 0; k <= value.index; ++k) {
    const ir::ValueInfo& info = graph.value(ir::ValueId{k});
    if (!info.op.valid()) continue;
    const ir::Op& op = graph.op(info.op);
    double bound = 0;
    for (const ir::ValueId operand : op.operands) bound = std::max(bound, bounds[operand.index]);
    for (const ir::RegionId region : op.regions) {
      for (const ir::ValueId yield : graph.region(region).yields) bound = std::max(bound, bounds[yield.index]);
    }
    bounds[k] = bound + (info.type.is_float() ? ops::info(op.kind).ulp_bound : 0);
  }
  return bounds[value.index];
}

TEST_CASE("programs are as near to float64 as their ops promise") {
  const std::filesystem::path folder = std::filesystem::path(DR_SOURCE_DIR) / "tests/golden/programs";
  bool differs = false;
  for (const char* name : {"adam.dr", "sh_light_fit.dr", "deblur.dr", "texture_fit.dr"}) {
    std::ifstream file(folder / name);
    std::stringstream text;
    text << file.rdbuf();
    dsl::SourceManager sources;
    dsl::DiagnosticList diagnostics;
    const auto lowered = lower::lower(sources, sources.add(name, text.str()), {}, diagnostics);
    REQUIRE(lowered.has_value());
    const ir::Graph graph = passes::run_passes(*lowered, passes::default_passes());
    for (const ir::Step& step : graph.steps) {
      reference::Session exact(graph), single(graph);
      auto expected = exact.run(step.name), found = single.run(step.name, rounded());
      if (const auto* wrong = std::get_if<reference::EvalError>(&expected)) FAIL(name << ": " << wrong->message);
      for (const ir::Output& output : step.outputs) {
        const Image& a = std::get<reference::StepResult>(expected).outputs.at(output.name);
        const Image& b = std::get<reference::StepResult>(found).outputs.at(output.name);
        double size = 0, distance = 0;
        for (size_t i = 0; i < a.data.size(); ++i) {
          size = std::max(size, std::fabs(a.data[i]));
          distance = std::max(distance, std::fabs(a.data[i] - b.data[i]));
        }
        INFO(name << " " << step.name << "." << output.name);
        if (!a.type.is_float()) continue;
        differs |= distance > 0;
        CHECK(distance <= bound_of(graph, output.value) * std::ldexp(1.0, -24) * size);
      }
    }
  }
  CHECK(differs);
}

}  // namespace
}  // namespace dr::reference_test
