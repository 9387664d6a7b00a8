// SPDX-License-Identifier: Apache-2.0
// The op table as Markdown.
#pragma once

#include <string>

namespace dr::ops {

// All ops by family: what each means, the types it takes, and what its entry says for tests.
std::string document_ops();

}  // namespace dr::ops
