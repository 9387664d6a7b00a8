// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/loss_log.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <system_error>

namespace dr::drun {

LossLog::~LossLog() {
  if (descriptor_ >= 0) close(descriptor_);
}

std::optional<std::string> LossLog::add(const std::string& line, const std::string& before) {
  if (path_.empty()) return std::nullopt;
  if (!is_begun_) waiting_ = before;
  is_begun_ = true;
  waiting_ += line;
  if (std::chrono::steady_clock::now() - flushed_ < std::chrono::seconds(1)) return failed_;
  return flush();
}

std::optional<std::string> LossLog::flush() {
  failed_.reset();
  if (waiting_.empty()) return failed_;
  flushed_ = std::chrono::steady_clock::now();
  if (const auto reason = write_waiting()) failed_ = "cannot write '" + path_ + "': " + *reason;
  return failed_;
}

std::optional<std::string> LossLog::restore(const std::string& lines) {
  std::error_code error;
  if (!is_begun_ && std::filesystem::file_size(path_, error) != lines.size()) add("", lines);
  return flush();
}

// What is written of a line that found no room is taken back.
std::optional<std::string> LossLog::write_waiting() {
  const auto reason = [] { return std::generic_category().message(errno); };
  if (descriptor_ < 0) descriptor_ = open(path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  if (descriptor_ < 0) return reason();
  std::optional<std::string> failed;
  size_t written = 0;
  while (written < waiting_.size() && !failed) {
    const ssize_t now = write(descriptor_, waiting_.data() + written, waiting_.size() - written);
    if (now >= 0)
      written += static_cast<size_t>(now);
    else if (errno != EINTR)
      failed = reason();
  }
  const size_t whole = written == 0 ? 0 : waiting_.rfind('\n', written - 1) + 1;
  if (whole < written) {
    const off_t end = lseek(descriptor_, -static_cast<off_t>(written - whole), SEEK_CUR);
    if (end >= 0 && ftruncate(descriptor_, end) != 0) failed = reason();
  }
  waiting_.erase(0, whole);
  return failed;
}

}  // namespace dr::drun
