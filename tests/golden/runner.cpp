// SPDX-License-Identifier: Apache-2.0
// golden_runner: runs drc on .dr, .ir and .schedule files as their directives say (tests/golden/directive.h), and
// compares what it prints with the expectation files beside them.

#include <algorithm>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <system_error>
#include <vector>

#include "tests/golden/diff.h"
#include "tests/golden/directive.h"
#include "tests/golden/process.h"

namespace dr::golden {
namespace {

namespace fs = std::filesystem;

constexpr int kFailure = 1;
constexpr int kBadUsage = 2;
constexpr int kSkipped = 77;  // ctest's SKIP_RETURN_CODE

constexpr std::string_view kUsage =
    "usage: golden_runner --drc PATH [--update] [--file FILE]... [FOLDER]...   run tests; rewrite expectations\n"
    "       golden_runner --list FOLDER...      name the files that hold directives\n"
    "       golden_runner --unused FOLDER...    fail on expectation files that no test reads\n";

struct Options {
  enum class Mode { Run, List, Unused };
  Mode mode = Mode::Run;
  bool update = false;
  fs::path drc;
  std::vector<fs::path> paths;  // files and folders
};

enum class Outcome { Passed, Failed, Skipped };

void print(std::string_view text) { std::fwrite(text.data(), 1, text.size(), stdout); }

std::optional<std::string> read_file(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  if (!stream) return std::nullopt;
  return std::string(std::istreambuf_iterator<char>(stream), {});
}

// Whole or not at all: an interrupted update must not leave half an expectation.
void write_file(const fs::path& path, const std::string& text) {
  const fs::path temporary = path.string() + ".new";
  std::ofstream stream(temporary, std::ios::binary);
  stream << text;
  stream.close();
  if (!stream) throw std::system_error(errno, std::generic_category(), "cannot write " + temporary.string());
  fs::rename(temporary, path);
}

std::string replace_all(std::string text, std::string_view from, std::string_view to) {
  for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
  return text;
}

// The .dr, .ir and .schedule files under `roots`, sorted. A root that does not exist holds none.
std::vector<fs::path> sources_under(const std::vector<fs::path>& roots) {
  std::set<fs::path> files;
  for (const fs::path& root : roots) {
    if (fs::is_regular_file(root)) files.insert(root);
    if (!fs::is_directory(root)) continue;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root)) {
      const fs::path extension = entry.path().extension();
      if (entry.is_regular_file() && (extension == ".dr" || extension == ".ir" || extension == ".schedule"))
        files.insert(entry.path());
    }
  }
  return {files.begin(), files.end()};
}

struct ReportedError {
  size_t line = 0;  // of the code in the tested file, 0 in another file
  std::string code;
  std::string message;
  std::string text;  // the line as printed
};

// Reads `file:line:col: error[E0312]: message` lines and leaves the rest of a report alone.
std::vector<ReportedError> reported_errors(const std::string& output, const std::string& file,
                                           const std::string& source) {
  std::vector<ReportedError> errors;
  for (size_t begin = 0; begin < output.size();) {
    const size_t end = std::min(output.find('\n', begin), output.size());
    const std::string line = output.substr(begin, end - begin);
    begin = end + 1;
    constexpr std::string_view kMark = ": error[";
    const size_t mark = line.find(kMark);
    const size_t close = line.find("]: ", mark == std::string::npos ? line.size() : mark);
    if (close == std::string::npos) continue;
    const size_t column = line.rfind(':', mark - 1);
    const size_t number = column == std::string::npos || column == 0 ? std::string::npos : line.rfind(':', column - 1);
    if (number == std::string::npos) continue;
    const std::string digits = line.substr(number + 1, column - number - 1);
    if (digits.empty() || digits.size() > 9 || digits.find_first_not_of("0123456789") != std::string::npos) continue;
    ReportedError error;
    if (line.substr(0, number) == file) error.line = code_line_of(source, std::stoul(digits));
    error.code = line.substr(mark + kMark.size(), close - mark - kMark.size());
    error.message = line.substr(close + 3);
    error.text = line;
    errors.push_back(error);
  }
  return errors;
}

class FileTest {
 public:
  FileTest(const Options& options, const fs::path& path, std::string source)
      : options_(options),
        path_(path),
        folder_(fs::canonical(path).parent_path()),
        name_(path.filename().string()),
        source_(std::move(source)),
        directives_(parse_directives(source_)) {}

