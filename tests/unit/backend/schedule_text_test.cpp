// SPDX-License-Identifier: Apache-2.0
// The text form of schedules: what is printed parses to the same, and compiling goes on from it to the same bytes; what
// is damaged is refused with a line.
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "compiler/backend/pipeline.h"
#include "compiler/backend/schedule/text.h"
#include "compiler/driver/driver.h"
#include "tests/catch.h"
#include "tests/sanitized.h"

using namespace dr;
using namespace dr::backend;

namespace {

constexpr std::string_view kGraph = R"(leaf a : float[V] param
leaf i : int[V] input
%0 : float[V] = leaf text "a"
%1 : int[V] = leaf text "i"
%2 : float[V] = exp %0
%sum.3 : float[V] = scatter_add %1, %2 dims [V, 1, 1]
step go {
  output sum %sum.3
  update a %2
}
)";

constexpr std::string_view kSchedule = R"(schedule after choose-sums
leaf a : float[V]
leaf i : int[V]
buffer exp : float[V]
buffer sum : float[V]
step go {
  %0 in a
  %1 in i
  %2 in exp
  %sum.3 in sum
  stage 0
  pass exp compute [V]
    reads a
    ops exp %2
    writes exp
  stage 1
  pass sum scatter rows [V]
    reads i exp
    ops scatter_add %sum.3
    writes sum
    sum sum of %sum.3
    rows i[0] of V
  output sum = sum
  update a <- exp
}
)";

constexpr size_t kSmall = 2000, kLarge = 50000;  // ops of a graph

std::string changed(std::string_view from, std::string_view to) {
  std::string text = std::string(kGraph) + std::string(kSchedule);
  const size_t at = text.find(from);
  REQUIRE(at != std::string::npos);
  return text.replace(at, from.size(), to);
}

std::string error_of(const std::string& text) {
  const auto parsed = parse_schedule(text);
  if (const auto* error = std::get_if<ir::ParseError>(&parsed))
    return std::to_string(error->line) + ": " + error->message;
  const auto& [graph, schedule] = std::get<ParsedSchedule>(parsed);
  const auto violations = check_schedule(graph, schedule, std::get<target::Profile>(target::load_profile("lavapipe")));
  return violations.empty() ? "none" : violations[0].text;
}

std::string read_file(const std::filesystem::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

// All passes but the one that calls glslang, whose input says all.
std::vector<BackendPass> passes_to_glsl() {
  std::vector<BackendPass> out(backend_passes().begin(), backend_passes().end());
  std::erase_if(out, [](const BackendPass& pass) { return pass.name == "assemble"; });
  return out;
}

// GLSL and bundle of a graph; nullopt where a limit does not allow them.
std::optional<std::string> product(const ir::Graph& graph, const target::Profile& profile,
                                   const CompileOptions& options, Schedule schedule = {}) {
  Compilation compilation(graph, profile, options, std::move(schedule));
  if (run_backend(compilation, passes_to_glsl())) return std::nullopt;
  const std::vector<uint8_t> bytes = bundle::write(compilation.out.bundle);
  std::string out(bytes.begin(), bytes.end());
  for (const GlslShader& shader : compilation.out.glsl) out += shader.source;
  return out;
}

// Prints and parses the schedule after each pass; goes on from each where the graph is small, else from the last, and
// from none where it is large.
void check_round_trip(const ir::Graph& graph, const target::Profile& profile) {
  std::vector<std::string> texts;
  CompileOptions options;
  if (graph.op_count() > kLarge) options.hooks.stop_after = "check-limits";
  options.hooks.after = [&](std::string_view name, const ir::Graph& of, const Schedule* schedule,
                            const bundle::BundleT&, double) {
    if (!schedule || (graph.op_count() > kSmall && name != "check-limits")) return;
    texts.push_back(print_whole(of, *schedule));
    const auto parsed = parse_schedule(texts.back());
    if (const auto* error = std::get_if<ir::ParseError>(&parsed))
      FAIL("after " << name << ", line " << error->line << ": " << error->message);
    const auto& [graph_again, schedule_again] = std::get<ParsedSchedule>(parsed);
    CHECK(print_whole(graph_again, schedule_again) == texts.back());
    CHECK(check_schedule(graph_again, schedule_again, profile) == check_schedule(of, *schedule, profile));
  };
  const auto expected = product(graph, profile, options);
  options.hooks.after = nullptr;
  // Sanitizers see schedules from text go on in tests/golden/passes.
  if (kSanitized || !expected || graph.op_count() > kLarge) return;
  for (const std::string& text : texts) {
    auto parsed = parse_schedule(text);
    auto& [graph_again, schedule_again] = std::get<ParsedSchedule>(parsed);
    INFO("after " << schedule_again.after);
    const auto again = product(graph_again, profile, options, std::move(schedule_again));
    CHECK((again == expected));
  }
}

}  // namespace

