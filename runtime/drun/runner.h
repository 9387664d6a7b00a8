// SPDX-License-Identifier: Apache-2.0
// A run of drun: open the device, load or compile the program, bind, run, write results.
#pragma once

#include "runtime/drun/options.h"

namespace dr::drun {

// 0 well, 1 the user's or the device's mistake (told on stderr), 130 and 143 after SIGINT and SIGTERM, 124 after
// --timeout.
int run(const Options& options);

}  // namespace dr::drun
