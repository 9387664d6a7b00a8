// SPDX-License-Identifier: Apache-2.0
// Random programs for any time: the evaluator against lavapipe and SwiftShader, and on each device ways through the
// compiler against each other. What fails is cut down and written as the text of a graph, with its seed.
//
//   fuzz_programs [--seconds N] [--seed N] [--keep FOLDER] [--reduce-seconds N] [FILE.ir]
//
// --seed is the first program's. A FILE is looked at alone, with the data of its seed. Each program runs in a process
// of its own, which may die or hang. DR_LAVAPIPE_ICD and DR_SWIFTSHADER_ICD name the devices.
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <optional>
#include <random>
#include <sstream>

#include "compiler/ir/parse.h"
#include "compiler/ir/print.h"
#include "tests/stress/problem.h"
#include "tests/stress/reduce_graph.h"

using namespace dr;
using test::Images;
using test::Problem;
using test::Way;

namespace {

constexpr int kSecondsAProgram = 120;
// Smooth programs may differ by rounding, and by so many times what float32 or a last place of the data changes.
constexpr double kTolerance = 1e-5, kUnstable = 10;

using Clock = std::chrono::steady_clock;
double since(Clock::time_point start) { return std::chrono::duration<double>(Clock::now() - start).count(); }

// What is wrong with a program: its kind, and where. Programs that are cut down keep the first three.
struct Finding {
  std::string kind, device, way, text;
  bool same_as(const Finding& other) const { return kind == other.kind && device == other.device && way == other.way; }
  std::string str() const { return kind + (device.empty() ? "" : " on " + device + ", " + way) + ": " + text; }
};

// What came of a program, as its process tells it.
struct Verdict {
  std::optional<Finding> finding;
  int ways = 0, told = 0;  // that ran, and that were refused in words
  double worst = 0;
};

// ---- In the process of a program
// -------------------------------------------------------------------------------------

const std::vector<Way>& all_ways() {
  static const std::vector<Way> ways = {{"fragment", "fused", {}},
                                        {"compute", "naive", {}},
                                        {"fragment", "naive", {}},
                                        {"fragment", "fused", {"substages"}},
                                        {"fragment", "fused", {"substages", "remat"}},
                                        {"fragment", "fused", {"stages"}},
                                        {"compute", "fused", {"stages"}},
                                        {"compute", "fused", {"remat"}},
                                        {"compute", "fused", {"cache"}},
                                        {"compute", "fused", {"cache", "remat"}},
                                        {"compute", "fused", {"active"}},
                                        {"compute", "fused", {"branches"}},
                                        {"compute", "fused", {"slots"}},
                                        {"fragment", "fused", {"active", "branches"}},
                                        {"compute", "fused", {}, "exact"},
                                        {"compute", "fused", {}, "rows"},
                                        {"compute", "fused", {}, "atomic"},
                                        {"fragment", "naive", {}, "atomic"}};
  return ways;
}

class Check {
 public:
  // Where `like` is given, only what it found is looked for.
  Check(const Problem& problem, const std::optional<Finding>& like) : problem_(problem), like_(like) {}

  Verdict go() {
    try {
      graph_ = test::lowered(problem_.graph);
      expected_ = test::evaluate(problem_, graph_, false);
      if (!problem_.exact) {
        const double rounded = test::distance(test::evaluate(problem_, graph_, true), expected_);
        const double moved = test::distance(test::evaluate(problem_, graph_, false, 1e-7), expected_);
        tolerance_ = kTolerance + kUnstable * std::max(rounded, moved);
      } else if (test::distance(test::evaluate(problem_, graph_, true), expected_) != 0) {
        wrong("differs", "", {}, "the evaluator in float32 from itself");
      }
    } catch (const std::exception& error) {
      wrong("error", "", {}, error.what());
    }
    for (const auto& [name, variable] :
         {std::pair("lavapipe", "DR_LAVAPIPE_ICD"), {"swiftshader", "DR_SWIFTSHADER_ICD"}}) {
      if (verdict_.finding) break;
      const char* icd = std::getenv(variable);
      if (icd == nullptr || (like_ && !like_->device.empty() && like_->device != name)) continue;
      setenv("VK_ICD_FILENAMES", icd, 1);
      setenv("VK_DRIVER_FILES", icd, 1);
      check_on(name);
    }
    return verdict_;
  }

 private:
  void wrong(const char* kind, const std::string& device, const std::optional<Way>& way, const std::string& text) {
    if (!verdict_.finding) verdict_.finding = Finding{kind, device, way ? way->str() : "", text};
  }

  std::optional<Images> run(const runtime::Device& device, const target::Profile& profile, const std::string& name,
                            const Way& way) {
    try {
      ++verdict_.ways;
      return test::run_on(device, problem_, graph_, profile, expected_, way);
    } catch (const test::BeyondProfile&) {
      ++verdict_.told;
    } catch (const std::exception& error) {
      wrong("error", name, way, error.what());
    }
    return std::nullopt;
  }

