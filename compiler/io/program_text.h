// SPDX-License-Identifier: Apache-2.0
// Files of programs and bundles, for all who run or compile them.
#pragma once

#include <string>

#include "compiler/io/file/result.h"

namespace dr::io {

// What stands in a program or a bundle. The error says why it cannot be read: "cannot read 'fit.dr': no such file"; or
// that it is data, as a mesh is, which is bound to an input.
Result<std::string> program_text(const std::string& path);

}  // namespace dr::io
