// SPDX-License-Identifier: Apache-2.0
// drun: options -> calls -> exit code.
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <new>

#include "runtime/drun/options.h"
#include "runtime/drun/runner.h"

// mimalloc's, where it is linked.
extern "C" [[gnu::weak]] void mi_register_error(void (*handler)(int, void*), void* argument);

namespace {

// Where mimalloc finds no memory it would abort without a word.
void on_allocator_error(int error, void*) {
  if (error != ENOMEM) return;
  std::fputs("drun: error: this machine has not enough memory for the program's data\n", stderr);
  std::_Exit(1);
}

}  // namespace

int main(int argc, char** argv) {
  if (mi_register_error != nullptr) mi_register_error(on_allocator_error, nullptr);
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
