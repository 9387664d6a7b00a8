// SPDX-License-Identifier: Apache-2.0
#include "compiler/io/program_text.h"

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <system_error>

#include "compiler/io/array/array.h"
#include "compiler/io/file/failure.h"

namespace dr::io {

namespace {

// Right after opening it failed: errno may say why.
std::string why_unreadable(const std::string& path) {
  const int number = errno;
  std::error_code error;
  const auto type = std::filesystem::status(path, error).type();
  if (type == std::filesystem::file_type::not_found) return ": no such file";
  if (type == std::filesystem::file_type::directory) return ": it is a folder";
  return number != 0 ? ": " + std::generic_category().message(number) : "";
}

}  // namespace

Result<std::string> program_text(const std::string& path) {
  std::error_code error;
  std::ifstream file;
  errno = 0;
  if (!std::filesystem::is_directory(path, error)) file.open(path, std::ios::binary);
  std::ostringstream text;
  if (file.is_open()) text << file.rdbuf();
  if (!file.is_open() || file.bad()) return Error{"cannot read " + path_in_quotes(path) + why_unreadable(path)};
  if (is_bindable(path))
    return Error{"expected a program, found data: " + path_in_quotes(path) +
                 " can be bound to an input, as in --bind NAME=" + path};
  return std::move(text).str();
}

}  // namespace dr::io
