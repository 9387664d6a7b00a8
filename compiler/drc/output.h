// SPDX-License-Identifier: Apache-2.0
// Writing products: files whole or not at all, `-` to stdout.
#pragma once

#include <string>
#include <string_view>

namespace dr::drc {

// False after a message on stderr.
bool write_product(const std::string& file, std::string_view content);

// Another text for a file that a person wrote, and that had the text `before`: it keeps its owner, its mode and its
// other names. False after a message; what was there is lost in no case.
bool rewrite_file(const std::string& file, std::string_view before, std::string_view content);

}  // namespace dr::drc
