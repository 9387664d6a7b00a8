// SPDX-License-Identifier: Apache-2.0
// `drc lsp`: programs for editors, over stdin and stdout.
#include <iostream>

#include "compiler/backend/spirv/shader_cache.h"
#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/language_server/server.h"
#include "version_generated.h"

namespace dr::drc {

int lsp(const InputOptions& options) {
  language_server::ServerOptions server;
  server.include_dirs = options.compile.include_dirs;
  server.version = version();
  for (const std::string& define : options.defines) {
    const auto parts = split_assignment(define, "-D");
    if (!parts) return kBadUsage;
    server.defines[parts->first] = parts->second;
  }
  if (const auto cache = backend::default_cache_folder(); !cache.empty()) server.library_folder = cache / "library";
  return language_server::serve(std::cin, std::cout, server) ? kOk : kUserError;
}

}  // namespace dr::drc
