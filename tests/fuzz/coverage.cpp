// SPDX-License-Identifier: Apache-2.0
// Compiled without the option that the rest has: the calls would call themselves.
#include "tests/fuzz/coverage.h"

#include <array>

namespace {

// A byte for each place that a call can return to, the instruction of a call being longer than four bytes; a bit in it
// for each of eight sorts of places before. Places that follow each other share a line of the processor's cache: this
// runs at every block. Not locked: a lost count costs nothing.
std::array<uint8_t, 1 << 24> reached;
dr::fuzz::Coverage found;
uintptr_t before = 0;

}  // namespace

namespace dr::fuzz {

Coverage coverage() { return found; }

}  // namespace dr::fuzz

// Where the linker put the first byte of the executable.
extern "C" const char __executable_start;

extern "C" void __sanitizer_cov_trace_pc() {
  const uintptr_t here =
      reinterpret_cast<uintptr_t>(__builtin_return_address(0)) - reinterpret_cast<uintptr_t>(&__executable_start);
  uint8_t& byte = reached[(here >> 2) % reached.size()];
  const auto bit = static_cast<uint8_t>(1u << (before * 0x9e3779b1u >> 13 & 7));
  before = here;
  if ((byte & bit) != 0) return;
  if (byte == 0) ++found.blocks;
  ++found.edges;
  byte |= bit;
}