  Outcome run() {
    for (const std::string& problem : directives_.problems) fail(path_.string() + ":" + problem);
    if (directives_.tests.empty() && directives_.errors.empty()) fail(path_.string() + ": no //TEST and no //ERROR");
    if (failures_.empty()) {
      for (const TestRun& test : directives_.tests) run_test(test);
      if (!directives_.errors.empty()) run_check();
    }
    if (!directives_.skip || !directives_.problems.empty()) {
      print(failures_);
      return failures_.empty() ? Outcome::Passed : Outcome::Failed;
    }
    if (failures_.empty()) {
      print(path_.string() + ": passes; remove its //SKIP\n");
      return Outcome::Failed;
    }
    print(path_.string() + ": skipped: " + *directives_.skip + "\n");
    return Outcome::Skipped;
  }

 private:
  void fail(const std::string& message) { failures_ += message + "\n"; }

  // Runs drc in the file's folder on its bare name, and drops that folder from what it prints: no paths in
  // expectations.
  ProcessResult run_drc(std::vector<std::string> arguments) {
    bool is_mentioned = false;
    for (std::string& argument : arguments) {
      is_mentioned = is_mentioned || argument.find("{file}") != std::string::npos;
      argument = replace_all(argument, "{file}", name_);
    }
    if (!is_mentioned) arguments.push_back(name_);
    ProcessResult result = run_process(options_.drc, arguments, folder_);
    const std::string prefix = folder_.string() + "/";
    result.out = replace_all(result.out, prefix, "");
    result.err = replace_all(result.err, prefix, "");
    return result;
  }

  // Whether drc ended as expected; what it said otherwise.
  bool has_exit_code(const ProcessResult& result, int expected, const std::string& where) {
    if (result.exit_code == expected) return true;
    fail(where + ": drc exits with " + std::to_string(result.exit_code) + ", expected " + std::to_string(expected) +
         (result.err.empty() ? "" : "\n" + result.err));
    return false;
  }

  void run_test(const TestRun& test) {
    const std::string where = path_.string() + ":" + std::to_string(test.line);
    const ProcessResult result = run_drc(test.arguments);
    if (!has_exit_code(result, directives_.exit_code, where)) return;
    const std::string& printed = directives_.compare_stderr ? result.err : result.out;
    if (&test == directives_.tests.data() && !directives_.checks.empty()) {
      run_checks(printed);
      return;
    }
    const std::string expectation = expectation_name(path_.stem().string(), test);
    const std::optional<std::string> expected = read_file(folder_ / expectation);
    if (expected == printed) return;
    const std::string before = expected ? expectation : "/dev/null";
    const std::string diff = unified_diff(expected.value_or(""), printed, before, "drc's output");
    if (options_.update && !directives_.skip) {
      write_file(folder_ / expectation, printed);
      print((path_.parent_path() / expectation).string() + (expected ? ": changed\n" : ": new\n") + diff);
    } else {
      fail(where + ": output differs from " + expectation + (expected ? "\n" : ", which does not exist\n") + diff);
    }
  }

  // Each //CHECK after the one before; each //CHECK-NOT nowhere between its neighbours.
  void run_checks(const std::string& output) {
    size_t position = 0;
    std::vector<const Check*> absent;
    const auto check_absent = [&](size_t end) {
      for (const Check* check : absent) {
        const size_t found = output.find(check->text, position);
        if (found != std::string::npos && found + check->text.size() <= end) {
          fail(path_.string() + ":" + std::to_string(check->line) + ": found, though it must not be: " + check->text);
        }
      }
      absent.clear();
    };
    const size_t failures_before = failures_.size();
    for (const Check& check : directives_.checks) {
      if (check.negative) {
        absent.push_back(&check);
        continue;
      }
      const size_t found = output.find(check.text, position);
      if (found == std::string::npos) {
        fail(path_.string() + ":" + std::to_string(check.line) + ": not found" +
             (position > 0 ? " after the text above it: " : ": ") + check.text);
        break;
      }
      check_absent(found);
      position = found + check.text.size();
    }
    check_absent(output.size());
    if (failures_.size() != failures_before) fail("drc's output:\n" + output);
  }

  void run_check() {
    const ProcessResult result = run_drc({"check"});
    has_exit_code(result, 1, path_.string() + ": drc check");
    std::vector<ReportedError> errors = reported_errors(result.out + result.err, name_, source_);
    for (const ExpectedError& expected : directives_.errors) {
      const auto match = std::find_if(errors.begin(), errors.end(), [&](const ReportedError& error) {
        return error.line == expected.code_line && error.code == expected.code &&
               error.message.find(expected.text) != std::string::npos;
      });
      if (match != errors.end()) {
        errors.erase(match);
        continue;
      }
      fail(path_.string() + ":" + std::to_string(expected.line) + ": drc does not report " + expected.code +
           (expected.text.empty() ? "" : " '" + expected.text + "'") + " for line " +
           std::to_string(expected.code_line));
    }
    for (const ReportedError& error : errors) fail(path_.string() + ": no //ERROR below the line for: " + error.text);
  }

