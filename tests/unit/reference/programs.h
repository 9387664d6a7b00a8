// SPDX-License-Identifier: Apache-2.0
// Programs that are larger than they are meaningful: for measuring, and for comparing runs.
#pragma once

#include <string>

namespace dr::reference_test {

// `count` element-wise ops over float[W, H, L], from the leaf "x" to the output "r" of the step "s".
std::string chain_program(int count);
// Sums, scatters and regions over float[W, H, L], whose results depend on the order of additions.
std::string mixed_program();

}  // namespace dr::reference_test
