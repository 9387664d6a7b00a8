// SPDX-License-Identifier: Apache-2.0
// What passes::explain_gradient finds, in the user's words: names, places in the program, reasons.
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "compiler/driver/driver.h"

namespace dr::driver {

struct ExplainedGradient {
  // A value with a name on the way, its place ("fit.dr:3:5", or empty), and the ops that lead from it to the next one.
  struct Stop {
    std::string name, place, through;
  };
  // Where something stops it. `shown` is the reason after the place, with the line and a caret under it.
  struct Mark {
    std::string place, reason, shown;
  };
  bool flows = false;
  std::string summary;                   // one sentence
  std::vector<std::vector<Stop>> paths;  // the few shortest, loss first
  size_t more_paths = 0;
  std::vector<Mark> clamps;  // where it is zero outside of limits
  std::vector<Mark> cuts;    // ways that carry nothing, also where others flow

  std::string text() const;  // all of it, for people
};

// Of an output or `let` (`loss`) with respect to a leaf or `let`; the second: why there is none. Precondition:
// program.lowered() is sound.
std::variant<ExplainedGradient, std::string> explain_gradient(Compilation& program, const std::string& loss,
                                                              const std::string& target);

}  // namespace dr::driver
