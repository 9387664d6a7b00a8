// SPDX-License-Identifier: Apache-2.0
// Bundles from strangers: mutated ones are loaded and run, in processes of their own, and end in an answer, not in a
// signal. DR_TABLE_MUTATIONS and DR_SPIRV_MUTATIONS say how many, DR_FIRST_MUTATION with which number to begin; a
// number is a seed, so that what is printed can be run again alone; what does not end or dies is left as a file
// mutant-N.drb where this was called, for `drun --timeout`.
#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <map>

#include "compiler/backend/bundle/check_shaders.h"
#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/stress/mutate_bundle.h"

using namespace dr;
using io::Array;

namespace {

// Maps, reductions, states, counters; rasters and gradients by every scatter; branches, loops, layers, tables of
// meshes.
constexpr const char* kPrograms[] = {
    R"(edition 1;
param p : float[W, H] = 0.5;
state m : float[W, H];
input t : float[W, H];
let blurred = 0.5 * shift(t, 1, 0) + 0.5 * t - mean(t);
let e = mean((p - blurred) * (p - blurred)) * (1.0 + 0.01 * float(step_index));
step fit { m <- 0.9 * m + grad(e, p); p <- p - m; output e, p; }
)",
    R"(edition 1;
param table : vec3[V] = 0.25;
input index : ivec3[F];
let x = table.at(index.x) + table.at(index.y) * reduce(sum, k in 0..5) { sin(float(k)) };
let e = sum(dot(x, x));
step fit { table <- table - 0.1 * grad(e, table); output e, table; }
)",
    R"(edition 1;
input position : vec2[V];
input face : ivec3[F];
param shade : float[V] = 0.5;
struct Triangle { a: vec2; b: vec2; c: vec2; }
let seen = raster(F, 16, 16) {
  setup(f) -> Triangle {
    let i = face.at(f);
    Triangle(position.at(i.x), position.at(i.y), position.at(i.z))
  }
  corner(s, k) -> vec2 { [s.a, s.b, s.c][k] }
  depth(s, p) -> float { 0.01 * p.x }
}[0];
let c = if seen.face >= 0 { shade.at(face.at(seen.face).x) } else { 0.0 };
let e = sum(c * c);
step look { shade <- shade - 0.1 * grad(e, shade); output picture = c, face_of = seen.face; }
)"};

std::vector<bundle::BundleT> bases() {
  std::vector<bundle::BundleT> out;
  int number = 0;
  for (const char* text : kPrograms)
    for (const char* lower : {"compute", "fragment"}) {
      jit::Options options;
      options.profile = "lavapipe";
      options.lower = lower;
      options.raster = lower == std::string("fragment") ? "hardware" : "compute";
      const auto path = std::filesystem::path(DR_BUILD_DIR) / ("mutations_" + std::to_string(number++) + ".dr");
      std::ofstream(path) << text;
      out.push_back(std::get<bundle::BundleT>(bundle::read(test::compile(path.string(), options))));
    }
  return out;
}

bundle::BundleT copy_of(const bundle::BundleT& b) { return std::get<bundle::BundleT>(bundle::read(bundle::write(b))); }

enum Outcome : char { kRefused = 'r', kFailed = 'f', kRan = 'o' };

// Data for every leaf that takes some; then all steps, twice.
Outcome run(const runtime::Device& device, const std::vector<uint8_t>& bytes) {
  runtime::LoadOptions options;
  options.memory_limit = 256 << 20;
  auto program = runtime::Program::load(device, bytes, options);
  if (!program) return kRefused;
  bool well = true;
  for (const auto& leaf : program->leaves()) {
    const bool rows = leaf.components != 1;
    const int64_t w = 9, h = rows ? 1 : 9;
    std::vector<double> values(static_cast<size_t>(w * h * leaf.components));
    for (size_t k = 0; k < values.size(); ++k) values[k] = static_cast<double>(k % 7);
    auto data = Array::from_doubles(values, leaf.components, w, h, 1).converted(leaf.kind);
    if (data && program->is_input(leaf.name)) (void)program->bind(leaf.name, *data);
  }
  for (const std::string symbol : {"W", "H", "V", "F"}) (void)program->bind_symbol(symbol, 9);
  for (const std::string& step : program->steps()) {
    well = program->run(step, 2) && well;
    for (const std::string& output : program->outputs(step)) well = program->output(step, output) && well;
    (void)program->rasters(step);
    (void)program->pins(step);
    (void)program->timed_run(step);
  }
  return well ? kRan : kFailed;
}

using Mutate = void (*)(bundle::BundleT&, test::Random&);

std::vector<uint8_t> mutant(const std::vector<bundle::BundleT>& all, Mutate mutate, uint64_t number) {
  test::Random random(number * 2654435761u + 1);
  bundle::BundleT b = copy_of(all[number % all.size()]);
  mutate(b, random);
  return bundle::write(b);
}

