// SPDX-License-Identifier: Apache-2.0
// Runs a fuzz target over a corpus and random changes of it, where there is no libFuzzer:
//
//   fuzz_NAME [--seconds N] [--runs N] [--seed N] [--keep FOLDER] [--end=.dr]... FILE|FOLDER...
//
// First every file of the corpus as it is, then changed ones until the time or the number of runs is over (without
// either, only the files). An input that crashes, or takes more than five seconds of processor time, is written to a
// file crash-SEED-RUN before the process dies.
//
// Where the code tells what it reaches (coverage.h), an input that reaches something new is changed again from then on,
// files that reach nothing new are not changed, and --keep writes such inputs to a folder, from where later runs start.
// A line each time that the runs have doubled says how many there were, what they reached, and which was the last to
// reach something new. SIGINT and SIGTERM end it as time does.
#include <fcntl.h>
#include <sys/time.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <random>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/fuzz/coverage.h"
#include "tests/fuzz/mutate.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);
// Where a target knows better than tokens how its inputs are changed: the new size of what stands in `data`.
extern "C" __attribute__((weak)) size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max, unsigned seed);
// There with the sanitizers only.
extern "C" __attribute__((weak)) void __sanitizer_set_death_callback(void (*)());

namespace {

constexpr int kSecondsAnInput = 5;

// The running input, for whoever has to write it in a dying process: no allocation, no locks.
std::string current;
std::array<char, 64> crash_file = {};

void write_all(int file, const char* data, size_t size) {
  while (size > 0) {
    const ssize_t written = write(file, data, size);
    if (written <= 0) return;
    data += written;
    size -= static_cast<size_t>(written);
  }
}

void tell(const char* message) { write_all(STDERR_FILENO, message, std::strlen(message)); }

void save_input() {
  static bool saved = false;
  if (std::exchange(saved, true)) return;
  const int file = open(crash_file.data(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
  write_all(file, current.data(), current.size());
  close(file);
  tell("\nthe input is in ");
  tell(crash_file.data());
  tell("\n");
}

void on_signal(int signal) {
  if (signal == SIGPROF) tell("\nan input takes too long");
  save_input();
  std::signal(signal, SIG_DFL);
  if (signal == SIGPROF) std::abort();
  raise(signal);
}

volatile std::sig_atomic_t is_stopped = 0;

void install_handlers() {
  for (const int signal : {SIGINT, SIGTERM}) std::signal(signal, [](int) { is_stopped = 1; });
  if (__sanitizer_set_death_callback != nullptr) __sanitizer_set_death_callback(save_input);
  static std::array<char, 1 << 16> stack;  // where the usual one has overflowed
  stack_t other = {};
  other.ss_sp = stack.data();
  other.ss_size = stack.size();
  sigaltstack(&other, nullptr);
  struct sigaction action = {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_ONSTACK;
  std::vector<int> signals = {SIGABRT, SIGPROF};
  if (__sanitizer_set_death_callback == nullptr) signals.insert(signals.end(), {SIGSEGV, SIGBUS, SIGFPE, SIGILL});
  for (const int signal : signals) sigaction(signal, &action, nullptr);
}

double processor_time() {
  timespec now = {};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

void run(const std::string& text, uint64_t seed, uint64_t number) {
  current = text;
  std::snprintf(crash_file.data(), crash_file.size(), "crash-%llu-%llu", static_cast<unsigned long long>(seed),
                static_cast<unsigned long long>(number));
  const itimerval limit = {.it_interval = {}, .it_value = {.tv_sec = kSecondsAnInput, .tv_usec = 0}};
  setitimer(ITIMER_PROF, &limit, nullptr);
  LLVMFuzzerTestOneInput(reinterpret_cast<const uint8_t*>(text.data()), text.size());
  const itimerval off = {};
  setitimer(ITIMER_PROF, &off, nullptr);
}

struct Settings {
  uint64_t seconds = 0, runs = 0, seed = 1;
  std::string keep;
  std::vector<std::string> places, ends;
};

std::vector<std::string> read_corpus(const Settings& settings) {
  namespace fs = std::filesystem;
  std::vector<std::string> files;
  for (const std::string& place : settings.places) {
    if (!fs::is_directory(place)) {
      files.push_back(place);
      continue;
    }
    for (const auto& entry : fs::recursive_directory_iterator(place)) {
      const std::string file = entry.path().string();
      const bool wanted = place == settings.keep ||
                          std::ranges::any_of(settings.ends, [&](const auto& end) { return file.ends_with(end); });
      if (entry.is_regular_file() && wanted) files.push_back(file);
    }
  }
  std::sort(files.begin(), files.end());
  std::vector<std::string> texts;
  for (const std::string& file : files) {
    std::ostringstream text;
    text << std::ifstream(file, std::ios::binary).rdbuf();
    texts.push_back(std::move(text).str());
  }
  // What reaches the same in less comes first.
  std::ranges::stable_sort(texts, {}, &std::string::size);
  return texts;
}

// Inputs, and what came of them.
class Fuzzer {
 public:
  explicit Fuzzer(const Settings& settings) : settings_(settings), files_(read_corpus(settings)) {}

  bool has_files() const { return !files_.empty(); }
  void go();

 private:
  double elapsed() const { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count(); }
  void try_input(const std::string& text, bool from_files);
  void keep(const std::string& text) const;
  void report() const;

  Settings settings_;
  std::vector<std::string> files_;     // as they came
  std::vector<dr::fuzz::Input> pool_;  // what is changed
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
  uint64_t number_ = 0, last_new_ = 0;
};

// What reaches what none before it did is changed from then on.
void Fuzzer::try_input(const std::string& text, bool from_files) {
  const dr::fuzz::Coverage before = dr::fuzz::coverage();
  const double start = processor_time();
  run(text, settings_.seed, ++number_);
  const double cost = processor_time() - start;
  const dr::fuzz::Coverage after = dr::fuzz::coverage();
  const bool is_new = after.blocks != before.blocks || after.edges != before.edges;
  if (is_new) last_new_ = number_;
  if (is_new || (from_files && after.blocks == 0)) pool_.push_back({text, cost});
  if (is_new && !from_files) keep(text);
  if (number_ >= 1024 && (number_ & (number_ - 1)) == 0) report();
}

void Fuzzer::keep(const std::string& text) const {
  if (settings_.keep.empty()) return;
  std::array<char, 32> name = {};
  std::snprintf(name.data(), name.size(), "%016zx", std::hash<std::string>()(text));
  std::ofstream(std::filesystem::path(settings_.keep) / name.data(), std::ios::binary) << text;
}

void Fuzzer::report() const {
  const dr::fuzz::Coverage reached = dr::fuzz::coverage();
  std::printf("%llu runs in %.0f seconds", static_cast<unsigned long long>(number_), elapsed());
  if (reached.blocks > 0)
    std::printf(": %llu blocks, %llu edges, %zu inputs, the last of them run %llu",
                static_cast<unsigned long long>(reached.blocks), static_cast<unsigned long long>(reached.edges),
                pool_.size(), static_cast<unsigned long long>(last_new_));
  std::printf("\n");
  std::fflush(stdout);
}

void Fuzzer::go() {
  for (const std::string& text : files_)
    if (is_stopped == 0) try_input(text, true);
  if (pool_.empty()) return report();
  dr::fuzz::Mutator mutator(pool_, files_, settings_.seed);
  std::mt19937_64 seeds(settings_.seed);
  constexpr size_t kMost = size_t{1} << 17;
  std::vector<uint8_t> room;
  const auto next = [&] {
    if (LLVMFuzzerCustomMutator == nullptr || seeds() % 4 == 0) return mutator.next();
    const std::string& text = mutator.any_text();
    room.assign(std::max(text.size(), kMost), 0);
    std::copy(text.begin(), text.end(), room.begin());
    const size_t size = LLVMFuzzerCustomMutator(room.data(), text.size(), room.size(), static_cast<unsigned>(seeds()));
    return std::string(room.begin(), room.begin() + static_cast<ptrdiff_t>(size));
  };
  const auto is_over = [&](uint64_t changed) {
    return settings_.seconds > 0 ? elapsed() >= static_cast<double>(settings_.seconds) : changed >= settings_.runs;
  };
  for (uint64_t changed = 0; !is_over(changed) && is_stopped == 0; ++changed) try_input(next(), false);
  report();
}

[[noreturn]] void usage() {
  std::fputs("usage: fuzz_NAME [--seconds N] [--runs N] [--seed N] [--keep FOLDER] [--end=.dr]... FILE|FOLDER...\n",
             stderr);
  std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
  Settings settings;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const bool has_value = i + 1 < argc;
    if (!word.starts_with("--")) {
      settings.places.push_back(word);
    } else if (word.starts_with("--end=")) {
      settings.ends.push_back(word.substr(6));
    } else if (!has_value) {
      usage();
    } else if (word == "--keep") {
      settings.keep = argv[++i];
      std::filesystem::create_directories(settings.keep);
      settings.places.push_back(settings.keep);
    } else {
      uint64_t* const number = word == "--seconds" ? &settings.seconds
                               : word == "--runs"  ? &settings.runs
                               : word == "--seed"  ? &settings.seed
                                                   : nullptr;
      if (number == nullptr) usage();
      *number = std::strtoull(argv[++i], nullptr, 10);
    }
  }
  Fuzzer fuzzer(settings);
  if (!fuzzer.has_files()) usage();
  install_handlers();
  std::printf("seed %llu\n", static_cast<unsigned long long>(settings.seed));
  std::fflush(stdout);
  fuzzer.go();
  return 0;
}
