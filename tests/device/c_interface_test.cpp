// SPDX-License-Identifier: Apache-2.0
// The C interface as a host in C sees it, on the evaluator and on lavapipe: whose mistake an error is, what a warning's
// function and a forked process may do, and what is refused in words.
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <string>
#include <vector>

#include "runtime/c/dressi.h"
#include "tests/catch.h"

namespace {

constexpr const char* kFit = R"(edition 1;
param offset : vec3 = vec3(0.0);
input position : vec3[V];
let moved = position + offset;
let error = mean(dot(moved, moved));
step fit { offset <- offset - 0.1 * grad(error, offset); output error, moved; }
step look { output moved, offset, position; }
)";

using Options = std::vector<const char*>;

// Lavapipe where it is, and the evaluator.
std::vector<std::string> device_names() {
  std::vector<std::string> names = {"reference"};
  if (const char* icd = std::getenv("DR_LAVAPIPE_ICD")) {
    ::setenv("VK_DRIVER_FILES", icd, 1);
    ::setenv("VK_ICD_FILENAMES", icd, 1);
    names.emplace_back("llvmpipe");
  } else if (std::getenv("CI") != nullptr) {
    FAIL("DR_LAVAPIPE_ICD is not set");
  }
  return names;
}

dressi_array array_of(std::vector<float>& numbers, int components) {
  const auto count = static_cast<int64_t>(numbers.size());
  return {DRESSI_FLOAT32, components, count / components, 1, 1, numbers.data(), nullptr};
}

// A device and runs on it.
struct Host {
  explicit Host(const std::string& name) : device(dressi_device_open(name.c_str(), 0)) {
    INFO(dressi_error());
    REQUIRE(device != nullptr);
  }
  Host(const Host&) = delete;
  Host& operator=(const Host&) = delete;
  ~Host() {
    for (dressi_run* run : runs) dressi_run_free(run);
    for (dressi_bundle* bundle : bundles) dressi_bundle_free(bundle);
    dressi_device_free(device);
  }
  dressi_bundle* compiled(const char* text, Options options = {}) {
    options.push_back(nullptr);
    bundles.push_back(dressi_compile("test.dr", text, device, options.data()));
    INFO(dressi_error());
    REQUIRE(bundles.back() != nullptr);
    return bundles.back();
  }
  dressi_run* run_of(const char* text, Options options = {}) {
    options.push_back(nullptr);
    runs.push_back(dressi_run_open(device, compiled(text), options.data()));
    INFO(dressi_error());
    REQUIRE(runs.back() != nullptr);
    return runs.back();
  }
  // A run that has its data.
  dressi_run* fit(float first = 1) {
    dressi_run* run = run_of(kFit);
    std::vector<float> numbers = {first, 2, 3, 4, 5, 6};
    const dressi_array position = array_of(numbers, 3);
    REQUIRE(dressi_bind(run, "position", &position) == 1);
    return run;
  }
  dressi_device* device;
  std::vector<dressi_bundle*> bundles = {};
  std::vector<dressi_run*> runs = {};
};

void everywhere(const std::function<void(Host&, bool is_device)>& what) {
  for (const std::string& name : device_names()) {
    INFO(name);
    Host host(name);
    what(host, name != "reference");
  }
}

// The last call failed so.
void says(const std::string& words, dressi_error_kind kind) {
  INFO("expected: " << words << "\n  found: " << dressi_error());
  CHECK(std::string(dressi_error()).find(words) != std::string::npos);
  CHECK(dressi_error_kind_of_last() == kind);
}

float first_of(dressi_array& array) {
  const float out = array.kind == DRESSI_FLOAT64 ? static_cast<float>(*static_cast<double*>(array.data))
                                                 : *static_cast<float*>(array.data);
  dressi_array_free(&array);
  return out;
}

float offset_of(dressi_run* run) {
  dressi_array leaf;
  REQUIRE(dressi_leaf(run, "offset", &leaf) == 1);
  return first_of(leaf);
}

// While this lives the process takes some megabytes more and not a lot.
class LittleMemory {
 public:
  LittleMemory() {
    ::getrlimit(RLIMIT_AS, &before_);
    size_t pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    rlimit now = before_;
    now.rlim_cur = pages * static_cast<size_t>(::sysconf(_SC_PAGESIZE)) + (size_t{256} << 20);
    ::setrlimit(RLIMIT_AS, &now);
  }
  LittleMemory(const LittleMemory&) = delete;
  LittleMemory& operator=(const LittleMemory&) = delete;
  ~LittleMemory() { ::setrlimit(RLIMIT_AS, &before_); }

 private:
  rlimit before_{};
};

// What `call` returns in a forked process; -1 where it does not end in time.
int in_fork(const std::function<bool()>& call) {
  const pid_t child = ::fork();
  if (child == 0) {
    ::alarm(30);
    ::_exit(call() ? 0 : 1);
  }
  int status = 0;
  ::waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

}  // namespace

