// SPDX-License-Identifier: Apache-2.0
// `drc check`: says what is wrong with a program and makes nothing.
#include "compiler/drc/command.h"
#include "compiler/drc/input.h"

namespace dr::drc {

int check(const InputOptions& options) { return load_graph(options) ? kOk : kUserError; }

}  // namespace dr::drc
