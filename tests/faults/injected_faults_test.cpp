// SPDX-License-Identifier: Apache-2.0
// Each Vulkan call, allocation and file call of a program's life fails once, on each software device. Whatever was
// asked for then is done or refused in words; what was refused can be asked for again, of the same object or, where
// that says that it cannot go on, of a new one; the results have the bits of a life without faults; and no object of
// Vulkan is left alive. DR_FAULTS says how many places of each kind are tried, evenly spread; `all` means every call,
// and `stacks` the first call from each stack of callers, which are all that the code can tell apart.
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <optional>

#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/faults/shim.h"

using namespace dr;
using faults::Kind;
using io::Array;

namespace {

namespace fs = std::filesystem;

// A fit with states and a counter; a mesh in images, with its gradient.
constexpr const char* kFit = R"(edition 1;
param p : float[W] = 0.5;
state m : float[W];
input t : float[W];
let d = p - 0.5 * shift(t, 1, 0);
let e = sum(d * d) * (1.0 + 0.01 * float(step_index));
step fit { m <- 0.9 * m + grad(e, p); p <- p - 0.01 * m; output e, p; }
)";
constexpr const char* kMesh = R"(edition 1;
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
)";

struct Case {
  const char* name;
  std::vector<uint8_t> bundle;
  std::vector<std::pair<std::string, Array>> data;
  std::string step, output, param;
};

std::vector<Case> cases(const std::string& device) {
  std::vector<float> line(24);
  for (size_t k = 0; k < line.size(); ++k) line[k] = 0.1f * static_cast<float>(k % 5);
  jit::Options options;
  options.profile = device;
  options.lower = "fragment";
  options.raster = "hardware";
  const fs::path mesh = fs::path(DR_BUILD_DIR) / "injected_mesh.dr";
  std::ofstream(mesh) << kMesh;
  std::vector<Case> out;
  out.push_back({"fit", test::compile_text("injected_fit.dr", kFit, device), {}, "fit", "e", "p"});
  out.back().data = {{"t", Array::from_floats(line)}};
  out.push_back({"mesh", test::compile(mesh.string(), options), {}, "look", "picture", "shade"});
  out.back().data = {{"position", Array::from_floats(std::vector<float>{1, 1, 14, 2, 3, 13, 12, 15}, 2)},
                     {"face", Array::from_ints(std::vector<int32_t>{0, 1, 2, 1, 3, 2}, 3)}};
  return out;
}

// What is asked of the library, and no more, may fail.
template <class F>
auto watched(const F& call) {
  struct Watch {
    Watch() { faults::set_watching(true); }
    ~Watch() { faults::set_watching(false); }
  } const watch;
  return call();
}

// A life: objects, what was asked of them, and how often something was refused.
struct Life {
  const Case& what;
  const char* device_name;
  std::string folder;
  std::optional<runtime::Device> device = std::nullopt;
  std::optional<runtime::Program> program = std::nullopt;
  int refused = 0, renewed = 0;
  std::vector<std::vector<std::byte>> results = {};

  // Asked once more where it was refused; `again` makes a new program, with all that was done to the old one.
  template <class T>
  T ask(const std::function<io::Result<T>()>& call, const std::function<void()>& again) {
    io::Result<T> result = watched(call);
    for (int k = 0; !result; ++k) {
      INFO("refused: " << result.error());
      REQUIRE(result.error().size() > 10);
      REQUIRE(k < 3);
      ++refused;
      if (again && result.error().find("load") != std::string::npos) {
        ++renewed;
        again();
      }
      result = watched(call);
    }
    if constexpr (!std::is_void_v<T>) return std::move(result).value();
  }

  void open() {
    device = ask<runtime::Device>([&] { return runtime::Device::open({.name = device_name}); }, nullptr);
  }
  void load() {
    runtime::LoadOptions options;
    options.pipeline_folder = folder;
    program = ask<runtime::Program>([&] { return runtime::Program::load(*device, what.bundle, options); }, nullptr);
    for (const auto& leaf : what.data) ask<void>([&] { return program->bind(leaf.first, leaf.second); }, nullptr);
  }
  void keep(const Array& array) { results.push_back(array.bytes); }
  void go() {
    open();
    load();
    int runs = 0;  // what a new program has to do again
    const std::function<void()> again = [&] {
      end();
      open();
      load();
      if (runs > 0) ask<void>([&] { return program->run(what.step, runs); }, nullptr);
    };
    ask<void>([&] { return program->run(what.step, 2); }, again);
    runs = 2;
    keep(ask<Array>([&] { return program->output(what.step, what.output); }, again));
    for (const auto& leaf : what.data) ask<void>([&] { return program->bind(leaf.first, leaf.second); }, again);
    ask<std::vector<runtime::CommandTime>>([&] { return program->timed_run(what.step); }, again);
    runs = 3;
    ask<void>([&] { return program->run(what.step, 1); }, again);
    runs = 4;
    keep(ask<Array>([&] { return program->leaf(what.param); }, again));
    for (const auto& raster : ask<std::vector<std::vector<Array>>>([&] { return program->rasters(what.step); }, again))
      for (const Array& part : raster) keep(part);
    end();
  }
  void end() {
    watched([&] {
      program.reset();
      device.reset();
    });
  }
};

