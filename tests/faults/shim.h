// SPDX-License-Identifier: Apache-2.0
// Faults on order: the n-th call of a kind fails, once. The library stands before libc and libstdc++ (linked first, or
// preloaded), and is a layer of Vulkan's loader; calls of drivers and of the loader are left alone.
#pragma once

#include <string>
#include <vector>

namespace dr::faults {

enum class Kind {
  Vulkan,  // calls that give a VkResult
  New,     // operator new
  File,    // calls that open, read, write, name or close files: an error
  Short,   // calls that read or write: less than asked for
};
inline constexpr int kKinds = 4;

// Counts the calls of each kind from 1; the one of number `at` fails, none for 0.
void arm(Kind kind, long at);
// Arms nothing, and tells calls apart by the stacks from which they come; then the number of the first call from each
// stack. A function that calls itself more often makes no other stack.
void watch_stacks(Kind kind);
std::vector<long> first_of_stacks();
// Whether calls count and fail: a test turns it off for what it does itself. It is on at first.
void set_watching(bool watching);
// How many calls there were; where none was to fail, the number of the last one that might have.
long seen(Kind kind);
// What failed since, "vkCreateBuffer"; empty when nothing did.
std::string failed();
// Vulkan objects that were made and not destroyed: "2 Buffer, 1 Fence".
std::string alive();

// For the layer and the calls: whether this call is to fail. Where it turns out that it may not, the next one does.
bool is_due(Kind kind, const char* name, bool (*may_fail)() = nullptr);

}  // namespace dr::faults
