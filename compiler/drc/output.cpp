// SPDX-License-Identifier: Apache-2.0
// Writing products of the commands.
#include "compiler/drc/output.h"

#include <cstdio>
#include <filesystem>
#include <fstream>

#include "compiler/drc/input.h"

namespace dr::drc {

bool write_product(const std::string& file, std::string_view content) {
  if (file == "-") {
    const bool written = std::fwrite(content.data(), 1, content.size(), stdout) == content.size() && std::fflush(stdout) == 0;
    if (!written) print_error("cannot write to stdout");
    return written;
  }
  // A reader of the file, or an interruption, must never meet half of it.
  const std::string temporary = file + ".new";
  std::error_code error;
  {
    std::ofstream out(temporary, std::ios::binary | std::ios::trunc);
    out.write(content.data(), static_cast<std::streamsize>(content.size()));
    out.close();
    if (!out) error = std::make_error_code(std::errc::io_error);
  }
  if (!error) std::filesystem::rename(temporary, file, error);
  if (!error) return true;
  std::error_code ignored;
  std::filesystem::remove(temporary, ignored);
  print_error("cannot write '" + file + "'");
  return false;
}

}  // namespace dr::drc
