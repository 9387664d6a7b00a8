// SPDX-License-Identifier: Apache-2.0
// Runs a command to its end and keeps what it printed.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace dr::golden {

struct ProcessResult {
  int exit_code = 0;  // 128 + number for a signal, 127 for a command that cannot be started
  std::string out;
  std::string err;
};

// Runs `command` with `arguments` in `folder`, with no input. Throws std::system_error when the system is out of
// processes or files.
ProcessResult run_process(const std::filesystem::path& command, const std::vector<std::string>& arguments,
                          const std::filesystem::path& folder);

}  // namespace dr::golden
