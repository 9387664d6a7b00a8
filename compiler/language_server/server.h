// SPDX-License-Identifier: Apache-2.0
// A language server: reads requests from a stream, answers on another one, and tells what is wrong with the texts that
// are open in the editor.
#pragma once

#include <filesystem>
#include <istream>
#include <map>
#include <ostream>
#include <string>
#include <vector>

namespace dr::language_server {

struct ServerOptions {
  std::vector<std::string> include_dirs;
  std::map<std::string, std::string, std::less<>> defines;
  std::filesystem::path library_folder;  // takes the library's texts, so that an editor can open them
  std::string version;
};

// Until `exit` or the end of the stream. Whether it was asked to shut down before.
bool serve(std::istream& in, std::ostream& out, const ServerOptions& options);

}  // namespace dr::language_server
