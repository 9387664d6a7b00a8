// SPDX-License-Identifier: Apache-2.0
// Memory for code that cannot take an exception of operator new: its tables would be left half made, and its locks
// held.
#pragma once

namespace dr::backend {

// While one is alive in a thread, an allocation there that finds no memory gets what is kept for it, and done() throws
// std::bad_alloc once the code is through. Where that too is used up, the process ends in words with exit code 1.
class SpareMemory {
 public:
  SpareMemory();
  SpareMemory(const SpareMemory&) = delete;
  SpareMemory& operator=(const SpareMemory&) = delete;
  ~SpareMemory();
  void done();
};

}  // namespace dr::backend
