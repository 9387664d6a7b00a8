// SPDX-License-Identifier: Apache-2.0
// Finds a code's section of the explanations and makes it text for a terminal.
#include "dsl/diagnostic/explain.h"

#include <algorithm>
#include <vector>

namespace dr::dsl {
namespace {

constexpr std::string_view kExplanations =
#include "explanations.inc"
    ;

constexpr Code kAllCodes[] = {
#define DR_DIAGNOSTIC(code, summary) Code::code,
#include "dsl/diagnostic/diagnostic_codes.def"
#undef DR_DIAGNOSTIC
};

std::string_view section(std::string_view name) {
  const std::string head = "\n## " + std::string(name) + "\n";
  const size_t begin = kExplanations.find(head);
  if (begin == std::string_view::npos) return {};
  const std::string_view rest = kExplanations.substr(begin + head.size());
  return rest.substr(0, rest.find("\n## "));
}

}  // namespace

std::optional<Code> find_code(std::string_view name) {
  std::string upper(name);
  if (upper.starts_with('e')) upper[0] = 'E';
  for (const Code code : kAllCodes) {
    if (code_name(code) == upper) return code;
  }
  return std::nullopt;
}

std::vector<std::string> code_names() {
  std::vector<std::string> names;
  for (const Code code : kAllCodes) names.emplace_back(code_name(code));
  return names;
}

std::string explain(Code code) {
  std::string out = std::string(code_name(code)) + ": " + std::string(code_summary(code)) + '\n';
  std::string_view text = section(code_name(code));
  bool in_example = false;
  int examples = 0;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(line.size() + 1, text.size()));
    if (line.starts_with("```")) {
      in_example = !in_example;
      if (in_example) out += examples++ == 0 ? "Wrong:\n\n" : "Right:\n\n";
      continue;
    }
    if (in_example && !line.empty()) out += "    ";
    out += line;
    out += '\n';
  }
  return out;
}

}  // namespace dr::dsl
