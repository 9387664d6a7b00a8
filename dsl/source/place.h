// SPDX-License-Identifier: Apache-2.0
// Places in source texts, printed as diagnostics print them (dsl/diagnostic/diagnostic.h), for messages that have no
// code.
#pragma once

#include <string>

#include "dsl/source/source.h"

namespace dr::dsl {

// "fit.dr:12:13: ", or nothing for a span that is not valid.
std::string format_place(const SourceManager& sources, const Span& span);
// The source line and the caret under it, each ending the line. Precondition: a valid span.
std::string format_source_line(const SourceManager& sources, const Span& span);

}  // namespace dr::dsl
