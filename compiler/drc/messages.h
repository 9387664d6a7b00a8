// SPDX-License-Identifier: Apache-2.0
// What a command says on stderr: text as it goes, or one JSON document at the end (--diagnostics=json).
#pragma once

#include <cstdint>
#include <string>

#include "dsl/diagnostic/diagnostic.h"
#include "dsl/source/source.h"

namespace dr::drc {

// From here on messages are collected, for write_messages.
void collect_messages();

// Ends the run: prints what was collected as one JSON array, empty if there is nothing to say. Its schema stands in
// docs/reference/language.md, section "Messages for programs". Does nothing if messages are not collected.
void write_messages();

// Diagnostics of a program.
void report(const dsl::DiagnosticList& diagnostics, const dsl::SourceManager& sources);

// "error: message": what has no place in a program, as a file that cannot be read.
void print_error(const std::string& message);
void print_warning(const std::string& message);

// "file:line: error: message": a line of a file that is no program, counted from 1.
void print_line_error(const dsl::SourceManager& sources, dsl::FileId file, uint32_t line, const std::string& message);

}  // namespace dr::drc
