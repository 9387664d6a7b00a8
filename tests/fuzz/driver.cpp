// SPDX-License-Identifier: Apache-2.0
// Runs a fuzz target over a corpus and random changes of it, where there is no libFuzzer:
//
//   fuzz_NAME [--seconds N] [--runs N] [--seed N] [--end=.dr]... FILE|FOLDER...
//
// First every file of the corpus as it is, then changed ones until the time or the number of runs is over (without
// either, only the files). It prints how many runs there were. An input that crashes, or takes more than five seconds
// of processor time, is written to a file crash-SEED-RUN before the process dies.
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
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "tests/fuzz/mutate.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size);
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

void install_handlers() {
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

std::vector<std::string> read_corpus(const std::vector<std::string>& places, const std::vector<std::string>& ends) {
  namespace fs = std::filesystem;
  std::vector<std::string> files;
  for (const std::string& place : places) {
    if (!fs::is_directory(place)) {
      files.push_back(place);
      continue;
    }
    for (const auto& entry : fs::recursive_directory_iterator(place)) {
      const std::string file = entry.path().string();
      const bool wanted = std::ranges::any_of(ends, [&](const std::string& end) { return file.ends_with(end); });
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
  return texts;
}

[[noreturn]] void usage() {
  std::fputs("usage: fuzz_NAME [--seconds N] [--runs N] [--seed N] [--end=.dr]... FILE|FOLDER...\n", stderr);
  std::exit(2);
}

}  // namespace

int main(int argc, char** argv) {
  uint64_t seconds = 0, runs = 0, seed = 1;
  std::vector<std::string> places, ends;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const bool has_value = i + 1 < argc;
    if (!word.starts_with("--")) {
      places.push_back(word);
    } else if (word.starts_with("--end=")) {
      ends.push_back(word.substr(6));
    } else if (!has_value) {
      usage();
    } else {
      uint64_t* const number = word == "--seconds" ? &seconds
                               : word == "--runs"  ? &runs
                               : word == "--seed"  ? &seed
                                                   : nullptr;
      if (number == nullptr) usage();
      *number = std::strtoull(argv[++i], nullptr, 10);
    }
  }
  const std::vector<std::string> corpus = read_corpus(places, ends);
  if (corpus.empty()) usage();

  install_handlers();
  std::printf("seed %llu, %zu files\n", static_cast<unsigned long long>(seed), corpus.size());
  std::fflush(stdout);
  const auto start = std::chrono::steady_clock::now();
  const auto elapsed = [&] { return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count(); };
  uint64_t number = 0;
  for (const std::string& text : corpus) run(text, seed, ++number);
  dr::fuzz::Mutator mutator(corpus, seed);
  for (uint64_t changed = 0; seconds > 0 ? elapsed() < static_cast<double>(seconds) : changed < runs; ++changed)
    run(mutator.next(), seed, ++number);
  std::printf("%llu runs in %.0f seconds\n", static_cast<unsigned long long>(number), elapsed());
  return 0;
}
