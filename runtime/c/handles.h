// SPDX-License-Identifier: Apache-2.0
// What the files of the C interface share: handles, errors, arrays. Private to them.
#pragma once

#include <unistd.h>

#include <atomic>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "compiler/backend/bundle/bundle.h"
#include "compiler/ir/internal_error.h"
#include "runtime/c/dressi.h"
#include "runtime/jit/jit.h"
#include "runtime/jit/reference_program.h"
#include "runtime/runtime.h"
#include "runtime/watch/watch.h"

// Who made an object. After a fork the child has the memory of a device and none of its threads: a call would wait for
// them for ever, and so would freeing it.
struct Maker {
  pid_t process = ::getpid();
  bool is_this_process() const { return process == ::getpid(); }
};

struct dressi_device {
  Maker maker;
  std::optional<dr::runtime::Device> device;  // none: the reference
  std::string info;
};

struct dressi_bundle {
  std::vector<uint8_t> bytes;
  dr::bundle::BundleT tables;
  dr::jit::Options options;
  std::string info, schedule;
};

struct dressi_run {
  Maker maker;
  std::mutex mutex;
  std::atomic<std::thread::id> caller;  // whose call has the mutex
  bool is_freed = false;                // by a warning within a call, which deletes it in the end
  dressi_warn warn = nullptr;           // none: stderr
  void* warn_context = nullptr;
  // Shared with views of its memory.
  std::variant<std::shared_ptr<dr::runtime::Program>, std::shared_ptr<dr::jit::ReferenceProgram>> program;
  std::string text;                                         // of the last answer
  std::map<std::string, std::vector<std::string>> outputs;  // by step
  std::unique_ptr<dr::watch::Watch> watch;                  // its page, if there is one, and how often steps ran by it
  std::map<std::string, int64_t> watched_runs;
  std::string watched_step;  // the last one
};

namespace dr::c {

// What dressi_error() says.
inline thread_local std::string last_error;
inline thread_local dressi_error_kind last_kind = DRESSI_NO_ERROR;

struct Mistake {
  dressi_error_kind kind;
  std::string text;
};
[[noreturn]] inline void fail(std::string text, dressi_error_kind kind = DRESSI_USER_ERROR) {
  throw Mistake{kind, std::move(text)};
}

template <typename T>
T must(dr::io::Result<T> result, dressi_error_kind kind = DRESSI_USER_ERROR) {
  if (!result) fail(result.error(), result.blame() == dr::io::Blame::Device ? DRESSI_DEVICE_ERROR : kind);
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

// Runs `make`; what it throws becomes the error, and the answer `failed`.
template <typename Make, typename T>
T guarded(T failed, const Make& make) {
  const auto set = [&](dressi_error_kind kind, std::string text) {
    last_kind = kind;
    last_error = std::move(text);
    return failed;
  };
  try {
    return make();
  } catch (Mistake& mistake) {
    return set(mistake.kind, std::move(mistake.text));
  } catch (const dr::ir::InternalError& error) {
    return set(DRESSI_INTERNAL_ERROR, error.what());
  } catch (const std::bad_alloc&) {
    return set(DRESSI_DEVICE_ERROR, "this machine has not enough memory for the program and its data");
  } catch (const std::exception& error) {
    return set(DRESSI_INTERNAL_ERROR, error.what());
  }
}

template <typename T>
T& given(T* pointer, const char* what) {
  if (pointer == nullptr) fail(std::string(what) + " is missing (NULL)");
  return *pointer;
}
inline std::string word(const char* text, const char* what) { return std::string(&given(text, what)); }

inline dr::runtime::HostArray array_of(const dressi_array& from) {
  if (from.kind < DRESSI_FLOAT32 || from.kind > DRESSI_BOOL)
    fail("unknown kind of scalar " + std::to_string(from.kind));
  const auto kind = static_cast<dr::io::ElementKind>(from.kind);
  const auto scalar = static_cast<int64_t>(dr::io::scalar_size(kind));
  if (from.components < 1 || from.components > 16 || from.width < 1 || from.height < 1 || from.layers < 1)
    fail("expected at least one element of 1 to 16 components, found " + std::to_string(from.width) + " x " +
         std::to_string(from.height) + " x " + std::to_string(from.layers) + " of " + std::to_string(from.components));
  int64_t bytes = scalar * from.components;
  for (const int64_t n : {from.width, from.height, from.layers})
    if (__builtin_mul_overflow(bytes, n, &bytes) || bytes > dr::io::kMaxArrayBytes) fail("the array is too large");
  given(static_cast<const char*>(from.data), "the data of the array");
  return {kind, from.components, from.width, from.height, from.layers, from.data};
}

// What an array that came out belongs to.
struct Owner {
  dr::io::Array copy;
  std::shared_ptr<void> view, program;  // destroyed from the last on
  Maker maker;
};

template <typename From>
void describe(const From& from, void* data, std::unique_ptr<Owner> owner, dressi_array& out) {
  out.kind = static_cast<int32_t>(from.kind);
  out.components = from.components;
  out.width = from.width;
  out.height = from.height;
  out.layers = from.layers;
  out.data = data;
  out.owner = owner.release();
}

inline int give(dr::io::Array array, dressi_array& out) {
  auto owner = std::make_unique<Owner>();
  owner->copy = std::move(array);
  const dr::io::Array& from = owner->copy;
  void* const data = owner->copy.bytes.data();
  describe(from, data, std::move(owner), out);
  return 1;
}

inline int give_view(const dr::runtime::HostArray& array, std::shared_ptr<void> program, dressi_array& out) {
  auto owner = std::make_unique<Owner>();
  owner->view = array.held;
  owner->program = std::move(program);
  describe(array, array.data, std::move(owner), out);
  return 1;
}

template <typename T>
T& opened_here(T* pointer, const char* what) {
  T& object = given(pointer, what);
  if (!object.maker.is_this_process())
    fail(std::string(what) +
             " was opened before this process was forked; open it again here, or start processes by spawn",
         DRESSI_DEVICE_ERROR);
  return object;
}

// A call that is alone with a run. What a warning calls within it would wait for itself.
class Turn {
 public:
  explicit Turn(dressi_run& run) : run_(run) {
    if (run.caller == std::this_thread::get_id())
      fail(
          "a warning's function called the run that the warning is of; keep the warning, and call when it has "
          "returned");
    run.mutex.lock();
    run.caller = std::this_thread::get_id();
  }
  Turn(const Turn&) = delete;
  Turn& operator=(const Turn&) = delete;
  ~Turn() {
    run_.caller = std::thread::id();
    const bool is_freed = run_.is_freed;
    run_.mutex.unlock();
    if (is_freed) delete &run_;
  }

 private:
  dressi_run& run_;
};

// Calls `use` with the program of the run, alone with it.
template <typename T, typename Use>
T with_program(T failed, dressi_run* run, const Use& use) {
  return guarded(failed, [&]() -> T {
    dressi_run& here = opened_here(run, "the run");
    const Turn turn(here);
    return std::visit([&](auto& program) { return use(*program, here); }, here.program);
  });
}

// None: the evaluator.
inline std::shared_ptr<dr::runtime::Program> device_program(dressi_run& run) {
  auto* program = std::get_if<std::shared_ptr<dr::runtime::Program>>(&run.program);
  return program == nullptr ? nullptr : *program;
}

inline dr::runtime::Program& on_device(dressi_run& run) {
  const auto program = device_program(run);
  if (!program) fail("the evaluator runs no commands: there is nothing to count, to time or to share");
  return *program;
}

}  // namespace dr::c
