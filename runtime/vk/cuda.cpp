// SPDX-License-Identifier: Apache-2.0
// The driver's interface, as far as it is needed, and what stands on it.
#include "runtime/vk/cuda.h"

#include <dlfcn.h>
#include <unistd.h>

#include <array>
#include <cstring>
#include <string>
#include <utility>

namespace dr::runtime {

namespace {

// As CUDA's manual has them (CUDA_EXTERNAL_MEMORY_HANDLE_DESC and so on); the sizes are part of its binary interface.
struct Handle {  // of memory or of a semaphore
  union {
    int file;
    struct {
      void* handle;
      const void* name;
    } named;
  };
};
struct MemoryHandle {
  int type = 0;
  Handle handle = {};
  unsigned long long size = 0;
  unsigned flags = 0, reserved[16] = {};
};
struct MappedBuffer {
  unsigned long long offset = 0, size = 0;
  unsigned flags = 0, reserved[16] = {};
};
struct SemaphoreHandle {
  int type = 0;
  Handle handle = {};
  unsigned flags = 0, reserved[16] = {};
};
struct SemaphoreValue {  // to set, or to wait for
  unsigned long long value = 0, others[2] = {};
  unsigned more[12] = {}, flags = 0, reserved[16] = {};
};
struct Side {  // of a copy
  size_t x = 0, y = 0;
  int type = 0;
  void* host = nullptr;
  uint64_t address = 0;
  void* array = nullptr;
  size_t pitch = 0;
};
struct Copy {
  Side from, to;
  size_t width = 0, height = 0;
};
static_assert(sizeof(MemoryHandle) == 104 && sizeof(MappedBuffer) == 88 && sizeof(SemaphoreHandle) == 96 &&
              sizeof(SemaphoreValue) == 144 && sizeof(Copy) == 128);

constexpr int kFile = 1, kTimelineFile = 9, kOnDevice = 2;

}  // namespace

struct Cuda::Api {
  void* library = nullptr;
  int (*get_error)(int, const char**) = nullptr;
  int (*init)(unsigned) = nullptr;
  int (*device_count)(int*) = nullptr;
  int (*device_get)(int*, int) = nullptr;
  int (*device_uuid)(void*, int) = nullptr;
  int (*retain)(void**, int) = nullptr;
  int (*release)(int) = nullptr;
  int (*current)(void**) = nullptr;
  int (*push)(void*) = nullptr;
  int (*pop)(void**) = nullptr;
  int (*synchronize)() = nullptr;
  int (*import_memory)(void**, const MemoryHandle*) = nullptr;
  int (*map)(uint64_t*, void*, const MappedBuffer*) = nullptr;
  int (*unmap)(uint64_t) = nullptr;
  int (*destroy_memory)(void*) = nullptr;
  int (*import_semaphore)(void**, const SemaphoreHandle*) = nullptr;
  int (*destroy_semaphore)(void*) = nullptr;
  int (*signal)(void* const*, const SemaphoreValue*, unsigned, CudaStream) = nullptr;
  int (*wait)(void* const*, const SemaphoreValue*, unsigned, CudaStream) = nullptr;
  int (*copy)(uint64_t, uint64_t, size_t, CudaStream) = nullptr;
  int (*copy_rows)(const Copy*, CudaStream) = nullptr;

