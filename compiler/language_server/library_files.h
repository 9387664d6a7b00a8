// SPDX-License-Identifier: Apache-2.0
// The library's modules as files that an editor can open. The compiler holds their texts; a folder of the cache takes
// copies when one is asked for.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

namespace dr::language_server {

// The file of a module ("std/camera.dr") under `folder`, written if it is not there. Nothing if it cannot be.
std::optional<std::string> library_file(const std::filesystem::path& folder, std::string_view module);

// The module that a path is such a copy of, if it is one: "std/camera.dr".
std::optional<std::string> module_of_file(const std::filesystem::path& folder, std::string_view path);

}  // namespace dr::language_server
