// SPDX-License-Identifier: Apache-2.0
#include "runtime/drun/loss_log.h"

#include "runtime/drun/target.h"

namespace dr::drun {

void LossLog::add(const std::string& line, const std::string& before) {
  if (path_.empty()) return;
  if (!file_) {
    file_.reset(std::fopen(path_.c_str(), "wb"));
    if (!file_) throw Mistake{"cannot write '" + path_ + "'"};
    waiting_ = before;
  }
  waiting_ += line;
  if (std::chrono::steady_clock::now() - flushed_ >= std::chrono::seconds(1)) flush();
}

void LossLog::flush() {
  if (!file_ || waiting_.empty()) return;
  const bool written = std::fwrite(waiting_.data(), 1, waiting_.size(), file_.get()) == waiting_.size();
  if (std::fflush(file_.get()) != 0 || !written) throw Mistake{"cannot write '" + path_ + "'"};
  waiting_.clear();
  flushed_ = std::chrono::steady_clock::now();
}

}  // namespace dr::drun
