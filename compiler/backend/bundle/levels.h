// SPDX-License-Identifier: Apache-2.0
// Levels of commands: each stands one behind the last of those that it must wait for, for what it reads or writes.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <span>

namespace dr::bundle {

class Levels {
 public:
  struct Touch {
    uint32_t resource;
    bool writes;
  };

  // The level of the next command, from 0.
  size_t add(std::span<const Touch> command) {
    size_t own = 0;
    for (const Touch& t : command) own = std::max(own, t.writes ? behind_[t.resource].any : behind_[t.resource].write);
    for (const Touch& t : command) {
      Behind& behind = behind_[t.resource];
      if (t.writes) behind.write = own + 1;
      behind.any = std::max(behind.any, own + 1);
    }
    return own;
  }

  // The level behind all that touches it.
  size_t behind(uint32_t resource) const {
    const auto it = behind_.find(resource);
    return it == behind_.end() ? 0 : it->second.any;
  }

 private:
  struct Behind {
    size_t write = 0, any = 0;  // the levels behind its last write, and behind whatever touches it
  };
  std::map<uint32_t, Behind> behind_;
};

}  // namespace dr::bundle