  Api();
  ~Api() { dlclose(library); }
  void check(int result, const char* what) const {
    if (result == 0) return;
    const char* text = nullptr;
    get_error(result, &text);
    throw DeviceFailure{std::string("CUDA cannot ") + what + ": " +
                        (text != nullptr ? text : "error " + std::to_string(result))};
  }
};

Cuda::Api::Api() : library(dlopen("libcuda.so.1", RTLD_NOW | RTLD_LOCAL)) {
  if (library == nullptr) throw DeviceFailure{"there is no CUDA here: libcuda.so.1 cannot be loaded"};
  const auto load = [this](auto& function, const char* name) {
    void* const found = dlsym(library, name);
    if (found == nullptr) {
      dlclose(library);
      throw DeviceFailure{std::string("the CUDA driver is too old: it has no ") + name};
    }
    std::memcpy(&function, &found, sizeof(found));
  };
  load(get_error, "cuGetErrorString");
  load(init, "cuInit");
  load(device_count, "cuDeviceGetCount");
  load(device_get, "cuDeviceGet");
  load(device_uuid, "cuDeviceGetUuid");
  load(retain, "cuDevicePrimaryCtxRetain");
  load(release, "cuDevicePrimaryCtxRelease_v2");
  load(current, "cuCtxGetCurrent");
  load(push, "cuCtxPushCurrent_v2");
  load(pop, "cuCtxPopCurrent_v2");
  load(synchronize, "cuCtxSynchronize");
  load(import_memory, "cuImportExternalMemory");
  load(map, "cuExternalMemoryGetMappedBuffer");
  load(unmap, "cuMemFree_v2");
  load(destroy_memory, "cuDestroyExternalMemory");
  load(import_semaphore, "cuImportExternalSemaphore");
  load(destroy_semaphore, "cuDestroyExternalSemaphore");
  load(signal, "cuSignalExternalSemaphoresAsync");
  load(wait, "cuWaitExternalSemaphoresAsync");
  load(copy, "cuMemcpyDtoDAsync_v2");
  load(copy_rows, "cuMemcpy2DAsync_v2");
}

// The context is the thread's current one while this lives.
class Cuda::Current {
 public:
  explicit Current(const Cuda& cuda) : cuda_(cuda) {
    void* now = nullptr;
    cuda_.api_->check(cuda_.api_->current(&now), "say its context");
    if (now == cuda_.context_) return;
    cuda_.api_->check(cuda_.api_->push(cuda_.context_), "take its context");
    pushed_ = true;
  }
  Current(const Current&) = delete;
  Current& operator=(const Current&) = delete;
  ~Current() {
    void* popped = nullptr;
    if (pushed_) cuda_.api_->pop(&popped);
  }

