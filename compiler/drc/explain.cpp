// SPDX-License-Identifier: Apache-2.0
// `drc explain`: what a code of a message means.
#include "dsl/diagnostic/explain.h"

#include <cstdio>

#include "compiler/drc/command.h"
#include "compiler/drc/messages.h"
#include "compiler/drc/output.h"

namespace dr::drc {

int explain(const std::string& name) {
  const std::vector<std::string> known = dsl::code_names();
  if (name.empty()) {
    std::string list;
    for (const std::string& code : known) {
      list += code + "  " + std::string(dsl::code_summary(*dsl::find_code(code))) + '\n';
    }
    return write_product("-", list) ? kOk : kUserError;
  }
  const auto code = dsl::find_code(name);
  if (!code) {
    const auto nearest = dsl::nearest_name(name, known);
    print_error("there is no code '" + name + "'" + (nearest ? ", did you mean '" + *nearest + "'?" : "") +
                " (drc explain lists all)");
    return kBadUsage;
  }
  return write_product("-", dsl::explain(*code)) ? kOk : kUserError;
}

}  // namespace dr::drc
