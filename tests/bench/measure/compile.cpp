// SPDX-License-Identifier: Apache-2.0
// What compiling costs before there is code: each pass over generated graphs of several sizes, and checking a generated
// program. Times are the process's own processor time, which other work on the machine changes least: the median and
// the smallest of several runs after a first one that does not count.
//
//   bench_compile FILE [RUNS]    a table on stdout, one JSON object a line in FILE
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "compiler/backend/pack/pack.h"
#include "compiler/lower/lower.h"
#include "compiler/passes/passes.h"
#include "compiler/target/profile.h"
#include "dsl/syntax/parser.h"
#include "tests/bench/measure/compile_input.h"

using namespace dr;

namespace {

double milliseconds_used() {
  timespec time;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return 1e3 * static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_nsec);
}

class Report {
 public:
  explicit Report(std::FILE* file) : file_(file) {}

  void heading(const char* title) { std::printf("\n%-34s %12s %12s\n", title, "median ms", "smallest ms"); }
  void row(const std::string& what, size_t size, std::vector<double> times) {
    std::sort(times.begin(), times.end());
    const double median = times[times.size() / 2];
    std::printf("%8zu  %-24s %12.2f %12.2f\n", size, what.c_str(), median, times[0]);
    std::fprintf(file_,
                 "{\"bench\": \"compile\", \"what\": \"%s\", \"size\": %zu, \"runs\": %zu, \"median_ms\": %.3f, "
                 "\"smallest_ms\": %.3f}\n",
                 what.c_str(), size, times.size(), median, times[0]);
    std::fflush(stdout);
  }

 private:
  std::FILE* file_;
};

// Adds the time that f takes to a row.
template <class F>
auto timed(std::vector<double>& times, const F& f) {
  const double start = milliseconds_used();
  auto result = f();
  times.push_back(milliseconds_used() - start);
  return result;
}

void measure_passes(Report& report, size_t ops, int runs) {
  const ir::Graph graph = bench::generated_graph(ops);
  const auto profile = std::get<target::Profile>(target::load_profile("lavapipe"));
  std::vector<double> verify, first, differentiate, second, all, pack;
  size_t simplified = 0, differentiated = 0, result = 0;
  for (int run = -1; run < runs; ++run) {
    if (run == 0) verify = first = differentiate = second = all = pack = {};
    timed(verify, [&] { return passes::verify(graph).size(); });
    const ir::Graph a = timed(first, [&] { return passes::simplify(graph); });
    const ir::Graph b = timed(differentiate, [&] { return passes::differentiate(a); });
    const ir::Graph c = timed(second, [&] { return passes::simplify(b); });
    all.push_back(first.back() + differentiate.back() + second.back());
    timed(pack, [&] { return backend::pack(c, profile, {}).steps[0].passes.size(); });
    simplified = a.op_count(), differentiated = b.op_count(), result = c.op_count();
  }
  const size_t size = graph.op_count();
  report.row("verify", size, verify);
  report.row("simplify", size, first);
  report.row("differentiate", size, differentiate);
  report.row("simplify again", size, second);
  report.row("the three passes", size, all);
  report.row("pack what came of it", size, pack);
  std::printf("          %zu ops, then %zu, then %zu\n", simplified, differentiated, result);
}

void measure_checking(Report& report, size_t lines, int runs) {
  const std::string source = bench::generated_source(lines);
  const auto size = static_cast<size_t>(std::count(source.begin(), source.end(), '\n'));
  std::vector<double> parse, check;
  size_t ops = 0;
  for (int run = -1; run < runs; ++run) {
    if (run == 0) parse = check = {};
    dsl::SourceManager sources;
    dsl::DiagnosticList diagnostics;
    const dsl::FileId root = sources.add("generated.dr", source);
    timed(parse, [&] { return dsl::parse(sources, root, diagnostics).items.size(); });
    const auto graph = timed(check, [&] { return lower::lower(sources, root, {}, diagnostics); });
    if (!graph) {
      std::fputs(dsl::format(diagnostics, sources).c_str(), stderr);
      std::exit(1);
    }
    ops = graph->op_count();
  }
  report.row("parse", size, parse);
  report.row("check: parse and lower", size, check);
  std::printf("          %zu ops\n", ops);
}

}  // namespace

int main(int argc, char** argv) {
  const int runs = argc > 2 ? std::atoi(argv[2]) : 9;
  std::FILE* file = argc > 1 ? std::fopen(argv[1], "w") : nullptr;
  if (file == nullptr || runs < 1) {
    std::fputs("usage: bench_compile FILE [RUNS]\n", stderr);
    return 2;
  }
  Report report(file);
  report.heading("ops in the graph");
  for (const size_t ops : {1000, 5000, 20000, 80000}) measure_passes(report, ops, runs);
  report.heading("lines of source");
  for (const size_t lines : {500, 5000}) measure_checking(report, lines, runs);
  std::fclose(file);
  return 0;
}
