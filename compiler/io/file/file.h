// SPDX-License-Identifier: Apache-2.0
// Whole files in, whole files out. Private to compiler/io; every function throws Failure.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace dr::io {

using Bytes = std::vector<uint8_t>;

// The largest file that is read.
inline constexpr uint64_t kMaxFileBytes = uint64_t{256} << 20;

// The content of a regular file of at most kMaxFileBytes. Never blocks on a pipe or a device.
Bytes read_file(const std::string& path);

inline std::string_view as_text(std::span<const uint8_t> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

// One file to be written.
struct OutputFile {
  std::string path;
  Bytes bytes;
};

// Writes all files, or leaves all as they were: each goes to a temporary file next to its place first, and only when
// all are complete are they renamed over. (Should a rename itself fail, the files before it are already new; each file
// is still either the old or the new one in full.) A symbolic link is written through; anything but a regular file is
// refused.
void write_files(std::span<const OutputFile> files);
void write_file(const std::string& path, Bytes bytes);

// ".png" in lower case, or nothing.
std::string extension_of(std::string_view path);

// The part after the last '/'.
std::string_view file_name_of(std::string_view path);

// The files that match `pattern`, in the order of their names' bytes. `*` stands for any run of characters and `?` for
// one, in the last part of the path only; names that start with a dot are matched only by a pattern that does.
std::vector<std::string> files_matching(const std::string& pattern);

}  // namespace dr::io