// Runs mutants from `first` on, and writes what became of each to the pipe. Never returns.
[[noreturn]] void work(const std::vector<bundle::BundleT>& all, Mutate mutate, uint64_t first, uint64_t end, int pipe) {
  const auto device = runtime::Device::open({});
  if (!device) _exit(2);
  for (uint64_t k = first; k < end; ++k) {
    const char outcome = run(*device, mutant(all, mutate, k));
    if (write(pipe, &outcome, 1) != 1) _exit(3);
  }
  _exit(0);
}

struct Counts {
  uint64_t done = 0, refused = 0, failed = 0, ran = 0, hung = 0;
  std::vector<std::string> signals;
};

void leave(const std::vector<bundle::BundleT>& all, Mutate mutate, uint64_t number) {
  const std::vector<uint8_t> bytes = mutant(all, mutate, number);
  std::ofstream("mutant-" + std::to_string(number) + ".drb", std::ios::binary)
      .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
}

// A process a few hundred mutants; one that dies is followed by another after the mutant that it died of.
Counts run_mutants(const std::vector<bundle::BundleT>& all, Mutate mutate, uint64_t first, uint64_t count) {
  constexpr int kLongest = 60'000;  // ms, on a machine that does much else
  Counts out;
  uint64_t next = first;
  while (next < first + count) {
    int ends[2];
    REQUIRE(pipe(ends) == 0);
    const uint64_t end = std::min(first + count, next + 400);
    const pid_t child = fork();
    REQUIRE(child >= 0);
    if (child == 0) {
      close(ends[0]);
      work(all, mutate, next, end, ends[1]);
    }
    close(ends[1]);
    bool hangs = false;
    for (;;) {
      pollfd waiting{ends[0], POLLIN, 0};
      char outcome = 0;
      if (poll(&waiting, 1, kLongest) == 0) {
        hangs = true;
        kill(child, SIGKILL);
        break;
      }
      if (read(ends[0], &outcome, 1) != 1) break;
      ++next;
      ++out.done;
      (outcome == kRefused ? out.refused : outcome == kFailed ? out.failed : out.ran) += 1;
    }
    close(ends[0]);
    int status = 0;
    waitpid(child, &status, 0);
    if (hangs) {
      std::printf("mutant %llu does not end\n", static_cast<unsigned long long>(next));
      leave(all, mutate, next);
      ++out.hung;
      ++out.done;
      ++next;
    } else if (WIFSIGNALED(status)) {
      leave(all, mutate, next);
      out.signals.push_back(std::to_string(next) + ": " + strsignal(WTERMSIG(status)));
      ++out.done;
      ++next;
    } else {
      REQUIRE(WEXITSTATUS(status) == 0);
    }
  }
  return out;
}

uint64_t setting(const char* name, uint64_t otherwise) {
  const char* value = std::getenv(name);
  return value == nullptr ? otherwise : std::strtoull(value, nullptr, 10);
}

void expect_answers(const char* what, Mutate mutate, uint64_t count) {
  const std::vector<bundle::BundleT> all = bases();
  for (const auto& [name, variable] :
       {std::pair("lavapipe", "DR_LAVAPIPE_ICD"), {"swiftshader", "DR_SWIFTSHADER_ICD"}}) {
    const char* icd = std::getenv(variable);
    if (icd == nullptr) {
      std::printf("%s is not set: mutants on %s are left out\n", variable, name);
      continue;
    }
    setenv("VK_ICD_FILENAMES", icd, 1);
    setenv("VK_DRIVER_FILES", icd, 1);
    const Counts c = run_mutants(all, mutate, setting("DR_FIRST_MUTATION", 0), count);
    std::printf("%s, %s: %llu mutants, %llu refused when loaded, %llu later, %llu ran, %llu did not end, %zu signals\n",
                name, what, static_cast<unsigned long long>(c.done), static_cast<unsigned long long>(c.refused),
                static_cast<unsigned long long>(c.failed), static_cast<unsigned long long>(c.ran),
                static_cast<unsigned long long>(c.hung), c.signals.size());
    for (const std::string& signal : c.signals) std::printf("  mutant %s\n", signal.c_str());
    std::fflush(stdout);
    CHECK(c.signals.empty());
    CHECK(c.ran > 0);
    CHECK(c.refused > 0);
  }
}

}  // namespace

TEST_CASE("a bundle whose tables were changed is answered") {
  expect_answers("tables", test::mutate_tables, setting("DR_TABLE_MUTATIONS", 1000));
}

TEST_CASE("a bundle with one word of SPIR-V changed is answered") {
  expect_answers("SPIR-V", test::mutate_spirv, setting("DR_SPIRV_MUTATIONS", 500));
}
