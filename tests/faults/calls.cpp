// SPDX-License-Identifier: Apache-2.0
// The calls of libc and libstdc++ that fail on order, where the executable makes them, itself or through libstdc++.
#include <dlfcn.h>
#include <fcntl.h>
#include <link.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>
#include <unwind.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <new>

#include "tests/faults/shim.h"

namespace {

using dr::faults::is_due;
using dr::faults::Kind;

struct Range {
  uintptr_t begin = 0, end = 0;
  bool holds(uintptr_t address) const { return begin <= address && address < end; }
};

// Of libraries that call on behalf of others.
bool only_passes(const char* library) {
  for (const char* known : {"libdr_faults", "libc.so", "libgcc", "ld-linux"})
    if (std::strstr(library, known) != nullptr) return true;
  return false;
}

// Where the code of the executable, of libstdc++ and of what only passes calls on stands. All are there from the start.
struct Places {
  Range executable, library;
  std::array<Range, 8> passing;
  size_t passing_count = 0;
  Places() {
    dl_iterate_phdr(
        [](dl_phdr_info* info, size_t, void* places) {
          auto& all = *static_cast<Places*>(places);
          Range* range = nullptr;
          if (all.executable.end == 0)
            range = &all.executable;  // it comes first
          else if (std::strstr(info->dlpi_name, "libstdc++") != nullptr)
            range = &all.library;
          else if (only_passes(info->dlpi_name) && all.passing_count < all.passing.size())
            range = &all.passing[all.passing_count++];
          if (range == nullptr) return 0;
          for (int k = 0; k < info->dlpi_phnum; ++k) {
            const ElfW(Phdr)& header = info->dlpi_phdr[k];
            if (header.p_type != PT_LOAD || (header.p_flags & PF_X) == 0) continue;
            range->begin = info->dlpi_addr + header.p_vaddr;
            range->end = range->begin + header.p_memsz;
          }
          return 0;
        },
        this);
  }
  bool passes(uintptr_t at) const {
    return std::ranges::any_of(passing, [&](const Range& r) { return r.holds(at); });
  }
};

const Places& places() {
  static const Places all;
  return all;
}

// The first caller that is neither of this library nor of libstdc++.
bool is_through_library() {
  const auto look = [](_Unwind_Context* context, void* found) {
    const uintptr_t at = _Unwind_GetIP(context);
    static const auto self = reinterpret_cast<uintptr_t>(&is_through_library);
    const bool here = at > self - (1 << 14) && at < self + (1 << 14);
    if (here || places().library.holds(at)) return _URC_NO_REASON;
    *static_cast<bool*>(found) = places().executable.holds(at);
    return _URC_END_OF_STACK;
  };
  bool found = false;
  _Unwind_Backtrace(look, &found);
  return found;
}

bool is_ours(void* caller) {
  const auto at = reinterpret_cast<uintptr_t>(caller);
  if (places().executable.holds(at)) return true;
  return places().library.holds(at) && is_through_library();
}

// Drivers take templates of the executable, such as those of strings, where they have the same ones: no frame may be
// of any other library.
bool is_all_ours() {
  const auto look = [](_Unwind_Context* context, void* found) {
    const uintptr_t at = _Unwind_GetIP(context);
    if (places().library.holds(at) || places().executable.holds(at) || places().passes(at)) return _URC_NO_REASON;
    // Looking for a name takes long, and few frames come here.
    Dl_info info = {};
    if (dladdr(reinterpret_cast<void*>(at), &info) == 0 || info.dli_fname == nullptr || only_passes(info.dli_fname))
      return _URC_NO_REASON;
    *static_cast<bool*>(found) = false;
    return _URC_END_OF_STACK;
  };
  bool found = true;
  _Unwind_Backtrace(look, &found);
  return found;
}

template <class F>
F next(const char* name) {
  return reinterpret_cast<F>(dlsym(RTLD_NEXT, name));
}

// What is allocated before main() has nobody who could say so.
bool in_main = false;
int (*real_main)(int, char**, char**) = nullptr;

void* allocate(size_t size, void* caller) {
  if (in_main && is_ours(caller) && is_due(Kind::New, "operator new", is_all_ours)) return nullptr;
  return std::malloc(size == 0 ? 1 : size);
}

// As the standard's does it: a handler may find memory, or throw.
void* allocate_or_throw(size_t size, void* caller) {
  while (true) {
    if (void* const memory = allocate(size, caller)) return memory;
    const std::new_handler handler = std::get_new_handler();
    if (handler == nullptr) throw std::bad_alloc();
    handler();
  }
}

// An error of a disk; what is written finds no room.
bool fails(const char* name, void* caller, int error) {
  if (!is_ours(caller) || !is_due(Kind::File, name)) return false;
  errno = error;
  return true;
}

bool is_short(const char* name, size_t size, void* caller) {
  return size > 1 && is_ours(caller) && is_due(Kind::Short, name);
}

}  // namespace

