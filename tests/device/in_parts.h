// SPDX-License-Identifier: Apache-2.0
// Programs whose buffers are bound in parts, as those are that hold more than the device's bindings take.
#pragma once

#include <algorithm>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "runtime/runtime.h"
#include "tests/catch.h"
#include "tests/device/devices.h"

namespace dr::test {

// The program, and the bytes of a binding: the fewest, from `least` on, with which the device binds all parts. `bind`
// gives it its data; it is ready to run these steps, without the cache, so that all of it runs each time.
inline std::pair<runtime::Program, int64_t> load_in_parts(const runtime::Device& device,
                                                          const std::vector<uint8_t>& bundle,
                                                          const std::vector<std::string>& steps, int64_t least,
                                                          const std::function<void(runtime::Program&)>& bind) {
  for (int64_t bytes = least;; bytes *= 2) {
    auto program = must(runtime::Program::load(device, bundle, {.cache = false, .buffer_limit = bytes}));
    bind(program);
    const bool fits = std::ranges::all_of(steps, [&](const std::string& step) {
      const auto count = program.command_count(step);
      if (!count && count.error().find("are bound in parts") == std::string::npos) FAIL(count.error());
      return count.ok();
    });
    if (fits) return {std::move(program), bytes};
  }
}

}  // namespace dr::test