struct Counts {
  long places = 0, tried = 0, refused = 0, renewed = 0;
};

// How many places of `places` are tried.
long wanted(long places, long otherwise) {
  const char* setting = std::getenv("DR_FAULTS");
  const long most = setting == nullptr ? otherwise : std::string(setting) == "all" ? places : std::atol(setting);
  return std::clamp(most, 1L, std::max(places, 1L));
}

// DR_FAULT_PART=2/5: every fifth place, from the second on. SwiftShader lives some 1,000 times in a process: each time
// it is loaded it takes keys of threads and keeps them.
struct Part {
  long number = 1, of = 1;
  Part() {
    const char* setting = std::getenv("DR_FAULT_PART");
    if (setting != nullptr && (std::sscanf(setting, "%ld/%ld", &number, &of) != 2 || number < 1 || of < number))
      FAIL("DR_FAULT_PART is two numbers, as 2/5");
  }
};

void try_all(Kind kind, const char* kind_name, long otherwise) {
  const fs::path folder = fs::temp_directory_path() / ("dr_faults_" + std::to_string(getpid()));
  struct Removed {
    const fs::path& path;
    ~Removed() { fs::remove_all(path); }
  } const removed{folder};
  for (const auto& [device, variable] :
       {std::pair("lavapipe", "DR_LAVAPIPE_ICD"), {"swiftshader", "DR_SWIFTSHADER_ICD"}}) {
    const char* icd = std::getenv(variable);
    if (icd == nullptr) {
      if (std::getenv("CI") != nullptr) FAIL(std::string(variable) + " is not set: CI tests on every device");
      std::printf("%s is not set: faults on %s are left out\n", variable, device);
      continue;
    }
    setenv("VK_ICD_FILENAMES", icd, 1);
    setenv("VK_DRIVER_FILES", icd, 1);
    setenv("VK_LAYER_PATH", DR_LAYERS, 1);
    setenv("VK_INSTANCE_LAYERS", "VK_LAYER_DRESSI_faults", 1);
    setenv("NODEVICE_SELECT", "1", 1);  // Mesa's layer reads what a call that failed did not write
    faults::set_watching(false);
    Counts counts;
    for (const Case& what : cases(device)) {
      // A folder of a life without faults has its pipelines; the life that counts begins with them, as most do.
      const auto fresh = [&] {
        fs::remove_all(folder);
        return Life{what, device, folder.string()};
      };
      fresh().go();  // what is made once in a process
      Life whole = fresh();
      const char* setting = std::getenv("DR_FAULTS");
      const bool by_stack = setting != nullptr && std::string(setting) == "stacks";
      if (by_stack)
        faults::watch_stacks(kind);
      else
        faults::arm(kind, 0);
      whole.go();
      const std::vector<long> stacks = faults::first_of_stacks();
      REQUIRE(whole.refused == 0);
      REQUIRE(faults::alive().empty());
      const long places = by_stack ? static_cast<long>(stacks.size()) : faults::seen(kind);
      const long tried = by_stack ? places : wanted(places, otherwise);
      const Part part;
      REQUIRE(places > 0);
      for (long k = part.number - 1; k < tried; k += part.of) {
        const long at = by_stack ? stacks[static_cast<size_t>(k)] : 1 + k * places / tried;
        Life life = fresh();
        faults::arm(kind, at);
        life.go();
        INFO(what.name << " on " << device << ", " << kind_name << " " << at << " of " << places << ": "
                       << faults::failed());
        CHECK_FALSE(faults::failed().empty());
        CHECK(life.results == whole.results);
        CHECK(faults::alive() == "");
        ++counts.tried;
        counts.refused += life.refused;
        counts.renewed += life.renewed;
      }
      counts.places += places;
    }
    std::printf("%-12s %-6s %ld of %ld places failed, %ld answers in words, %ld programs loaded anew\n", device,
                kind_name, counts.tried, counts.places, counts.refused, counts.renewed);
    std::fflush(stdout);
  }
  faults::arm(kind, 0);
}

}  // namespace

TEST_CASE("every Vulkan call fails once") { try_all(Kind::Vulkan, "vulkan", 60); }
TEST_CASE("every allocation fails once") { try_all(Kind::New, "new", 30); }
TEST_CASE("every call of a file fails once") { try_all(Kind::File, "file", 20); }
TEST_CASE("every read and write is short once") { try_all(Kind::Short, "short", 10); }
