// SPDX-License-Identifier: Apache-2.0
// Writing products of the commands.
#include "compiler/drc/output.h"

#include <cstdio>
#include <filesystem>
#include <fstream>

#include "compiler/drc/input.h"

namespace dr::drc {
namespace {

namespace fs = std::filesystem;

bool write_to(const fs::path& file, std::string_view content) {
  std::ofstream out(file, std::ios::binary | std::ios::trunc);
  out.write(content.data(), static_cast<std::streamsize>(content.size()));
  out.close();
  return static_cast<bool>(out);
}

// A reader of the file, or an interruption, must never meet half of it: the content goes to a file beside it, which
// then takes its name.
bool replace(const fs::path& file, std::string_view content) {
  const fs::path temporary = file.string() + ".new";
  std::error_code error;
  if (write_to(temporary, content)) {
    fs::rename(temporary, file, error);
    if (!error) return true;
  }
  fs::remove(temporary, error);
  return false;
}

}  // namespace

bool write_product(const std::string& file, std::string_view content) {
  if (file == "-") {
    const bool written =
        std::fwrite(content.data(), 1, content.size(), stdout) == content.size() && std::fflush(stdout) == 0;
    if (!written) print_error("cannot write to stdout");
    return written;
  }
  // A link is written through. What is no regular file (a device, a pipe) must stay what it is: renaming over it would
  // put a file in its place.
  std::error_code error;
  fs::path target = file;
  if (fs::is_symlink(target, error)) {
    const fs::path resolved = fs::weakly_canonical(target, error);
    if (!error) target = resolved;
  }
  const fs::file_status status = fs::status(target, error);
  const bool replaceable = status.type() == fs::file_type::not_found || status.type() == fs::file_type::regular;
  if (replaceable ? replace(target, content) : write_to(target, content)) return true;
  print_error("cannot write '" + file + "'");
  return false;
}

}  // namespace dr::drc
