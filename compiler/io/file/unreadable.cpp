// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/file/unreadable.h"

#include <cerrno>
#include <filesystem>
#include <system_error>

#include "compiler/io/file/failure.h"

namespace dr::io {

std::string unreadable(const std::string& path) {
  const int number = errno;
  std::error_code error;
  const auto type = std::filesystem::status(path, error).type();
  std::string why;
  if (type == std::filesystem::file_type::not_found)
    why = ": no such file";
  else if (type == std::filesystem::file_type::directory)
    why = ": it is a folder";
  else if (number != 0)
    why = ": " + std::generic_category().message(number);
  return "cannot read " + path_in_quotes(path) + why;
}

}  // namespace dr::io
