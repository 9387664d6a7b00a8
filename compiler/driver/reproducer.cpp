// SPDX-License-Identifier: Apache-2.0
// What an internal error leaves behind.
#include <filesystem>
#include <fstream>
#include <functional>
#include <system_error>

#include "compiler/driver/driver.h"
#include "compiler/ir/print.h"

namespace dr::driver {

std::string keep_reproducer(const ir::Graph& graph, const Options& options, const std::string& message) {
  std::string text = "// drc build" + command_line(options) + "\n// ";
  for (const char c : message.substr(0, message.find("\nstep ")))
    text += c == '\n' ? std::string("\n// ") : std::string(1, c);
  text += "\n" + ir::print(graph);
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::temp_directory_path(error);
  if (error) return {};
  const auto file = folder / ("dressi-" + std::to_string(std::hash<std::string>{}(text)) + ".ir");
  std::ofstream out(file, std::ios::binary);
  out << text;
  out.close();
  return out ? file.string() : std::string();
}

}  // namespace dr::driver
