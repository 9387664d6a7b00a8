// SPDX-License-Identifier: Apache-2.0
// The log of losses, OUT/log.jsonl: a JSON object a line, there for others to read while the steps run.
#pragma once

#include <chrono>
#include <optional>
#include <string>

namespace dr::drun {

class LossLog {
 public:
  // Nothing is written before the first line; what an earlier run left in the file goes then. An empty path: no file.
  explicit LossLog(std::string path) : path_(std::move(path)) {}
  LossLog(const LossLog&) = delete;
  LossLog& operator=(const LossLog&) = delete;
  ~LossLog();
  // After the lines `before`, which are those of the run that goes on; they are looked at once. Lines reach the file
  // whole, all of the last second together. All give why some could not be written, if so: these wait for the next
  // time.
  std::optional<std::string> add(const std::string& line, const std::string& before);
  std::optional<std::string> flush();
  // The same where no line was added, and `lines` may be missing in the file: a run before found no room for them.
  std::optional<std::string> restore(const std::string& lines);

 private:
  std::optional<std::string> write_waiting();

  std::string path_, waiting_;
  std::optional<std::string> failed_;  // why lines wait
  bool is_begun_ = false;
  int descriptor_ = -1;
  std::chrono::steady_clock::time_point flushed_{};
};

}  // namespace dr::drun
