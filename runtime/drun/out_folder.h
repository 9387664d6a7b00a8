// SPDX-License-Identifier: Apache-2.0
// The folder of a run's results: one run at a time writes to it, and what killed runs left half-written goes.
#pragma once

#include <string>

namespace dr::drun {

class OutFolder {
 public:
  explicit OutFolder(std::string path) : path_(std::move(path)) {}
  OutFolder(const OutFolder&) = delete;
  OutFolder& operator=(const OutFolder&) = delete;
  ~OutFolder();
  // Makes the folder, unless it is there; until the end, no other run gets it. Throws Mistake where another one has it.
  // Where a file system knows no locks, there is none.
  void take();
  // Removes temporary files, and folders of checkpoints other than `in_use`. The folder is taken.
  void sweep(const std::string& in_use) const;

 private:
  std::string path_;
  int descriptor_ = -1;
};

// Returns when the file or folder is on the disk, as far as the system can say.
void sync_to_disk(const std::string& path);

}  // namespace dr::drun
