// SPDX-License-Identifier: Apache-2.0
// Names for the values that a program pins: `let y = pin(x);`. A device and the evaluator that replays its decisions
// know them by these.
#pragma once

#include <map>
#include <string>

#include "compiler/ir/graph.h"

namespace dr::ir {

// The Pin ops of the root, each with a name of its own: the user's name of the value or of what is pinned, else "pin";
// those that come later with the same name get _2, _3 and so on. Letters, digits and _ only. Pins inside regions have
// one value for each element and trip, and are not among them.
std::map<ValueId, std::string> pin_names(const Graph& graph);

}  // namespace dr::ir
