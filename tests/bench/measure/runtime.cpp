// SPDX-License-Identifier: Apache-2.0
// What the host adds to a step: a program of ten passes over 64 x 64 elements, on the first device that Vulkan lists
// or the one that is named. Times are a step's, in microseconds: the smallest and the median of several rounds.
//
//   bench_runtime FILE [DEVICE] [ROUNDS]    a table on stdout, one JSON object a line in FILE
#include "runtime/runtime.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "runtime/jit/jit.h"
#include "runtime/program/state.h"

namespace dr::runtime {
struct Inside {
  static OnDevice& of(Program& program) { return *program.state().on_device; }
};
}  // namespace dr::runtime

using namespace dr;

namespace {

constexpr int kSteps = 100;  // of a round

template <class T>
T must(io::Result<T> result) {
  if (!result) {
    std::fprintf(stderr, "bench_runtime: %s\n", result.error().c_str());
    std::exit(1);
  }
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

double wall_us() {
  return std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Processor time of this thread alone: the device's threads, if it has some, are not in it.
double thread_us() {
  timespec time;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return 1e6 * static_cast<double>(time.tv_sec) + 1e-3 * static_cast<double>(time.tv_nsec);
}

struct Times {
  std::vector<double> us;
  double smallest() const { return *std::min_element(us.begin(), us.end()); }
  double median() const {
    std::vector<double> sorted = us;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<long>(sorted.size() / 2), sorted.end());
    return sorted[sorted.size() / 2];
  }
};

// Each line reads its neighbours' finished values, so it is a pass of its own.
std::string program_text() {
  std::string text = "edition 1;\nparam a : float[W, H];\nlet x0 = a * float(step_index % 2 + 1);\n";
  for (int k = 1; k < 10; ++k) {
    const std::string x = "x" + std::to_string(k - 1);
    text += "let x" + std::to_string(k) + " = 0.5 * shift(" + x + ", 1, 0) + 0.4 * shift(" + x + ", 0, -1);\n";
  }
  return text + "step go { a <- a * 0.99 + x9 * 0.001; }\n";
}

std::vector<uint8_t> compile(const std::string& profile) {
  const auto path = std::filesystem::temp_directory_path() / "bench_runtime.dr";
  std::ofstream(path) << program_text();
  jit::Options options;
  options.profile = profile;
  auto bundle = jit::compile_file(path.string(), options);
  std::filesystem::remove(path);
  if (!bundle) {
    std::fputs(bundle.error().c_str(), stderr);
    std::exit(1);
  }
  return std::move(bundle).value();
}

// The commands of so many steps in one command buffer: what the device takes when no host stands between steps.
class Unattended {
 public:
  Unattended(runtime::Program& program, int steps) : on_device_(runtime::Inside::of(program)) {
    runtime::StepState& step = on_device_.steps[0];
    commands_ = on_device_.queue.command_buffer();
    commands_.begin(vk::CommandBufferBeginInfo(vk::CommandBufferUsageFlagBits::eSimultaneousUse));
    const std::vector<const runtime::Primitive*> chosen = step.chosen(step.list->everything());
    for (int k = 0; k < steps; ++k) {
      on_device_.queue.everything_before(commands_);
      on_device_.commands.record(commands_, chosen);
    }
    commands_.end();
  }
  void run() {
    on_device_.queue.submit(commands_);
    on_device_.queue.finish();
  }

 private:
  runtime::OnDevice& on_device_;
  vk::raii::CommandBuffer commands_{nullptr};
};

}  // namespace

int main(int argc, char** argv) {
  std::FILE* file = argc > 1 ? std::fopen(argv[1], "w") : nullptr;
  const int rounds = argc > 3 ? std::atoi(argv[3]) : 25;
  if (file == nullptr || rounds < 1) {
    std::fputs("usage: bench_runtime FILE [DEVICE] [ROUNDS]\n", stderr);
    return 2;
  }
  const auto device = must(runtime::Device::open({argc > 2 ? argv[2] : "", false}));
  const std::string profile = device.profile_name().empty() ? "lavapipe" : device.profile_name();
  auto program = must(runtime::Program::load(device, compile(profile)));
  must(program.bind("a", io::Array::from_floats(std::vector<float>(64 * 64, 1.0f), 1, 64, 64)));
  must(program.run("go", kSteps));

  Unattended unattended(program, kSteps);
  unattended.run();
  Times together, host, alone, on_device, unattended_us, beyond;
  for (int round = 0; round < rounds; ++round) {
    double start = wall_us(), thread = thread_us();
    must(program.run("go", kSteps));
    together.us.push_back((wall_us() - start) / kSteps);
    host.us.push_back((thread_us() - thread) / kSteps);
    start = wall_us();
    unattended.run();
    unattended_us.us.push_back((wall_us() - start) / kSteps);
    beyond.us.push_back(together.us.back() - unattended_us.us.back());
    start = wall_us();
    for (int k = 0; k < kSteps; ++k) must(program.run("go"));
    alone.us.push_back((wall_us() - start) / kSteps);
    for (int k = 0; k < 10; ++k) {
      double sum = 0;
      for (const runtime::CommandTime& t : must(program.timed_run("go"))) sum += t.nanoseconds * 1e-3;
      on_device.us.push_back(sum);
    }
  }
  std::printf("%s, %d commands a step\n%-44s %10s %10s\n", device.info().name.c_str(),
              must(program.command_count("go")), "us a step", "smallest", "median");
  const auto row = [&](const char* what, double smallest, double median) {
    std::printf("%-44s %10.1f %10.1f\n", what, smallest, median);
    std::fprintf(file, "{\"bench\": \"runtime\", \"what\": \"%s\", \"smallest_us\": %.2f, \"median_us\": %.2f}\n", what,
                 smallest, median);
  };
  row("several under way", together.smallest(), together.median());
  row("the same commands in one submission", unattended_us.smallest(), unattended_us.median());
  row("beyond the device, round by round", beyond.smallest(), beyond.median());
  row("each waited for", alone.smallest(), alone.median());
  row("the device's commands, each waited for", on_device.smallest(), on_device.median());
  row("processor time of the calling thread", host.smallest(), host.median());
  std::fclose(file);
  return 0;
}