 private:
  const Cuda& cuda_;
  bool pushed_ = false;
};

std::shared_ptr<Cuda> Cuda::of(DeviceState& device) {
  const std::lock_guard lock(device.cuda_lock);
  if (device.cuda) return device.cuda;
  if (!device.shares_memory)
    throw DeviceFailure{"the device '" + std::string(device.properties.deviceName.data()) +
                        "' does not share its memory with CUDA"};
  std::shared_ptr<Cuda> cuda(new Cuda);
  cuda->api_ = std::make_unique<Api>();
  const Api& api = *cuda->api_;
  api.check(api.init(0), "start");
  int count = 0;
  api.check(api.device_count(&count), "count its devices");
  for (int k = 0; k < count && cuda->context_ == nullptr; ++k) {
    std::array<uint8_t, VK_UUID_SIZE> uuid = {};
    api.check(api.device_get(&cuda->device_, k), "open a device");
    api.check(api.device_uuid(uuid.data(), cuda->device_), "tell its devices apart");
    if (uuid != device.uuid) continue;
    api.check(api.retain(&cuda->context_, cuda->device_), "open the device");
    cuda->ordinal_ = k;
  }
  if (cuda->context_ == nullptr)
    throw DeviceFailure{"CUDA does not see the device '" + std::string(device.properties.deviceName.data()) + "'"};
  return device.cuda = cuda;
}

Cuda::~Cuda() {
  if (context_ != nullptr) api_->release(device_);
}

void Cuda::copy(Rows to, Rows from, size_t bytes, size_t count, CudaStream stream) const {
  const Current current(*this);
  if (to.pitch == bytes && from.pitch == bytes)
    return api_->check(api_->copy(to.address, from.address, bytes * count, stream), "copy");
  Copy rows;
  rows.from.type = rows.to.type = kOnDevice;
  rows.from.address = from.address;
  rows.from.pitch = from.pitch;
  rows.to.address = to.address;
  rows.to.pitch = to.pitch;
  rows.width = bytes;
  rows.height = count;
  api_->check(api_->copy_rows(&rows, stream), "copy");
}

void Cuda::finish() const {
  const Current current(*this);
  api_->check(api_->synchronize(), "finish");
}

CudaMemory::CudaMemory(std::shared_ptr<Cuda> cuda, int file, size_t bytes) : cuda_(std::move(cuda)) {
  const Cuda::Api& api = *cuda_->api_;
  const Cuda::Current current(*cuda_);
  MemoryHandle handle;
  handle.type = kFile;
  handle.handle.file = file;
  handle.size = bytes;
  const int result = api.import_memory(&memory_, &handle);
  if (result != 0) close(file);  // else it is CUDA's
  api.check(result, "take memory of Vulkan");
  MappedBuffer all;
  all.size = bytes;
  if (const int mapped = api.map(&address_, memory_, &all); mapped != 0) {
    api.destroy_memory(memory_);
    api.check(mapped, "map memory of Vulkan");
  }
}

CudaMemory::~CudaMemory() {
  try {
    const Cuda::Current current(*cuda_);
    cuda_->api_->synchronize();
    cuda_->api_->unmap(address_);
    cuda_->api_->destroy_memory(memory_);
  } catch (const Failure&) {  // the process ends, and CUDA did before
  }
}

CudaOrder::CudaOrder(const std::shared_ptr<DeviceState>& device, std::shared_ptr<Cuda> cuda)
    : device_(device), cuda_(std::move(cuda)) {
  vk::ExportSemaphoreCreateInfo exported(vk::ExternalSemaphoreHandleTypeFlagBits::eOpaqueFd);
  vk::SemaphoreTypeCreateInfo timeline(vk::SemaphoreType::eTimeline, 0, &exported);
  semaphore_ = vk::raii::Semaphore(device_->device, vk::SemaphoreCreateInfo({}, &timeline));
  const int file = device_->device.getSemaphoreFdKHR({*semaphore_, vk::ExternalSemaphoreHandleTypeFlagBits::eOpaqueFd});
  const Cuda::Current current(*cuda_);
  SemaphoreHandle handle;
  handle.type = kTimelineFile;
  handle.handle.file = file;
  const int result = cuda_->api_->import_semaphore(&imported_, &handle);
  if (result != 0) close(file);
  cuda_->api_->check(result, "take a semaphore of Vulkan");
}

CudaOrder::~CudaOrder() {
  try {
    const Cuda::Current current(*cuda_);
    cuda_->api_->synchronize();
    cuda_->api_->destroy_semaphore(imported_);
  } catch (const Failure&) {
  }
}

void CudaOrder::set_stream(CudaStream stream) {
  if (stream == stream_) return;
  // The one before may be gone, and cannot be asked.
  cuda_->finish();
  stream_ = stream;
  let_wait(stream);
}

void CudaOrder::let_wait(CudaStream stream) const {
  if (submitted_ == 0) return;
  const Cuda::Current current(*cuda_);
  SemaphoreValue value;
  value.value = submitted_;
  cuda_->api_->check(cuda_->api_->wait(&imported_, &value, 1, stream), "wait for Vulkan");
}

CudaOrder::Values CudaOrder::before_submission() {
  const Cuda::Current current(*cuda_);
  SemaphoreValue value;
  value.value = ++given_;
  cuda_->api_->check(cuda_->api_->signal(&imported_, &value, 1, stream_), "signal Vulkan");
  const uint64_t wait = given_;
  return {wait, ++given_};
}

void CudaOrder::after_submission(const Values& values) {
  submitted_ = values.done;
  let_wait(stream_);
}

}  // namespace dr::runtime