  const Options& options_;
  fs::path path_;
  fs::path folder_;
  std::string name_;
  std::string source_;
  Directives directives_;
  std::string failures_;
};

int run_tests(const Options& options) {
  std::map<Outcome, int> counts;
  const std::vector<fs::path> files = sources_under(options.paths);
  for (const fs::path& path : files) {
    std::optional<std::string> source = read_file(path);
    const bool is_named = std::find(options.paths.begin(), options.paths.end(), path) != options.paths.end();
    if (source && !is_named && !parse_directives(*source).any()) continue;  // a module that tests import
    if (!source) {
      print(path.string() + ": cannot be read\n");
      ++counts[Outcome::Failed];
      continue;
    }
    ++counts[FileTest(options, path, std::move(*source)).run()];
  }
  if (files.size() != 1) {
    print(std::to_string(counts[Outcome::Passed]) + " passed, " + std::to_string(counts[Outcome::Failed]) +
          " failed, " + std::to_string(counts[Outcome::Skipped]) + " skipped\n");
  }
  if (counts[Outcome::Failed] > 0) return kFailure;
  return files.size() == 1 && counts[Outcome::Skipped] > 0 ? kSkipped : 0;
}

int list_files(const std::vector<fs::path>& roots) {
  for (const fs::path& path : sources_under(roots)) {
    const std::optional<std::string> source = read_file(path);
    if (source && parse_directives(*source).any()) print(path.string() + "\n");
  }
  return 0;
}

// Fails on an expectation that no test reads, and on one that two tests (a.dr and a.ir) would share.
int find_unused(const std::vector<fs::path>& roots) {
  std::map<fs::path, int> readers;
  for (const fs::path& path : sources_under(roots)) {
    const Directives directives = parse_directives(read_file(path).value_or(""));
    for (const TestRun& test : directives.tests) {
      if (&test == directives.tests.data() && !directives.checks.empty()) continue;
      ++readers[path.parent_path() / expectation_name(path.stem().string(), test)];
    }
  }
  int status = 0;
  for (const auto& [path, count] : readers) {
    if (count == 1) continue;
    print(path.string() + ": read by several tests\n");
    status = kFailure;
  }
  for (const fs::path& root : roots) {
    if (!fs::is_directory(root)) continue;
    for (const fs::directory_entry& entry : fs::recursive_directory_iterator(root)) {
      if (entry.path().extension() != ".expected" || readers.contains(entry.path())) continue;
      print(entry.path().string() + ": no test reads it\n");
      status = kFailure;
    }
  }
  return status;
}

// Nothing when the command line makes no sense.
std::optional<Options> parse_options(const std::vector<std::string>& arguments) {
  Options options;
  for (size_t i = 0; i < arguments.size(); ++i) {
    const std::string& argument = arguments[i];
    if (argument == "--update") {
      options.update = true;
    } else if (argument == "--list") {
      options.mode = Options::Mode::List;
    } else if (argument == "--unused") {
      options.mode = Options::Mode::Unused;
    } else if ((argument == "--drc" || argument == "--file") && i + 1 < arguments.size()) {
      const fs::path value = arguments[++i];
      if (argument == "--drc") options.drc = fs::absolute(value);
      if (argument == "--file") options.paths.push_back(value);
      if (argument == "--file" && !fs::is_regular_file(value)) return std::nullopt;
    } else if (argument.starts_with("-")) {
      return std::nullopt;
    } else {
      options.paths.emplace_back(argument);
    }
  }
  const bool needs_drc = options.mode == Options::Mode::Run;
  if (options.paths.empty() || needs_drc == options.drc.empty() || (options.update && !needs_drc)) return std::nullopt;
  return options;
}

int run(const std::vector<std::string>& arguments) {
  if (arguments == std::vector<std::string>{"--help"}) {
    print(kUsage);
    return 0;
  }
  const std::optional<Options> options = parse_options(arguments);
  if (!options) {
    std::fwrite(kUsage.data(), 1, kUsage.size(), stderr);
    return kBadUsage;
  }
  switch (options->mode) {
    case Options::Mode::Run: return run_tests(*options);
    case Options::Mode::List: return list_files(options->paths);
    case Options::Mode::Unused: return find_unused(options->paths);
  }
  return kBadUsage;
}

}  // namespace
}  // namespace dr::golden

int main(int argc, char** argv) {
  try {
    return dr::golden::run({argv + 1, argv + argc});
  } catch (const std::exception& error) {
    std::fprintf(stderr, "golden_runner: %s\n", error.what());
    return dr::golden::kFailure;
  }
}
