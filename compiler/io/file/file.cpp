// SPDX-License-Identifier: Apache-2.0
// Reading with a size limit, writing through a temporary file and a rename, and name patterns.

#include "compiler/io/file/file.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <memory>
#include <random>
#include <system_error>

#include "compiler/io/file/failure.h"

namespace dr::io {
namespace {

namespace fs = std::filesystem;

struct CloseFile {
  void operator()(std::FILE* file) const { std::fclose(file); }
};
using FileHandle = std::unique_ptr<std::FILE, CloseFile>;

std::string reason(int error_number) { return std::generic_category().message(error_number); }

// A file that is removed again unless it was renamed into place.
class TemporaryFile {
 public:
  // Next to `target`, so that the rename stays within one file system.
  TemporaryFile(const fs::path& target, const Bytes& bytes) : target_(target) {
    std::random_device random;
    FileHandle file;
    for (int attempt = 0; attempt < 16 && !file; ++attempt) {
      path_ = target;
      path_ += cat(".", random(), ".tmp");
      file.reset(std::fopen(path_.c_str(), "wbx"));  // x: never opens what someone else has made
      if (!file && errno != EEXIST) break;
    }
    if (!file) {
      const int error_number = errno;
      path_.clear();
      fail(reason(error_number));
    }
    errno = 0;
    const bool written = bytes.empty() || std::fwrite(bytes.data(), 1, bytes.size(), file.get()) == bytes.size();
    const bool flushed = written && std::fflush(file.get()) == 0;
    const int error_number = errno;
    // fclose reports what a network file system finds out last.
    const bool closed = std::fclose(file.release()) == 0;
    if (!flushed || !closed) {
      const int close_error = errno;
      remove();
      fail(reason(flushed ? close_error : error_number));
    }
  }
  TemporaryFile(TemporaryFile&& other) noexcept : path_(std::move(other.path_)), target_(std::move(other.target_)) {
    other.path_.clear();
  }
  TemporaryFile& operator=(TemporaryFile&&) = delete;
  ~TemporaryFile() { remove(); }

  void move_into_place() {
    std::error_code error;
    fs::rename(path_, target_, error);
    if (error) fail(error.message());
    path_.clear();
  }

 private:
  void remove() noexcept {
    if (path_.empty()) return;
    std::error_code ignored;
    fs::remove(path_, ignored);
    path_.clear();
  }

  fs::path path_;
  fs::path target_;
};

// Where the bytes of `path` have to go.
fs::path output_target(const std::string& path) {
  fs::path target = path;
  std::error_code error;
  if (fs::is_symlink(target, error)) {
    target = fs::weakly_canonical(target, error);
    if (error) fail(error.message());
  }
  const fs::file_status status = fs::status(target, error);
  if (fs::is_directory(status)) fail("it is a folder");
  if (fs::exists(status) && !fs::is_regular_file(status)) fail("it is not a regular file");
  const fs::path folder = target.parent_path();
  if (!folder.empty() && !fs::is_directory(folder, error)) {
    fail("there is no folder ", path_in_quotes(folder.string()));
  }
  return target;
}

// Whether `name` matches `pattern`: the usual two-pointer walk, which returns to the last star on a mismatch.
bool matches(std::string_view pattern, std::string_view name) {
  size_t p = 0;
  size_t n = 0;
  size_t star = std::string_view::npos;
  size_t star_name = 0;
  while (n < name.size()) {
    if (p < pattern.size() && pattern[p] == '*') {
      star = p++;
      star_name = n;
    } else if (p < pattern.size() && (pattern[p] == '?' || pattern[p] == name[n])) {
      ++p;
      ++n;
    } else if (star != std::string_view::npos) {
      p = star + 1;
      n = ++star_name;
    } else {
      return false;
    }
  }
  while (p < pattern.size() && pattern[p] == '*') ++p;
  return p == pattern.size();
}

}  // namespace

Bytes read_file(const std::string& path) {
  std::error_code error;
  if (path.find('\0') != std::string::npos) fail("the name holds a zero byte");
  const fs::file_status status = fs::status(path, error);
  if (status.type() == fs::file_type::not_found) fail("no such file");
  if (fs::is_directory(status)) fail("it is a folder");
  if (error) fail(error.message());
  if (!fs::is_regular_file(status)) fail("it is not a regular file");
  const uint64_t size = fs::file_size(path, error);
  if (error) fail(error.message());
  if (size > kMaxFileBytes) fail("it has ", size, " bytes, the limit is ", kMaxFileBytes);

  const FileHandle file(std::fopen(path.c_str(), "rb"));
  if (!file) fail(reason(errno));
  Bytes bytes(size);
  errno = 0;
  if (size > 0 && std::fread(bytes.data(), 1, bytes.size(), file.get()) != bytes.size()) {
    fail(std::ferror(file.get()) ? reason(errno) : "it became shorter while it was read");
  }
  return bytes;
}

void write_files(std::span<const OutputFile> files) {
  std::vector<TemporaryFile> temporaries;
  temporaries.reserve(files.size());
  const auto naming = [&](size_t index, const auto& work) {
    try {
      work();
    } catch (const Failure& failure) {
      // The caller names the one file it was asked for; of several, say which.
      if (files.size() == 1) throw;
      fail(path_in_quotes(files[index].path), ": ", failure.what());
    }
  };
  for (size_t i = 0; i < files.size(); ++i) {
    naming(i, [&] { temporaries.emplace_back(output_target(files[i].path), files[i].bytes); });
  }
  for (size_t i = 0; i < files.size(); ++i) {
    naming(i, [&] { temporaries[i].move_into_place(); });
  }
}

void write_file(const std::string& path, Bytes bytes) {
  const OutputFile file{path, std::move(bytes)};
  write_files({&file, 1});
}

std::string_view file_name_of(std::string_view path) {
  const size_t slash = path.rfind('/');
  return slash == std::string_view::npos ? path : path.substr(slash + 1);
}

std::string extension_of(std::string_view path) {
  const std::string_view name = file_name_of(path);
  const size_t dot = name.rfind('.');
  if (dot == std::string_view::npos || dot == 0) return {};
  std::string extension(name.substr(dot));
  for (char& c : extension) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return extension;
}

std::vector<std::string> files_matching(const std::string& pattern) {
  const std::string_view name_pattern = file_name_of(pattern);
  const std::string folder = pattern.substr(0, pattern.size() - name_pattern.size());  // with its '/'
  if (folder.find_first_of("*?") != std::string::npos) fail("only the file name may hold '*' or '?'");
  std::error_code error;
  std::vector<std::string> found;
  fs::directory_iterator entry(folder.empty() ? "." : folder, error);
  if (error) fail("there is no folder ", path_in_quotes(folder));
  for (const fs::directory_iterator end; entry != end; entry.increment(error)) {
    const std::string name = entry->path().filename().string();
    const bool hidden = name.starts_with('.') && !name_pattern.starts_with('.');
    if (!hidden && matches(name_pattern, name) && entry->is_regular_file(error)) found.push_back(folder + name);
  }
  if (error) fail(error.message());
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace dr::io
