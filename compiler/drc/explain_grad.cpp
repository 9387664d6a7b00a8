// SPDX-License-Identifier: Apache-2.0
// `drc explain-grad`: says in words why a gradient is what it is.
#include <cstdio>

#include "compiler/drc/command.h"
#include "compiler/drc/input.h"
#include "compiler/driver/explained_gradient.h"

namespace dr::drc {

int explain_grad(const ExplainGradOptions& options) {
  const auto program = load_graph(options.input);
  if (!program) return kUserError;
  const auto explained = driver::explain_gradient(*program, options.loss, options.target);
  if (const auto* problem = std::get_if<std::string>(&explained)) return print_error(*problem), kUserError;
  std::fputs(std::get<driver::ExplainedGradient>(explained).text().c_str(), stdout);
  return kOk;
}

}  // namespace dr::drc
