// SPDX-License-Identifier: Apache-2.0
// drun: options -> calls -> exit code.
#include <cstdio>
#include <new>

#include "runtime/drun/options.h"
#include "runtime/drun/runner.h"

int main(int argc, char** argv) {
  dr::drun::Options options;
  int exit_code = 0;
  try {
    if (!dr::drun::parse_options(argc, argv, options, exit_code)) return exit_code;
  } catch (const std::bad_alloc&) {
    std::fputs("drun: error: this machine has not enough memory\n", stderr);
    return 1;
  }
  return dr::drun::run(options);
}
