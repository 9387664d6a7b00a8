// SPDX-License-Identifier: Apache-2.0
// Answers to what an editor asks about a place in a text.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "compiler/language_server/analysis.h"

namespace dr::language_server {

using Json = nlohmann::json;

// The messages of a program as the protocol's diagnostics of its root file.
Json diagnostics(const Analysis& analysis, const std::filesystem::path& library);

// What the name at an offset is, in Markdown; null where nothing is known.
Json hover(const Analysis& analysis, uint32_t offset);

// Where the name at an offset is declared; null where nothing is known.
Json definition(const Analysis& analysis, uint32_t offset, const std::filesystem::path& library);

// What may be written at an offset. `analyse` reads the text as it would be with another word there.
using Analyse = std::function<Analysis(std::string text, uint32_t members_at)>;
Json completion(const Analysis& analysis, uint32_t offset, const std::vector<std::string>& folders,
                const Analyse& analyse);

// Shared by the above: a span as the protocol's range, and the URI of a file of the analysis.
Json range_json(const Lines& lines, uint32_t begin, uint32_t end);
Json location_json(const Analysis& analysis, const dsl::Span& span, const std::filesystem::path& library);

}  // namespace dr::language_server