TEST_CASE("what the device or the machine has too little of is no mistake of the user") {
  static const char* const kLarge = "edition 1; param x : mat4[V] = mat4(1.0); step t { x <- x * 2.0; output x; }";
  everywhere([&](Host& host, bool is_device) {
    dressi_run* large = host.run_of(kLarge);
    REQUIRE(dressi_bind_symbol(large, "V", 20'000'000) == 1);
    {
      const LittleMemory little;
      CHECK(dressi_step(large, "t", 1) == 0);
      says("memory", DRESSI_DEVICE_ERROR);
    }
    // What the caller asks for that is not there stays the caller's mistake.
    CHECK(dressi_step(large, "none", 1) == 0);
    if (!is_device) return says("there is no step 'none'", DRESSI_USER_ERROR);
    dressi_run* larger = host.run_of(kLarge);
    REQUIRE(dressi_bind_symbol(larger, "V", 2'000'000'000) == 1);
    CHECK(dressi_step(larger, "t", 1) == 0);
    says("bytes, the device allows", DRESSI_DEVICE_ERROR);
    CHECK(dressi_timed_step(larger, "t") == nullptr);
    says("bytes, the device allows", DRESSI_DEVICE_ERROR);
    CHECK(dressi_checked_step(larger, "t") == nullptr);
    says("bytes, the device allows", DRESSI_DEVICE_ERROR);
    int made = 0;
    REQUIRE(dressi_watch(larger, 0) != nullptr);
    CHECK(dressi_watched_step(larger, "t", 1, &made) == 0);
    says("bytes, the device allows", DRESSI_DEVICE_ERROR);
    CHECK(dressi_step(host.run_of(kFit, {"memory", "1"}), "look", 1) == 0);
    says("needs data", DRESSI_USER_ERROR);
  });
}

TEST_CASE("limits of a device are told as the device's") {
  everywhere([](Host& host, bool is_device) {
    if (!is_device) return;
    dressi_run* loop =
        host.run_of("edition 1; input n : int; let s = fold(k in 0..n, x = 0.0) { x + 1.0 }; step t { output s; }",
                    {"memory", "1000000"});
    int32_t trips = 100'000;
    const dressi_array n = {DRESSI_INT32, 1, 1, 1, 1, &trips, nullptr};
    REQUIRE(dressi_bind(loop, "n", &n) == 1);
    CHECK(dressi_step(loop, "t", 1) == 0);
    says("takes more trips than this device gives one", DRESSI_DEVICE_ERROR);
    dressi_run* small = host.run_of("edition 1; param x : float[V] = 1.0; step t { x <- 2.0 * x; }", {"memory", "1"});
    REQUIRE(dressi_bind_symbol(small, "V", 4) == 1);
    CHECK(dressi_step(small, "t", 1) == 0);
    says("more than the limit of 1", DRESSI_DEVICE_ERROR);
    dressi_run* shared = host.run_of(kFit, {"share", "on"});
    dressi_array leaf;
    CHECK(dressi_cuda_stream(shared, nullptr) == 0);
    says("does not share its memory with CUDA", DRESSI_DEVICE_ERROR);
    CHECK(dressi_cuda_leaf(shared, "offset", &leaf, nullptr) == 0);
    says("does not share its memory with CUDA", DRESSI_DEVICE_ERROR);
  });
}

namespace {

struct Told {
  dressi_run* run;
  bool frees = false;
  std::vector<std::string> answers = {};
};

void call_back(const char*, void* context) {
  auto& told = *static_cast<Told*>(context);
  if (told.frees) return dressi_run_free(told.run);
  dressi_array array;
  if (dressi_step(told.run, "fit", 1) != 0 || dressi_leaf(told.run, "offset", &array) != 0 ||
      dressi_on_warning(told.run, nullptr, nullptr) != 0)
    told.answers.emplace_back("called");
  told.answers.emplace_back(dressi_error());
}

}  // namespace

TEST_CASE("a warning's function that calls its run gets an error, and may free it") {
  everywhere([](Host& host, bool) {
    dressi_run* run = host.fit(NAN);
    Told told{run};
    REQUIRE(dressi_on_warning(run, call_back, &told) == 1);
    CHECK(dressi_step(run, "fit", 1) == 1);
    dressi_array output;
    REQUIRE(dressi_output(run, "fit", "moved", &output) == 1);
    dressi_array_free(&output);
    REQUIRE_FALSE(told.answers.empty());
    for (const std::string& answer : told.answers)
      CHECK(answer.find("a warning's function called the run") != std::string::npos);

    told = {host.fit(NAN), true};
    host.runs.pop_back();
    REQUIRE(dressi_on_warning(told.run, call_back, &told) == 1);
    REQUIRE(dressi_step(told.run, "look", 1) == 1);
    REQUIRE(dressi_output(told.run, "look", "position", &output) == 1);
    CHECK(std::isnan(first_of(output)));
  });
}

TEST_CASE("what is written to an output changes no leaf") {
  everywhere([](Host& host, bool is_device) {
    dressi_run* run = host.fit();
    REQUIRE(dressi_step(run, "look", 1) == 1);
    for (const char* name : {"moved", "offset", "position"}) {
      INFO(name);
      dressi_array view;
      const int kind = dressi_output_view(run, "look", name, &view);
      REQUIRE((kind == 1 || kind == 2));
      CHECK((is_device || kind == 2));
      const dressi_array before = view;
      std::memset(view.data, 0x40, 4);
      dressi_array leaf;
      REQUIRE(dressi_leaf(run, "position", &leaf) == 1);
      CHECK(leaf.data != before.data);
      CHECK(first_of(leaf) == 1);
      CHECK(offset_of(run) == 0);
      dressi_array_free(&view);
    }
  });
}

TEST_CASE("a process that was forked is told so, and goes on") {
  everywhere([](Host& host, bool is_device) {
    dressi_run* run = host.fit();
    REQUIRE(dressi_step(run, "fit", 1) == 1);
    dressi_array view;
    REQUIRE(dressi_leaf_view(run, "offset", &view) > 0);
    const auto is_refused = [](bool failed) {
      return failed && std::strstr(dressi_error(), "was opened before this process was forked") != nullptr &&
             dressi_error_kind_of_last() == DRESSI_DEVICE_ERROR;
    };
    CHECK(in_fork([&] { return is_refused(dressi_step(run, "fit", 1) == 0); }) == 0);
    CHECK(in_fork([&] { return is_refused(dressi_run_open(host.device, host.bundles[0], nullptr) == nullptr); }) == 0);
    CHECK(in_fork([&] { return is_refused(dressi_compile("a.dr", kFit, host.device, nullptr) == nullptr); }) == 0);
    CHECK(in_fork([&] { return is_refused(dressi_watch(run, 0) == nullptr); }) == 0);
    CHECK(in_fork([&] {
            dressi_array leaf;
            return is_refused(dressi_leaf(run, "offset", &leaf) == 0);
          }) == 0);
    CHECK(in_fork([&] {
            dressi_array_free(&view);
            dressi_run_free(run);
            dressi_device_free(host.device);
            return true;
          }) == 0);
    CHECK(in_fork([&] {
            Host own(is_device ? "llvmpipe" : "reference");
            return dressi_step(own.fit(), "fit", 1) == 1 && dressi_bundle_info(host.bundles[0]) != nullptr;
          }) == 0);
    CHECK(dressi_step(run, "fit", 1) == 1);
    dressi_array_free(&view);
  });
}

TEST_CASE("answers of the C interface are whole, and failures have words") {
  Host host("reference");
  size_t size = 7;
  CHECK(dressi_bundle_bytes(nullptr, &size) == nullptr);
  says("the bundle is missing (NULL)", DRESSI_USER_ERROR);
  dressi_bundle* bundle = host.compiled("edition 1;");
  CHECK(dressi_bundle_bytes(bundle, nullptr) == nullptr);
  says("where to say how many bytes there are is missing (NULL)", DRESSI_USER_ERROR);
  CHECK(dressi_bundle_bytes(bundle, &size) != nullptr);
  const std::string info = dressi_bundle_info(bundle);
  CHECK(info.find(R"("leaves":[])") != std::string::npos);
  CHECK(info.find(R"("steps":[])") != std::string::npos);
}

TEST_CASE("names of programs, adjoints and options that are wrong are the caller's mistakes") {
  Host host("reference");
  CHECK(dressi_compile("\xff\xfe.dr", kFit, nullptr, nullptr) == nullptr);
  says("the name of the program is not UTF-8, from byte 0 on", DRESSI_USER_ERROR);
  CHECK(dressi_explain_gradient("\xff.dr", kFit, nullptr, "error", "offset") == nullptr);
  says("the name of the program is not UTF-8", DRESSI_USER_ERROR);
  for (const char* name : {"a\n.dr", "a\x7f.dr", "a\xc2\x9b.dr"}) {
    CHECK(dressi_compile(name, kFit, nullptr, nullptr) == nullptr);
    says("the name of the program has a line break or another control character, at byte 1", DRESSI_USER_ERROR);
  }
  dressi_bundle* accents = dressi_compile("a\"b/\xc3\xa9 \xf0\x9f\x98\x80.dr", kFit, nullptr, nullptr);
  CHECK(accents != nullptr);
  dressi_bundle_free(accents);
  const char* twice[] = {"adjoint", "look:offset,offset:moved", nullptr};
  CHECK(dressi_compile("a.dr", kFit, nullptr, twice) == nullptr);
  says("the adjoint of step 'look' names leaf 'offset' twice", DRESSI_USER_ERROR);
  const char* again[] = {"adjoint", "look:offset:moved,moved", nullptr};
  CHECK(dressi_compile("a.dr", kFit, nullptr, again) == nullptr);
  says("the adjoint of step 'look' names output 'moved' twice", DRESSI_USER_ERROR);
  dressi_bundle* bundle = host.compiled(kFit);
  for (const char* value : {"0", "-1", "512M", "", "99999999999999999999"}) {
    const char* options[] = {"memory", value, nullptr};
    CHECK(dressi_run_open(host.device, bundle, options) == nullptr);
    says("for 'memory', as 536870912, found '" + std::string(value) + "'", DRESSI_USER_ERROR);
  }
}
