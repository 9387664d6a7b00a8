// SPDX-License-Identifier: Apache-2.0
// CUDA beside Vulkan on one GPU: memory that both see, and streams and the queue that wait for each other without the
// host. The driver's library is opened when it is first asked for: nothing of CUDA is needed to build or to load this.
#pragma once

#include <cstdint>
#include <memory>

#include "runtime/vk/device.h"

namespace dr::runtime {

using CudaStream = void*;  // a CUstream: 0 and 1 are the default one, 2 is the thread's own

// CUDA's device that is the same GPU. Throws Failure, as all here do, with what CUDA says.
class Cuda {
 public:
  // The device's own; opened on the first call.
  static std::shared_ptr<Cuda> of(DeviceState& device);
  ~Cuda();
  int ordinal() const { return ordinal_; }
  // Copies rows of bytes after what is on the stream: `count` of `bytes` each, that begin so many bytes apart.
  struct Rows {
    uint64_t address;
    size_t pitch;
  };
  void copy(Rows to, Rows from, size_t bytes, size_t count, CudaStream stream) const;
  // Waits for all streams.
  void finish() const;

 private:
  friend class CudaMemory;
  friend class CudaOrder;
  struct Api;
  class Current;
  Cuda() = default;
  std::unique_ptr<Api> api_;
  int ordinal_ = 0, device_ = 0;
  void* context_ = nullptr;  // the primary one, which the runtime API and the libraries over it use
};

// Memory of Vulkan as CUDA sees it. It lives until this is gone, also when Vulkan gave it back.
class CudaMemory {
 public:
  // Takes the file that names it.
  CudaMemory(std::shared_ptr<Cuda> cuda, int file, size_t bytes);
  CudaMemory(const CudaMemory&) = delete;
  CudaMemory& operator=(const CudaMemory&) = delete;
  ~CudaMemory();  // when all streams are done
  uint64_t address() const { return address_; }

 private:
  std::shared_ptr<Cuda> cuda_;
  void* memory_ = nullptr;
  uint64_t address_ = 0;
};

// The order of a stream and submissions to a queue: each waits for what the other was given before.
class CudaOrder {
 public:
  CudaOrder(const std::shared_ptr<DeviceState>& device, std::shared_ptr<Cuda> cuda);
  CudaOrder(const CudaOrder&) = delete;
  CudaOrder& operator=(const CudaOrder&) = delete;
  ~CudaOrder();
  const Cuda& cuda() const { return *cuda_; }
  // The stream whose work submissions wait for, and which waits for them, from now on.
  void set_stream(CudaStream stream);
  CudaStream stream() const { return stream_; }
  // Another stream waits for what was submitted so far.
  void let_wait(CudaStream stream) const;

  // For the queue: a submission waits for the semaphore's value `wait` and sets it to `done`.
  struct Values {
    uint64_t wait, done;
  };
  vk::Semaphore semaphore() const { return *semaphore_; }
  Values before_submission();
  void after_submission(const Values& values);

 private:
  void signal(uint64_t value) const;
  std::shared_ptr<DeviceState> device_;
  std::shared_ptr<Cuda> cuda_;
  vk::raii::Semaphore semaphore_{nullptr};
  void* imported_ = nullptr;
  CudaStream stream_ = nullptr;
  uint64_t given_ = 0, submitted_ = 0;  // values: the last that was given out, and that a submission sets
};

}  // namespace dr::runtime
