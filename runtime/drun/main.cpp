// SPDX-License-Identifier: Apache-2.0
// drun: options -> calls -> exit code.
#include "runtime/drun/options.h"
#include "runtime/drun/runner.h"

int main(int argc, char** argv) {
  dr::drun::Options options;
  int exit_code = 0;
  if (!dr::drun::parse_options(argc, argv, options, exit_code)) return exit_code;
  return dr::drun::run(options);
}
