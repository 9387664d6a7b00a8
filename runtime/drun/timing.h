// SPDX-License-Identifier: Apache-2.0
// What commands took, as text.
#pragma once

#include <string>
#include <vector>

#include "runtime/runtime.h"

namespace dr::drun {

// A line for each command, the slowest first: its time and share, its bytes a nanosecond, the lines of the program
// behind it.
std::string timing_table(const std::string& step, std::vector<runtime::CommandTime> times);
// "fit.dr:3-5,9 std/loss.dr:12": neighbouring lines of a file together, a few of them.
std::string joined_lines(const std::vector<std::string>& lines);
// "fit: 200 runs; commands 5,400 run and 600 left out; ops ...; bytes ...".
std::string counters_line(const std::string& step, const runtime::StepCounters& counters);
// "memory: 1200 bytes of the device and 300 of the host, 1500 at most; of the host's: photo".
std::string memory_line(const runtime::MemoryUse& use);

}  // namespace dr::drun