  void check_on(const std::string& name) {
    auto opened = runtime::Device::open({name});
    if (!opened) return wrong("error", name, {}, opened.error());
    const runtime::Device device = std::move(opened).value();
    const auto loaded = target::load_profile(name);
    const auto& profile = std::get<target::Profile>(loaded);
    const Way usual;
    const auto found = run(device, profile, name, usual);
    if (!found) return;
    compare(*found, name, usual);
    std::mt19937_64 random(problem_.seed);
    std::vector<Way> ways = all_ways();
    std::shuffle(ways.begin(), ways.end(), random);
    if (like_ && !like_->device.empty())
      std::erase_if(ways, [&](const Way& way) { return way.str() != like_->way; });
    else
      ways.resize(problem_.exact ? 6 : 4);
    for (const Way& way : ways) {
      if (verdict_.finding) return;
      const auto other = run(device, profile, name, way);
      if (!other) continue;
      compare(*other, name, way);
      const double apart = test::distance(*other, *found);
      // Sums of rows and of atomics have orders of their own.
      if (std::string_view(way.scatter) == "auto" && apart != 0)
        wrong("bits", name, way, "differ by " + std::to_string(apart) + " from " + usual.str());
    }
  }

  void compare(const Images& found, const std::string& name, const Way& way) {
    const double apart = test::distance(found, expected_);
    if (!problem_.exact && std::isfinite(apart))
      verdict_.worst = std::max(verdict_.worst, apart / (tolerance_ / kTolerance));
    if (apart <= tolerance_) return;
    std::ostringstream text;
    text << "by " << apart << " of " << tolerance_ << " from the evaluator";
    wrong("differs", name, way, text.str());
  }

