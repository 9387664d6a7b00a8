// SPDX-License-Identifier: Apache-2.0
// What commands took, as text.
#pragma once

#include <string>
#include <vector>

#include "runtime/jit/measure.h"
#include "runtime/runtime.h"

namespace dr::drun {

// A line for each command, the slowest first: its time and share, the bytes of all that it reads or writes, how many of
// them a nanosecond, the least time that the device's profile gives such a command, the lines of the program behind it.
std::string timing_table(const std::string& step, std::vector<runtime::CommandTime> times, const jit::Floor& floor);
// "fit.dr:3-5,9 std/loss.dr:12": neighbouring lines of a file together, a few of them.
std::string joined_lines(const std::vector<std::string>& lines);

}  // namespace dr::drun
