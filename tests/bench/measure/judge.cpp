// SPDX-License-Identifier: Apache-2.0
// Points for another judge of the float64 evaluator (tests/bench/judge.py): operands and what it says of them.
//
//   bench_judge OUT COUNT
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "compiler/ops/emit.h"
#include "compiler/passes/passes.h"
#include "tests/device/accuracy/batch.h"
#include "tests/device/accuracy/samples.h"
#include "tests/gradient/build.h"
#include "tests/must.h"

using namespace dr;
using namespace dr::accuracy;
using ir::ValueId;

namespace {

constexpr size_t kBatch = BatchGraph::kBatch;

// For each case and direction a share of `count`: operands of the case's domain and special ones, and the result.
int points(const std::string& file, size_t count) {
  std::ofstream out(file);
  if (!out) benchmark::stop("cannot write '" + file + "'");
  const std::vector<Case> cases = number_cases();
  size_t directions = 0;
  for (const Case& c : cases) directions += 1 + c.derivatives.size();
  for (const Case& c : cases) {
    const Samples samples = draw(c, static_cast<int64_t>(count / directions), 7);
    ir::Builder b;
    Values xs;
    for (size_t k = 0; k < c.operands.size(); ++k)
      xs.push_back(gradient_test::leaf(b, "x" + std::to_string(k), ir::kFloat, {ir::Dim(8), 1, 1}));
    std::vector<std::pair<std::string, ValueId>> results{{"value", c.build(b, xs)}};
    std::vector<ValueId> targets;
    for (const Derivative& d : c.derivatives) targets.push_back(xs[d.operand]);
    if (!targets.empty()) {
      const auto found = gradient_test::grad(b, results[0].second, ops::constant(b, ir::kFloat, 1.0), targets);
      for (size_t k = 0; k < found.size(); ++k)
        results.emplace_back("d/dx" + std::to_string(c.derivatives[k].operand + 1), found[k]);
    }
    gradient_test::add_step(b.graph(), "go", results);
    const ir::Graph graph = passes::run_passes(std::move(b).finish(), passes::default_passes());
    BatchGraph batch(graph);
    const auto n = static_cast<size_t>(samples.operands[0].count());
    for (size_t begin = 0; begin < n; begin += kBatch) {
      const size_t here = std::min(kBatch, n - begin);
      for (size_t k = 0; k < xs.size(); ++k)
        if (double* leaf = batch.leaf("x" + std::to_string(k)))
          std::copy_n(samples.operands[k].data.data() + begin, here, leaf);
      batch.run(here);
      for (size_t i = 0; i < here; ++i)
        for (const auto& [direction, value] : results) {
          char text[64];
          out << c.name << "\t" << direction;
          for (const reference::Image& operand : samples.operands) {
            std::snprintf(text, sizeof text, "\t%a", operand.data[begin + i]);
            out << text;
          }
          std::snprintf(text, sizeof text, "\t%a\n", batch.result(batch.output(direction))[i]);
          out << text;
        }
    }
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 3 && std::atoll(argv[2]) > 0) return points(argv[1], static_cast<size_t>(std::atoll(argv[2])));
  std::fputs("usage: bench_judge OUT COUNT\n", stderr);
  return 2;
}
