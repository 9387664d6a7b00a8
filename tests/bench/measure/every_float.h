// SPDX-License-Identifier: Apache-2.0
// The parts of docs/results/accuracy.md that `./dr bench sweep` and `./dr bench judge` have the figures of.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>

namespace dr {

// Of a row in JSON whose bound depends on the operands: ", 98.1% of it"; else nothing.
std::string share_of(const nlohmann::json& row);

// From the lines of JSON in `folder`/sweep and from `folder`/judge.json, on stdout; nothing for what is not there.
void document_every_float(const std::string& folder);
void document_judge(const std::string& folder);

}  // namespace dr
