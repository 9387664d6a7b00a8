// SPDX-License-Identifier: Apache-2.0
// From a file to a graph, with messages on stderr.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "compiler/drc/command.h"
#include "compiler/drc/messages.h"
#include "compiler/ir/graph.h"

namespace dr::drc {

// The name of a file in messages: `-` is <stdin>.
std::string shown_name(const std::string& file);

// `name=value` split, or nullopt after a message that names `option`.
std::optional<std::pair<std::string, std::string>> split_assignment(const std::string& text, std::string_view option);

// The text of a file; `-` is stdin. Messages go to stderr.
std::optional<std::string> read_text(const std::string& file);

// Reads, parses, lowers and verifies. Nullopt after messages. Spans of the graph point into `sources`.
std::optional<ir::Graph> load_graph(const InputOptions& options, dsl::SourceManager& sources,
                                    bool* has_messages = nullptr);
std::optional<ir::Graph> load_graph(const InputOptions& options);

// The syntax tree as text. Nullopt after messages.
std::optional<std::string> load_tree(const InputOptions& options);

}  // namespace dr::drc