  const Problem& problem_;
  const std::optional<Finding>& like_;
  ir::Graph graph_;
  Images expected_;
  double tolerance_ = 0;
  Verdict verdict_;
};

// ---- Beside it
// -------------------------------------------------------------------------------------------------------

std::string written(const Verdict& verdict) {
  std::ostringstream text;
  text << verdict.ways << '\n' << verdict.told << '\n' << verdict.worst << '\n';
  if (verdict.finding)
    text << verdict.finding->kind << '\n'
         << verdict.finding->device << '\n'
         << verdict.finding->way << '\n'
         << verdict.finding->text;
  return text.str();
}

std::optional<Verdict> read(const std::string& words) {
  std::istringstream text(words);
  Verdict verdict;
  if (!(text >> verdict.ways >> verdict.told >> verdict.worst)) return std::nullopt;
  text.ignore();
  Finding finding;
  if (std::getline(text, finding.kind) && std::getline(text, finding.device) && std::getline(text, finding.way)) {
    std::getline(text, finding.text, '\0');
    verdict.finding = finding;
  }
  return verdict;
}

// In a process of its own.
Verdict look_at(const Problem& problem, const std::optional<Finding>& like = {}) {
  int ends[2];
  if (pipe(ends) != 0) throw std::runtime_error("no pipe");
  const pid_t child = fork();
  if (child == 0) {
    close(ends[0]);
    const std::string words = written(Check(problem, like).go());
    const bool told = write(ends[1], words.data(), words.size()) == static_cast<ssize_t>(words.size());
    _exit(told ? 0 : 1);
  }
  close(ends[1]);
  const auto start = Clock::now();
  std::string words;
  bool hangs = false;
  for (;;) {
    pollfd wait = {ends[0], POLLIN, 0};
    const double left = kSecondsAProgram - since(start);
    hangs = left <= 0 || poll(&wait, 1, static_cast<int>(left * 1000)) == 0;
    if (hangs) break;
    char room[4096];
    const ssize_t got = ::read(ends[0], room, sizeof room);
    if (got <= 0) break;
    words.append(room, static_cast<size_t>(got));
  }
  close(ends[0]);
  if (hangs) kill(child, SIGKILL);
  int status = 0;
  waitpid(child, &status, 0);
  if (hangs) return {Finding{"hang", "", "", "more than " + std::to_string(kSecondsAProgram) + " s"}};
  if (const auto verdict = read(words); verdict && WIFEXITED(status)) return *verdict;
  return {Finding{"crash", "", "", WIFSIGNALED(status) ? strsignal(WTERMSIG(status)) : "no word"}};
}

// Mostly small; else images about the sizes of workgroups and of their rows, and loops about what lavapipe runs.
test::Sizes sizes_of(uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto one_of = [&](std::initializer_list<int64_t> numbers) {
    return numbers.begin()[random() % numbers.size()];
  };
  const bool smooth = seed % 2 != 0;
  const uint64_t size = (seed / 2) % 32;
  if (size >= 20 && size < 26)
    return {{one_of({63, 64, 65, 255, 256, 257}), one_of({1, 2, 15, 16, 17}), one_of({1, 2})}, 0};
  if (size >= 26 && size < 28 && smooth) return {{one_of({65535, 65536, 65537}), one_of({1, 2}), 1}, 0};
  if (size >= 28 && size < 31 && smooth) return {{4, 3, 2}, one_of({65533, 65534, 65535, 65536, 131072})};
  if (size == 31 && smooth && (seed / 64) % 4 == 0) return {{one_of({4194239, 4194240, 4194241}), 1, 1}, 0};
  return {};
}

struct Settings {
  double seconds = 60, reduce_seconds = 600;
  uint64_t seed = 1;
  std::string keep = ".", file;
};

void reduce(const Problem& problem, const Finding& finding, const Settings& settings) {
  const auto fails = [&](const ir::Graph& graph) {
    const Verdict verdict = look_at({graph, problem.seed, problem.exact}, finding);
    return verdict.finding && verdict.finding->same_as(finding);
  };
  ir::Graph least = problem.graph;
  if (fails(least)) least = test::reduce_graph(least, fails, settings.reduce_seconds);
  const std::filesystem::path file =
      std::filesystem::path(settings.keep) / ("program-" + std::to_string(problem.seed) + ".ir");
  std::ofstream(file) << "// " << finding.str().substr(0, finding.str().find('\n')) << "\n// fuzz_programs --seed "
                      << problem.seed << " " << file.filename().string() << "\n"
                      << ir::print(least);
  std::printf("  %zu ops became %zu: %s\n", test::ops_of(problem.graph), test::ops_of(least), file.c_str());
}

int look_at_file(const Settings& settings) {
  std::ostringstream text;
  text << std::ifstream(settings.file).rdbuf();
  auto parsed = ir::parse(text.str());
  if (const auto* error = std::get_if<ir::ParseError>(&parsed)) {
    std::fprintf(stderr, "%s:%u: %s\n", settings.file.c_str(), error->line, error->message.c_str());
    return 2;
  }
  const Problem problem{std::get<ir::Graph>(std::move(parsed)), settings.seed, settings.seed % 2 == 0};
  const Verdict verdict = look_at(problem);
  std::printf("%s\n", verdict.finding ? verdict.finding->str().c_str() : "nothing is wrong");
  return verdict.finding ? 1 : 0;
}

int go(const Settings& settings) {
  std::filesystem::create_directories(settings.keep);
  const auto start = Clock::now();
  uint64_t programs = 0, ways = 0, told = 0, wrong = 0, large = 0;
  double worst = 0;
  const auto report = [&] {
    std::printf(
        "%llu programs in %.0f seconds, %llu of them large: %llu ways ran, %llu refused in words, worst %.1e, %llu "
        "wrong\n",
        static_cast<unsigned long long>(programs), since(start), static_cast<unsigned long long>(large),
        static_cast<unsigned long long>(ways), static_cast<unsigned long long>(told), worst,
        static_cast<unsigned long long>(wrong));
    std::fflush(stdout);
  };
  for (uint64_t seed = settings.seed; since(start) < settings.seconds; ++seed) {
    const test::Sizes sizes = sizes_of(seed);
    const Problem problem = test::random_problem(seed, sizes);
    const Verdict verdict = look_at(problem);
    ++programs;
    large += sizes.trips > 0 || sizes.images[0] > 4 ? 1 : 0;
    ways += static_cast<uint64_t>(verdict.ways);
    told += static_cast<uint64_t>(verdict.told);
    worst = std::max(worst, verdict.worst);
    if (verdict.finding) {
      ++wrong;
      std::printf("seed %llu (images of %lld x %lld x %lld, %lld trips): %s\n", static_cast<unsigned long long>(seed),
                  static_cast<long long>(sizes.images[0]), static_cast<long long>(sizes.images[1]),
                  static_cast<long long>(sizes.images[2]), static_cast<long long>(sizes.trips),
                  verdict.finding->str().c_str());
      std::fflush(stdout);
      reduce(problem, *verdict.finding, settings);
    }
    if ((programs & (programs - 1)) == 0) report();
  }
  report();
  return wrong > 0 ? 1 : 0;
}

[[noreturn]] void usage() {
  std::fputs("usage: fuzz_programs [--seconds N] [--seed N] [--keep FOLDER] [--reduce-seconds N] [FILE.ir]\n", stderr);
  std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (!word.starts_with("--")) {
      settings.file = word;
      continue;
    }
    if (i + 1 == argc) usage();
    const char* value = argv[++i];
    if (word == "--seconds")
      settings.seconds = std::strtod(value, nullptr);
    else if (word == "--reduce-seconds")
      settings.reduce_seconds = std::strtod(value, nullptr);
    else if (word == "--seed")
      settings.seed = std::strtoull(value, nullptr, 10);
    else if (word == "--keep")
      settings.keep = value;
    else
      usage();
  }
  return settings.file.empty() ? go(settings) : look_at_file(settings);
}
