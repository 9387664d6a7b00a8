// SPDX-License-Identifier: Apache-2.0
// Memory does not grow with steps and with loads, on each software device: the process holds as much at the end of a
// long life as in its middle. DR_FLAT_STEPS and DR_FLAT_LOADS say how long it is.
#include <malloc.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <fstream>

#include "runtime/jit/jit.h"
#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/compile.h"

using namespace dr;

namespace {

// Drivers and allocators keep a little more now and then; what leaks at each step or load is far above this.
constexpr double kSlack = 2;

constexpr const char* kFit = R"(edition 1;
import std.optim;
param p : float[W] = 0.5;
state s : float[W] = 0.0;
input t : float[W];
let e = mean((p - t) * (p - t)) + 0.001 * mean(s);
step fit { minimize e over p with optim.adam(rate = 0.01); s <- s * 0.9 + sin(p); output error = e; }
)";

int64_t number(const char* name, int64_t otherwise) {
  const char* text = std::getenv(name);
  return text != nullptr ? std::atoll(text) : otherwise;
}

// MiB of the process in memory, without what the allocator has back already.
double resident() {
  malloc_trim(0);
  int64_t all = 0, pages = 0;
  std::ifstream("/proc/self/statm") >> all >> pages;
  return static_cast<double>(pages * sysconf(_SC_PAGESIZE)) / (1 << 20);
}

template <class T>
T must(io::Result<T> result) {
  if (!result) FAIL(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

// Does it `count` times, and looks at the memory ten times.
template <class Do>
void expect_flat(const char* device, const char* what, int64_t count, const Do& once) {
  std::vector<double> held;
  for (int64_t part = 1; part <= 10; ++part) {
    once(std::max<int64_t>(1, count / 10));
    held.push_back(resident());
  }
  std::printf("%-12s %lld %s: ", device, static_cast<long long>(count), what);
  for (const double size : held) std::printf(" %.1f", size);
  std::printf(" MiB\n");
  std::fflush(stdout);
  CHECK(held[9] - held[4] <= kSlack);
}

}  // namespace

TEST_CASE("memory does not grow with steps and loads") {
  for (const auto& [name, variable] :
       {std::pair("lavapipe", "DR_LAVAPIPE_ICD"), {"swiftshader", "DR_SWIFTSHADER_ICD"}}) {
    const char* icd = std::getenv(variable);
    if (icd == nullptr) {
      if (std::getenv("CI") != nullptr) FAIL(std::string(variable) + " is not set: CI tests on every device");
      continue;
    }
    setenv("VK_ICD_FILENAMES", icd, 1);
    setenv("VK_DRIVER_FILES", icd, 1);
    const std::vector<uint8_t> bundle = test::compile_text("flat_memory.dr", kFit, name);
    const runtime::Device device = must(runtime::Device::open({name}));
    const io::Array target = io::Array::from_floats(std::vector<float>(64, 0.25f));
    auto program = must(runtime::Program::load(device, bundle));
    must(program.bind("t", target));
    expect_flat(name, "steps", number("DR_FLAT_STEPS", 2000), [&](int64_t count) {
      // A hundred at once, and then what the last of them gave.
      for (int64_t done = 0; done < count; done += 100) {
        must(program.run("fit", static_cast<int>(std::min<int64_t>(100, count - done))));
        must(program.output("fit", "error"));
      }
    });
    expect_flat(name, "loads", number("DR_FLAT_LOADS", 50), [&](int64_t count) {
      for (int64_t k = 0; k < count; ++k) {
        auto one = must(runtime::Program::load(device, bundle));
        must(one.bind("t", target));
        must(one.run("fit", 2));
        must(one.output("fit", "error"));
      }
    });
  }
}