TEST_CASE("schedules of all golden programs print, parse, and compile to the same bytes") {
  const std::filesystem::path root = std::string(DR_SOURCE_DIR) + "/tests/golden";
  std::vector<std::filesystem::path> files;
  for (const char* folder : {"programs", "backend"})
    for (const auto& entry : std::filesystem::directory_iterator(root / folder))
      if (entry.path().extension() == ".dr" && entry.path().stem() != "soft_stress")  // large, and like soft_skip
        files.push_back(entry.path());
  std::ranges::sort(files);
  REQUIRE(files.size() > 60);
  size_t compiled = 0;
  for (size_t k = 0; k < files.size(); ++k) {
    // The release build compares all.
    if (kSanitized && k % 6 != 0) continue;
    driver::Options options;
    options.include_dirs = {files[k].parent_path().string()};
    driver::Compilation program(files[k].string(), read_file(files[k]), options);
    const ir::Graph* graph = program.differentiated();
    if (graph == nullptr) continue;  // a program whose test is its error
    if (kSanitized && graph->op_count() > kSmall) continue;
    constexpr const char* kProfiles[] = {"lavapipe", "nvidia-h200", "swiftshader", "intel-uhd620"};
    const std::string name = kProfiles[k % std::size(kProfiles)];
    INFO(files[k] << " for " << name);
    check_round_trip(*graph, std::get<target::Profile>(target::load_profile(name)));
    ++compiled;
  }
  CHECK(compiled > (kSanitized ? 4 : 60));
}

TEST_CASE("the text of a schedule is what it says") {
  const auto parsed = parse_schedule(std::string(kGraph) + std::string(kSchedule));
  REQUIRE(std::holds_alternative<ParsedSchedule>(parsed));
  const auto& [graph, schedule] = std::get<ParsedSchedule>(parsed);
  CHECK(print_whole(graph, schedule) == std::string(kGraph) + std::string(kSchedule));
  CHECK(schedule.after == "choose-sums");
  const Pass& pass = schedule.steps.at(0).passes.at(1);
  REQUIRE(pass.is<ScatterPass>());
  REQUIRE(pass.get<ScatterPass>().lowering() == ScatterLowering::Rows);
  CHECK(std::get<RowsOfLeaf>(pass.get<ScatterPass>().rows().table).leaf == 1);
  CHECK(pass.stage == 1);
}

TEST_CASE("what is wrong with a schedule's text is said with its line") {
  CHECK(error_of(changed("", "")) == "none");
  CHECK(error_of(changed("buffer exp :", "bufer exp :")) ==
        "14: expected a storage (leaf, step_index buffer, buffer, half buffer, entries buffer, epoch entries buffer, "
        "bits "
        "buffer, sums buffer, emptied sums buffer, listed sums buffer, emptied buffer, image, tile) and a resource's "
        "name before ':', "
        "found 'bufer'");
  CHECK(error_of(changed("buffer sum :", "buffer exp :")) == "15: resource 'exp' is defined twice");
  CHECK(error_of(changed("%2 in exp", "%9 in exp")) == "19: the graph has no value %9");
  CHECK(error_of(changed("%2 in exp", "%2 in ex")) == "19: there is no resource 'ex'");
  CHECK(error_of(changed("compute [V]", "compte [V]")) ==
        "22: expected 'compute', 'fragment', 'reduce', 'scatter' or 'raster', found 'compte'");
  CHECK(error_of(changed("ops exp %2", "ops sin %2")) == "24: this value is made by 'exp', found 'sin'");
  CHECK(error_of(changed("  stage 0\n", "")) == "21: expected 'stage' before the first pass");
  CHECK(error_of(changed("    rows i[0] of V", "    rows j[0] of V")) == "32: the graph has no leaf 'j'");
  CHECK(error_of(changed("}\nschedule", "}\nschedules")) ==
        "11: expected 'leaf', 'step', or an op's results, found 'schedules'");
}

