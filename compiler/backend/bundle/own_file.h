// SPDX-License-Identifier: Apache-2.0
// Files that this user wrote for itself: entries of caches. What another user owns or may write is not there.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>

namespace dr::bundle {

// The file's content; nothing where it cannot be read, is no file, belongs to another user, or others may write it.
// Marks it as used now.
std::optional<std::string> read_own_file(const std::filesystem::path& path);

// Writes the parts one after the other, whole or not at all, for this user alone. Makes the folder. Says whether it
// did.
bool write_own_file(const std::filesystem::path& path, std::initializer_list<std::string_view> parts);

}  // namespace dr::bundle
