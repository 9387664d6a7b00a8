// SPDX-License-Identifier: Apache-2.0
// The texts of the large programs.
#include "tests/unit/reference/programs.h"

namespace dr::reference_test {

std::string chain_program(int count) {
  static const char* const kOps[] = {"add %A, %B", "mul %A, %B", "sub %A, %B", "max %A, %B",
                                     "abs %A",     "sqrt %A",    "sin %A",     "div %A, %B"};
  std::string text = R"(
    leaf x : float[W, H, L] input
    leaf k : float[W] input
    %0 : float[W, H, L] = leaf text "x"
    %1 : float[W] = leaf text "k"
    %2 : float = const floats [0.75]
    %3 : float[W, H, L] = add %0, %1
)";
  for (int i = 4; i < 4 + count; ++i) {
    std::string op = kOps[static_cast<size_t>(i) % 8];
    op.replace(op.find("%A"), 2, "%" + std::to_string(i - 1));
    // The second operand: an image, a number or a row.
    const int second = i % 3 == 0 ? 2 : i % 5 == 0 ? 1 : i - 2 > 2 ? i - 2 : 0;
    if (const size_t at = op.find("%B"); at != std::string::npos) op.replace(at, 2, "%" + std::to_string(second));
    text += "%" + std::to_string(i) + " : float[W, H, L] = " + op + "\n";
  }
  return text + "step s {\noutput r %" + std::to_string(3 + count) + "\n}\n";
}

std::string mixed_program() {
  return R"(
    leaf x : vec3[W, H, L] input
    leaf n : int[W, H] input
    %0 : vec3[W, H, L] = leaf text "x"
    %1 : int[W, H] = leaf text "n"
    %2 : vec3 = reduce_sum %0 ints [1, 1, 1]
    %3 : vec3[W] = reduce_sum %0 ints [0, 1, 1]
    %4 : int = const floats [0]
    %5 : int = const floats [5]
    %6 : int = const floats [1]
    %7 : vec3[11, 1, 1] = scatter_add %1, %0 dims [11, 1, 1]
    %8 : vec3[W, H, L], %9 : vec3[W], %10 : vec3[3, 5] = reduce %4, %1 ints [-1] dims [W, H, L, W, 1, 1, 3, 5, 1] yields [sum, scatter, scatter] (%11 : int[W, H]) {
      %12 : int[W, H] = add %11, %1
      %13 : vec3[W, H, L] = mul %0, %0
      %14 : int[W, H] = mod %11, %5
      %15 : bool[W, H] = eq %14, %6
      %16 : accumulation vec3[3, 5], %17 : vec3[W, H, L] = if %15 dims [W, H, L, 3, 5, 1] yields [scatter, element] {
        %18 : ivec2[W, H] = compose %6, %14 ints [2, 1]
        yield %18, %13, %0
      } {
        %19 : accumulation vec3[3, 5] = reduce %14, %5 ints [-1] dims [W, H, L, 3, 5, 1] yields [scatter] (%20 : int[W, H]) {
          %21 : ivec2[W, H] = compose %4, %20 ints [2, 1]
          yield %21, %0
        }
        yield %19, %13
      }
      yield %17, %12, %13, %16
    }
    step s {
      output total %2
      output columns %3
      output scattered %7
      output sums %8
      output wide %9
      output deep %10
    })";
}

}  // namespace dr::reference_test
