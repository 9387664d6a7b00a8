// SPDX-License-Identifier: Apache-2.0
// Writing products: files whole or not at all, `-` to stdout.
#pragma once

#include <string>
#include <string_view>

namespace dr::drc {

// False after a message on stderr.
bool write_product(const std::string& file, std::string_view content);

}  // namespace dr::drc