TEST_CASE("a pass has what its kind has, and no other") {
  const auto with = [](std::string_view before, std::string_view line) {
    return changed(before, std::string(before) + std::string(line));
  };
  constexpr std::string_view kMap = "    writes exp\n", kScatter = "    sum sum of %sum.3\n";
  constexpr std::string_view kRows = "scatter rows [V]", kTable = "    rows i[0] of V\n";
  const auto refuses = [](const std::string& text, std::string_view word) {
    const std::string error = error_of(text), found = ", found '" + std::string(word) + "'";
    return error.find("expected what passes of its kind have") != std::string::npos && error.ends_with(found);
  };
  CHECK(error_of(with(kMap, "    block 2 1 1\n")) == "none");
  CHECK(refuses(with(kMap, "    relist\n"), "relist"));
  CHECK(refuses(with(kMap, "    walks faces alone, watched\n"), "walks"));
  for (const std::string_view word : {"partial", "active", "relist", "join", "cut", "skips", "set"})
    CHECK(refuses(with(kScatter, "    " + std::string(word) + " exp\n"), word));
  const auto exact = [&](std::string_view lines) {
    std::string text = changed(kRows, "scatter exact [V]");
    const size_t at = text.find(kTable);
    return text.replace(at, kTable.size(), lines);
  };
  CHECK(error_of(exact("    active exp\n    listed by exp\n    join lanes\n    relist\n")) == "none");
  CHECK(error_of(exact("    active exp\n    joins exp\n    keeps terms\n")) == "none");
  CHECK(refuses(exact("    active exp\n    joins exp\n    relist\n"), "relist"));
  CHECK(refuses(exact("    active exp\n    keeps terms\n"), "keeps"));
  CHECK(refuses(exact("    listed by exp\n"), "listed"));
  CHECK(refuses(exact("    skips zeros\n"), "skips"));
  CHECK(refuses(exact(kTable), "rows"));
}

TEST_CASE("what does not fit together in a schedule is said with its pass") {
  CHECK(error_of(changed("buffer exp : float[V]", "buffer exp : vec2[V]")) ==
        "step go: stores a value of another type in 'exp'");
  CHECK(error_of(changed("reads i exp", "reads i")) == "step go, pass sum: op 'scatter_add' lacks an operand");
  CHECK(error_of(changed("reads i exp", "reads exp i")) == "step go, pass sum: reads values out of order");
  CHECK(error_of(changed("rows i[0]", "rows i[3]")) == "step go, pass sum: has rows by a column that leaf 'i' lacks");
  CHECK(error_of(changed("    rows i[0] of V\n", "")) == "step go, pass sum: has rows without a table");
  CHECK(error_of(changed("sum sum of %sum.3", "sum sum of %2")) ==
        "step go, pass sum: sums a term that it does not scatter");
  CHECK(error_of(changed("  output sum = sum\n", "")) == "step go: has other outputs than the graph's step");
  CHECK(error_of(changed("stage 1", "stage 0")) == "step go, pass sum: needs another pass of its stage");
}

TEST_CASE("damaged texts of schedules are refused or checked, never trusted") {
  const std::string text = std::string(kGraph) + std::string(kSchedule);
  std::mt19937 random(7);
  const auto profile = std::get<target::Profile>(target::load_profile("lavapipe"));
  size_t parsed_count = 0;
  for (int k = 0; k < dr::repeats(20000); ++k) {
    std::string damaged = text;
    const size_t begin = kGraph.size() + random() % kSchedule.size(), length = random() % 6;
    const size_t from = kGraph.size() + random() % kSchedule.size();
    damaged.replace(begin, length, text.substr(from, random() % 12));
    const auto parsed = parse_schedule(damaged);
    if (!std::holds_alternative<ParsedSchedule>(parsed)) continue;
    ++parsed_count;
    const auto& [graph, schedule] = std::get<ParsedSchedule>(parsed);
    const std::string again = print_whole(graph, schedule);
    const auto twice = parse_schedule(again);
    REQUIRE(std::holds_alternative<ParsedSchedule>(twice));
    REQUIRE(print_whole(std::get<ParsedSchedule>(twice).graph, std::get<ParsedSchedule>(twice).schedule) == again);
    check_schedule(graph, schedule, profile);
  }
  CHECK(parsed_count > static_cast<size_t>(dr::repeats(500)));
}

TEST_CASE("each pass over schedules has golden tests from text") {
  const std::filesystem::path folder = std::string(DR_SOURCE_DIR) + "/tests/golden/passes";
  const std::vector<std::string> names = driver::schedule_pass_names();
  REQUIRE(names.size() > 5);
  for (std::string name : names) {
    const std::string end = name == "pack" ? ".ir" : ".schedule";
    std::ranges::replace(name, '-', '_');
    size_t cases = 0;
    if (std::filesystem::is_directory(folder / name))
      for (const auto& entry : std::filesystem::directory_iterator(folder / name))
        if (entry.path().extension() == end) ++cases;
    INFO("tests/golden/passes/" << name << " has a case " << end);
    CHECK(cases > 0);
  }
}