#define DR_CALLER __builtin_return_address(0)
#define DR_NEXT(name) static const auto real = next<decltype(&(name))>(#name)

void* operator new(size_t size) { return allocate_or_throw(size, DR_CALLER); }
void* operator new[](size_t size) { return allocate_or_throw(size, DR_CALLER); }
void* operator new(size_t size, const std::nothrow_t&) noexcept { return allocate(size, DR_CALLER); }
void* operator new[](size_t size, const std::nothrow_t&) noexcept { return allocate(size, DR_CALLER); }
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, size_t) noexcept { std::free(memory); }
void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
void operator delete[](void* memory, const std::nothrow_t&) noexcept { std::free(memory); }

extern "C" {

// NOLINTNEXTLINE(bugprone-reserved-identifier): of libc, which calls it
int __libc_start_main(int (*main)(int, char**, char**), int argc, char** argv, void (*init)(), void (*fini)(),
                      void (*loader)(), void* stack) {
  using Start = int (*)(int (*)(int, char**, char**), int, char**, void (*)(), void (*)(), void (*)(), void*);
  static const auto real = next<Start>("__libc_start_main");
  real_main = main;
  const auto go = [](int count, char** words, char** environment) {
    in_main = true;
    const int code = real_main(count, words, environment);
    in_main = false;  // destructors of what stands outside of functions
    return code;
  };
  return real(go, argc, argv, init, fini, loader, stack);
}
int open(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = va_arg(rest, mode_t);
  va_end(rest);
  if (fails("open", DR_CALLER, EMFILE)) return -1;
  using Open = int (*)(const char*, int, ...);
  static const auto real = next<Open>("open");
  return real(path, flags, mode);
}
ssize_t read(int file, void* to, size_t size) {
  DR_NEXT(read);
  if (fails("read", DR_CALLER, EIO)) return -1;
  return real(file, to, is_short("read", size, DR_CALLER) ? size / 2 : size);
}
ssize_t write(int file, const void* from, size_t size) {
  DR_NEXT(write);
  if (fails("write", DR_CALLER, ENOSPC)) return -1;
  return real(file, from, is_short("write", size, DR_CALLER) ? size / 2 : size);
}
ssize_t writev(int file, const iovec* parts, int count) {
  DR_NEXT(writev);
  if (fails("writev", DR_CALLER, ENOSPC)) return -1;
  return real(file, parts, count > 1 && is_short("writev", 2, DR_CALLER) ? 1 : count);
}
FILE* fopen(const char* path, const char* mode) {
  DR_NEXT(fopen);
  return fails("fopen", DR_CALLER, EMFILE) ? nullptr : real(path, mode);
}
FILE* fopen64(const char* path, const char* mode) {
  DR_NEXT(fopen64);
  return fails("fopen64", DR_CALLER, EMFILE) ? nullptr : real(path, mode);
}
size_t fread(void* to, size_t size, size_t count, FILE* file) {
  DR_NEXT(fread);
  if (fails("fread", DR_CALLER, EIO)) return 0;
  return real(to, size, is_short("fread", count, DR_CALLER) ? count / 2 : count, file);
}
size_t fwrite(const void* from, size_t size, size_t count, FILE* file) {
  DR_NEXT(fwrite);
  // What is for people goes through: it is not what is tested.
  if (file == stderr || file == stdout) return real(from, size, count, file);
  if (fails("fwrite", DR_CALLER, ENOSPC)) return 0;
  if (!is_short("fwrite", count, DR_CALLER)) return real(from, size, count, file);
  const size_t written = real(from, size, count / 2, file);
  errno = ENOSPC;
  return written;
}
int fflush(FILE* file) {
  DR_NEXT(fflush);
  if (file == stderr || file == stdout || file == nullptr) return real(file);
  return fails("fflush", DR_CALLER, ENOSPC) ? EOF : real(file);
}
int fclose(FILE* file) {
  DR_NEXT(fclose);
  const bool bad = fails("fclose", DR_CALLER, EIO);
  const int result = real(file);
  if (bad) errno = EIO;
  return bad ? EOF : result;
}
int close(int file) {
  DR_NEXT(close);
  const bool bad = fails("close", DR_CALLER, EIO);
  const int result = real(file);
  if (bad) errno = EIO;
  return bad ? -1 : result;
}
int fsync(int file) {
  DR_NEXT(fsync);
  return fails("fsync", DR_CALLER, EIO) ? -1 : real(file);
}
int rename(const char* from, const char* to) noexcept {
  DR_NEXT(rename);
  return fails("rename", DR_CALLER, EIO) ? -1 : real(from, to);
}
int mkdir(const char* path, mode_t mode) noexcept {
  DR_NEXT(mkdir);
  return fails("mkdir", DR_CALLER, ENOSPC) ? -1 : real(path, mode);
}
int flock(int file, int what) noexcept {
  DR_NEXT(flock);
  return fails("flock", DR_CALLER, ENOLCK) ? -1 : real(file, what);
}

}  // extern "C"
