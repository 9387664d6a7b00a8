// SPDX-License-Identifier: Apache-2.0
// Compiled without the option that the rest has: the calls would call themselves.
#include "tests/fuzz/coverage.h"

#include <array>

namespace {

// One bit for each byte of code, one byte for each number of an edge. Not locked: a lost count costs nothing.
std::array<uint8_t, 1 << 23> blocks;
std::array<uint8_t, 1 << 22> edges;
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
  uint8_t& byte = blocks[(here >> 3) % blocks.size()];
  const auto bit = static_cast<uint8_t>(1u << (here & 7));
  if ((byte & bit) == 0) {
    byte |= bit;
    ++found.blocks;
  }
  uint8_t& edge = edges[(here ^ before * 0x9e3779b1u) % edges.size()];
  if (edge == 0) {
    edge = 1;
    ++found.edges;
  }
  before = here;
}
