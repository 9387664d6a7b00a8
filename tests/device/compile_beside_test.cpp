// SPDX-License-Identifier: Apache-2.0
// Shaders that are compiled beside a first run: the run finds all of them among the driver's files.
#include "runtime/program/compile_beside.h"

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <map>

#include "compiler/backend/bundle/bundle.h"
#include "tests/catch.h"
#include "tests/device/compile.h"
#include "tests/device/devices.h"

using namespace dr;
using test::must;

namespace {

const char* const kProgram = R"(edition 1;
input x : float[W, H];
param p : float[W, H] = 0.5;
let blurred = (x.at(coord(W, H) + ivec3(1, 0, 0)) + x) * 0.5;
let error = mean((p - blurred) * (p - blurred));
step fit {
  p <- p - grad(error, p);
  output error;
}
step look { output most = max(blurred), twice = 2.0 * p; }
)";

// The driver's folder for what it compiled, empty at first.
class Folder {
 public:
  Folder() : path_(std::filesystem::temp_directory_path() / ("compile_beside_" + std::to_string(getpid()))) {
    std::filesystem::remove_all(path_);
    setenv("MESA_SHADER_CACHE_DIR", path_.c_str(), 1);
    unsetenv("MESA_SHADER_CACHE_DISABLE");
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  // The sizes of the files of shaders, by name.
  std::map<std::string, uintmax_t> files() const {
    std::map<std::string, uintmax_t> out;
    if (!std::filesystem::exists(path_)) return out;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(path_))
      if (entry.is_regular_file() && entry.path().filename() != "index") out[entry.path()] = entry.file_size();
    return out;
  }

 private:
  std::filesystem::path path_;
};

}  // namespace

TEST_CASE("a run finds what was compiled beside it", "[device]") {
  const Folder folder;
  const char* icd = std::getenv("DR_LAVAPIPE_ICD");
  if (icd == nullptr) {
    if (std::getenv("CI") != nullptr) FAIL("DR_LAVAPIPE_ICD is not set: CI tests on every device");
    std::printf("DR_LAVAPIPE_ICD is not set: compiling beside a run is left out\n");
    return;
  }
  setenv("VK_ICD_FILENAMES", icd, 1);
  setenv("VK_DRIVER_FILES", icd, 1);
  const std::vector<uint8_t> bytes = test::compile_text("compile_beside.dr", kProgram, "lavapipe");
  auto bundle = std::get<bundle::BundleT>(bundle::read(bytes));
  std::set<uint32_t> all;
  for (uint32_t r = 0; r < bundle.resources.size(); ++r) all.insert(r);
  runtime::Sizes sizes;
  sizes.set("W", 40, "the test");
  sizes.set("H", 30, "the test");
  {
    const auto device = runtime::open_device({});
    // The first shader of the step that runs is the run's own.
    runtime::CompileBeside(*device, bundle, sizes, {}, {{1, all}, {0, all}}).wait();
    const size_t but_one = folder.files().size();
    runtime::CompileBeside beside(*device, bundle, sizes, {}, {{0, all}, {1, all}});
    CHECK((beside.has(0) && beside.has(1) && !beside.has(2)));
    beside.wait();
    beside.arrive(1);  // waits for nothing
    CHECK(folder.files().size() == but_one + 1);
  }
  const auto before = folder.files();
  CHECK(before.size() >= 3);
  {
    const runtime::Device device = must(runtime::Device::open({}));
    runtime::Program program = must(runtime::Program::load(device, bytes));
    const std::vector<float> x(40 * 30, 0.25f);
    must(program.bind("x", io::Array::from<float>(x, 1, 40, 30, 1)));
    must(program.run("fit", 2));
    must(program.run("look"));
  }
  CHECK(folder.files() == before);
}
