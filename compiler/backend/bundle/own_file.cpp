// SPDX-License-Identifier: Apache-2.0
#include "compiler/backend/bundle/own_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>

namespace dr::bundle {

namespace fs = std::filesystem;

namespace {

struct File {
  explicit File(int opened) : descriptor(opened) {}
  File(const File&) = delete;
  File& operator=(const File&) = delete;
  ~File() {
    if (descriptor >= 0) close(descriptor);
  }
  int descriptor;
};

}  // namespace

std::optional<std::string> read_own_file(const fs::path& path) {
  // A pipe of this name must not hold up who opens it.
  const File file(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
  struct stat status = {};
  if (file.descriptor < 0 || fstat(file.descriptor, &status) != 0 || !S_ISREG(status.st_mode)) return std::nullopt;
  if (status.st_uid != geteuid() || (status.st_mode & (S_IWGRP | S_IWOTH)) != 0) return std::nullopt;
  std::string content(static_cast<size_t>(status.st_size), '\0');
  for (size_t at = 0; at < content.size();) {
    const ssize_t n = ::read(file.descriptor, content.data() + at, content.size() - at);
    if (n <= 0) return std::nullopt;
    at += static_cast<size_t>(n);
  }
  futimens(file.descriptor, nullptr);  // no matter if that cannot be noted
  return content;
}

bool write_own_file(const fs::path& path, std::initializer_list<std::string_view> parts) {
  std::error_code error;
  fs::create_directories(path.parent_path(), error);
  if (error) return false;
  static std::atomic<unsigned> counter{0};
  const std::string temporary = path.string() + "." + std::to_string(getpid()) + "." + std::to_string(counter++);
  bool written = true;
  {
    const File file(open(temporary.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, S_IRUSR | S_IWUSR));
    if (file.descriptor < 0) return false;
    for (std::string_view part : parts)
      while (written && !part.empty()) {
        const ssize_t n = ::write(file.descriptor, part.data(), part.size());
        written = n > 0;
        if (written) part.remove_prefix(static_cast<size_t>(n));
      }
  }
  if (written) fs::rename(temporary, path, error);
  if (!written || error) fs::remove(temporary, error);
  return written && !error;
}

}  // namespace dr::bundle
