// SPDX-License-Identifier: Apache-2.0
// The log of losses, OUT/log.jsonl: a JSON object a line, there for others to read while the steps run.
#pragma once

#include <chrono>
#include <cstdio>
#include <memory>
#include <string>

namespace dr::drun {

class LossLog {
 public:
  // Nothing is written before the first line; what an earlier run left in the file goes then. An empty path: no file.
  explicit LossLog(std::string path) : path_(std::move(path)) {}
  // After the lines `before`, which are those of the run that goes on; they are looked at once. Lines reach the file
  // whole, all of the last second together. Throws Mistake.
  void add(const std::string& line, const std::string& before);
  void flush();

 private:
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  std::string path_, waiting_;
  std::unique_ptr<std::FILE, Close> file_;
  std::chrono::steady_clock::time_point flushed_{};
};

}  // namespace dr::drun
