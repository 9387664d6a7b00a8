// SPDX-License-Identifier: Apache-2.0
// How a benchmark ends that cannot go on: a line on stderr and exit code 1.
#pragma once

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <type_traits>
#include <utility>

#include "compiler/io/array/array.h"

namespace dr::benchmark {

[[noreturn]] inline void stop(const std::string& why) {
  std::fprintf(stderr, "%s: %s\n", program_invocation_short_name, why.c_str());
  std::exit(1);
}

// What a call gives; its error stops the benchmark.
template <class T>
T must(io::Result<T> result) {
  if (!result) stop(result.error());
  if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

}  // namespace dr::benchmark
