// SPDX-License-Identifier: Apache-2.0
// From a file to a graph, with messages on stderr.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "compiler/drc/command.h"
#include "compiler/drc/messages.h"
#include "compiler/driver/driver.h"

namespace dr::drc {

// The name of a file in messages: `-` is <stdin>.
std::string shown_name(const std::string& file);

// `name=value` split, or nullopt after a message that names `option`.
std::optional<std::pair<std::string, std::string>> split_assignment(const std::string& text, std::string_view option);

// The text of a file; `-` is stdin. Messages go to stderr.
std::optional<std::string> read_text(const std::string& file);

// The program that the options name. Null after messages.
std::unique_ptr<driver::Compilation> open_program(const InputOptions& options, driver::Hooks hooks);

// Prints the error of a program that has one beside its diagnostics.
void tell_error(const driver::Compilation& program);

// A program that has been read, parsed, lowered and verified; it has told its messages. Null if it is wrong.
std::unique_ptr<driver::Compilation> load_graph(const InputOptions& options);

// The syntax tree as text. Nullopt after messages.
std::optional<std::string> load_tree(const InputOptions& options);

}  // namespace dr::drc
