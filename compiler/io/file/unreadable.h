// SPDX-License-Identifier: Apache-2.0
// Files that cannot be read, for all who open them by themselves.
#pragma once

#include <string>

namespace dr::io {

// "cannot read 'fit.dr': no such file", right after opening it failed: errno may say why.
std::string unreadable(const std::string& path);

}  // namespace dr::io
