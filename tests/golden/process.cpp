// SPDX-License-Identifier: Apache-2.0
// A child process whose output goes to unnamed temporary files: unlike pipes, they cannot fill up.

#include "tests/golden/process.h"

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <system_error>

namespace dr::golden {
namespace {

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

[[noreturn]] void fail(const char* what) { throw std::system_error(errno, std::generic_category(), what); }

File temporary_file() {
  File file(std::tmpfile());
  if (!file) fail("cannot create a temporary file");
  return file;
}

std::string contents(std::FILE* file) {
  std::string text;
  std::rewind(file);
  std::array<char, 4096> chunk{};
  while (const size_t count = std::fread(chunk.data(), 1, chunk.size(), file)) text.append(chunk.data(), count);
  return text;
}

}  // namespace

ProcessResult run_process(const std::filesystem::path& command, const std::vector<std::string>& arguments,
                          const std::filesystem::path& folder) {
  std::string name = command.string();
  std::vector<std::string> words = arguments;
  std::vector<char*> argv{name.data()};
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  const File out = temporary_file();
  const File err = temporary_file();

  const pid_t child = fork();
  if (child < 0) fail("cannot start a process");
  if (child == 0) {
    // A finding of a sanitizer must not look like exit code 1, which tests of errors expect.
    setenv("ASAN_OPTIONS", "exitcode=86", 0);
    setenv("UBSAN_OPTIONS", "exitcode=86:print_stacktrace=1", 0);
    const int input = open("/dev/null", O_RDONLY);
    if (input >= 0 && dup2(input, STDIN_FILENO) >= 0 && dup2(fileno(out.get()), STDOUT_FILENO) >= 0 &&
        dup2(fileno(err.get()), STDERR_FILENO) >= 0 && chdir(folder.c_str()) == 0) {
      execv(name.c_str(), argv.data());
    }
    dprintf(STDERR_FILENO, "%s: %s\n", name.c_str(), std::strerror(errno));
    _exit(127);
  }

  int status = 0;
  while (waitpid(child, &status, 0) < 0) {
    if (errno != EINTR) fail("cannot wait for a process");
  }
  ProcessResult result;
  result.exit_code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  result.out = contents(out.get());
  result.err = contents(err.get());
  return result;
}

}  // namespace dr::golden
